"""Colour: primaries, transfer functions, displays and views, as plain NumPy. Kernels are held to what is written here."""
