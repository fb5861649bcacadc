"""What a run leaves beside its frames, so that it can be checked, resumed, and not disturbed by another."""
