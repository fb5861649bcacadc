"""No false alarm: sequences as their renderers wrote them, and files that other people's software wrote."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.inspection import Inspection
from postfx.doctor.checks.planes import COSTS
from postfx.doctor.geometry import fit_rotation
from postfx.errors import ReadError
from postfx.frame import Role
from tests.doctor import covers

REPOSITORY = Path(__file__).parent.parent.parent
ROOM = REPOSITORY / "samples" / "room"


def bad(source: Path, guides: Path | None = None) -> list[str]:
    found = Inspection(str(source), None, None, guides and str(guides)).findings
    return [f"{finding.code}: {finding.evidence}" for finding in found if finding.level == "error"]


def test_the_sample_is_fine():
    inspection = Inspection(str(ROOM / "noisy.####.exr"), None, None)
    assert inspection.findings == [] and inspection.exit_code == 0


def test_a_right_overlay_is_fine(room, diagnose):
    assert diagnose(covers.over(covers.right)(room)) == diagnose(room)
    glow = covers.over(lambda overlay: overlay * (1, 1, 1, 0))
    assert diagnose(glow(room)) == diagnose(room)


@pytest.mark.parametrize("axes", [(-1, 1, -1), (-1, 1, 1), (-1, -1, 1)], ids=["z back", "x right", "y down"])
def test_cameras_may_have_other_axes(room, diagnose, axes):
    turned = [replace(frame, world_to_camera=frame.world_to_camera @ np.diag([*axes, 1])) for frame in room]
    assert diagnose(turned) == diagnose(room)
    inverted = [replace(f, planes={**f.planes, Role.NORMAL: -f[Role.NORMAL]}) for f in turned]
    assert "normal-inverted" in {finding.code for finding in diagnose(inverted)}


def test_pixels_may_be_tall(room, diagnose):
    """Every other row of the sample: normals fit depth as before."""
    def tall(frame, aspect):
        planes = {role: np.ascontiguousarray(plane[::2]) for role, plane in frame.planes.items()}
        planes[Role.MOTION] = planes[Role.MOTION] * np.float32((1, 0.5))
        y = (frame.jitter[1] - 0.5) / 2  # of the upper one of two pixels
        return replace(frame, planes=planes, jitter=(frame.jitter[0], y), metadata={"pixelAspectRatio": aspect})

    fits = [fit_rotation(tall(room[0], aspect)) for aspect in (0.5, 1.0)]
    assert fits[0].angle < 3 < fits[1].angle
    assert not [found for found in diagnose([tall(frame, 0.5) for frame in room]) if found.code.startswith("matrix")]


@pytest.mark.parametrize("name", ["living_room", "staircase", "garage"])
def test_sequences_have_no_error(shared_dir, name):
    folder = shared_dir / "sequences" / name
    assert bad(folder / "noisy.####.exr") == []
    if list(folder.glob("guides.*.exr")):
        assert bad(folder / "noisy.####.exr", folder / "guides.####.exr") == []


def test_collected_files_have_no_error(shared_dir):
    """All that can be read, which is all but deep data and subsampled channels."""
    read, refused = {}, set()
    files = [*shared_dir.glob("exr/*/*.exr"), *shared_dir.glob("hdr/*.exr")]
    for path in [*sorted(files), shared_dir / "exr" / "beachball" / "multipart.####.exr"]:
        try:
            read[path.name] = bad(path)
        except ReadError:
            refused.add(path.name)
    assert refused == {"representativeDeepImage.exr", "XYZ_YC.exr"} and len(read) == len(files) - 1
    assert not any(read.values()), {name: found for name, found in read.items() if found}


def test_a_part_of_the_garage_has_no_error(shared_dir):
    """Frame 1 as a single part, as other software writes it again."""
    assert bad(shared_dir / "sequences" / "garage" / "interleaved.0001.exr") == []


def test_costs_are_those_of_the_quality_page():
    text = (REPOSITORY / "docs" / "quality.md").read_text(encoding="utf-8")
    names = {Role.DIFFUSE_ALBEDO: "diffuse albedo", Role.SPECULAR_ALBEDO: "specular albedo"}
    for role, cost in COSTS.items():
        (row,) = re.findall(rf"^\| {names.get(role, str(role))} \| (.*dB, flicker.*)$", text, re.MULTILINE)
        losses = [-float(loss) for loss in re.findall(r"([+-]?[\d.]+) dB", row)]
        assert (min(losses), max(losses)) == pytest.approx(cost)
