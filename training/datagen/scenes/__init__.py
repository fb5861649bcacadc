"""Scenes for the data factory: procedural ones, converted real ones, cameras and motion."""
