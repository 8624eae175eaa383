"""Fitting what `chachart train` ships: draws of the simulator's channels, and networks."""
