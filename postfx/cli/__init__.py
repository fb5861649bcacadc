"""The command line: one file a verb."""

import os  # not pathlib, which would take a tenth of the time of --help
import sys

from postfx.version import DISTRIBUTION, pip_install


def find_namesake(site: str) -> str | None:
    """The other package 'postfx' of the index, name and version, where a folder of packages holds
    it: it has the same import name and command, and its files and ours replace each other."""
    for name in os.listdir(site):
        files = os.path.join(site, name, "RECORD")
        if name.startswith("postfx-") and name.endswith(".dist-info") and os.path.isfile(files):
            with open(files, encoding="utf-8", errors="replace") as lines:
                if any(line.startswith("postfx/imgio.py,") for line in lines):
                    return name.removesuffix(".dist-info").replace("-", " ")
    return None


_SITE = os.path.abspath(os.path.join(__file__, "../../.."))
if _namesake := find_namesake(_SITE):  # whichever was installed last: ours is not whole any more
    print(f"error: {_namesake}, another package of that name, shares the folder "
          f"{os.path.join(_SITE, 'postfx')} with {DISTRIBUTION}: pip uninstall postfx "
          f"{DISTRIBUTION}, then {pip_install()}", file=sys.stderr)
    sys.exit(2)
