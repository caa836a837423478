"""Frontiers and the planners built on them."""
