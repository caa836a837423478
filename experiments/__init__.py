"""Experiments that repeat papers, compare planners and measure the package: `python -m experiments.NAME`."""

from dc2g_jax._src.cli import prepare

prepare()
