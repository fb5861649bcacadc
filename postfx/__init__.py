"""postfx: post-processing of rendered image sequences."""
