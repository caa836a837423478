"""Cost-to-go estimators, their networks and checkpoints."""
