"""Datasets of houses (published, own or procedural), maps of any origin, and episode starts."""
