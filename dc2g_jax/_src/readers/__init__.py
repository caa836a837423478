"""Datasets of houses (published, own or procedural), episode starts, and training pairs."""
