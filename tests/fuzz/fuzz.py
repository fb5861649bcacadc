"""Coverage-guided fuzzing of one target: `python tests/fuzz/fuzz.py TARGET [SECONDS] [REPRODUCER]`.

Ends with an error when a target raises anything but PostfxError, takes more than 10 seconds for one input or more than
2 GiB in all, or ends the process; the input is written to the folder of POSTFX_FUZZ_OUT (by default where it runs).
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

WATCHED = ["postfx.io", "postfx.masks", "postfx.cli.run_options", "postfx.system", "postfx.files", "postfx.runs",
           "postfx.passes.tonemap", "postfx.runtime.models",
           "postfx.runtime.model_file"]

KERNELS = Path(__file__).resolve().parents[2] / "postfx/kernels"
COMPILED = [f"postfx.kernels.{source.stem}" for source in KERNELS.glob("*.py")]  # Numba knows no marks of coverage

with atheris.instrument_imports(include=WATCHED, exclude=COMPILED):
    from tests.fuzz import targets

from postfx.errors import PostfxError  # noqa: E402

SECONDS, LONGEST_S, MOST_MB, LONGEST_INPUT = 5, 10, 2048, 1 << 16


def main(name: str, seconds: str = str(SECONDS), reproducer: str | None = None) -> None:
    target = targets.TARGETS[name]

    def attempt(content: bytes) -> None:
        try:
            target(content)
        except PostfxError as error:
            assert str(error), "an error without a word"

    folder = Path(tempfile.mkdtemp(prefix="postfx-corpus-"))
    targets.seeds(name, folder)
    out = os.environ.get("POSTFX_FUZZ_OUT", ".")
    limits = [f"-max_total_time={seconds}", f"-timeout={LONGEST_S}", f"-rss_limit_mb={MOST_MB}",
              f"-max_len={LONGEST_INPUT}", f"-artifact_prefix={out}/", "-print_final_stats=1", "-close_fd_mask=0"]
    atheris.Setup([sys.argv[0], *limits, reproducer or str(folder)], attempt)
    try:
        atheris.Fuzz()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(targets.FOLDER, ignore_errors=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
