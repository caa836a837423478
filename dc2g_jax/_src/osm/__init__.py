"""Maps from OpenStreetMap extracts: reading them, drawing their classes, and adding doors, driveways and walks."""
