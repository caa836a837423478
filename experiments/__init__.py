"""The commands of a checkout: `python -m experiments.NAME`, those of the package and those that measure it."""

import sys

from dc2g_jax._src.cli import commands

# The package's commands have their files there; here they only have their names.
__path__ += commands.__path__

if sys.argv[0] == "-m":  # so it is while `python -m` imports the package of the module that it runs
    commands.prepare()
