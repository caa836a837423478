"""The command line: code shared by the commands in `experiments`."""
