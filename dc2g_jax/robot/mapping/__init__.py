"""Semantic maps from depth images with class labels (paper, section III-C), and a simulated camera."""
