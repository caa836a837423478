"""Object goals indoors: houses, the map of what stands in them, the cost of the way to it, and control."""
