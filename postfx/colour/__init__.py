"""Colour: primaries, transfer functions, displays and views, as plain NumPy that kernels are held to."""
