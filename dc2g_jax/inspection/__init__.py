"""Figures, animations and rerun recordings."""
