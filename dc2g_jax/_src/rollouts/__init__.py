"""Many episodes at once, and what their results mean."""
