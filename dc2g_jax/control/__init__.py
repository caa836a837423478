"""How a robot moves: a vehicle, how it follows a path, and how it keeps clear of people."""
