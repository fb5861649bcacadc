"""The toy training of docs/howto/train.md, by the page's own commands.

    python -m training.measure.toy [--folder FOLDER]

Runs each line of the block of code, and prints what it took of the processor, and the PSNR of
held-out clips where it trains.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE, SECTION = ROOT / "docs/howto/train.md", "## In a minute"
EXPORT = "export "


def lines_of(page: Path) -> list[str]:
    """The lines of the section's block of code. ValueError where the page has none."""
    section = page.read_text(encoding="utf-8").partition(SECTION)[2]
    found = re.search(r"```sh\n(.*?)```", section, re.DOTALL)
    if found is None:
        raise ValueError(f"{page.name} has no block of code below '{SECTION}'")
    return found[1].splitlines()


def busy() -> float:
    """Seconds of the processor that the children took which have ended."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime


def run(folder: Path) -> list[float]:
    """Run the lines in a folder; the held-out PSNR of each training, dB."""
    environment, quality = os.environ | {"PYTHONPATH": str(ROOT)}, []
    for line in lines_of(PAGE):
        if line.startswith(EXPORT):
            name, _, value = line.removeprefix(EXPORT).partition("=")
            environment[name] = value
            continue
        words, before = [sys.executable, *line.split()[1:]], busy()
        done = subprocess.run(words, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True,
                              check=True)
        told = re.findall(r"^validation (\{.*\})$", done.stdout, re.MULTILINE)
        quality += [json.loads(told[-1])["validation_psnr"]] if told else []
        held_out = f", held out {quality[-1]:.2f} dB" if told else ""
        print(f"{line.split()[2]}: {busy() - before:.1f} s of the processor{held_out}", flush=True)
    return quality


def main(words: list[str] | None = None) -> None:
    """Run the page's commands."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--folder", type=Path,
                        help="where clips and runs go (default: a temporary one)")
    given = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as temporary:
        run(given.folder or Path(temporary))


if __name__ == "__main__":
    main()
