"""Commands: options, calls, files. Run one with `dc2g NAME --help` or `python -m experiments.MODULE --help`."""

import sys

from dc2g_jax.cli.commands import prepare

if sys.argv[0] == "-m":  # so it is while `python -m` imports the package of the module that it runs
    prepare()
