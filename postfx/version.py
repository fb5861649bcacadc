"""What the package is called and which version it is: a file of its own, so that any module can write it."""

__version__ = "0.2.0"
DISTRIBUTION = "postfx-render"
"""Name on the package index, where the name postfx is another project's."""


def pip_install(extra: str) -> str:
    """The command that installs what an extra of this package needs."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"
