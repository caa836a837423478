"""From camera to door: a vehicle that maps, plans and drives at once (paper, section IV-D)."""
