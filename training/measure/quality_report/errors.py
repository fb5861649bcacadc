"""What can go wrong."""


class ReportError(Exception):
    """The document or a file of the results is not as it must be; one line that names it."""


class Missing(Exception):
    """Data of a block was not measured; names the file."""
