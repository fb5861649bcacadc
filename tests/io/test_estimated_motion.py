"""Motion that is estimated from planes, against a camera over traced walls whose true motion is
known."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.main import main
from postfx.errors import FrameError, SequenceError
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.motion.estimated import motion_of, picture_of
from tests.integrate.pinhole import hit_plane, hit_sphere, turned

HEIGHT, WIDTH = 108, 192
FOCAL = WIDTH / 2 / np.tan(np.radians(60) / 2)
FLOOR, WALL = (np.zeros(3), np.array([0.0, 1, 0])), (np.array([0.0, 0, 5]), np.array([0.0, 0, -1]))
EYE, AXES = np.array([0.0, 1.4, -3.0]), turned(0.0, -0.3)
BALL, RADIUS = np.array([0.3, 0.6, 0.2]), 0.4


def trace(
    eye: np.ndarray, axes: np.ndarray, ball: np.ndarray = BALL,
    jitter: tuple[float, float] = (0, 0), seed: int = 0
) -> tuple[Frame, np.ndarray, np.ndarray]:
    """A frame of a ball over a floor before a wall, all textured by `seed`; its points, and which
    are the ball's."""
    x = (np.arange(WIDTH) + 0.5 + jitter[0] - WIDTH / 2) / FOCAL
    y = (HEIGHT / 2 - (np.arange(HEIGHT) + 0.5 + jitter[1])) / FOCAL
    rays = x[None, :, None] * axes[0] + y[:, None, None] * axes[1] + axes[2]
    hits = np.stack([hit_plane(eye, rays, *FLOOR), hit_plane(eye, rays, *WALL),
                     hit_sphere(eye, rays, ball, RADIUS)])
    depth, shape = hits.min(0), hits.argmin(0)
    points = eye + rays * depth[..., None]
    local = np.where(shape[..., None] == 2, points - ball, points)
    rng = np.random.default_rng(seed)
    waves = [np.sin(local @ rng.normal(0, 6, 3) + rng.uniform(0, 6)) for _ in range(6)]
    albedo = np.repeat((0.4 + 0.06 * np.sum(waves, 0))[..., None], 3, -1)
    normal = np.select([shape[..., None] == 0, shape[..., None] == 1], [FLOOR[1], WALL[1]],
                       (points - ball) / RADIUS)
    planes = {Role.COLOUR: albedo, Role.DIFFUSE_ALBEDO: albedo, Role.NORMAL: normal,
              Role.DEPTH: depth[..., None]}
    return Frame({role: np.ascontiguousarray(plane, np.float32) for role, plane in planes.items()},
                 jitter=jitter), \
        points, shape == 2


def seen_at(points: np.ndarray, eye: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Pixel positions of points, jitter apart."""
    x, y, z = np.moveaxis((points - eye) @ axes.T, -1, 0)
    return np.stack([WIDTH / 2 + FOCAL * x / z, HEIGHT / 2 - FOCAL * y / z], -1)


def errors(motion: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Of pixels that were in the picture and lie away from its rim."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    there = np.stack([x, y], -1) + truth
    inside = ((there > 4) & (there < (WIDTH - 5, HEIGHT - 5))).all(-1)
    return np.where(inside, np.linalg.norm(motion - truth, axis=-1), np.nan)


BEFORE = EYE - [0.12, 0.03, 0.15], turned(-0.02, -0.31)


@pytest.mark.parametrize("jitter", [((0, 0), (0, 0)), ((0.4, -0.3), (-0.4, 0.35))],
                         ids=["steady", "jitter"])
def test_a_camera_that_moves(jitter: tuple[tuple[float, float], tuple[float, float]]) -> None:
    now, points, _ = trace(EYE, AXES, jitter=jitter[0])
    before, *_ = trace(*BEFORE, jitter=jitter[1])
    truth = seen_at(points, *BEFORE) - seen_at(points, EYE, AXES)
    assert np.median(np.linalg.norm(truth, axis=-1)) > 4
    missed = errors(motion_of(now, before), truth)
    assert np.nanmedian(missed) < 0.06 and np.nanquantile(missed, 0.95) < 0.2
    del now.planes[Role.DEPTH]
    assert np.nanmedian(errors(motion_of(now, before), truth)) < 0.5, "by flow alone"


def test_a_thing_that_moves_keeps_its_own_motion() -> None:
    now, points, ball = trace(EYE, AXES)
    step = np.array([0.05, 0.25, 0.0])
    before, *_ = trace(*BEFORE, ball=BALL - step)
    truth = seen_at(points - np.where(ball[..., None], step, 0), *BEFORE) - seen_at(points, EYE,
                                                                                    AXES)
    missed = errors(motion_of(now, before), truth)
    assert np.nanmedian(missed[~ball]) < 0.06, "the camera's, whatever the ball does"
    assert np.nanmedian(missed[ball]) < 1, "by flow"
    camera = seen_at(points, *BEFORE) - seen_at(points, EYE, AXES)
    assert np.median(np.linalg.norm(camera - truth, axis=-1)[ball]) > 5


def test_a_lamp_that_is_written_as_albedo_does_not_outshine_the_picture() -> None:
    def picture(lamp: float) -> np.ndarray:
        albedo = np.full((32, 32, 3), 0.5, np.float32)
        albedo[8:12, 8:12] = lamp
        return picture_of(Frame({Role.COLOUR: albedo, Role.DIFFUSE_ALBEDO: albedo})).values

    np.testing.assert_array_equal(picture(1000.0), picture(1.5))
    assert (picture(1.5) > picture(1.0)).any()


def test_zero_at_rest_at_a_cut_and_without_a_frame_before() -> None:
    now, *_ = trace(EYE, AXES)
    rng = np.random.default_rng(1)
    noisy = [Frame({role: plane + rng.normal(0, 0.01, plane.shape).astype(np.float32)
                    for role, plane in trace(EYE, AXES, jitter=jitter)[0].planes.items()},
                   jitter=jitter)
             for jitter in ((0, 0), (0, 0), (0.3, -0.2))]
    other, *_ = trace(EYE + [0.5, 0.8, 1.0], turned(0.8, 0.2), ball=BALL + 9, seed=5)
    small = Frame({Role.NORMAL: np.zeros((8, 8, 3), np.float32)})
    pairs = {"same": (now, now), "noise": tuple(noisy[:2]), "noise, jitter": (noisy[2], noisy[0]),
             "cut": (now, other), "first": (now, None), "another size": (now, small),
             "tiny": (small, small)}
    for why, (frame, before) in pairs.items():
        assert not motion_of(frame, before).any(), why
    for frame in noisy:
        del frame.planes[Role.DEPTH]
    assert not motion_of(noisy[1], noisy[0]).any(), "noise without depth"
    with pytest.raises(FrameError,
                       match="cannot be estimated without one of the AOVs diffuse_albedo, normal"):
        motion_of(Frame({Role.COLOUR: now[Role.COLOUR]}), None)


@pytest.fixture
def walk(write_exr: Callable[..., Path]) -> str:
    """Four frames on the disk: in.####.exr without motion, zero.####.exr with zeros, some.####.exr
    with no vector on the left and one of (5, 5) on the right."""
    names = {Role.COLOUR: ("R", "G", "B"),
             Role.DIFFUSE_ALBEDO: ("albedo.R", "albedo.G", "albedo.B"),
             Role.NORMAL: ("normal.X", "normal.Y", "normal.Z"), Role.DEPTH: ("depth.Z",)}
    for number in range(1, 5):
        frame, *_ = trace(EYE + [0.1 * number, 0, 0.05 * number], AXES)
        stored = {name: frame[role][..., k] for role, some in names.items()
                  for k, name in enumerate(some)}
        path = write_exr(f"in.{number:04d}.exr", stored)
        write_exr(f"zero.{number:04d}.exr",
                  stored | {name: 0 * stored["R"] for name in ("motion.X", "motion.Y")})
        some = np.where(np.arange(WIDTH) < WIDTH // 2, 1e10, 5.0) + 0 * stored["R"]
        write_exr(f"some.{number:04d}.exr", stored | dict.fromkeys(("motion.X", "motion.Y"), some))
    return str(path.with_name("in.####.exr"))


def test_a_sequence_estimates_motion_whatever_was_read_before(walk: str) -> None:
    shot = read_sequence(walk, motion="auto")
    with shot.open(3) as files:
        spec = files.spec()
    frames = list(shot)
    assert frames[2].spec == spec and Role.MOTION in spec.roles
    assert not frames[0][Role.MOTION].any() and np.abs(frames[2][Role.MOTION]).mean() > 1
    assert sum("motion is estimated" in text for text in shot.warnings) == 1
    alone = read_sequence(walk, "3", motion="estimate").read(3, (Role.COLOUR, Role.MOTION))
    assert list(alone.planes) == [Role.COLOUR, Role.MOTION], "what is only looked at is not kept"
    for own in (alone, read_sequence(walk, "4,3,2", motion="auto").read(3)):
        np.testing.assert_array_equal(own[Role.MOTION], frames[2][Role.MOTION])
    assert not read_sequence(walk, motion="auto", cuts=[3]).read(3)[Role.MOTION].any()
    assert Role.MOTION not in Sequence(walk).read(3)
    with pytest.raises(SequenceError, match="motion 'guess': give auto, file, estimate"):
        read_sequence(walk, motion="guess")


@pytest.mark.parametrize("motion", ["auto", "estimate"])
def test_motion_is_estimated_beside_what_is_left_alone(walk: str, motion: str) -> None:
    """What is left alone is found in the AOVs as they are read, which lack the motion."""
    plain = read_sequence(walk, motion=motion).read(3)
    masked = read_sequence(walk, motion=motion, leave="auto").read(3)
    assert {*masked.planes} == {*plain.planes, Role.STRENGTH}
    np.testing.assert_array_equal(masked[Role.MOTION], plain[Role.MOTION])
    assert np.abs(masked[Role.MOTION]).mean() > 1


def test_a_frame_that_is_written_again_is_looked_at_again(walk: str) -> None:
    """As by a renderer, while `postfx watch` shows the frames."""
    shot, folder = read_sequence(walk, motion="auto"), Path(walk).parent
    shot.read(2)
    first = shot.read(3)[Role.MOTION]
    shot.read(2)
    shutil.copy(folder / "in.0001.exr", folder / "in.0002.exr")
    shot.look_again(1)
    again = shot.read(3)[Role.MOTION]
    np.testing.assert_array_equal(again, read_sequence(walk, motion="auto").read(3)[Role.MOTION])
    assert not np.array_equal(again, first)


def test_zeros_in_files_are_replaced_where_the_planes_move(walk: str) -> None:
    zero = walk.replace("in.", "zero.")
    expected = read_sequence(walk, motion="auto").read(3)[Role.MOTION]
    np.testing.assert_array_equal(read_sequence(zero, motion="auto").read(3)[Role.MOTION], expected)
    assert not Sequence(zero).read(3)[Role.MOTION].any()


def test_unknown_vectors_are_estimated_and_the_others_stay(walk: str) -> None:
    some, half = walk.replace("in.", "some."), WIDTH // 2
    estimated = read_sequence(walk, motion="auto").read(3)[Role.MOTION]
    shot = read_sequence(some, motion="auto")
    found = shot.read(3)[Role.MOTION]
    np.testing.assert_array_equal(found[:, :half], estimated[:, :half])
    assert (found[:, half:] == 5).all() and "some motion is estimated" in shot.warnings[0]
    assert np.isnan(Sequence(some)
                    .read(3)[Role.MOTION][:, :half]).all(), "of files alone it is unknown"


def test_a_run_plans_with_estimated_motion(walk: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words, lacks in (((), False), (("--motion", "auto"), False), (("--motion", "file"), True)):
        assert main(["run", walk, "--explain", "--model", "s", *words]) == 0
        assert ("no motion vectors, so every frame is denoised "
                "alone" in capsys.readouterr().out) == lacks, words


@pytest.mark.parametrize(("name", "most"),
                         [("garage", 0.15), ("doorway", 0.15), ("living_room", 0.3)])
def test_shared_sequences(shared_dir: Path, name: str, most: float) -> None:
    files = str(shared_dir / "sequences" / name / "noisy.####.exr")
    number = Sequence(files).numbers[3]
    truth = Sequence(files).read(number)[Role.MOTION]
    found = read_sequence(files, motion="estimate").read(number)[Role.MOTION]
    assert np.median(np.linalg.norm(truth, axis=-1)) > 1
    assert np.median(np.linalg.norm(found - truth, axis=-1)) < most
