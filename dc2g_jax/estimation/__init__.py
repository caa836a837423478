"""Cost-to-go estimators: networks, losses, training and checkpoints."""
