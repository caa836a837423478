"""Vehicles: how they move, follow paths and avoid people, and the drive from camera to door (section IV-D)."""
