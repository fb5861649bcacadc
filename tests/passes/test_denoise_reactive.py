"""The reactive mask of the denoised upscaler: where the history is not used, and what that does to
ghosts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx.errors import MissingPlaneError, PassOptionError
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.options import ReactiveOption, parse_reactive
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import PLANES, guided, noisy
from tests.passes.particles import Shot, ghost_energy, seen, shots

ROOM = Path(__file__).resolve().parents[2] / "samples" / "room" / "noisy.####.exr"
SIZES = [((37, 50), 2, False), ((37, 50), 1, False), ((21, 35), 1.5, True), ((37, 50), 2, True)]


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def sequence() -> list[Shot]:
    return list(shots())


def run(frames: list[Frame], device: Device, **options) -> list[np.ndarray]:
    pipeline = Pipeline([DenoiseUpscale(**{"scale": 2, **options})], device, exposure="metadata",
                        cuts="none")
    return [pipeline(replace(frame, exposure=frame.exposure or 0.0))[Role.COLOUR]
            for frame in frames]


def given(frame: Frame, role: Role, plane: np.ndarray | float) -> Frame:
    """The frame with one plane more."""
    height, width = frame[Role.COLOUR].shape[:2]
    channels = 3 if role is Role.OPAQUE_COLOUR else 1
    full = np.broadcast_to(np.asarray(plane, np.float32), (height, width, channels))
    return replace(frame, planes={**frame.planes, role: full.copy()})


def reactive(frames: list[Frame], *values: float | np.ndarray) -> list[Frame]:
    """Frames with masks; the last value is that of all others, too."""
    masks = [*values, *[values[-1]] * (len(frames) - len(values))]
    return [given(frame, Role.REACTIVE, mask) for frame, mask in zip(frames, masks, strict=True)]


def some_frames(size: tuple[int, int], scale: float, with_guides: bool) -> list[Frame]:
    """Four frames of changing exposure."""
    frames = [noisy(number, *size, exposure=np.log2(exposure))
              for number, exposure in enumerate((1.0, 1.0, 2.5, 0.7))]
    output = tuple(round(side * scale) for side in size)
    return [guided(frame, *output) for frame in frames] if with_guides else frames


@pytest.mark.parametrize(("size", "scale", "with_guides"), SIZES)
def test_mask_of_0_changes_no_bit(size: tuple[int, int], scale: float, with_guides: bool,
                                  device: Device) -> None:
    frames = some_frames(size, scale, with_guides)
    wanted = run(frames, device, scale=scale)
    np.testing.assert_array_equal(run(reactive(frames, 0), device, scale=scale), wanted)


@pytest.mark.parametrize(("size", "scale", "with_guides"), SIZES)
def test_mask_of_1_is_a_reset(size: tuple[int, int], scale: float, with_guides: bool,
                              device: Device) -> None:
    frames = some_frames(size, scale, with_guides)
    wanted = run([replace(frame, reset=True) for frame in frames], device, scale=scale)
    assert np.abs(run(frames, device, scale=scale)[1] - wanted[1]).max() > 0.1
    np.testing.assert_array_equal(run(reactive(frames, 1), device, scale=scale), wanted)


def test_what_a_mask_of_1_leaves_is_not_used_either(device: Device) -> None:
    """The frame after it is a first frame, too; the next one has a history again."""
    frames = [noisy(number) for number in range(4)]
    found = run(reactive(frames, 0, 1, 0), device)
    alone = run([replace(frames[2], reset=True), frames[3]], device)
    np.testing.assert_array_equal(found[2:], alone)


def test_between_mixes(device: Device) -> None:
    """Ever nearer to the picture without history, and both ends are reached smoothly. With half of
    its history a network may be farther from the picture with all of it than with a quarter."""
    cut = np.s_[20:164, 40:280]
    frames = [replace(frame, planes={role: plane[cut] for role, plane in frame.planes.items()})
              for frame in read_sequence(ROOM, "1-4")]
    shares = (0.0, 0.02, 0.25, 0.5, 0.75, 0.98, 1.0)
    pictures = [seen(run(reactive(frames, share), device, model="s.fp32")[-1]) for share in shares]
    whole = np.abs(pictures[-1] - pictures[0]).mean()
    from_first = [np.abs(picture - pictures[0]).mean() / whole for picture in pictures]
    from_last = [np.abs(picture - pictures[-1]).mean() / whole for picture in pictures]
    assert from_first[:4] == sorted(from_first[:4]) and from_last == sorted(from_last, reverse=True)
    assert from_first[1] < 0.15 and from_last[-2] < 0.15


@pytest.mark.parametrize("model", ["s", pytest.param("m", marks=pytest.mark.soak)])
def test_particles_leave_a_third_of_their_ghosts_at_most(model: str, sequence: list[Shot],
                                                         device: Device) -> None:
    """With a mask as a plane, and with one of the difference."""
    ghosts = ghost_energy(run([shot.frame for shot in sequence], device, model=model), sequence)
    masked = [given(shot.frame, Role.REACTIVE, shot.coverage > 0) for shot in sequence]
    differing = [given(shot.frame, Role.OPAQUE_COLOUR, shot.opaque[Role.COLOUR])
                 for shot in sequence]
    for way, frames in (("plane", masked), ("difference", differing)):
        assert ghost_energy(run(frames, device, model=model), sequence) < ghosts / 3, way
    assert ghosts > 10 * ghost_energy(run([shot.opaque for shot in sequence], device, model=model),
                                      sequence)


def test_the_mask_of_the_difference(sequence: list[Shot], device: Device) -> None:
    """The same picture as with a plane that holds what the documentation says."""
    frames = [replace(shot.frame, exposure=1.0) for shot in sequence[:3]]
    with_opaque = [given(frame, Role.OPAQUE_COLOUR, shot.opaque[Role.COLOUR])
                   for frame, shot in zip(frames, sequence, strict=False)]
    planes = []
    for frame, shot in zip(frames, sequence, strict=False):
        both = (2 * frame[Role.COLOUR], 2 * shot.opaque[Role.COLOUR])
        with_all, without = (np.sqrt(light / (1 + light)) for light in both)
        difference = np.abs(with_all - without).max(2, keepdims=True)
        planes.append(given(frame, Role.REACTIVE,
                            np.where(difference >= 0.1, np.minimum(1, 3 * difference), 0)))
    found = run(with_opaque, device, reactive="difference,scale=3,threshold=0.1")
    np.testing.assert_allclose(found, run(planes, device), rtol=1e-3, atol=1e-3)


def test_a_mask_acts_in_windows_as_in_the_whole_frame(device: Device) -> None:
    """Windows around what has strength."""
    frames = list(read_sequence(ROOM, "1-3"))
    mask = np.random.default_rng(0).random((180, 320, 1)) > 0.7
    strength = np.zeros((180, 320, 1), np.float32)
    strength[60:120, 100:170] = 1
    whole = run(reactive(frames, mask), device, model="s.fp32")
    windows = run([given(frame, Role.STRENGTH, strength) for frame in reactive(frames, mask)],
                  device, model="s.fp32")
    inner = np.s_[124:236, 204:336]
    for found, wanted in zip(windows, whole, strict=True):
        np.testing.assert_allclose(seen(found[inner]), seen(wanted[inner]), atol=1e-3)
    assert np.abs(whole[2] - run(frames, device, model="s.fp32")[2]).max() > 1e-2


def test_tiles_within_a_memory_budget_do_the_same() -> None:
    frames = [noisy(number, 400, 460) for number in (1, 2)]
    frames = reactive(frames, np.random.default_rng(0).random((400, 460, 1)) > 0.7)
    whole, tiled = (run(frames, Device("cpu", threads=2, memory=memory), model="s.fp32")
                    for memory in (None, "560M"))
    np.testing.assert_allclose(seen(tiled[1]), seen(whole[1]), atol=1e-3)


def test_the_portable_kernels_do_the_same(device: Device) -> None:
    portable = Device("cpu", threads=2, compiled_kernels=False)
    frames = [noisy(number) for number in (1, 2, 3)]
    frames = [given(frame, Role.OPAQUE_COLOUR, 0.5 * frame[Role.COLOUR]) for frame in frames]
    one, other = (run(frames, place, scale=1.5, model="s.fp32") for place in (device, portable))
    np.testing.assert_allclose(one, other, rtol=2e-3, atol=2e-3)


def test_a_mask_that_no_file_should_hold(device: Device) -> None:
    frames = [noisy(number, 24, 40) for number in (1, 2)]
    bad, good = np.zeros((24, 40, 1), np.float32), np.zeros((24, 40, 1), np.float32)
    bad[5:8], good[7] = np.array([np.nan, -7, 9])[:, None, None], 1
    np.testing.assert_array_equal(run(reactive(frames, bad), device),
                                  run(reactive(frames, good), device))


def test_what_is_read_and_what_is_said() -> None:
    both = given(given(noisy(1), Role.REACTIVE, 0), Role.OPAQUE_COLOUR, 0)
    only = given(noisy(1), Role.OPAQUE_COLOUR, 0).spec

    def planned(spec, **options) -> tuple[set[Role], str]:
        plan = Pipeline([DenoiseUpscale(**options)]).explain(spec)
        return {Role.REACTIVE, Role.OPAQUE_COLOUR} & set(plan.planes), "".join(plan.remarks)

    assert planned(both.spec) == ({Role.REACTIVE},
                                  "denoise_upscale: reactive mask from the AOV 'reactive'")
    assert planned(only)[0] == planned(both.spec, reactive="difference")[0] == {Role.OPAQUE_COLOUR}
    said = ("denoise_upscale: reactive mask from the difference of colour and opaque_colour: times "
            "8, 0 below 0.05")
    assert planned(only, reactive="auto,scale=8")[1] == said
    still = tuple(role for role in PLANES if role is not Role.MOTION)
    alone = given(noisy(1, planes=still), Role.REACTIVE, 0).spec
    for spec, options in ((both.spec, {"reactive": "none"}), (alone, {}),
                          (both.spec, {"strength": 0})):
        assert planned(spec,
                       **options)[0] == set() and "reactive" not in planned(spec, **options)[1]
    with pytest.raises(MissingPlaneError, match="needs AOV 'reactive'"):
        planned(only, reactive="plane")


def test_nothing_is_made_where_there_is_no_mask(monkeypatch) -> None:
    place, made = Device("cpu", threads=2), []
    make = place.compute_state
    monkeypatch.setattr(place, "compute_state",
                        lambda kernel: made.append(kernel.name) or make(kernel))
    run([noisy(number) for number in (1, 2)], place)
    assert not {"denoise_reactive", "denoise_spread", "denoise_keep"} & set(made)
    run(reactive([noisy(1)], 0), place)
    assert {"denoise_spread", "denoise_keep"} < set(made) and "denoise_reactive" not in made


def test_the_option_is_parsed() -> None:
    assert parse_reactive("auto") == ReactiveOption("auto", 4.0, 0.05)
    assert parse_reactive("difference, scale=8,threshold=0") == ReactiveOption("difference", 8.0,
                                                                               0.0)


@pytest.mark.parametrize(("text", "said"), [
    ("automatic", "reactive 'automatic': did you mean auto. begin with auto, plane, difference"),
    ("auto,cut=1", "unknown 'cut': use scale= or threshold="),
    ("auto,scale=much", "'scale=much' needs a number from 0 on"),
    ("auto,threshold=-1", "'threshold=-1' needs a number from 0 on"),
    ("auto,scale=nan", "'scale=nan' needs a number from 0 on"),
])
def test_a_wrong_option_says_what_is_right(text: str, said: str) -> None:
    with pytest.raises(PassOptionError, match=said):
        DenoiseUpscale(reactive=text)
