"""Training of the indoor network of Goel and others (2022): samples from journeys, losses, recipes."""
