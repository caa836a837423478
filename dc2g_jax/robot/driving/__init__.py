"""Vehicles: how they move, where they fit, sampled controls, and simulated episodes of many robots."""
