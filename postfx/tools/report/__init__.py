"""Reports of runs and captures: pages, charts and JSON, and the comparison of two captures."""
