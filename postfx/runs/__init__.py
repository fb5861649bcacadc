"""Records that a run keeps beside its frames, to check it, resume it and protect it from other
runs."""
