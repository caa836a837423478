"""Images and tables, read strictly and written atomically; files that the package ships."""
