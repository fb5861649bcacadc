"""The version of the package: a file of its own, so that any module can write it into what it makes."""

__version__ = "0.1.0"
