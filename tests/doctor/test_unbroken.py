"""No false alarm: sequences as their renderers wrote them, and files that other people's software
wrote."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx.doctor.geometry import fit_rotation
from postfx.doctor.inspection import Inspection
from postfx.doctor.plane_checks import COSTS
from postfx.errors import ReadError
from postfx.frame import DEPTH_MISS, Frame, Role
from postfx.io.sequence import read_sequence
from tests.doctor import covers

REPOSITORY = Path(__file__).parent.parent.parent
ROOM = REPOSITORY / "samples" / "room"
CLIPS = REPOSITORY / "tests" / "training" / "measure" / "kinds"


def bad(source: Path, guides: Path | None = None) -> list[str]:
    found = Inspection(str(source), None, None, guides and str(guides)).findings
    return [f"{finding.code}: {finding.evidence}" for finding in found if finding.level == "error"]


def test_the_sample_is_fine():
    inspection = Inspection(str(ROOM / "noisy.####.exr"), None, None)
    assert inspection.findings == [] and inspection.exit_code == 0


def test_a_right_overlay_is_fine(room, diagnose):
    room = room[:2]
    assert diagnose(covers.over(covers.right)(room)) == diagnose(room)
    glow = covers.over(lambda overlay: overlay * (1, 1, 1, 0))
    assert diagnose(glow(room)) == diagnose(room)


def test_cameras_may_have_other_axes(room, diagnose):
    """z back, x right, y down."""
    for axes in ((-1, 1, -1), (-1, 1, 1), (-1, -1, 1)):
        turned = [replace(frame, world_to_camera=frame.world_to_camera @ np.diag([*axes, 1]))
                  for frame in room[:2]]
        assert diagnose(turned) == diagnose(room[:2]), axes
    inverted = [replace(f, planes={**f.planes, Role.NORMAL: -f[Role.NORMAL]}) for f in turned]
    assert "normal-inverted" in {finding.code for finding in diagnose(inverted)}


def test_a_backdrop_far_away_is_no_miss(room, diagnose):
    """A wall that faces the camera has one depth, and normals."""
    far = [replace(f, planes={**f.planes, Role.DEPTH: np.where(f[Role.DEPTH] < DEPTH_MISS,
                                                               f[Role.DEPTH], 1000)})
           for f in room[:1]]
    assert "depth-miss-far" in {finding.code for finding in diagnose(far)}
    facing = np.where(far[0][Role.DEPTH] == 1000, np.float32((0, 0, 1)), far[0][Role.NORMAL])
    wall = [replace(far[0], planes={**far[0].planes, Role.NORMAL: facing.astype(np.float32)})]
    assert "depth-miss-far" not in {finding.code for finding in diagnose(wall)}


def test_pixels_may_be_tall(room, diagnose):
    """Every other row of the sample: normals fit depth as before."""
    def tall(frame, aspect):
        planes = {role: np.ascontiguousarray(plane[::2]) for role, plane in frame.planes.items()}
        planes[Role.MOTION] = planes[Role.MOTION] * np.float32((1, 0.5))
        y = (frame.jitter[1] - 0.5) / 2  # of the upper one of two pixels
        return replace(frame, planes=planes, jitter=(frame.jitter[0], y),
                       metadata={"pixelAspectRatio": aspect})

    fits = [fit_rotation(tall(room[0], aspect)) for aspect in (0.5, 1.0)]
    assert fits[0].angle < 3 < fits[1].angle
    tall_room = [tall(frame, 0.5) for frame in room[:2]]
    assert not [found for found in diagnose(tall_room) if found.code.startswith("matrix")]


@pytest.mark.parametrize("name", ["garage", "mist", "water_1x4", "snow_1x16", *(
    pytest.param(name, marks=pytest.mark.soak)
    for name in ("doorway", "living_room", "staircase"))])
def test_sequences_have_no_error(shared_dir, name):
    folder = shared_dir / "sequences" / name
    guides = folder / "guides.####.exr" if list(folder.glob("guides.*.exr")) else None
    assert bad(folder / "noisy.####.exr", guides) == []


def test_wrong_motion_is_found_on_water_all_the_same(shared_dir, diagnose):
    """What is seen in waves and through them moves otherwise than they do, which is no fault."""
    water = read_sequence(str(shared_dir / "sequences" / "water_1x4" / "noisy.####.exr"))
    frames = [water.read(number) for number in water.numbers[:2]]
    negated = [replace(frame, planes={**frame.planes, Role.MOTION: -frame[Role.MOTION]})
               for frame in frames]
    assert "motion-sign" in {finding.code for finding in diagnose(negated)}


def clip_of(path: Path) -> list[Frame]:
    """Frames of a small clip of one kind of content."""
    clip, roles = np.load(path), [role for role in Role if f"v0_{role}" in np.load(path)]
    planes = [{role: clip[f"v0_{role}"][at].astype(np.float32).reshape(64, 64, -1)
               for role in roles}
              for at in range(4)]
    return [Frame(held, number=at + 1, reset=bool(clip["reset"][at]))
            for at, held in enumerate(planes)]


def test_no_kind_of_content_has_an_error(diagnose):
    """Fog, fur, leaves, defocus and motion blur, as Cycles writes them: their normals are means
    over samples."""
    averaged = set()
    for path in sorted(CLIPS.glob("*.npz")):
        found = diagnose(clip_of(path))
        assert not [(f.code, f.evidence) for f in found if f.level == "error"], path.name
        averaged |= {path.name.split(".")[0]
                     for f in found if f.code == "normal-averaged" and f.level == "info"}
    assert "fog" in averaged


def test_scaled_normals_are_no_means(diagnose):
    """Also where a few of them are means."""
    for name in ("product", "foliage"):
        frames = [replace(f, planes={**f.planes, Role.NORMAL: 0.5 * f[Role.NORMAL]})
                  for f in clip_of(CLIPS / f"{name}.2.npz")]
        assert "normal-length" in {finding.code
                                   for finding in diagnose(frames) if finding.level == "error"}


@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.soak)])
def test_collected_files_have_no_error(shared_dir, every):
    """All that can be read, which is all but deep data and subsampled channels."""
    read, refused, unread = {}, set(), {"representativeDeepImage.exr", "XYZ_YC.exr"}
    files = sorted([*shared_dir.glob("exr/*/*.exr"), *shared_dir.glob("hdr/*.exr")])
    some = [path for at, path in enumerate(files) if at % every == 0 or path.name in unread]
    for path in [*some, shared_dir / "exr" / "beachball" / "multipart.####.exr"]:
        try:
            read[path.name] = bad(path)
        except ReadError:
            refused.add(path.name)
    assert refused == unread and len(read) == len(some) - 1
    assert not any(read.values()), {name: found for name, found in read.items() if found}


def test_a_part_of_the_garage_has_no_error(shared_dir):
    """Frame 1 as a single part, as other software writes it again."""
    assert bad(shared_dir / "sequences" / "garage" / "interleaved.0001.exr") == []


def test_costs_are_those_of_the_quality_page():
    text = (REPOSITORY / "docs" / "lab" / "quality.md").read_text(encoding="utf-8")
    names = {Role.DIFFUSE_ALBEDO: "diffuse albedo", Role.SPECULAR_ALBEDO: "specular albedo"}
    for role, cost in COSTS.items():
        (row,) = re.findall(rf"^\| {names.get(role, str(role))} \| (.*dB, flicker.*)$", text,
                            re.MULTILINE)
        losses = [-float(loss) for loss in re.findall(r"([+-]?[\d.]+) dB", row)]
        assert (min(losses), max(losses)) == pytest.approx(cost)
