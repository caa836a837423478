"""Networks that predict costs from partial maps, and their training."""
