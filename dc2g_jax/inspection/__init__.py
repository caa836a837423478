"""Looking inside: figures and rerun recordings."""
