"""What a robot has: its camera, the classes that it tells apart, its map, and costs on such maps."""
