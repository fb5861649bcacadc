"""Architecture sweep of the denoised upscaler: variants of its network, trained alike, measured, run time on error."""
