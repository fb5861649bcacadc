"""Parts of the picture, and alpha, through the denoiser: their sum is the picture, which does not
change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.errors import FrameError, PassOptionError
from postfx.frame import PART_KINDS, Frame, Part, Role
from postfx.kernels.denoise.alpha import CORRECT, FIT, GATHER
from postfx.passes.denoise import DenoiseUpscale, kinds
from postfx.passes.denoise.assembly import FrameNetworks
from postfx.passes.denoise.part_sums import coverage
from postfx.passes.denoise.parts import mean_stops
from postfx.pipeline import Pipeline
from postfx.planes import has_negative_light
from postfx.runtime import Device
from postfx.system import PROCESS
from tests.passes.denoise_frames import guided, noisy

NAMES = ("key", "fill", "rim")


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def lit(number: int, height: int = 37, width: int = 50) -> Frame:
    """A frame with three light groups that add up to its colour; the last one is dark on the
    left."""
    frame = noisy(number, height, width)
    shares = np.random.default_rng([7, number]).random((3, height, width, 3), np.float32)
    shares[2, :, : width // 2] = 0
    shares /= shares.sum(0)
    frame.parts = {name: frame[Role.COLOUR] * share
                   for name, share in zip(NAMES, shares, strict=True)}
    return frame


def upscaler(device: Device, **options) -> Pipeline:
    return Pipeline([DenoiseUpscale(**{"model": "s.fp32", "scale": 2, **options})], device,
                    exposure=0.5)


def assert_adds_up(frame: Frame, names: tuple[str, ...] = NAMES) -> None:
    picture = frame[Role.COLOUR]
    np.testing.assert_allclose(sum(frame.parts[name] for name in names), picture, rtol=1e-5,
                               atol=1e-6)
    assert all(frame.parts[name].min() >= 0 for name in names)


def masked(frame: Frame, value: float) -> Frame:
    strength = np.zeros((*frame[Role.COLOUR].shape[:2], 1), np.float32)
    strength[8:20, 8:40] = value
    return replace(frame, planes={**frame.planes, Role.STRENGTH: strength})


KINDS = {
    "2x": ({}, lambda frame: frame),
    "1.5x": ({"scale": 1.5}, lambda frame: frame),
    "1x, detail given back": ({"scale": 1},
                              lambda frame: replace(frame, jitter=(0.0, 0.0), samples=256)),
    "guides": ({}, lambda frame: guided(frame, 74, 100)),
    "strength 0.5": ({"strength": 0.5}, lambda frame: frame),
    "strength 0": ({"strength": 0.0}, lambda frame: frame),
    "a mask": ({}, lambda frame: masked(frame, 0.7)),
    "a mask of nothing": ({}, lambda frame: masked(frame, 0.0)),
    "own filters": ({"part_filters": "own"}, lambda frame: frame),
    "own filters, guides": ({"part_filters": "own"}, lambda frame: guided(frame, 74, 100)),
    "own filters, a mask": ({"part_filters": "own"}, lambda frame: masked(frame, 0.7)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_parts_add_up_to_the_picture_which_is_the_same_without_them(kind: str,
                                                                    device: Device) -> None:
    options, change = KINDS[kind]
    with_parts, without = upscaler(device, parts=NAMES, **options), upscaler(device, **options)
    for frame in map(change, map(lit, (1, 2, 3))):
        found = with_parts(frame)
        np.testing.assert_array_equal(found[Role.COLOUR], without(frame)[Role.COLOUR])
        assert_adds_up(found)


def test_a_still_frame_and_a_cut(device: Device) -> None:
    pipeline = upscaler(device, parts=NAMES)
    for number in (1, 2, 3):
        frame = lit(number)
        frame.planes[Role.MOTION][:] = 0
        assert_adds_up(pipeline(replace(frame, reset=number == 3)))


def test_some_parts_are_what_they_are_among_all(device: Device) -> None:
    """The rest of the picture, which nobody asked for, is left to it: in the first frame, and by
    its history."""
    all_of_it, some = upscaler(device, parts=NAMES), upscaler(device, parts=NAMES[:2])
    for frame in map(lit, (1, 2, 3)):
        whole, found = all_of_it(frame), some(frame)
        for name in NAMES[:2]:
            np.testing.assert_allclose(found.parts[name], whole.parts[name], rtol=2e-3, atol=1e-4)
        assert "rim" not in found.parts


@pytest.mark.parametrize("way", ["a memory budget", "a mask"])
def test_tiles_give_the_same(way: str, device: Device) -> None:
    """The network works on windows: all of the frame in turn, or around what is not left as it
    is."""
    size = (200, 320) if way == "a memory budget" else (300, 420)
    tiles = Device("cpu", 2, memory=PROCESS + (150 << 20)) if way == "a memory budget" else device
    whole, tiled = upscaler(device, parts=NAMES), upscaler(tiles, parts=NAMES)
    for frame in (lit(number, *size) for number in (1, 2)):
        wanted, found = whole(frame), tiled(frame if tiles is not device else masked(frame, 1.0))
        assert_adds_up(found)
        inner = slice(24, 32), slice(24, 64)
        for name in NAMES:
            np.testing.assert_allclose(found.parts[name][inner], wanted.parts[name][inner],
                                       rtol=0.02, atol=0.01)
    assert tiles is not device or "network outside of" in str(tiled.explain())


@pytest.mark.parametrize("filters", ["picture", "own"])
def test_history_goes_on_after_a_stop_and_when_frames_change_their_size(filters: str,
                                                                        device: Device) -> None:
    options = {"parts": NAMES, "scale": None, "size": (100, 74), "part_filters": filters}
    pipeline, again = upscaler(device, **options), upscaler(device, **options)
    frames = [lit(number, *size) for number, size in enumerate(((37, 50), (40, 54), (37, 50)), 1)]
    for frame in frames[:2]:
        assert_adds_up(pipeline(frame))
    again.recall(frames[1], {name: array.copy() for name, array in pipeline.history().items()})
    found, resumed = pipeline(frames[2]), again(frames[2])
    assert_adds_up(found)
    assert all(np.array_equal(resumed.parts[name], found.parts[name]) for name in NAMES)


@pytest.mark.parametrize("filters", ["picture", "own"])
def test_a_recalled_history_is_all_there_is(filters: str, device: Device) -> None:
    """What a part left before is forgotten where the history has none of it."""
    pipeline = upscaler(device, parts=NAMES, part_filters=filters)
    frame = pipeline(lit(1)) and lit(1)
    kept = {name: array.copy()
            for name, array in pipeline.history().items() if not name.endswith(" of key")}
    assert len(kept) < len(pipeline.history())
    pipeline.recall(frame, kept)
    assert set(pipeline.history()) == set(kept)


def test_each_part_has_a_history_of_its_own(device: Device) -> None:
    """Noise that comes and goes is averaged: a still part differs less from frame to frame than its
    input."""
    pipeline, parts = upscaler(device, parts=NAMES), []
    for number in range(1, 6):
        frame = lit(number)
        frame.planes = {**lit(1).planes, Role.COLOUR: frame[Role.COLOUR],
                        Role.MOTION: 0 * frame[Role.MOTION]}
        parts.append(pipeline(frame).parts["key"])
    alone = upscaler(device, parts=NAMES)(replace(frame, reset=True)).parts["key"]
    assert np.abs(parts[-1] - parts[-2]).mean() < 0.7 * np.abs(alone - parts[-2]).mean()


def test_own_filters_see_the_noise_of_a_weak_light(device: Device) -> None:
    """Beside a strong and clean one, of whose picture the filters have nothing to do."""
    frame = lit(1)
    frame.planes = {role: np.broadcast_to(plane.mean((0, 1)), plane.shape).copy()
                    for role, plane in frame.planes.items()}
    noise = np.random.default_rng(2).exponential(0.02, (37, 50, 1)).astype(np.float32)
    frame.parts = {"strong": frame[Role.COLOUR], "weak": noise * frame[Role.COLOUR]}
    frame.planes[Role.COLOUR] = frame.parts["strong"] + frame.parts["weak"]
    by = {filters: upscaler(device, parts=["strong", "weak"], part_filters=filters)(frame)
                   .parts["weak"] for filters in ("picture", "own")}
    assert by["own"].std() < 0.7 * by["picture"].std()
    assert abs(by["own"].mean() - frame.parts["weak"].mean()) < 0.2 * frame.parts["weak"].mean()
    assert "own filters: strong, weak" in str(
        upscaler(device, parts=["strong", "weak"], part_filters="own").explain(
        frame.spec))
    with pytest.raises(PassOptionError, match="no part filters 'all': give picture or own"):
        DenoiseUpscale(part_filters="all")


def test_planes_are_filtered_at_output_size_and_keep_their_meaning(device: Device) -> None:
    frame = lit(1)
    frame.parts = {"n": frame[Role.NORMAL], "p": 9 * frame[Role.NORMAL] - 3,
                   "mist": frame[Role.ROUGHNESS]}
    found = upscaler(device, parts=[Part("n", "normal"), Part("p", "position"),
                                    Part("mist", "mist")])(frame).parts
    np.testing.assert_allclose(np.linalg.norm(found["n"], axis=2), 1, atol=1e-5)
    assert found["p"].min() >= frame.parts["p"].min() and found["p"].max() <= frame.parts["p"].max()
    assert (found["mist"].shape == (74, 100, 1)
            and 0 <= found["mist"].min() <= found["mist"].max() <= 1)
    assert abs(found["p"].mean() - frame.parts["p"].mean()) < 0.2


def test_depth_is_filtered_by_its_reciprocals_and_nothing_stays_nothing(device: Device) -> None:
    frame = lit(1)
    noise = np.random.default_rng(5).random((37, 50, 1), np.float32)
    planes = {"cycles": 1e10, "infinite": np.inf, "none is 0": 0.0, "camera looks along -z": -1e30}
    for name, nothing in planes.items():
        frame.parts[name] = np.where(np.arange(50)[:, None] < 30,
                                     np.float32(-1 if nothing < 0 else 1) * (4 + noise),
                                     np.float32(nothing))
    parts = [Part(name, "depth") for name in planes]
    for strength in (1.0, 0.5, 0.0):
        found = upscaler(device, parts=parts, strength=strength)(frame).parts
        for name, nothing in planes.items():
            assert (found[name].shape == (74, 100, 1)
                    and (found[name][:, 76:] == np.float32(nothing)).all())
            there = (-1 if nothing < 0 else 1) * found[name][:, :40]
            assert 4 <= there.min() and there.max() <= 5 and abs(there.mean() - 4.5) < 0.1
            assert strength < 1 or there.std() < 0.5 * noise.std()


def test_fog_is_filtered_without_the_reflectance_of_what_lies_behind(device: Device) -> None:
    frame = lit(1)
    fog = np.full_like(frame[Role.COLOUR], 0.3)
    frame.planes[Role.COLOUR] = frame[Role.COLOUR] + fog
    frame.parts["fog"] = fog
    parts = upscaler(device, parts=[*NAMES, Part("fog", "scatter")])(frame)
    assert_adds_up(parts, (*NAMES, "fog"))
    as_light = upscaler(device, parts=[*NAMES, Part("fog", "light")])(frame)
    assert parts.parts["fog"].std() < 0.6 * as_light.parts["fog"].std()


def test_every_kind_of_parts_stands_in_the_table():
    """In the order in which users read it. Only light is divided by reflectance."""
    assert tuple(kinds.KINDS) == PART_KINDS
    divided = [name for name, kind in kinds.KINDS.items() if kind.divided]
    assert divided == ["light", "diffuse", "specular"]


def test_own_filters_of_fog_see_no_surface(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planes of the surface behind fog mislead them; light through glass, which files divide by a
    colour, has one."""
    runs, encode = [], FrameNetworks.encode

    def record(frames: FrameNetworks, commands, planes, *rest, **named):
        runs.append({name: planes[name].download()
                     for name in ("colour", "normal", "depth", "diffuse_albedo")})
        return encode(frames, commands, planes, *rest, **named)

    monkeypatch.setattr(FrameNetworks, "encode", record)
    frame = lit(1)
    frame.parts = {"fog": 0.2 * frame[Role.COLOUR], "glass": 0.3 * frame[Role.COLOUR],
                   "colour": np.ones((37, 50, 3), np.float32)}
    parts = [Part("fog", "scatter"), Part("glass", "scatter", factor="colour"),
             Part("colour", "factor")]
    upscaler(device, parts=parts, part_filters="own")(frame)
    seen = {name: next(run for run in runs if np.array_equal(run["colour"], frame.parts[name]))
            for name in ("fog", "glass")}
    assert not seen["fog"]["normal"].any() and (seen["fog"]["depth"] == 1).all()
    assert np.array_equal(seen["glass"]["normal"], frame[Role.NORMAL])
    assert not seen["fog"]["diffuse_albedo"].any() and not seen["glass"]["diffuse_albedo"].any()


def test_no_light_lies_where_there_is_no_lamp_and_no_surface_of_its_kind(device: Device) -> None:
    frame, there = lit(1), np.zeros((37, 50, 3), np.float32)
    there[10:20, 10:20] = 1
    light = frame[Role.COLOUR]
    frame.parts = {"lamp": 4 * there, "glass": there * light, "rest": (1 - there) * light,
                   "colour of glass": there}
    frame.planes[Role.COLOUR] = light + 4 * there
    parts = [Part("lamp", "emission"), Part("glass", "scatter", factor="colour of glass"),
             Part("rest"), Part("colour of glass", "factor")]
    for filters in ("picture", "own"):
        found = upscaler(device, parts=parts, part_filters=filters)(frame)
        assert_adds_up(found, ("lamp", "glass", "rest"))
        for name in ("lamp", "glass"):
            inside = found.parts[name][24:36, 24:36]
            assert inside.min() >= 0 and (inside > 0).mean() > 0.99  # sharpening may reach zero
            found.parts[name][18:42, 18:42] = 0
            assert not found.parts[name].any()


def test_a_part_fades_at_the_edges_of_its_surfaces_but_sparse_light_reaches_everywhere() -> None:
    lit = np.zeros((24, 30), bool)
    lit[:, 12:] = True
    np.testing.assert_allclose(coverage(lit, True),
                               np.tile(np.repeat([0, 1 / 3, 1], [11, 1, 18]), (24, 1)), atol=1e-6)
    sparse = np.random.default_rng(4).random((24, 30)) < 0.2
    assert coverage(sparse, True).mean() > 0.98 and coverage(sparse, False).mean() < 0.6
    assert not coverage(np.zeros((24, 30), bool), True).any()


def test_sparse_light_is_exposed_by_its_mean() -> None:
    light = np.full((64, 40, 3), 1e-4, np.float32)
    light[:, ::20] = 5.0
    assert abs(mean_stops(light) + 2) < 0.01 and mean_stops(0 * light) is None
    light[8, 3] = np.nan
    assert abs(mean_stops(light) + 2) < 0.01


def test_alpha_is_denoised_where_it_is_noisy_and_left_alone_where_it_is_clean(
    device: Device
) -> None:
    frame = lit(1)
    noise = np.random.default_rng(3).random((37, 50, 1), np.float32)
    noisy_alpha = replace(frame,
                          planes={**frame.planes, Role.ALPHA: (0.6 > noise) * (0.5 + 0.5 * noise)})
    drawn = np.kron(np.random.default_rng(3).random((8, 10)) > 0.5,
                    np.ones((5, 5), np.bool_))[:37, :50, None]
    clean = replace(frame, planes={**frame.planes, Role.ALPHA: drawn.astype(np.float32)})
    resampled = upscaler(device, alpha=False)
    denoised, again, *others = (upscaler(device) for _ in range(4))
    assert np.array_equal(denoised(clean)[Role.ALPHA], resampled(clean)[Role.ALPHA])
    found, plain = denoised(noisy_alpha)[Role.ALPHA], resampled(noisy_alpha)[Role.ALPHA]
    assert found.shape == (74, 100, 1) and 0 <= found.min() and found.max() <= 1
    assert (found.std() < 0.5 * plain.std()
            and abs(found.mean() - noisy_alpha[Role.ALPHA].mean()) < 0.07)
    again.recall(noisy_alpha, {name: array.copy() for name, array in denoised.history().items()})
    assert np.array_equal(again(noisy_alpha)[Role.ALPHA], denoised(noisy_alpha)[Role.ALPHA])
    first, second = ([run(frame) for frame in (before, clean, noisy_alpha)][-1][Role.ALPHA]
                     for run, before in zip(others, (clean, noisy_alpha), strict=True))
    assert np.array_equal(first, second)  # what lies two frames back is no history


NEAR = np.full((1, 1), 2, np.float32)


def gathered(alphas: list[np.ndarray], step: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Means of alpha (h, w) of frames that move by so much, at 4 samples a pixel, and their
    variance."""
    (h, w), rates = alphas[0].shape, np.array([1, 1 / 4, 1 / 32, 1 / 16], np.float32)
    samples, doubt = np.zeros((2 * h, 2 * w, 1), np.float32), np.zeros((h, w, 1), np.float32)
    moved = np.broadcast_to(-np.float32(step), (h, w, 2)).copy()
    for i, alpha in enumerate(alphas):
        part = alpha[..., None].astype(np.float32)
        last = samples.copy(), doubt.copy(), rates * np.float32([i > 0, 1, 1, 1])
        GATHER.rows(0, h, part, moved, *last[:2], NEAR, last[2], samples, doubt)
    return samples[..., 0], doubt[..., 0]


def stripe(place: float, size: int, pixels: int) -> np.ndarray:
    """Coverage of pixels of a row by a stripe 0.5 units wide; `pixels` in each of `size` units."""
    edges = np.arange(size * pixels + 1) / pixels
    return np.diff(np.clip(edges, place, place + 0.5)) * pixels


def test_means_of_alpha_are_exact_where_nothing_moves_and_begin_anew_where_it_changed() -> None:
    alphas = list((np.random.default_rng(1).random((8, 16, 20, 4)) < 0.4).mean(-1))
    samples, doubt = gathered(alphas, (0, 0))
    exact = np.isclose(samples, np.kron(np.mean(alphas, 0), np.ones((2, 2))), atol=1e-5)
    # chance alone begins anew at a few
    assert (exact.mean() > 0.9 and np.isclose(doubt, 1 / 32).mean() > 0.9)
    samples, doubt = gathered([*alphas, np.ones((16, 20))], (0, 0))
    assert samples.min() == 1 and doubt.min() == 0.25


def test_means_of_alpha_know_quarters_of_pixels_where_things_move_by_parts_of_one() -> None:
    alphas = [np.tile(stripe(4.1 + 0.5 * i, 24, 1), (12, 1)) for i in range(8)]
    samples, _ = gathered(alphas, (0.5, 0))
    wanted = stripe(4.1 + 0.5 * 7, 24, 2)
    blurred = np.repeat(alphas[-1][6], 2)
    assert np.abs(samples[12] - wanted).sum() < 0.5 * np.abs(blurred - wanted).sum()


def test_corrected_alpha_comes_nearer_to_its_samples_where_it_has_structure() -> None:
    random = np.random.default_rng(0)
    filtered = random.uniform(0.3, 0.7, (26, 30, 1)).astype(np.float32)
    filtered[:14] = np.linspace(0.3, 0.5, 30)[:, None]  # a slope: what differs there is noise
    samples, moved = np.full((26, 30, 1), 0.45, np.float32), np.zeros((13, 15, 2), np.float32)
    doubt = np.full((13, 15, 1), 0.25, np.float32)
    doubt[:, 8:] = 0
    found, fit = np.empty((26, 30, 1), np.float32), np.zeros((4, 13, 15), np.float32)
    rest = np.zeros((26, 30, 3), np.float32), fit, samples, doubt, moved, NEAR
    CORRECT.rows(0, 26, filtered, *rest, np.array([0.25, 0.01, 0, 0], np.float32), found)
    means, before = (alpha[..., 0].reshape(13, 2, 15, 2).mean((1, 3))
                     for alpha in (found, filtered))
    apart = np.abs(means - 0.45) / np.abs(before - 0.45)
    np.testing.assert_allclose(found[:11, 2:-2], filtered[:11, 2:-2], atol=0.02)
    assert np.median(apart[9:12, 9:]) < np.median(apart[9:12, :7]) < 0.95
    sharper = np.empty((26, 30, 1), np.float32)
    CORRECT.rows(0, 26, filtered, *rest, np.array([0, 0, 0.5, 0], np.float32), sharper)
    assert sharper[18:].std() > 1.2 * filtered[18:].std()


def test_alpha_gets_the_edges_that_colours_have() -> None:
    inside = np.add.outer(0.7 * np.arange(32), np.arange(40)) > 37.3  # an edge across
    picture = np.where(inside[..., None], (0.9, 0.5, 0.1), (0.0, 0.0, 0.0)).astype(np.float32)
    samples = np.kron(inside.reshape(16, 2, 20, 2).mean((1, 3)),
                      np.ones((2, 2)))[..., None].astype(np.float32)
    fit, found = np.empty((4, 16, 20), np.float32), np.empty((32, 40, 1), np.float32)
    FIT.rows(0, 16, picture, samples, NEAR, fit)
    doubt, moved = np.zeros((16, 20, 1), np.float32), np.zeros((16, 20, 2), np.float32)
    for share, least, most in ((0, 0.1, 1), (1, 0, 0.05)):
        gain = np.array([0, 1e-6, 0, share], np.float32)
        CORRECT.rows(0, 32, samples, picture, fit, samples, doubt, moved, NEAR, gain, found)
        assert least <= np.abs(found[..., 0] - inside)[4:-4, 4:-4].max() <= most


def test_alpha_of_many_samples_is_nearly_the_frame_s_own_but_not_if_it_is_jittered(
    device: Device
) -> None:
    alpha = np.broadcast_to(np.where(np.arange(50) % 5 < 2, 0.9, 0.0)[:, None],
                            (37, 50, 1)).astype(np.float32)
    frame = replace(lit(1), samples=256)
    frame.planes[Role.ALPHA] = alpha
    own, shifted = (upscaler(device)(replace(frame, jitter=jitter))[Role.ALPHA].reshape(
        37, 2, 50, 2
    ).mean((1, 3)) for jitter in ((0.0, 0.0), (1e-6, 0.0)))
    assert np.abs(own - alpha[..., 0]).mean() < 0.7 * np.abs(shifted - alpha[..., 0]).mean()


def test_the_plan_shows_parts_and_a_missing_one_is_named(device: Device) -> None:
    pipeline = upscaler(device, parts=NAMES)
    plan = pipeline.explain(lit(1).spec)
    assert plan.parts == ("fill", "key", "rim") and "parts   fill, key, rim" in str(plan)
    assert plan.as_dict()["parts"] == ["fill", "key", "rim"]
    frame = lit(1)
    del frame.parts["fill"]
    with pytest.raises(FrameError, match="no part 'fill': its parts are key, rim"):
        pipeline(frame)
    with pytest.raises(FrameError, match="'key' is named twice"):
        DenoiseUpscale(parts=["key", Part("key", "diffuse")])
    with pytest.raises(FrameError, match="unknown kind 'glow': use light"):
        Part("key", "glow")
    with pytest.raises(FrameError, match=r"part 'key' of frame 1 has shape \(3, 3, 3\)"):
        replace(lit(1), parts={"key": np.zeros((3, 3, 3), np.float32)})


def test_values_that_no_file_should_hold_do_not_spread(device: Device) -> None:
    pipeline = upscaler(device, parts=NAMES)
    frame = lit(1)
    frame.parts["key"][3, 4] = np.nan
    frame.parts["key"][9, 9] = np.inf
    frame.parts["fill"][5, 5] = -4
    for current in (frame, lit(2)):
        found = pipeline(current)
        assert all(np.isfinite(part).all() and part.min() >= 0 for part in found.parts.values())


def test_alpha_of_one_sample_a_pixel_is_denoised():
    """It is 0 or 1 everywhere, and noise all the same; a mask that was drawn stays."""
    rng, (rows, columns) = np.random.default_rng(4), np.mgrid[0:64, 0:96]
    cover = np.clip((20 - np.hypot(columns - 48, rows - 32)) / 14 + 0.5, 0, 1)
    noisy = (rng.random(cover.shape) < cover).astype(np.float32)
    drawn = (cover > 0.5).astype(np.float32)
    drawn[5] = 1  # a wire
    pipeline = Pipeline([DenoiseUpscale(scale=1, model="s")], Device("cpu"))
    made = []
    for alpha in (noisy, drawn):
        colour = np.repeat(0.5 * alpha[..., None], 3, axis=2)
        made.append(pipeline(Frame({Role.COLOUR: colour, Role.ALPHA: alpha},
                                   reset=True))[Role.ALPHA][..., 0])
    assert np.mean((made[0] - cover) ** 2) < 0.3 * np.mean((noisy - cover) ** 2)
    np.testing.assert_array_equal(made[1], drawn)


BEYOND = {
    "twice the picture": {"a": 2.0},
    "one and a half": {"a": 1.0, "b": 0.5},
    "split twice": {"key": 0.6, "fill": 0.4, "diffuse": 0.7, "specular": 0.3},
}


@pytest.mark.parametrize("kind", BEYOND)
def test_light_that_is_no_part_of_the_picture_is_filtered_and_never_rescaled(
    kind: str, device: Device
) -> None:
    """Such parts were cut to the picture, in silence: the first one to half of its light."""
    pipeline = upscaler(device, parts=tuple(BEYOND[kind]), scale=1)
    for number in (1, 2):
        frame = noisy(number, 37, 50)
        frame.parts = {name: share * frame[Role.COLOUR] for name, share in BEYOND[kind].items()}
        found = pipeline(frame)
        for name, part in found.parts.items():
            assert part.mean() == pytest.approx(BEYOND[kind][name] * found[Role.COLOUR].mean(),
                                                rel=0.05)


SHARES = {"key": 1.4, "dark": -0.6, "fill": 0.2}
"""Of the picture's light; the second part takes light away."""


@pytest.mark.parametrize("options", [{}, {"scale": 1}, {"strength": 0.5}, {"strength": 0.0},
                                     {"part_filters": "own"}], ids=str)
def test_light_below_0_stays(options: dict[str, object], device: Device) -> None:
    """It was cut, and the parts then added up to more than the picture."""
    pipeline = upscaler(device, parts=tuple(SHARES), **options)
    for number in (1, 2, 3):
        frame = noisy(number, 37, 50)
        frame.parts = {name: share * frame[Role.COLOUR] for name, share in SHARES.items()}
        found = pipeline(frame)
    picture = found[Role.COLOUR]
    np.testing.assert_allclose(sum(found.parts.values()), picture, rtol=1e-4, atol=1e-5)
    for name, share in SHARES.items():
        assert found.parts[name].mean() == pytest.approx(share * picture.mean(), rel=0.12, abs=0)


def test_light_below_0_may_come_late_and_a_stop_changes_nothing(device: Device) -> None:
    def frames() -> list[Frame]:
        found = [noisy(number, 37, 50) for number in (1, 2, 3, 4)]
        for number, frame in enumerate(found):
            shadow = frame[Role.COLOUR] * np.float32(0.1 if number < 1 else -0.5)
            frame.parts = {"shadow": shadow, "rest": frame[Role.COLOUR] - shadow}
        return found

    pipeline, again = (upscaler(device, parts=("shadow", "rest")) for _ in range(2))
    found = [pipeline(frame) for frame in frames()[:3]]
    kept = {name: array.copy() for name, array in pipeline.history().items()}
    again.recall(frames()[2], kept)
    last, resumed = pipeline(frames()[3]), again(frames()[3])
    assert found[0].parts["shadow"].min() >= 0 > found[1].parts["shadow"].max()
    for name, part in last.parts.items():
        np.testing.assert_array_equal(resumed.parts[name], part)


def test_what_a_pixel_filter_leaves_below_0_costs_no_layer(device: Device) -> None:
    part = np.ones((16, 16, 3), np.float32)
    part[::8] = -0.02
    picture = np.ones((16, 16, 3), np.float32)
    assert has_negative_light(part, picture)
    assert not has_negative_light(np.where(part < 0, 1, part) * np.float32(0.999), picture)
    # a layer without light, which a renderer rounds
    assert not has_negative_light(np.full((16, 16, 3), -1e-6, np.float32), picture)
    part[::8] = 1
    part[0, 0] = -0.02
    assert not has_negative_light(part, picture)


def between_lamps(number: int, on_the_camera: bool) -> Frame:
    """A wall that pans by three pixels a frame, in the light of two lamps that is the same
    everywhere together. Each one's light grows across the screen, or across the wall."""
    height, width = 64, 96
    y, x = np.mgrid[:height, :width] + 0.5
    wall = x + 3 * number
    light = 0.5 + 0.2 * np.sin(0.35 * wall) * np.cos(0.3 * y)
    share = x / 120 if on_the_camera else wall / 150
    random = np.random.default_rng(number)
    parts = {name: (light * part)[..., None] * random.gamma(64, 1 / 64, (height, width, 3))
             for name, part in (("key", share), ("fill", 1 - share))}
    planes = {Role.COLOUR: sum(parts.values()), Role.DEPTH: np.full((height, width, 1), 5.0),
              Role.MOTION: np.zeros((height, width, 2)) + (3.0, 0.0)}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=number + 1, parts={name: part.astype(np.float32)
                                           for name, part in parts.items()})


@pytest.mark.parametrize(("on_the_camera", "filters", "least", "most"), [
    (False, "picture", 0.0, 0.006), (True, "picture", 0.05, 0.1), (True, "own", 0.0, 0.025)])
def test_light_that_passes_from_part_to_part_is_late(device, on_the_camera, filters, least, most):
    """By one to two frames of 0.06 each: the picture shows nothing of it, and parts trust earlier
    frames where the picture does."""
    pipeline = Pipeline([DenoiseUpscale(model="s", scale=1, parts=("key", "fill"),
                                        part_filters=filters)], device)
    for number in range(6):
        given = between_lamps(number, on_the_camera)
        shown = pipeline(given)
    off = max(abs(float(shown.parts[name].mean() / part.mean()) - 1)
              for name, part in given.parts.items())
    assert least <= off <= most
    assert_adds_up(shown, ("key", "fill"))
