"""Reports of what ran: a capture as a page and as JSON, and the comparison of two captures."""
