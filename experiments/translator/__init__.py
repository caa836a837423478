"""The image-to-image translator of the first paper: its data, training and evaluation."""
