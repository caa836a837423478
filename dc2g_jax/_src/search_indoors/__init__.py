"""Search for objects indoors: houses, semantic maps, costs of the path to an object, and control."""
