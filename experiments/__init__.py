"""Commands: options, calls, files. Run one with `python -m experiments.NAME --help`."""
