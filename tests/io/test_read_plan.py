"""A frame whose headers are like those of one before is not matched again, and is read like a frame
alone."""

from collections.abc import Iterator

import numpy as np
import pytest

from postfx.frame import Role
from postfx.io import read_plan
from postfx.io.sequence import Sequence, read_sequence

PLANES = ("R", "G", "B", "normal.X", "normal.Y", "normal.Z", "depth.Z", "motion.X", "motion.Y")
CAMERA_SPACE = (
    'name = "cam"\nextends = "generic"\n[[plane]]\nrole = "normal"\nnames = ["normal"]\n'
    'channels = ["XYZ"]\nspace = "camera"\n[header]\nexposure = ["lit"]\njitter = ["jitter"]\n'
    'world_to_camera = ["worldToCamera"]\n'
)
TURN = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [1, 2, 3, 1]], np.float32)


@pytest.fixture
def matched(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """One entry for each frame that is matched."""
    found: list[int] = []

    class Counted(read_plan.Planner):
        def __init__(self, *given: object) -> None:
            found.append(1)
            super().__init__(*given)

    monkeypatch.setattr("postfx.io.frame_reader.Planner", Counted)
    return found


def are_alike(frames: Sequence, path: str, **options: str) -> None:
    """Every frame of a sequence is the frame that it is when it is read alone."""
    for number in frames.numbers:
        got, alone = frames.read(number), read_sequence(path, [number], **options).read(number)
        assert (
            list(got.planes) == list(alone.planes) and got.metadata.keys() == alone.metadata.keys()
        )
        for role in got.planes:
            np.testing.assert_array_equal(got[role], alone[role])
        facts = [(frame.exposure, frame.jitter, frame.source, frame.colour_source.attributes["lit"])
                 for frame in (got, alone)]
        assert facts[0] == facts[1]


def test_headers_that_are_alike_are_matched_once(write_exr, ramp, tmp_path, matched):
    (tmp_path / "cam.toml").write_text(CAMERA_SPACE)
    for number in range(1, 7):
        turn = {"worldToCamera": np.roll(TURN, number, 0).ravel()} if number != 5 else {}
        channels = ramp(*PLANES, *(["extra.Y"] if number == 4 else []))
        write_exr(
            f"a.{number:04d}.exr", channels, lit=0.5 * number, jitter=(0.1 * number, 0.0), **turn
        )
    path, options = str(tmp_path / "a.####.exr"), {"profile": str(tmp_path / "cam.toml")}
    frames = read_sequence(path, **options)
    numbers = []
    for number in frames.numbers:
        frame = frames.read(number)
        numbers.append((len(matched), Role.NORMAL in frame, frame.exposure))
    # The second frame has the area of the first, the fourth another channel, the fifth no camera
    # for its normals.
    assert [count for count, *_ in numbers] == [1, 2, 2, 3, 4, 5]
    assert [held for _, held, _ in numbers] == [True, True, True, True, False, True]
    # This profile takes a factor from the header, as versions before wrote it.
    factors = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    assert [told for *_, told in numbers] == pytest.approx(np.log2(factors))
    are_alike(frames, path, **options)


def test_guides_in_files_of_their_own_are_matched_once(write_exr, ramp, tmp_path, matched):
    drawn = ramp("albedo.R", "albedo.G", "albedo.B").items()
    large = {name: np.repeat(np.repeat(plane, 2, 0), 2, 1) / 16 for name, plane in drawn}
    for number in range(1, 5):
        write_exr(f"a.{number:04d}.exr", ramp("R", "G", "B"))
        write_exr(f"g.{number:04d}.exr", {name: number * plane for name, plane in large.items()})
    frames = read_sequence(str(tmp_path / "a.####.exr"), guides=str(tmp_path / "g.####.exr"))
    for number in frames.numbers:
        (guide,) = frames.read(number).guides.values()
        np.testing.assert_array_equal(guide[..., 0], number * large["albedo.R"])
    assert len(matched) == 3, (
        "the first frame and its guides, and the second, which has the first one's area"
    )
