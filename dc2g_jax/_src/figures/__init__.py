"""Figures, animations, and the replays that they show."""
