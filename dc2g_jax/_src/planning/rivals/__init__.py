"""Planners after other papers, one file each, to compare with: `dc2g compare` runs them all."""
