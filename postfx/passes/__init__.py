"""The passes: one file each, found through the entry-point group `postfx.passes`."""
