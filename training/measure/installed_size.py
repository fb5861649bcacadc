"""Size of what an environment has installed, by package: what an installation of postfx takes on a
disk.

    python -m training.measure.installed_size ENVIRONMENT ...

An environment is the folder that `python -m venv` made, after `pip install` of the wheel. Prints
the space that its site-packages take in MB of 2^20 bytes, in all and for each package of 1 MB and
more, with the folder of libraries that it brings. Several environments are printed one after the
other.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

MB = 1 << 20
BLOCK = 512
"""Bytes that `st_blocks` counts in."""
INSTALLERS = {"pip", "setuptools", "pkg_resources", "_distutils_hack", "distutils"}
"""What every environment has before anything is installed, by Python's version."""


def sizes_of(site: Path) -> Counter[str]:
    """Bytes on the disk by package; files beside packages count as theirs."""
    found: Counter[str] = Counter()
    for entry in site.iterdir():
        paths = [entry, *entry.rglob("*")] if entry.is_dir() and not entry.is_symlink() else [entry]
        name = entry.name.partition(".")[0].partition("-")[0].lower()
        found[name] += sum(path.lstat().st_blocks * BLOCK for path in paths)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("environment", type=Path, nargs="+")
    for environment in parser.parse_args().environment:
        (site,) = environment.glob("lib/python*/site-packages")
        sizes = sizes_of(site)
        rest = sum(size for name, size in sizes.items() if name not in INSTALLERS)
        print(f"{environment.name}, {site.parent.name}: {sum(sizes.values()) / MB:.0f} MB, "
              f"{rest / MB:.0f} MB without pip and setuptools")
        for name, size in sizes.most_common():
            if size >= MB:
                print(f"  {name}: {size / MB:.0f}")


if __name__ == "__main__":
    main()
