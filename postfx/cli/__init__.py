"""The command line: one file a verb."""

import sys
from pathlib import Path

from postfx.version import DISTRIBUTION


def find_namesake(site: Path) -> str | None:
    """The other package 'postfx' of the index, name and version, where a folder of packages holds it: it has the same
    import name and command, and its files and ours replace each other."""
    for found in site.glob("postfx-*.dist-info"):
        files = found / "RECORD"
        if files.is_file() and "\npostfx/imgio.py," in "\n" + files.read_text(encoding="utf-8", errors="replace"):
            return found.name.removesuffix(".dist-info").replace("-", " ")
    return None


_SITE = Path(__file__).parents[2]
if _namesake := find_namesake(_SITE):  # whichever of both came last: what of us is left may still run, but is not whole
    print(f"error: {_namesake}, another package of that name, shares the folder {_SITE / 'postfx'} with "
          f"{DISTRIBUTION}: pip uninstall postfx {DISTRIBUTION}, then pip install {DISTRIBUTION}", file=sys.stderr)
    sys.exit(2)
