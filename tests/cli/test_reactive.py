"""`--reactive` of `postfx run`, and what `postfx inspect` says about its planes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx import Role, integrate, read_sequence

ROOM = Path(__file__).resolve().parents[2] / "samples" / "room" / "noisy.####.exr"


@pytest.fixture
def smoke(tmp_path: Path) -> None:
    """in/shot.0001.exr to 0003.exr: a corner of a room with a bright spot that flies, and the
    colour without it."""
    for frame in read_sequence(ROOM, frames="1-3"):
        planes = {role: plane[40:100, 60:150] for role, plane in frame.planes.items()}
        colour = planes[Role.COLOUR].copy()
        colour[20:24, 15 * frame.number:15 * frame.number + 4] += 5
        planes |= {Role.COLOUR: colour, Role.OPAQUE_COLOUR: planes[Role.COLOUR]}
        integrate.write_planes(tmp_path / f"in/shot.{frame.number:04d}.exr",
                               replace(frame, planes=planes))


def test_the_plan_tells_how_the_mask_is_made(postfx, smoke):
    done = postfx("run", "in/", "--explain")
    assert "reactive mask from the difference of colour and opaque_colour: times 4" in done.out
    done = postfx("run", "in/", "--explain", "--reactive", "none")
    assert ("skips   AOV 'opaque_colour': no pass reads it" in done.out and "reactive "
            "mask" not in done.out)


def test_the_mask_changes_what_was_left_behind(postfx, smoke, tmp_path):
    for kind in ("none", "auto,threshold=0.02"):
        run = ("run", "in/", "-o", f"{kind[:4]}/####.exr", "--model", "s", "--scale", "2",
               "--reactive", kind)
        assert postfx(*run).code == 0
    without, masked = (next(iter(read_sequence(tmp_path / kind, "3")))[Role.COLOUR]
                       for kind in ("none", "auto"))
    assert np.abs(masked - without)[40:48, 60:68].max() > 0.05


@pytest.mark.parametrize(("given", "said"),
                         [("plane", "needs AOV 'reactive'"), ("auto,cut=2", "unknown 'cut'")])
def test_what_cannot_be_is_an_error(postfx, smoke, given, said):
    done = postfx("run", "in/", "-o", "out/####.exr", "--reactive", given)
    assert done.code == 2 and said in done.err


def test_the_doctor_names_the_planes(postfx, smoke):
    roles = postfx("inspect", "in/", "--json").json["roles"]
    assert roles["opaque_colour"]["planes"] == [f"opaque_colour.{letter}" for letter in "RGB"]
    assert roles["reactive"]["planes"] == []
