"""The tone-mapping and display passes, run through a pipeline."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.errors import FrameError, PassOptionError
from postfx.frame import Frame, FrameSpec, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.display import Display
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.system import models_dir

SPEC = FrameSpec(160, 90, [Role.COLOUR])


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def scene(seed: int = 0, height: int = 90, width: int = 160) -> np.ndarray:
    """Soft light over eight stops with coloured patches and a lamp."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    light = np.exp2(8 * x / width - 6)[..., None] * np.ones(3, np.float32)
    patches = (random.uniform(0.2, 1.0, (4, 4, 3)).repeat(height // 4 + 1, 0)
               .repeat(width // 4 + 1, 1)[:height, :width])
    lamp = 40.0 * (((x - 30) ** 2 + (y - 20) ** 2) < 36)[..., None]
    return np.ascontiguousarray(light * patches + lamp, np.float32)


def frame(colour: np.ndarray, **values: object) -> Frame:
    return Frame({Role.COLOUR: colour}, **values)


def tone_map(colour: np.ndarray, device: Device, ev: float = 0.0, **options: object) -> np.ndarray:
    return Pipeline([ToneMap(**options)], device, exposure=ev)(frame(colour))[Role.COLOUR]


def test_gives_display_colour_of_the_same_size_and_keeps_other_planes(device: Device) -> None:
    given = Frame({Role.COLOUR: scene(), Role.ALPHA: np.ones((90, 160, 1), np.float32)})
    out = Pipeline([ToneMap()], device)(given)
    assert out.encoding == "srgb"
    assert out[Role.COLOUR].shape == (90, 160, 3)
    assert out[Role.COLOUR].min() >= 0 and out[Role.COLOUR].max() <= 1
    np.testing.assert_array_equal(out[Role.ALPHA], given[Role.ALPHA])


@pytest.mark.parametrize(("tag", "grey", "slack"), [("aces2", 0.349, 0.002), ("local", 0.44, 0.06)])
def test_mid_grey_and_highlights_land_where_the_look_puts_them(
    device: Device, tag: str, grey: float, slack: float
) -> None:
    """ACES 2 puts mid grey at 0.349 of the sRGB signal, behind 0.75 stops of gain at 0.44."""
    found = tone_map(np.full((90, 160, 3), 0.18, np.float32), device, look=tag)
    np.testing.assert_allclose(found, grey, atol=slack)
    assert tone_map(np.full((90, 160, 3), 64.0, np.float32), device, look=tag).min() > 0.85
    assert tone_map(np.zeros((90, 160, 3), np.float32), device, look=tag).max() < 0.03


@pytest.mark.parametrize(("tag", "tint"), [("aces2", 1e-5), ("agx", 1e-3), ("pbr_neutral", 1e-5),
                                           ("local", 0.05), ("auto", 1e-5)])
def test_grey_stays_grey_and_brighter_stays_brighter(device: Device, tag: str, tint: float) -> None:
    ramp = np.exp2(np.linspace(-7, 5, 640, dtype=np.float32)) * 0.18
    out = tone_map(np.ascontiguousarray(np.broadcast_to(ramp[None, :, None], (360, 640, 3))),
                   device, look=tag)
    assert (out.max(2) - out.min(2)).max() < tint
    luminance = out[180] @ np.float32([0.2126, 0.7152, 0.0722])
    assert np.diff(luminance).min() > -1 / 255
    assert luminance[-1] - luminance[0] > 0.6


def test_light_outside_rec709_is_not_cut(device: Device) -> None:
    """A green of Rec.2020, whose red is negative in Rec.709, differs from the green that cutting
    would make of it."""
    green = np.full((8, 8, 3), [-0.2, 0.4, 0.0], np.float32)
    assert np.abs(tone_map(green, device, look="agx")
                  - tone_map(np.maximum(green, 0), device, look="agx")).max() > 0.02


def test_very_bright_colours_keep_their_hue(device: Device) -> None:
    """Orange of 600 and of 600000: cutting channel by channel would make the second yellow."""
    orange = np.full((8, 8, 3), [600.0, 150.0, 5.0], np.float32)
    np.testing.assert_allclose(tone_map(orange * 1000, device), tone_map(orange, device), atol=1e-4)


def test_a_look_can_be_a_file(device: Device) -> None:
    path = models_dir() / "tonemap.agx.onnx"
    np.testing.assert_array_equal(tone_map(scene(), device, look=str(path)),
                                  tone_map(scene(), device, look="agx"))


def test_exposure_scales_the_scene_before_the_look(device: Device) -> None:
    np.testing.assert_allclose(tone_map(scene() / 8, device, ev=3.0), tone_map(scene(), device),
                               atol=1e-4)
    assert tone_map(scene(), device, ev=2.0).mean() > tone_map(scene(), device).mean() + 0.05


def test_bad_pixels_stay_where_they_are(device: Device) -> None:
    colour = scene()
    bad = colour.copy()
    bad[10, 10], bad[50, 60], bad[70, 100] = np.nan, np.inf, -5.0
    out, clean = (tone_map(x, device, look="local") for x in (bad, colour))
    assert np.isfinite(out).all()
    touched = np.abs(out - clean).max(2) > 0.02
    assert set(map(tuple, np.argwhere(touched))) <= {(10, 10), (50, 60), (70, 100)}


def test_works_at_sizes_around_the_low_resolution_copy(device: Device) -> None:
    for height, width in ((1, 1), (3, 700), (256, 256), (301, 255)):
        out = tone_map(np.full((height, width, 3), 0.18, np.float32), device, look="local")
        np.testing.assert_allclose(out, 0.44, atol=0.06)


@pytest.mark.parametrize("tag", ["local", "auto"])
def test_a_still_picture_gives_the_same_bits_every_frame(device: Device, tag: str) -> None:
    pipeline = Pipeline([ToneMap(look=tag)], device, exposure=0.0)
    first = pipeline(frame(scene()))[Role.COLOUR].copy()
    for number in range(2, 12):
        np.testing.assert_array_equal(pipeline(frame(scene(), number=number))[Role.COLOUR], first)


def test_the_grid_follows_slowly_and_at_once_at_cuts(device: Device) -> None:
    """A picture and its mirror image: as much light, elsewhere."""
    given = scene(1)
    turned = np.ascontiguousarray(given[:, ::-1])

    def after(keep: float, **values: object) -> np.ndarray:
        pipeline = Pipeline([ToneMap(look="local", keep=keep)], device, exposure=0.0, cuts="none")
        pipeline(frame(given))
        return pipeline(frame(turned, **values))[Role.COLOUR]

    alone = after(0.0)
    np.testing.assert_array_equal(after(0.9, reset=True), alone)
    slow, slower = np.abs(after(0.5) - alone).mean(), np.abs(after(0.9) - alone).mean()
    assert 0 < slow < slower


def steady(tag: str, device: Device) -> Pipeline:
    return Pipeline([ToneMap(look=tag)], device, exposure=0.0, cuts="none")


def kept_of(pipeline: Pipeline) -> np.ndarray:
    return pipeline.passes[0].history()["held"].copy()


@pytest.mark.parametrize("stops", [-3, -1, 1, 3])
@pytest.mark.parametrize(("tag", "frames"), [("local", 5), ("auto", 22)])
def test_looks_follow_a_step_of_light(device: Device, tag: str, frames: int, stops: int) -> None:
    """90 % of the way after fewer frames than those, never back."""
    pipeline, light = steady(tag, device), scene()
    stepped = light.copy()
    stepped[:, 40:] *= 2.0**stops
    pipeline(frame(light))
    made, wanted = [], tone_map(stepped, device, look=tag)
    for _ in range(frames):
        made.append(pipeline(frame(stepped))[Role.COLOUR].copy())
    way = np.array([np.abs(picture - wanted).mean() for picture in made])
    assert way[-1] < 0.1 * way[0] and (np.diff(way) < 0).all()


@pytest.mark.parametrize(("tag", "share"), [("local", 0.41), ("auto", 0.021)])
def test_small_changes_hardly_move_a_look(device: Device, tag: str, share: float) -> None:
    """Light that wavers by a twentieth of a stop, and a noise: the look takes no more of it than
    its card says."""
    pipeline, random = steady(tag, device), np.random.default_rng(5)
    pipeline(frame(scene()))
    for number in range(8):
        before = kept_of(pipeline)
        given = scene() * np.float32(2.0 ** (0.05 * (number % 2))) * random.uniform(0.8, 1.2,
                                                                                    (90, 160, 1))
        alone = steady(tag, device)
        alone(frame(given.astype(np.float32)))
        pipeline(frame(given.astype(np.float32)))
        asked = np.abs(kept_of(alone) - before).mean()
        moved = np.abs(kept_of(pipeline) - before).mean()
        assert asked > 1e-4 and moved < share * asked


@pytest.mark.parametrize("tag", ["local", "auto"])
def test_a_slow_ramp_is_followed(device: Device, tag: str) -> None:
    """Two stops in 100 frames: the look is never made for light that is half a stop away."""
    pipeline, lights = steady(tag, device), []
    for number in range(100):
        pipeline(frame(scene() * np.float32(2.0 ** (number / 50))))
        lights.append(pipeline.passes[0].history()["light"][0, 1:3].copy())
    made_for, now = np.transpose(lights)
    assert now[-1] - now[0] > 1 and np.abs(made_for - now).max() < 0.5


def test_a_recalled_history_goes_on_with_the_same_bits_amid_a_change(device: Device) -> None:
    frames = [Frame({Role.COLOUR: scene() * np.float32(gain)}, number)
              for number, gain in enumerate([1, 1, 4, 4, 4])]
    whole, again = steady("auto", device), steady("auto", device)
    for given in frames[:3]:
        whole(given)
    kept = {name: np.array(value) for name, value in whole.history().items()}
    again.recall(frames[2], kept)
    for given in frames[3:]:
        np.testing.assert_array_equal(again(given)[Role.COLOUR], whole(given)[Role.COLOUR])


@pytest.mark.parametrize("tag", ["aces2", "local", "auto"])
def test_portable_kernels_give_the_same_picture(device: Device, tag: str) -> None:
    portable = Device("cpu", threads=2, compiled_kernels=False)
    np.testing.assert_allclose(tone_map(scene(), portable, look=tag),
                               tone_map(scene(), device, look=tag), atol=1e-5)


def test_skips_what_is_for_a_display_already() -> None:
    for encoding in ("display-linear", "srgb"):
        spec = FrameSpec(8, 8, [Role.COLOUR], encoding)
        assert encoding in (ToneMap().skip(spec) or "")
    assert ToneMap().skip(SPEC) is None
    assert Display().skip(FrameSpec(8, 8, [Role.COLOUR], "srgb"))
    assert Display().skip(FrameSpec(8, 8, [Role.COLOUR], "display-linear")) is None


def test_options_that_cannot_be_are_refused(device: Device) -> None:
    for keep in (-0.1, 1.0):
        with pytest.raises(PassOptionError, match="keep"):
            ToneMap(keep=keep)
    with pytest.raises(PassOptionError, match="look 'looks/tonemap.sepia.onnx': no such file"):
        ToneMap(look="looks/tonemap.sepia.onnx")


def test_a_look_that_is_not_there_is_told_where_the_pass_is_made() -> None:
    with pytest.raises(PassOptionError, match="no look 'aces3': did you mean aces2.* agx, auto"):
        ToneMap("aces3")


def test_the_denoiser_refuses_a_picture_that_is_tone_mapped() -> None:
    light = Frame({Role.COLOUR: np.ones((24, 32, 3), np.float32)})
    with pytest.raises(FrameError, match="colour is srgb, and the denoiser takes scene-linear"):
        Pipeline([ToneMap(), DenoiseUpscale(model="s")], Device("cpu"))(light)


def test_display_encodes_exposed_light_and_cuts_it_at_one(device: Device) -> None:
    colour = np.full((4, 4, 3), 0.25, np.float32)
    colour[0] = 9.0

    def encoded(encoding: str) -> np.ndarray:
        given = frame(colour, encoding=encoding)
        return Pipeline([Display()], device, exposure=1.0)(given)[Role.COLOUR]

    np.testing.assert_allclose(encoded("scene-linear")[1], 0.735357, atol=1e-5)
    np.testing.assert_allclose(encoded("display-linear")[1], 0.537099, atol=1e-5)
    assert (encoded("scene-linear")[0] == 1).all()
