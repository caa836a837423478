"""Grids: terrain classes, packed cell sets, worlds, sensing and search; belief, `reset` and `step`."""
