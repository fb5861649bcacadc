"""Denoising in reverse order, so that a frame gains from later frames as well as from earlier ones.

Imports nothing, so that training can use reversed motion on machines that cannot read pictures.
"""
