"""Whether a chain of passes applies its exposure, and what a tone mapper makes of it."""
