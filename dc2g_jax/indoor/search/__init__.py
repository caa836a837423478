"""Searches: a robot and its guides, simulated or real, and what came of them."""
