"""Writes the table of docs/lab/doctor.md, every mistake with the finding and plane that name it,
and the picture of docs/howto/doctor.md.

python -m tests.doctor.table
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from postfx.doctor.inspection import picture
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from tests.doctor.breakages import BREAKAGES

REPOSITORY = Path(__file__).resolve().parent.parent.parent
PAGE = REPOSITORY / "docs" / "lab" / "doctor.md"
PICTURE = REPOSITORY / "docs" / "images" / "doctor.jpg"
OPEN, CLOSE = "<!-- table -->", "<!-- end -->"
SHOWN = ("albedo with noise of 0.08", "normals in camera space", "1 / depth, misses 0",
         "motion y up", "smoothness")


def main() -> None:
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    sheet(list(read_sequence(REPOSITORY / "samples" / "room" / "noisy.####.exr",
                             frames="1-5"))).save(
        PICTURE, quality=85)


def with_table(page: str) -> str:
    """The page with the table as it is now."""
    rows = ["| mistake | finding | plane |", "| --- | --- | --- |",
            *(f"| {breakage.name} | `{breakage.code}` | {breakage.role} |"
              for breakage in BREAKAGES)]
    before, rest = page.split(OPEN)
    return "\n".join([before + OPEN, *rows, CLOSE]) + rest.split(CLOSE)[1]


def sheet(frames: list[Frame]) -> Image.Image:
    """Pictures of planes as they should be, and below them broken."""
    columns = []
    for name in SHOWN:
        breakage = next(breakage for breakage in BREAKAGES if breakage.name == name)
        role = Role(breakage.role)
        broken = breakage.apply(frames)
        assert broken is not None, "it is of these planes"
        columns.append(np.concatenate([labelled(frames[2], role, str(role)),
                                       labelled(broken[2], role, name)]))
    return Image.fromarray(np.concatenate(columns, axis=1))


def labelled(frame: Frame, role: Role, text: str) -> np.ndarray:
    image = Image.fromarray(picture(frame[role], role))
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, draw.textlength(text) + 9, 16), fill=(0, 0, 0))
    draw.text((5, 3), text, fill=(255, 255, 255))
    return np.asarray(image)


if __name__ == "__main__":
    main()
