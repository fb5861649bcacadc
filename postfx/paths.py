"""Where the files that ship beside the code are."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def models_dir() -> Path:
    """Folder of the model packages (*.onnx + *.json): inside an installed wheel, or `models/` of a checkout."""
    packaged = _PACKAGE / "_models"
    return packaged if packaged.is_dir() else _PACKAGE.parent / "models"


def is_plain_name(name: str) -> bool:
    """Whether a file's name has no folder in it."""
    return bool(name) and name not in (".", "..") and not set(name) & set("/\\\0")
