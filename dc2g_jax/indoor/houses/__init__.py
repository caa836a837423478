"""Houses: floor plans drawn or read from files, furnished, as grids of cells."""
