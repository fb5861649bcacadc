"""Run time against error: methods measured side by side on a sequence with references."""
