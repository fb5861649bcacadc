"""What must hold for any picture: mirrored, turned, brighter, in another order, in pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from postfx.frame import Frame, Role
from postfx.kernels.image import positions, resample
from postfx.passes.composite import Overlay
from postfx.passes.display import Display, View
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import noisy
from tests.stress.bounds import bounds
from tests.stress.scenes import colours, display_psnr, on, pipeline

EXAMPLES = settings(max_examples=15, deadline=None, derandomize=True)
SIDES = st.integers(1, 23)
SEEDS = st.integers(0, 2**16)
TURNS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], Callable[[float, float], tuple]]] = {
    "left to right": (lambda plane: plane[:, ::-1], lambda x, y: (-x, y)),
    "upside down": (lambda plane: plane[::-1], lambda x, y: (x, -y)),
    "by 90 degrees": (lambda plane: np.rot90(plane), lambda x, y: (y, -x)),
    "by 180 degrees": (lambda plane: np.rot90(plane, 2), lambda x, y: (-x, -y)),
}
"""Name -> what it does with a picture, and with a vector of the image."""
BY_PIXEL = {
    "tonemap": ToneMap, "view": View, "view for HDR": lambda: View(view="reinhard", display="pq"),
    "display": Display, "display for HDR": lambda: Display(display="hlg"), "overlay": Overlay,
}
"""Passes that look at a pixel alone."""
RESAMPLED = 2e-6
"""Error of a mirrored resampling by the largest value: weights are rounded elsewhere."""
WHOLE = 1e-3
"""Pixels around a row or column of the image within which rounding may tell on which side of it a
position lies."""
TONE = 0.06, 0.006
"""Largest and mean difference, in code values, between what a tone mapper with a network makes of a
turned picture and what it makes of the picture, turned."""
PREROLL = {0: 30.0, 1: 33.0, 2: 35.0, 4: 41.0}
"""Frames that run before a piece of a sequence -> least decibels between it and the unbroken
run."""


def turned(frame: Frame, name: str) -> Frame:
    picture, vector = TURNS[name]
    planes = {role: picture(plane) for role, plane in frame.planes.items()}
    if Role.MOTION in planes:
        motion = planes[Role.MOTION]
        planes[Role.MOTION] = np.stack(vector(motion[..., 0], motion[..., 1]), axis=-1)
    return replace(frame, planes=planes, jitter=vector(*frame.jitter))


def brighter(frame: Frame, factor: float) -> Frame:
    return replace(frame,
                   planes={**frame.planes, Role.COLOUR: frame[Role.COLOUR] * np.float32(factor)})


def light(seed: int, height: int, width: int) -> Frame:
    """Light over 24 stops under a transparent overlay."""
    random = np.random.default_rng(seed)
    colour = np.exp2(random.uniform(-14, 10, (height, width, 3))).astype(np.float32)
    return Frame({Role.COLOUR: colour, Role.OVERLAY: random.random((height, width, 4), np.float32)})


@pytest.fixture(scope="module", params=BY_PIXEL)
def by_pixel(request: pytest.FixtureRequest, device: Device) -> Pipeline:
    return Pipeline([BY_PIXEL[request.param]()], device, exposure=0.0, cuts="none")


@EXAMPLES
@given(seed=SEEDS, height=SIDES, width=SIDES, name=st.sampled_from(sorted(TURNS)))
def test_what_works_by_pixel_turns_with_the_picture_to_the_bit(by_pixel, seed, height, width, name):
    frame, picture = light(seed, height, width), TURNS[name][0]
    found = by_pixel(turned(frame, name))[Role.COLOUR]
    np.testing.assert_array_equal(found, picture(by_pixel(frame)[Role.COLOUR]))


@EXAMPLES
@given(seed=SEEDS, stops=st.integers(-12, 12), by=st.sampled_from(("tonemap", "view", "display")))
def test_exposing_is_multiplying(device, seed, stops, by):
    """To the bit, for whole stops."""
    frame = light(seed, 7, 9)
    exposed, plain = (Pipeline([BY_PIXEL[by]()], device, exposure=ev, cuts="none")
                      for ev in (float(stops), 0.0))
    np.testing.assert_array_equal(exposed(frame)[Role.COLOUR],
                                  plain(brighter(frame, 2.0**stops))[Role.COLOUR])


@EXAMPLES
@example(seed=0, height=2, width=2, out=(2, 3), jitter=(0.0, 0.0), name="by 180 degrees")
@given(seed=SEEDS, height=SIDES, width=SIDES, out=st.tuples(st.integers(1, 60), st.integers(1, 60)),
       jitter=st.tuples(*[st.floats(-0.5, 0.5)] * 2), name=st.sampled_from(sorted(TURNS)))
def test_resampling_turns_with_the_picture(seed, height, width, out, jitter, name):
    image = light(seed, height, width)[Role.COLOUR]
    picture, vector = TURNS[name]
    turned_out = out[::-1] if "90" in name else out
    found = resample(picture(image), *turned_out, vector(*jitter))
    wanted = picture(resample(image, *out, jitter))
    whole = [np.abs(at - np.rint(at)) < WHOLE
             for at in map(positions, (height, width), out, jitter[::-1])]
    # else the sides of a whole row or column are not alike
    same = picture((whole[0][:, None] == whole[1])[..., None])
    np.testing.assert_allclose(found * same, wanted * same, rtol=0,
                               atol=RESAMPLED * max(out) * image.max())
    assert wanted.min() >= image.min() and wanted.max() <= image.max()


@pytest.mark.parametrize("name", TURNS)
def test_tone_mapping_with_a_network_nearly_turns_with_the_picture(
    name: str, rooms: list[Frame], device: Device
) -> None:
    """Its grid of 16 x 16 cells looks at the layout of the picture, too."""
    chain = Pipeline([ToneMap(look="local", keep=0.0)], device, exposure=0.0, cuts="none")
    frame, picture = Frame({Role.COLOUR: rooms[0][Role.COLOUR]}), TURNS[name][0]
    error = np.abs(chain(turned(frame, name))[Role.COLOUR] - picture(chain(frame)[Role.COLOUR]))
    assert error.max() < TONE[0] and error.mean() < TONE[1]


@pytest.mark.parametrize("name", TURNS)
@on()
def test_denoising_nearly_turns_with_the_picture(model: str, name: str, rooms: list[Frame],
                                                 device: Device) -> None:
    picture, wanted = TURNS[name][0], colours(rooms[:4], model, device)
    found = colours([turned(frame, name) for frame in rooms[:4]], model, device)
    for one, other in zip(found, wanted, strict=True):
        near = display_psnr(one, picture(other))
        print(f"{device.name} {model}: turned {near:.1f} dB")
        assert near > bounds(device, model).turned
        assert one.mean() == pytest.approx(other.mean(), rel=0.02)


@on()
@settings(EXAMPLES, max_examples=4)
@given(stops=st.integers(-20, 20))
def test_denoising_scales_with_light_to_the_bit(rooms, device, model, stops):
    """For whole stops, within a range of exposed light where nothing is too small for float32."""
    wanted = colours(rooms[:3], model, device)
    found = colours([brighter(frame, 2.0**stops) for frame in rooms[:3]], model, device,
                    float(-stops))
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one, other * np.float32(2.0**stops))


@on()
@settings(EXAMPLES, max_examples=4)
@given(stops=st.floats(-10, 10))
def test_denoising_scales_with_light(rooms, device, model, stops):
    wanted = colours(rooms[:3], model, device)
    found = colours([brighter(frame, 2.0**stops) for frame in rooms[:3]], model, device, -stops)
    for one, other in zip(found, wanted, strict=True):
        near = display_psnr(one * np.float32(2.0**-stops), other)
        print(f"{device.name} {model}: brighter {near:.1f} dB")
        assert near > bounds(device, model).brighter


@EXAMPLES
@given(order=st.permutations(range(5)), numbers=st.lists(st.integers(0, 4), max_size=3))
def test_what_was_before_a_cut_does_not_matter(device, order, numbers):
    """Frames that begin shots come in any order, after any frames."""
    chain = pipeline("s.fp32", device)
    frames = [noisy(number, 13, 17, reset=True) for number in range(5)]
    wanted = {n: chain(frame)[Role.COLOUR] for n, frame in enumerate(frames)}
    for number in numbers:
        chain(noisy(number, 13, 17))
    for number in order:
        np.testing.assert_array_equal(chain(frames[number])[Role.COLOUR], wanted[number])


@pytest.mark.parametrize("preroll", PREROLL)
@on()
def test_a_piece_with_a_preroll_is_near_to_the_unbroken_run(
    model: str, preroll: int, rooms: list[Frame], device: Device
) -> None:
    whole, piece = colours(rooms, model, device), colours(rooms[6 - preroll :], model, device)
    for found, wanted in zip(piece[preroll:], whole[6:], strict=True):
        assert display_psnr(found, wanted) > PREROLL[preroll]


@on()
@pytest.mark.parametrize("at", [1, 3])
def test_a_piece_with_a_checkpoint_is_that_of_the_unbroken_run(
    model: str, at: int, rooms: list[Frame], device: Device
) -> None:
    whole = pipeline(model, device, "auto")
    wanted = []
    for n, frame in enumerate(rooms[: at + 3]):
        wanted.append(whole(frame)[Role.COLOUR])
        if n == at:
            kept = {name: np.array(value) for name, value in whole.history().items()}
    piece = pipeline(model, device, "auto")
    piece.recall(rooms[at], kept)
    part = bounds(device, model).sessions
    for n in (at + 1, at + 2):
        found, least = piece(rooms[n])[Role.COLOUR], part * wanted[n].mean() / 20
        np.testing.assert_allclose(found, wanted[n], rtol=part, atol=least)
