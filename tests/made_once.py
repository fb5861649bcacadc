"""Files that take tests long to make: made once for all processes and runs, as long as their
sources stay the same."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from postfx.compiled import build, library
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


def compile_levels() -> None:
    """Our whole library for each level of this processor: tests of levels would compile its kernels
    one by one. Objects are kept for other checkouts of the same sources."""
    target, levels = build.this_target(), library.levels()
    objects, home = build.PACKAGED / target / "objects", private_folder("tests")
    if home is None:
        build.build(build.our_units(), target, objects.parent, levels)
        return
    kept = home / "objects"
    for folder in (kept, objects):
        folder.mkdir(parents=True, exist_ok=True)
    with (home / "objects.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _copy_missing(kept, objects)
        build.build(build.our_units(), target, objects.parent, levels)
        _copy_missing(objects, kept)
    library._whole_library.cache_clear()


def _copy_missing(source: Path, target: Path) -> None:
    """Objects of our files as they are now."""
    wanted = {build.digest_of([unit], build.this_target()) for unit in build.our_units()}
    for path in source.glob("*.o"):
        if path.name.partition("-")[0] in wanted and not (target / path.name).exists():
            shutil.copyfile(path, target / path.name)
