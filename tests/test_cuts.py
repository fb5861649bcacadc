"""Cuts are found where pictures are unrelated, and nowhere else: on real sequences, pans, flashes
and noise."""

from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest

from postfx import DenoiseUpscale, Device, Frame, Pipeline, Role, read_sequence
from postfx.cuts import CutDetector, _picture
from postfx.errors import CutError

ROOM = Path(__file__).resolve().parent.parent / "samples" / "room"
COLOUR_ONLY = (Role.COLOUR,)
WITH_MOTION = (Role.COLOUR, Role.MOTION)


@pytest.fixture(scope="module")
def room() -> list[Frame]:
    return [unmarked(frame) for frame in read_sequence(ROOM / "noisy.####.exr")]


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    """A picture without noise, (360, 640, 3)."""
    (frame,) = read_sequence(ROOM / "reference.0004.exr")
    return frame[Role.COLOUR]


def unmarked(frame: Frame, roles: tuple[Role, ...] | None = None) -> Frame:
    """A frame without the header's mark of a cut, with all planes or these."""
    kept = {role: plane for role, plane in frame.planes.items() if roles is None or role in roles}
    return replace(frame, planes=kept, reset=False)


def cuts(frames: list[Frame]) -> list[int]:
    """Indices at which a cut is found."""
    detector = CutDetector()
    return [index for index, frame in enumerate(frames) if detector(frame)]


@pytest.mark.parametrize(("size", "cells"),
                         [((1080, 1920), (45, 80)), ((2160, 800), (80, 29)), ((64, 96), (16, 24))])
def test_pictures_have_few_cells_of_four_pixels_and_more(size: tuple[int, int],
                                                         cells: tuple[int, int]) -> None:
    found = _picture(Frame({Role.COLOUR: np.ones((*size, 3), np.float32)}))
    assert found.light.shape == (*cells, 2)


def turned(frame: Frame) -> Frame:
    """A frame upside down: another picture with the same noise and planes."""
    planes = {role: np.rot90(plane, 2) * (-1 if role is Role.MOTION else 1)
              for role, plane in frame.planes.items()}
    return replace(frame, planes=planes)


def noisier(frame: Frame, kept: float) -> Frame:
    """Only some of the pixels got light, as with fewer samples."""
    rng = np.random.default_rng(frame.number)
    lit = rng.random((frame.spec.height, frame.spec.width, 1)) < kept
    return replace(frame, planes={**frame.planes,
                                  Role.COLOUR: frame[Role.COLOUR] * lit / np.float32(kept)})


@pytest.mark.parametrize("roles", [None, WITH_MOTION, COLOUR_ONLY])
def test_a_join_is_found_and_nothing_else(room, roles):
    frames = [unmarked(frame, roles) for frame in room]
    assert cuts(frames + [turned(frame) for frame in frames] + frames) == [8, 16]


def resized(frame: Frame, height: int, width: int) -> Frame:
    """The same view at another size, by the nearest pixels; motion in pixels of that size."""
    rows = (np.arange(height) + 0.5) * frame.spec.height // height
    columns = (np.arange(width) + 0.5) * frame.spec.width // width
    planes = {role: plane[rows.astype(int)][:, columns.astype(int)]
              for role, plane in frame.planes.items()}
    if Role.MOTION in planes:
        planes[Role.MOTION] = planes[Role.MOTION] * np.float32([width / frame.spec.width,
                                                                height / frame.spec.height])
    return replace(frame, planes=planes)


@pytest.mark.parametrize("roles", [None, WITH_MOTION, COLOUR_ONLY])
def test_frames_that_change_their_size_are_compared(room, roles):
    sizes = [(180, 320), (160, 284), (135, 240), (113, 200)]
    frames = [unmarked(frame, roles) for frame in room + [turned(frame) for frame in room]]
    assert cuts([resized(frame, *sizes[index % 4]) for index, frame in enumerate(frames)]) == [8]


def test_a_frame_marked_as_a_cut_is_not_found_again(room):
    assert cuts([room[0], replace(turned(room[1]), reset=True), turned(room[2])]) == []


def test_flashes_exposure_and_black_frames_are_no_cuts(room):
    y, x = np.mgrid[-1:1:180j, -1:1:320j]
    flash = (1 + 30 * np.exp(-4 * ((x - 0.4) ** 2 + y**2)))[..., None]
    gains = [1, 1, flash, 1, 64, 1 / 64, 0, 1]
    lit = [replace(frame, planes={**frame.planes, Role.COLOUR: frame[Role.COLOUR] * gain})
           for frame, gain in zip(room, gains, strict=True)]
    assert cuts(lit) == []


def test_other_light_on_the_same_surfaces_is_no_cut(room):
    albedo = room[3][Role.DIFFUSE_ALBEDO]
    facing = np.maximum(room[3][Role.NORMAL] @ np.float32([0.6, 0.8, 0]), 0.01)
    relit = replace(room[3], planes={**room[3].planes, Role.COLOUR: albedo * facing[..., None]})
    assert cuts([room[2], relit, room[4]]) == []
    assert cuts([unmarked(frame, WITH_MOTION) for frame in (room[2], relit)]) == [1]


@pytest.mark.parametrize("roles", [WITH_MOTION, COLOUR_ONLY])
def test_changing_exposure_without_guides_is_no_cut(room, roles):
    gains = [1, 1, 8, 1, 64, 1 / 64, 1, 1]
    lit = [replace(frame, planes={**frame.planes, Role.COLOUR: frame[Role.COLOUR] * gain})
           for frame, gain in zip(room, gains, strict=True)]
    assert cuts([unmarked(frame, roles) for frame in lit]) == []


@pytest.mark.parametrize("kept", [0.25, 0.05])
def test_noise_of_one_sample_and_less_is_no_cut(room, kept):
    assert cuts([noisier(frame, kept) for frame in room]) == []


def test_a_cut_is_found_in_the_noise_of_one_sample(room):
    frames = [noisier(frame, 0.25) for frame in room]
    assert cuts(frames + [turned(frame) for frame in frames]) == [8]


@pytest.mark.parametrize("step", [4, 40, 90])
def test_fast_pans_are_no_cuts(picture, step):
    """More than half of the picture's width a frame, with motion vectors."""
    wide = np.concatenate([picture, picture[:, ::-1]], axis=1)
    motion = np.broadcast_to(np.float32([step, 0]), (90, 160, 2))
    frames = [Frame({Role.COLOUR: wide[100:190, at : at + 160], Role.MOTION: motion})
              for at in range(0, 900, step)]
    assert cuts(frames[:12]) == []


def test_pans_without_motion_vectors_are_no_cuts(picture):
    frames = [Frame({Role.COLOUR: picture[100:280, at : at + 320]}) for at in range(0, 320, 60)]
    assert cuts(frames) == []


def test_motion_vectors_that_are_wrong_are_no_cuts(room):
    wrong = [replace(frame, planes={**frame.planes, Role.MOTION: frame[Role.MOTION] * 1.5 + 20})
             for frame in room]
    assert cuts(wrong) == []


@pytest.mark.parametrize("none", [np.nan, 9999.0, -400.0])
def test_unknown_vectors_are_no_cuts_and_a_join_is_found(picture, none):
    """Compared as frames without vectors, also where some are known; what is longer than the
    picture is not."""
    known = np.full((180, 320, 2), none, np.float32)
    known[:40, :40] = 60, 0
    frames = [Frame({Role.COLOUR: picture[100:280, at : at + 320], Role.MOTION: known})
              for at in range(0, 320, 60)]
    assert cuts(frames) == []
    other = (np.random.default_rng(7).uniform(0, 1, (45, 80, 3)).astype(np.float32).repeat(4, 0)
             .repeat(4, 1))
    assert cuts(frames[:3] + [Frame({Role.COLOUR: other, Role.MOTION: known})] * 2) == [3]


def test_tiny_and_empty_pictures_are_no_cuts(room):
    small = [Frame({Role.COLOUR: frame[Role.COLOUR][:20, :20]})
             for frame in (room[0], turned(room[0]))]
    empty = [Frame({Role.COLOUR: np.full((90, 160, 3), value, np.float32)})
             for value in (0.0, 1.0, np.nan)]
    assert cuts(small) == [] and cuts(empty) == []


def test_real_shots(shared_dir, room):
    shots = {name: [unmarked(frame)
                    for frame in read_sequence(shared_dir / "sequences" / name / "noisy.####.exr")]
             for name in ("living_room", "staircase", "garage")} | {"room": room}
    for roles in (None, WITH_MOTION, COLOUR_ONLY):
        reduced = {name: [unmarked(frame, roles) for frame in frames]
                   for name, frames in shots.items()}
        assert [name for name, frames in reduced.items() if cuts(frames)] == []
        joins = [(reduced[a][i], reduced[b][j])
                 for (a, b), i, j in product(permutations(shots, 2), (0, 7), (0, 4))]
        assert [cuts(list(pair)) for pair in joins] == [[1]] * len(joins)


def test_the_pipeline_drops_its_history_there(room):
    class Told(DenoiseUpscale):
        resets = 0

        def reset(self) -> None:
            self.resets += 1
            super().reset()

    frames = [*room[:2], *(turned(frame) for frame in room[:2])]
    for mode, wanted in (("auto", [False, False, True, False]), ("none", [False] * 4)):
        denoise = Told(scale=1)
        pipeline = Pipeline([denoise], Device("cpu"), cuts=mode)
        results, resets = [], []
        for frame in frames:
            results.append(pipeline(frame).reset)
            assert pipeline.cut == results[-1]
            resets.append(denoise.resets)
        assert (results == wanted and resets[2] - resets[1] == wanted[2]
                and not any(frame.reset for frame in frames))


def test_unknown_modes_are_refused():
    with pytest.raises(CutError, match="cuts 'always': use auto or none"):
        Pipeline([], Device("cpu"), cuts="always")


def test_thin_things_that_move_are_no_cut():
    """Wires of one pixel in front of a wall: even and odd rows show other light, so that only depth
    told, of which every fourth pixel is looked at. Each frame was taken for another shot."""
    def wires(time: int) -> Frame:
        y, x = (np.indices((450, 700)) + 0.5) / 5
        is_wire = [np.abs(y - 12 - 22 * k + 2 * time - (x - 70) * 0.05 * k) < 0.45
                   for k in range(4)]
        share = np.any(is_wire, 0).reshape(90, 5, 140, 5).mean((1, 3))
        wall = 0.5 + 0.1 * np.sin(0.3 * (x[::5, ::5] + 2 * time)) * np.cos(0.2 * y[::5, ::5])
        planes = {Role.COLOUR: (wall + share * (1.5 - wall))[..., None].repeat(3, -1),
                  Role.DEPTH: np.where(share > 0.3, 2.0, 9.0)[..., None],
                  Role.MOTION: np.where(share[..., None] > 0.3, (0.0, 2.0), (2.0, 0.0))}
        return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                     number=time + 1)

    detector = CutDetector()
    assert not any(detector(wires(time)) for time in range(4))


HEIGHT, WIDTH = 96, 160


def wall(seed: int, right: float = 0.0, turn: float = 0.0, scale: float = 1.0) -> np.ndarray:
    """A colourful pattern of waves of 7 pixels and more (96, 160, 3), seen from somewhere."""
    random = np.random.default_rng(seed)
    y, x = np.indices((HEIGHT, WIDTH)) - 0.5 * np.array([HEIGHT, WIDTH])[:, None, None]
    place = (x + 1j * y) * scale * np.exp(1j * turn) + right
    found = np.zeros((HEIGHT, WIDTH, 3))
    for _ in range(14):
        k = random.uniform(0.05, 0.9, 2) * random.choice((-1, 1), 2)
        wave = np.sin(place.real * k[0] + place.imag * k[1] + random.uniform(0, 6.3))
        found += wave[..., None] * random.uniform(-0.5, 0.5, 3)
    return (0.5 + 0.16 * found).clip(0.02, None)


def rained_on(picture: np.ndarray, number: int, drops: int, light: float) -> np.ndarray:
    """A picture behind streaks of light or of dark."""
    random, cover = np.random.default_rng(number), np.zeros(picture.shape[:2])
    for _ in range(drops):
        x, y = random.integers(picture.shape[1]), random.integers(-14, picture.shape[0])
        cover[max(y, 0):y + 14, x] = 0.9
    return picture * (1 - cover[..., None]) + light * cover[..., None]


def shown(pictures: list[np.ndarray]) -> list[Frame]:
    return [Frame({Role.COLOUR: one.astype(np.float32)}, number=number)
            for number, one in enumerate(pictures, 1)]


@pytest.mark.parametrize("light", [3.0, 0.01])
@pytest.mark.parametrize("drops", [200, 700, 1500])
def test_dense_rain_is_no_cut(picture, drops, light):
    """Up to two thirds of the picture. Each frame was taken for another shot."""
    small = picture[::2, ::2]
    for behind, count in ((wall(3), drops), (small, 4 * drops)):
        assert not cuts(shown([rained_on(behind, number, count, light) for number in range(4)]))


def test_a_cut_in_rain_is_found():
    behind = [wall(3), wall(3), wall(8), wall(8)]
    assert cuts(shown([rained_on(one, number, 700, 3.0)
                       for number, one in enumerate(behind)])) == [2]


@pytest.mark.parametrize("seeds", [(1, 2), (3, 4), (5, 6)])
def test_a_cut_between_walls_of_fine_texture_is_found(seeds):
    """Which tell nothing on a coarse grid."""
    one, other = seeds
    pictures = [wall(one), wall(one, 3), wall(other), wall(other, 3)]
    assert cuts(shown(pictures)) == [2]


WAYS = {"pan": {"right": 9.0}, "fast pan": {"right": 40.0}, "turn": {"turn": 0.08},
        "zoom": {"scale": 1.08}}


@pytest.mark.parametrize("way", WAYS)
def test_a_camera_before_fine_texture_is_no_cut(way):
    moved = {name: value - (name == "scale") for name, value in WAYS[way].items()}
    pictures = [wall(7, **{name: (name == "scale") + number * step
                           for name, step in moved.items()}) for number in range(3)]
    assert not cuts(shown(pictures))


def test_noise_before_fine_texture_and_dissolves_are_no_cuts():
    random = np.random.default_rng(2)
    noisy = [wall(7, 3 * number) * random.gamma(4, 0.25, (HEIGHT, WIDTH, 3))
             for number in range(4)]
    assert not cuts(shown(noisy))
    assert not cuts(shown([wall(7, 3 * number) * (1 - number / 6) + wall(9) * number / 6
                           for number in range(7)]))


def test_a_detector_goes_on_from_its_history_in_rain_and_before_texture():
    pictures = [wall(3), rained_on(wall(3), 1, 700, 3.0), wall(5), wall(5, 2)]
    whole, frames, past = CutDetector(), shown(pictures), {}
    for frame in frames:
        wanted = whole(frame)
        continued = CutDetector()
        continued.recall(past)
        assert continued(frame) == wanted
        past = whole.history()


@pytest.mark.filterwarnings("error")
def test_broken_pixels_hide_no_cut_and_make_none():
    broken = np.array([np.nan, np.inf, -np.inf, 3e38, 1e10, -1e10])
    pictures = [wall(1), wall(1, 3), wall(2), wall(2, 3)]
    for number, one in enumerate(pictures):
        random = np.random.default_rng(number)
        one[random.integers(HEIGHT, size=6), random.integers(WIDTH, size=6)] = broken[:, None]
    assert cuts(shown(pictures)) == [2]
    for value in broken:
        assert not cuts(shown([np.full((HEIGHT, WIDTH, 3), value)] * 2))
