"""Folders of the user's own for what can be made anew: compiled kernels, optimised networks."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path


def private_folder(name: str) -> Path | None:
    """A folder that nobody else may write to, since what lies there is run: in the user's cache, else with the
    temporary files; None where neither can be had."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for base in (home / "postfx", Path(tempfile.gettempdir()) / f"postfx-{os.getuid()}"):
        folder = base / name
        try:
            base.parent.mkdir(parents=True, exist_ok=True)
            for part in (base, folder):
                part.mkdir(mode=0o700, exist_ok=True)
            if all(map(_is_private, (base, folder))) and os.access(folder, os.W_OK):
                return folder
        except OSError:
            continue
    return None


def _is_private(folder: Path) -> bool:
    """Whether a folder, and the link if it is one, is this user's, and not for everyone to write to."""
    status = folder.stat()
    return {status.st_uid, folder.lstat().st_uid} == {os.getuid()} and not status.st_mode & stat.S_IWOTH
