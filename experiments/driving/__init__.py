"""The whole loop from camera to door (section IV-D): a simulated vehicle that drives among pedestrians."""
