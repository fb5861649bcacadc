"""The OpenEXR format: containers, ZIP compression, and the passthrough of what a render holds beside the picture."""
