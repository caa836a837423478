"""Studies of the notebook."""
