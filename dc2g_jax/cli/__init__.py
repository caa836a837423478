"""The command line: what the commands in `experiments` share."""
