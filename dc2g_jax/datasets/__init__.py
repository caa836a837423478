"""Houses on disk, houses drawn procedurally, and training pairs made from them."""
