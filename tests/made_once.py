"""Files that take tests long to make: made once for all processes and runs, as long as their
sources stay the same."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from postfx.system import private_folder


def copy_made_once(name: str, sources: Iterable[Path], versions: str, make: Callable[[Path], None],
                   target: Path) -> None:
    """Fill a folder with copies of what ``make`` puts into one: now, or in an earlier run from the
    same sources."""
    digest = hashlib.sha256(versions.encode())
    for path in sorted(sources):
        digest.update(path.read_bytes())
    home = private_folder("tests")
    if home is None:
        make(target)
        return
    kept = home / f"{name}-{digest.hexdigest()[:32]}"
    with (home / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # others wait for the one that makes it
        if not kept.is_dir():
            with TemporaryDirectory(dir=home) as folder:
                made = Path(folder) / name
                made.mkdir()
                make(made)
                made.rename(kept)
    shutil.copytree(kept, target, dirs_exist_ok=True)
