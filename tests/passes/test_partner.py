"""Open Image Denoise as a pass, and another denoiser as a partner of the project's own."""

from __future__ import annotations

import copy
import pickle
from importlib.metadata import EntryPoint
from typing import Any, ClassVar

import numpy as np
import pytest

from postfx import DenoiseUpscale, Frame, MixPartner, Oidn, Partner, Pipeline, Role
from postfx.errors import DeviceError, FrameError, OptionError, PassOptionError, RegistryError
from postfx.frame import FrameSpec
from postfx.passes import Pass, Reflection, registry
from postfx.passes.partner import (
    BACKWARD_FRAMES,
    MIXTURE_REACH_SHARE,
    SHARE_BESIDE_A_PICTURE,
    SHARE_BESIDE_TWO_STAGES,
    partner_weight,
)
from postfx.plan import make_plan
from postfx.runtime import Device

SIZE = 24, 32


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=1)


@pytest.fixture
def with_oidn() -> None:
    pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")


def picture(seed: int = 0, **planes: np.ndarray) -> Frame:
    """A noisy grey frame, and other planes."""
    noise = np.random.default_rng(seed).gamma(2.0, 0.25, (*SIZE, 3)).astype(np.float32)
    return Frame({Role.COLOUR: noise,
                  **{Role(name): np.asarray(plane, np.float32) for name, plane in planes.items()}})


def even(value: float, channels: int = 3) -> np.ndarray:
    return np.full((*SIZE, channels), value, np.float32)


def run(passes: list[Pass], frames: list[Frame], device: Device) -> list[Frame]:
    pipeline = Pipeline(passes, device, exposure=0.0, cuts="none")
    return [pipeline(frame) for frame in frames]


class Brighter(Pass):
    """Doubles the colour: stands for a denoiser of another package."""

    name: ClassVar[str] = "brighter"

    def __init__(self, *, larger: bool = False) -> None:
        super().__init__(larger=larger)

    def reflect(self, spec: FrameSpec) -> Reflection:
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=spec)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        from postfx.runtime import ArgumentTable

        state = device.host_state("brighter", ("colour",), ("output",),
                                  lambda colour, output: np.copyto(
            output, 2 * colour))
        output = device.heap.transient("brighter", (spec.height, spec.width, 3))
        self._table = ArgumentTable(state, {"output": output})
        super().compile(device, spec)

    def encode(self, commands: Any, frame: Any) -> None:
        super().encode(commands, frame)
        self._table["colour"] = frame[Role.COLOUR]
        with commands.compute_encoder("brighter") as encoder:
            encoder.dispatch(self._table.state, self._table)
        frame.set(Role.COLOUR, self._table["output"])


@pytest.fixture
def plug_in(monkeypatch: pytest.MonkeyPatch) -> None:
    points = (EntryPoint("brighter", f"{__name__}:Brighter", registry.ENTRY_POINT_GROUP),)
    monkeypatch.setattr(registry, "_installed", lambda: {"brighter": points})


# Open Image Denoise


@pytest.mark.usefixtures("with_oidn")
def test_it_takes_noise_away_and_keeps_the_light(device: Device) -> None:
    noisy = picture(diffuse_albedo=even(0.4), specular_albedo=even(0.1), normal=even(0.5))
    (clean,) = run([Oidn()], [noisy], device)
    assert clean[Role.COLOUR].std() < 0.2 * noisy[Role.COLOUR].std()
    assert clean[Role.COLOUR].mean() == pytest.approx(noisy[Role.COLOUR].mean(), rel=0.05)


@pytest.mark.usefixtures("with_oidn")
def test_noisy_planes_are_cleaned_before_they_help(device: Device) -> None:
    """Noise of the albedo does not come out in the picture, as it would if it counted as clean."""
    albedo = np.random.default_rng(1).random((*SIZE, 3), np.float32)
    noisy = picture(diffuse_albedo=albedo, normal=even(0.5))
    (clean,) = run([Oidn()], [noisy], device)
    shown = np.corrcoef(clean[Role.COLOUR].ravel(), albedo.ravel())[0, 1]
    assert abs(shown) < 0.3 and clean[Role.COLOUR].std() < 0.3 * noisy[Role.COLOUR].std()


@pytest.mark.usefixtures("with_oidn")
def test_both_albedos_count(device: Device) -> None:
    """A texture that only the specular albedo shows stays sharp."""
    stripes = (np.arange(SIZE[1]) // 4 % 2 * 0.6 + 0.2).astype(np.float32)[None, :, None] * even(1)
    noise = np.random.default_rng(2).gamma(4.0, 0.25, (*SIZE, 3)).astype(np.float32)
    frame = Frame({Role.COLOUR: stripes * noise, Role.DIFFUSE_ALBEDO: even(0),
                   Role.SPECULAR_ALBEDO: stripes, Role.NORMAL: even(0.5)})
    (clean,) = run([Oidn()], [frame], device)
    assert (np.abs(clean[Role.COLOUR] - stripes).mean() < 0.4 * np.abs(frame[Role.COLOUR] - stripes)
            .mean())


@pytest.mark.usefixtures("with_oidn")
def test_an_albedo_for_denoisers_takes_the_place_of_the_others(device: Device) -> None:
    """It shows what a mirror shows, which the others do not."""
    stripes = (np.arange(SIZE[1]) // 4 % 2 * 0.6 + 0.2).astype(np.float32)[None, :, None] * even(1)
    noise = np.random.default_rng(2).gamma(4.0, 0.25, (*SIZE, 3)).astype(np.float32)
    others = {Role.COLOUR: stripes * noise, Role.DIFFUSE_ALBEDO: even(0.9), Role.NORMAL: even(0.5)}
    with_it, without = run([Oidn()],
                           [Frame({**others, Role.DENOISING_ALBEDO: stripes}), Frame(others)],
                           device)
    assert (np.abs(with_it[Role.COLOUR] - stripes)
            .mean() < 0.7 * np.abs(without[Role.COLOUR] - stripes).mean())


@pytest.mark.usefixtures("with_oidn")
def test_a_normal_for_denoisers_goes_with_such_an_albedo(device: Device) -> None:
    """It shows the edge of what a mirror shows, where the mirror itself is even."""
    rng = np.random.default_rng(2)
    step = (np.arange(SIZE[1]) >= SIZE[1] // 2).astype(np.float32)[None, :, None] * even(1)
    edge = np.where(step > 0, np.float32([0, 0.6, 0.8]),
                    np.float32([0.6, 0, 0.8])).astype(np.float32)
    frame = {Role.COLOUR: (0.2 + step) * rng.gamma(4.0, 0.25, (*SIZE, 3)).astype(np.float32),
             Role.DIFFUSE_ALBEDO: even(0.9), Role.NORMAL: even(0.5)}
    (plain,) = run([Oidn()], [Frame(frame)], device)
    (alone,) = run([Oidn()], [Frame({**frame, Role.DENOISING_NORMAL: edge})], device)
    (both,) = run([Oidn()],
                  [Frame({**frame, Role.DENOISING_ALBEDO: even(0.9), Role.DENOISING_NORMAL: edge})],
                  device)
    same = {**frame, Role.NORMAL: edge}
    (wanted,) = run([Oidn()], [Frame(same)], device)
    np.testing.assert_array_equal(alone[Role.COLOUR], plain[Role.COLOUR])
    np.testing.assert_array_equal(both[Role.COLOUR], wanted[Role.COLOUR])
    assert not np.array_equal(plain[Role.COLOUR], wanted[Role.COLOUR])


@pytest.mark.usefixtures("with_oidn")
def test_values_that_are_no_numbers_spoil_nothing(device: Device) -> None:
    bad = picture(diffuse_albedo=even(0.5), normal=even(0.5))
    for role, value in ((Role.COLOUR, np.nan), (Role.COLOUR, np.inf),
                        (Role.DIFFUSE_ALBEDO, np.nan)):
        bad.planes[role][3, 4] = value
    pipeline = Pipeline([Oidn()], device, exposure=0.0)
    result = pipeline.on_device(bad.planes, exposure=0.0)  # where nothing is repaired before
    assert np.isfinite(result[Role.COLOUR].download()).all()


@pytest.mark.usefixtures("with_oidn")
@pytest.mark.parametrize("covered", [0.0, 1.0])
def test_alpha_without_parts_of_pixels_stays_to_the_bit(covered: float, device: Device) -> None:
    alpha = np.zeros((*SIZE, 1), np.float32)
    alpha[5:] = covered
    (clean,) = run([Oidn()], [picture(alpha=alpha)], device)
    np.testing.assert_array_equal(clean[Role.ALPHA], alpha)


@pytest.mark.usefixtures("with_oidn")
def test_noisy_alpha_is_denoised_and_may_be_left_alone(device: Device) -> None:
    alpha = np.random.default_rng(3).binomial(4, 0.5, (*SIZE, 1)).astype(np.float32) / 4
    (clean,) = run([Oidn()], [picture(alpha=alpha)], device)
    (left,) = run([Oidn(alpha=False)], [picture(alpha=alpha)], device)
    assert clean[Role.ALPHA].std() < 0.5 * alpha.std()
    np.testing.assert_array_equal(left[Role.ALPHA], alpha)


@pytest.mark.usefixtures("with_oidn")
def test_filters_of_a_size_are_committed_once(device: Device,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    from postfx import oidn

    made: list[oidn.Kind] = []

    class Counted(oidn.Filters):
        def __init__(self, package: Any, where: Any, quality: int, kind: oidn.Kind) -> None:
            made.append(kind)
            super().__init__(package, where, quality, kind)

    monkeypatch.setattr(oidn, "Filters", Counted)
    run([Oidn()], [picture(seed) for seed in range(4)], device)
    assert len(made) == 1


@pytest.mark.usefixtures("with_oidn")
def test_an_unknown_quality_is_named() -> None:
    with pytest.raises(PassOptionError, match="no quality 'best': give fast, balanced, high"):
        Oidn(quality="best")


def test_without_the_package_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("postfx.oidn.find_spec", lambda name: None)
    for make in (Oidn, Partner):
        with pytest.raises(DeviceError,
                           match=r"pyoidn.*is not installed: pip install '\.\[oidn\]'"):
            make()


# The mixture


def mix(frames: list[Frame], device: Device, **options: Any) -> list[np.ndarray]:
    return [frame[Role.COLOUR] for frame in run([MixPartner(**options)], frames, device)]


def pair(colour: float, partner: float, **planes: np.ndarray) -> Frame:
    return Frame({Role.COLOUR: even(colour), Role.PARTNER: even(partner),
                  **{Role(name): np.asarray(plane, np.float32) for name, plane in planes.items()}})


def between(one: float, other: float, share: float = 0.5) -> float:
    return float(np.expm1((1 - share) * np.log1p(one) + share * np.log1p(other)))


FIRST = partner_weight(1)
SETTLED = 6  # frames from which on the weight changes little


def test_a_first_frame_is_the_weighted_mean_of_logarithms(device: Device) -> None:
    (found,) = mix([pair(1, 7)], device)
    np.testing.assert_allclose(found, between(1, 7, FIRST), rtol=1e-5)


def test_the_partner_counts_less_beside_a_history_a_larger_picture_and_a_better_network(
    device: Device
) -> None:
    weights = [partner_weight(frames) for frames in range(1, 40)]
    assert (weights == sorted(weights, reverse=True) and 0.7 < weights[0] <= 1
            and 0.2 < weights[-1] < 0.4)
    (enlarged,) = mix([pair(1, 7)], device, scale=2)
    np.testing.assert_allclose(enlarged, between(1, 7, partner_weight(1, 2.0)), rtol=1e-5)
    (known,) = mix([pair(1, 7)], device, both_ways=True)
    np.testing.assert_allclose(known, between(1, 7, partner_weight(1 + BACKWARD_FRAMES)), rtol=1e-5)
    (beside,) = mix([pair(1, 7)], device, model="xl")
    share = SHARE_BESIDE_A_PICTURE * partner_weight(1)
    np.testing.assert_allclose(beside, between(1, 7, share), rtol=1e-5)
    (beside,) = mix([pair(1, 7)], device, model="xl", scale=2)
    share = SHARE_BESIDE_TWO_STAGES * partner_weight(1, 2.0)
    np.testing.assert_allclose(beside, between(1, 7, share), rtol=1e-5)
    apart = [pair(0, light, motion=even(0, 2)) for light in (10, 1e3, 10, 1e3, 10, 1e3)]
    found = [float(np.log1p(picture).mean() / np.log1p(frame[Role.PARTNER]).mean())
             for picture, frame in zip(mix(apart, device), apart, strict=True)]
    assert found[1] > found[3] > found[5]  # the lower end of what is allowed


def test_the_count_of_frames_is_part_of_the_history(device: Device) -> None:
    mixer = MixPartner()
    run([mixer], [pair(1, 7, motion=even(0, 2)) for _ in range(2)], device)
    kept = mixer.history()
    assert kept["frames"].tolist() == [2]
    mixer.recall(kept)
    assert mixer.history()["frames"].tolist() == [2]
    mixer.reset()
    assert mixer.history() == {}


def test_where_both_agree_nothing_changes_by_a_bit(device: Device) -> None:
    given = np.random.default_rng(0).gamma(1, 1, (*SIZE, 3)).astype(np.float32) - 0.1
    (found,) = mix([Frame({Role.COLOUR: given, Role.PARTNER: given.copy()})], device)
    np.testing.assert_array_equal(found, given)


def test_the_last_mixture_stays_as_long_as_it_lies_near_the_mean(device: Device) -> None:
    still = {"motion": even(0, 2)}
    frames = [*[pair(1, 7, **still)] * SETTLED, pair(1.2, 6.5, **still), pair(20, 30, **still)]
    *_, first, second, third = mix(frames, device)
    np.testing.assert_allclose(second, first, rtol=0.03)
    weight = partner_weight(SETTLED + 2)
    np.testing.assert_allclose(third, between(20, 30, (1 - MIXTURE_REACH_SHARE) * weight),
                               rtol=1e-5)


def test_the_last_mixture_moves_along_the_motion(device: Device) -> None:
    """A bright column goes two pixels to the right; where the picture has no past, the mean comes
    out."""
    def column(at: int) -> np.ndarray:
        plane = even(1)
        plane[:, at] = 3
        return plane

    moved = np.broadcast_to(np.float32([-2, 0]), (*SIZE, 2))
    frames = [Frame({Role.COLOUR: column(at), Role.PARTNER: column(at) * 1.5,
                     Role.MOTION: moved.copy()})
              for at in range(10, 10 + 2 * SETTLED, 2)]
    *_, first, second = mix(frames, device)
    np.testing.assert_allclose(second[:, 8 + 2 * SETTLED], first[:, 6 + 2 * SETTLED], rtol=0.02)
    np.testing.assert_allclose(second[:, 0], between(1, 1.5, partner_weight(SETTLED)), rtol=1e-5)


def test_no_past_counts_without_motion_or_after_a_cut(device: Device) -> None:
    frames = [pair(1, 7), pair(1.2, 6.5)]
    np.testing.assert_allclose(mix(frames, device)[1], between(1.2, 6.5, FIRST), rtol=1e-5)
    moving = [pair(1, 7, motion=even(0, 2)), pair(1.2, 6.5, motion=even(0, 2))]
    moving[1].reset = True
    np.testing.assert_allclose(mix(moving, device)[1], between(1.2, 6.5, FIRST), rtol=1e-5)


@pytest.mark.parametrize(("option", "plane", "share"),
                         [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.5, 0.5, 0.25)])
def test_strength_says_how_much_is_mixed(option: float, plane: float, share: float,
                                         device: Device) -> None:
    (found,) = mix([pair(1, 7, strength=even(plane, 1))], device, strength=option)
    np.testing.assert_allclose(found, between(1, 7, share * FIRST), rtol=1e-5)


def test_parts_add_up_to_the_mixture(device: Device) -> None:
    given = pair(1, 7)
    given.parts = {"key": 0.75 * given[Role.COLOUR], "fill": 0.25 * given[Role.COLOUR]}
    (found,) = run([MixPartner(parts=["key", "fill"])], [given], device)
    np.testing.assert_allclose(found.parts["key"] + found.parts["fill"], found[Role.COLOUR],
                               rtol=1e-5)


def test_very_bright_light_is_not_cut(device: Device) -> None:
    (found,) = mix([pair(1e6, 1e8)], device)
    np.testing.assert_allclose(found, between(1e6, 1e8, FIRST), rtol=1e-3)


def test_it_says_why_it_does_nothing() -> None:
    skips = make_plan([MixPartner()], picture().spec).skips
    assert ("mix_partner", "there is no partner's picture") in [(skip.what, skip.why)
                                                                for skip in skips]


# Any pass as a partner


@pytest.mark.usefixtures("plug_in")
@pytest.mark.parametrize("scale", [1, 1.5, 2])
def test_any_pass_of_the_frames_size_may_be_a_partner(scale: float, device: Device) -> None:
    light = Frame({Role.COLOUR: even(0.5), Role.MOTION: even(0, 2), Role.DEPTH: even(1, 1)})
    passes = [Partner(of="brighter"), DenoiseUpscale(scale=scale, model="s.fp32"),
              MixPartner(scale=scale)]
    (found,) = run(passes, [light], device)
    (alone,) = run([DenoiseUpscale(scale=scale, model="s.fp32")], [light], device)
    assert set(found.planes) >= {Role.COLOUR} and Role.PARTNER not in found
    own = np.log1p(alone[Role.COLOUR])
    wanted = np.expm1(own + partner_weight(1, scale) * (np.log1p(1.0) - own))
    np.testing.assert_allclose(found[Role.COLOUR], wanted, rtol=1e-4)


def test_a_pass_that_changes_the_size_is_no_partner() -> None:
    with pytest.raises(FrameError,
                       match="pass 'denoise_upscale' cannot be a partner: it does not make a "
                       "picture"):
        make_plan([Partner(of="denoise_upscale,scale=2")], picture().spec)


def test_words_that_name_no_pass_are_refused() -> None:
    with pytest.raises(RegistryError, match="no pass 'oidm': did you mean oidn?"):
        Partner(of="oidm")
    with pytest.raises(OptionError, match="--with open image: give a name"):
        Partner(of="open image")
    with pytest.raises(PassOptionError, match="runs before the upscaler"):
        Partner(of="tonemap,after=display")


@pytest.mark.usefixtures("with_oidn")
def test_copies_do_not_share_the_other_pass(device: Device) -> None:
    one = Partner(of="oidn,quality=fast")
    for other in (copy.copy(one), pickle.loads(pickle.dumps(one))):
        assert other.options == one.options
        assert other.described().startswith("oidn (pyoidn ")
    frame = picture(diffuse_albedo=even(0.5), normal=even(0.5))
    (first,), (second,) = (run([each, DenoiseUpscale(scale=1, model="s.fp32"), MixPartner()],
                               [frame], device)
                           for each in (one, copy.copy(one)))
    np.testing.assert_array_equal(first[Role.COLOUR], second[Role.COLOUR])


@pytest.mark.usefixtures("with_oidn")
def test_the_partner_makes_the_result_better_and_as_steady(device: Device) -> None:
    """Noise on a flat wall: closer to the truth than both, and steadier than Open Image Denoise
    alone."""
    planes = {"diffuse_albedo": even(0.5), "normal": even(0.5), "depth": even(1, 1),
              "motion": even(0, 2)}
    frames = [picture(seed, **planes) for seed in range(6)]
    ours = run([DenoiseUpscale(scale=1)], frames, device)
    theirs = run([Oidn()], frames, device)
    both = run([Partner(), DenoiseUpscale(scale=1), MixPartner()], frames, device)

    def flicker(results: list[Frame]) -> float:
        colours = [result[Role.COLOUR] for result in results[2:]]
        return float(np.mean([np.abs(b - a).mean()
                              for a, b in zip(colours, colours[1:], strict=False)]))

    def error(results: list[Frame]) -> float:
        return float(np.mean([((result[Role.COLOUR] - 0.5) ** 2).mean() for result in results[2:]]))

    assert flicker(both) < 0.75 * flicker(theirs)
    assert error(both) < max(error(ours), error(theirs))
