"""What the package is called, which version it is and how it is installed: a file of its own, so
that any module can write it."""

__version__ = "0.2.0"
DISTRIBUTION = "postfx-render"
"""Name for the package index, where the name postfx is another project's."""
IS_PUBLISHED = False
"""Whether the package index has it. Until then messages and documents name a checkout or a
wheel."""
PUBLISHER = "OWNER"
"""The account that publishes it, in conda-forge's recipe and ComfyUI's registry: to be set with
IS_PUBLISHED."""


def pip_install(extra: str = "") -> str:
    """How to install this package, or what an extra of it needs."""
    wanted = f"[{extra}]" if extra else ""
    if IS_PUBLISHED:
        return f"pip install '{DISTRIBUTION}{wanted}'"
    return f"pip install '.{wanted}' in a checkout of postfx, or 'FILE.whl{wanted}' with its wheel"
