"""Writes the table and the picture of docs/doctor.md: every mistake, where it was tried, and what was said of it.

python -m tests.doctor.table        # sequences beside the checkout are used where they are there
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from postfx.doctor import examine
from postfx.doctor.findings import Finding
from postfx.doctor.material import Material
from postfx.doctor.pictures import picture
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from tests.doctor.breakages import BREAKAGES, Breakage

REPOSITORY = Path(__file__).resolve().parent.parent.parent
PAGE, PICTURE = REPOSITORY / "docs" / "doctor.md", REPOSITORY / "docs" / "images" / "doctor.jpg"
OPEN, CLOSE = "<!-- table -->", "<!-- end -->"
FOLDERS = {"room": REPOSITORY / "samples" / "room"} | {
    name: REPOSITORY.parent / "shared" / "sequences" / name for name in ("living_room", "staircase", "garage")}
SHOWN = ("albedo with noise of 0.08", "normals in camera space", "1 / depth, misses 0", "motion y up", "smoothness")


def main() -> None:
    sequences = {name: list(read_sequence(folder / "noisy.####.exr", frames="1-5"))
                 for name, folder in FOLDERS.items() if folder.is_dir()}
    rows = ["| mistake | sequence | finding | evidence |", "| --- | --- | --- | --- |"]
    for breakage in BREAKAGES:
        results = {name: found for name, frames in sequences.items() if (found := diagnosed(breakage, frames))}
        rows += rows_of(breakage, results)
        print(f"{breakage.name}: {', '.join(results)}", flush=True)
    before, rest = PAGE.read_text(encoding="utf-8").split(OPEN)
    PAGE.write_text("\n".join([before + OPEN, *rows, CLOSE]) + rest.split(CLOSE)[1], encoding="utf-8")
    sheet(sequences["room"]).save(PICTURE, quality=85)


def diagnosed(breakage: Breakage, frames: list[Frame]) -> list[Finding] | None:
    broken = breakage.apply(frames)
    return None if broken is None else examine(Material(broken))


def rows_of(breakage: Breakage, results: dict[str, list[Finding]]) -> list[str]:
    """A row for the first and the last sequence that can be broken so; the second says on how many it was found."""
    named = {name: next((f for f in found if f.code == breakage.code), None) for name, found in results.items()}
    count = f"found on {sum(map(bool, named.values()))} of {len(named)}"
    items = list(named.items())
    return [f"| {first} | {name.replace('_', ' ')} | {cells(finding)} |"
            for first, (name, finding) in zip((breakage.name, count), (items[0], items[-1]), strict=True)]


def cells(finding: Finding | None) -> str:
    return f"{finding.level} `{finding.code}` | {finding.evidence}" if finding else "**missed** | "


def sheet(frames: list[Frame]) -> Image.Image:
    """Pictures of planes as they should be, and below them broken."""
    columns = []
    for name in SHOWN:
        breakage = next(breakage for breakage in BREAKAGES if breakage.name == name)
        role = Role(breakage.role)
        broken = breakage.apply(frames)
        columns.append(np.concatenate([labelled(frames[2], role, str(role)), labelled(broken[2], role, name)]))
    return Image.fromarray(np.concatenate(columns, axis=1))


def labelled(frame: Frame, role: Role, text: str) -> np.ndarray:
    image = Image.fromarray(picture(frame[role], role))
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, draw.textlength(text) + 9, 16), fill=(0, 0, 0))
    draw.text((5, 3), text, fill=(255, 255, 255))
    return np.asarray(image)


if __name__ == "__main__":
    main()
