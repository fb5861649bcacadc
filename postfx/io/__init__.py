"""Frames from and to files."""
