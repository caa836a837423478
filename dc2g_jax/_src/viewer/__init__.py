"""Recordings for the rerun viewer: episodes, object searches, mapping, training."""
