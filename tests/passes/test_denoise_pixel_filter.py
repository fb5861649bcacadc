"""Frames whose noise the renderer's pixel filter spread: networks that give the picture see them
without it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import postfx
from postfx import DenoiseUpscale, Device, Frame, Oidn, Partner, Pipeline, Role
from postfx.errors import PassOptionError
from postfx.frame import Part
from postfx.passes import Pass
from postfx.pixel_filter import find_stddev
from tests.splatted import splatted

SIZE = 96, 128
STDDEV = 0.5
LEAST_GAIN_DB = 4


@cache
def truth(scale: int = 1) -> np.ndarray:
    """Light that rises slowly, with a bright square."""
    rows, columns = np.mgrid[:scale * SIZE[0], :scale * SIZE[1]] / (scale * SIZE[1])
    light = np.stack([0.2 + 0.3 * rows, 0.3 + 0.2 * columns, 0.4 - 0.2 * rows], -1)
    light[scale * 30:scale * 60, scale * 40:scale * 80] *= 3
    return light


@cache
def light_of(number: int) -> np.ndarray:
    return splatted(truth(), STDDEV, samples=8, seed=number)


def frame(number: int = 1, **planes: np.ndarray) -> Frame:
    """A frame of a shot at rest."""
    held = {Role.COLOUR: light_of(number),
            Role.DIFFUSE_ALBEDO: np.full((*SIZE, 3), 0.5, np.float32),
            Role.NORMAL: np.tile(np.float32([0, 0, 1]), (*SIZE, 1)),
            Role.DEPTH: np.full((*SIZE, 1), 3, np.float32),
            Role.MOTION: np.zeros((*SIZE, 2), np.float32)}
    return Frame(held | {Role(name): plane for name, plane in planes.items()}, number=number)


def chain(model: str = "xl", **options: object) -> Pipeline:
    step = DenoiseUpscale(model=model, **{"scale": 1, **options})
    return Pipeline([step], Device("cpu", threads=2), exposure=0.0, cuts="none")


def picture(pipeline: Pipeline, given: Frame) -> np.ndarray:
    return np.array(pipeline(given)[Role.COLOUR])


def psnr(found: np.ndarray, scale: int = 1) -> float:
    return float(-10 * np.log10(np.square(found - truth(scale)).mean()))


@pytest.mark.parametrize(("model", "scale"), (("xl", 1), ("l", 1), ("xl", 2)))
def test_the_network_sees_noise_that_is_independent(model: str, scale: int) -> None:
    found, left = (picture(chain(model, scale=scale, pixel_filter=given), frame())
                   for given in ("auto", "none"))
    assert psnr(found, scale) > psnr(left, scale) + LEAST_GAIN_DB
    assert found.mean() == pytest.approx(truth().mean(), rel=0.02)


def test_its_width_may_be_given() -> None:
    told = find_stddev(light_of(1))
    assert told == pytest.approx(STDDEV, rel=0.1)
    found, named = (picture(chain(pixel_filter=given), frame()) for given in ("auto", told))
    np.testing.assert_array_equal(found, named)
    notes = DenoiseUpscale(model="xl", pixel_filter=told).reflect(frame().spec).notes
    (note,) = (note for note in notes if "pixel filter" in note)
    assert note == f"a pixel filter of {told:.2f} px is undone before it and applied again"
    step = DenoiseUpscale(model="xl", pixel_filter=told)
    assert not [one for one in step.remarks(frame().spec) if "pixel filter" in one]
    with pytest.raises(PassOptionError, match="pixel filter 'wide'"):
        DenoiseUpscale(pixel_filter="wide")


@pytest.mark.parametrize("options", ({"model": "m"}, {"model": "s", "scale": 2}), ids=str)
def test_networks_that_know_such_noise_see_it(options: dict) -> None:
    found, left = (picture(chain(**options, pixel_filter=given), frame())
                   for given in (STDDEV, "none"))
    np.testing.assert_array_equal(found, left)
    step = DenoiseUpscale(**options, pixel_filter=STDDEV)
    (remark,) = [one for one in step.remarks(frame().spec) if "pixel filter" in one]
    assert remark.startswith("a pixel filter of 0.50 px stays in the noise: network xl undoes it")


def test_independent_noise_is_left_as_it_is() -> None:
    noise = np.random.default_rng(1).gamma(1, 1, (*SIZE, 3))
    given = frame(colour=(truth() * noise).astype(np.float32))
    found, left = (picture(chain("l", pixel_filter=way), given) for way in ("auto", "none"))
    np.testing.assert_array_equal(found, left)


def test_what_the_first_frame_tells_holds_for_the_shot_and_is_recalled() -> None:
    """The second frame alone would tell another width."""
    assert find_stddev(light_of(1)) != find_stddev(light_of(2))
    whole, before, after = chain("l"), chain("l"), chain("l")
    wanted = [picture(whole, frame(number)) for number in (1, 2)]
    assert not np.array_equal(wanted[1], picture(chain("l"), frame(2)))
    np.testing.assert_array_equal(picture(before, frame(1)), wanted[0])
    after.recall(frame(1), before.history())
    np.testing.assert_array_equal(picture(after, frame(2)), wanted[1])
    again = picture(whole, replace(frame(2), reset=True))
    np.testing.assert_array_equal(again, picture(chain("l"), frame(2)))


def test_pixels_without_strength_stay_as_they_are() -> None:
    """Those beside them are spread from what is denoised, too."""
    strength = np.zeros((*SIZE, 1), np.float32)
    strength[33:50, 35:70] = 1
    found = picture(chain("l"), frame(strength=strength))
    whole = picture(chain("l"), frame())
    left = strength[..., 0] == 0
    np.testing.assert_array_equal(found[left], light_of(1)[left])
    np.testing.assert_allclose(found[~left], whole[~left], atol=0.01)


def test_half_the_strength_is_half_the_way() -> None:
    found, whole = (picture(chain("l", strength=amount), frame()) for amount in (0.5, 1))
    np.testing.assert_allclose(found, (whole + light_of(1)) / 2, atol=1e-5)


def test_parts_add_up_to_the_picture() -> None:
    names = ["key", "fill"]
    light = light_of(1)
    given = replace(frame(), parts={"key": 0.25 * light, "fill": 0.75 * light})
    result = chain("l", parts=[Part(name) for name in names])(given)
    found, alone = result[Role.COLOUR], picture(chain("l"), frame())
    np.testing.assert_array_equal(found, alone)
    np.testing.assert_allclose(sum(result.parts[name] for name in names), found, rtol=1e-3,
                               atol=1e-4)


def test_light_outside_the_gamut_is_kept() -> None:
    """It is denoised in wider primaries."""
    light = light_of(1) * np.float32([1, 1, -0.1])
    found = picture(chain("l"), frame(colour=light))
    np.testing.assert_allclose(found.mean((0, 1)), light.mean((0, 1)), rtol=0.07)


def test_a_mask_of_differences_compares_light_without_the_filter() -> None:
    """Where nothing lies before what is opaque, the history counts as without a mask."""
    option = {"model": "l", "reactive": "difference"}
    masked, plain = chain(**option), chain("l")
    for number in (1, 2):
        wanted = picture(plain, frame(number))
        found = picture(masked, frame(number, opaque_colour=light_of(number)))
    np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_a_still_in_one_call() -> None:
    found = postfx.denoise(light_of(1), model="l", device="cpu", exposure=0.0)
    left = picture(chain("l", pixel_filter="none"), Frame({Role.COLOUR: light_of(1)}))
    assert psnr(found) > psnr(left) + LEAST_GAIN_DB


def test_open_image_denoise_sees_noise_that_is_independent() -> None:
    pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")

    def denoised(step: Pass) -> np.ndarray:
        return picture(Pipeline([step], Device("cpu", threads=2), exposure=0.0), frame())

    found, named, left = (denoised(Oidn(pixel_filter=given))
                          for given in ("auto", find_stddev(light_of(1)), "none"))
    assert psnr(found) > psnr(left) + LEAST_GAIN_DB
    np.testing.assert_array_equal(found, named)


@pytest.mark.parametrize(("words", "alone"), (
    ("denoise_upscale,model=l,scale=1", {"pixel_filter": STDDEV}),
    ("denoise_upscale,model=l,scale=1,pixel_filter=none", {"pixel_filter": "none"}),
))
def test_a_partner_undoes_the_same_filter_unless_its_own_words_name_one(
    words: str, alone: dict[str, object]
) -> None:
    pipeline = Pipeline([Partner(of=words, pixel_filter=STDDEV)], Device("cpu", threads=2),
                        exposure=0.0, cuts="none")
    beside = np.array(pipeline(frame())[Role.PARTNER])
    np.testing.assert_array_equal(beside, picture(chain("l", **alone), frame()))
