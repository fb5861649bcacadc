"""Frames in reverse order, so that a frame gains from the frames after it as it does from those before it.

Imports nothing: reversed motion alone serves training, on machines that cannot read pictures.
"""
