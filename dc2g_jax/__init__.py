"""Planning toward a goal nobody has mapped: Deep Cost-to-Go (DC2G) training and batch evaluation in JAX."""
