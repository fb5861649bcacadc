"""Colour: primaries, transfer functions, displays and views, in plain NumPy, which kernels are tested against."""
