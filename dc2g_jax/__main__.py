"""`python -m dc2g_jax NAME OPTIONS` is `dc2g NAME OPTIONS`."""

from dc2g_jax._src.cli.commands import main

main()
