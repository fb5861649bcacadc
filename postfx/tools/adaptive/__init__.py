"""Where a shot needs more samples: the error of its denoised frames, and how many samples bring it
to a quality."""
