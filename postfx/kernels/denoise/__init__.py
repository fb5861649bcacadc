"""Kernels of the denoised upscaler, each family with its CUDA source beside it."""
