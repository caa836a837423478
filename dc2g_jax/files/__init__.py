"""Files that people and other programs write: images and tables, read strictly, and written whole."""
