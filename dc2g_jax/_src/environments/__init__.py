"""Reinforcement-learning environments of the search for a front door, for JAX and for Gymnasium."""
