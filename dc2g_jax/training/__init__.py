"""Training of cost-to-go networks: data, losses, steps, sweeps."""
