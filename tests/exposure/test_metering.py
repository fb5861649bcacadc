"""Exposure metering: what it must not be fooled by, that the meter only looks back, and that the
smooth curve lags behind nothing and is broken at cuts."""

from __future__ import annotations

import time
from statistics import NormalDist

import numpy as np
import pytest

import postfx
from postfx.exposure import (
    ExposureError,
    ExposureMeter,
    MeterReading,
    SmoothExposure,
    colours_of,
    measure,
    meter_frames,
    smooth_ev,
)
from postfx.frame import Frame, Role
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.exposure.scenes import scene
from tests.test_pipeline import Probe

WIDTH = 12.0  # half a second at 24 frames a second


def picture(ev: float = 0.0, height: int = 90, width: int = 160) -> np.ndarray:
    """A smooth scene around mid grey times 2 ** -ev, four stops from dark to bright."""
    ramp = np.exp2(np.linspace(-2, 2, width) - ev) * 0.18
    return np.ascontiguousarray(np.broadcast_to(ramp[None, :, None], (height, width, 3)),
                                np.float32)


def frame(colour: np.ndarray, **values: object) -> Frame:
    return Frame({Role.COLOUR: colour}, **values)


@pytest.mark.parametrize("ev", (-9.0, -1.0, 0.0, 3.5, 9.0))
def test_brings_the_picture_to_mid_grey(ev: float) -> None:
    assert measure(picture(ev)) == pytest.approx(ev, abs=0.02)


@pytest.mark.parametrize("size", [(1, 1), (6, 10), (1, 17), (9, 9)])
def test_frames_of_a_block_or_two_are_metered(size: tuple[int, int]) -> None:
    colour = np.random.default_rng(1).uniform(0.1, 1.0, (*size, 3)).astype(np.float32)
    assert measure(colour) == pytest.approx(np.log2(0.18 / colour.mean()), abs=1.0)


def test_black_borders_do_not_count() -> None:
    colour = np.zeros((180, 320, 3), np.float32)
    colour[40:130, 80:240] = picture()
    assert measure(colour) == pytest.approx(0.0, abs=0.15)


def test_bad_pixels_and_fireflies_do_not_count() -> None:
    colour = picture()
    random = np.random.default_rng(1)
    for value in (np.nan, np.inf, -np.inf, 1e6):
        at = random.integers(0, colour.shape[:2], (40, 2))
        colour[at[:, 0], at[:, 1]] = value
    assert measure(colour) == pytest.approx(0.0, abs=0.2)


def test_noise_of_one_sample_a_pixel_hardly_matters() -> None:
    clean = picture(height=180, width=320)
    lit = np.random.default_rng(2).random(clean.shape[:2]) < 0.15
    noisy = np.where(lit[..., None], clean / 0.15, 0).astype(np.float32)
    assert measure(noisy) == pytest.approx(measure(clean), abs=0.3)


def test_deep_black_counts_as_nine_stops_below_the_highlights() -> None:
    colour = np.full((96, 96, 3), 2.0**-20, np.float32)
    colour[:48] = 1.0
    assert measure(colour) == pytest.approx(np.log2(0.18) + 4.5, abs=0.05)


@pytest.mark.parametrize("decimals", [-11, -9, -8, -7, -3, 3, 8])
def test_light_in_any_unit_is_shown_alike(decimals: int) -> None:
    """Half floats end at 6e-8, and light below that counted as black. Dim blocks count alike."""
    unit = np.float32(10.0**decimals)
    colour = picture()
    colour[:, ::7] *= np.float32(1e-5)
    assert measure(colour * unit) == pytest.approx(measure(colour) - np.log2(unit), abs=1e-4)


def test_a_black_frame_has_no_exposure_and_keeps_the_last() -> None:
    black = np.zeros((32, 32, 3), np.float32)
    assert measure(black) is None
    meter = ExposureMeter()
    assert meter(frame(black)) == 1.0
    bright = meter(frame(picture(3.0), reset=True))
    assert meter(frame(black)) == bright


def test_follows_smoothly_faster_into_the_dark_and_at_once_at_cuts() -> None:
    def second_frame(step: float, **values: object) -> float:
        meter = ExposureMeter()
        meter(frame(picture(0.0)))
        return np.log2(meter(frame(picture(step), **values)))

    brighter, darker = second_frame(2.0), -second_frame(-2.0)
    assert 0 < brighter < darker < 1
    assert second_frame(2.0, reset=True) == pytest.approx(2.0, abs=0.05)


def test_speed_is_in_seconds_and_not_in_frames() -> None:
    def after_half_a_second(rate: int) -> float:
        meter = ExposureMeter()
        meter(frame(picture(0.0)))
        for _ in range(rate // 2):
            value = meter(frame(picture(2.0), metadata={"framesPerSecond": float(rate)}))
        return value

    assert after_half_a_second(12) == pytest.approx(after_half_a_second(60), rel=0.01)


def test_a_sequence_gives_the_same_numbers_from_the_same_past() -> None:
    frames = [frame(picture(np.sin(n))) for n in range(6)]
    meter, again = ExposureMeter(), ExposureMeter()
    whole = [meter(f) for f in frames]
    assert [again(f) for f in frames[:3]] == whole[:3]
    meter.reset()
    assert [meter(f) for f in frames] == whole


def test_fixed_stops() -> None:
    assert ExposureMeter(-2)(frame(picture())) == 0.25
    assert ExposureMeter("1.5")(frame(picture())) == pytest.approx(2**1.5)
    assert ExposureMeter(-64)(frame(picture())) == 2.0**-64
    assert [ExposureMeter(mode).remembers
            for mode in ("auto", "lit", "metadata", 0)] == [True, False, False, False]


@pytest.mark.parametrize("mode", ("automatic", "nan", 64.5, -1e9))
def test_other_modes_are_refused(mode: str | float) -> None:
    with pytest.raises(ExposureError, match="use auto, lit, metadata or a number of stops"):
        ExposureMeter(mode)


def test_lit_is_the_headers_exposure_or_none_and_what_a_run_used_is_not_lit() -> None:
    colour, used = picture(3.0), {"postfx:exposureUsed": 5.0}
    assert ExposureMeter("lit")(frame(colour, exposure=2.0, metadata=used)) == 4.0
    assert ExposureMeter("lit")(frame(colour, metadata=used)) == 1.0
    # as versions before wrote it
    assert ExposureMeter("metadata")(frame(colour, metadata=used)) == 5.0
    assert ExposureMeter("metadata")(frame(colour, metadata={"postfx:exposureUsedEV": 3.0})) == 8.0
    assert ExposureMeter("metadata")(frame(colour, exposure=2.0, metadata=used)) == 4.0


def test_metadata_is_taken_from_the_header_or_the_file_is_named() -> None:
    meter = ExposureMeter("metadata")
    assert meter(frame(picture(), exposure=np.log2(0.47))) == pytest.approx(0.47)
    with pytest.raises(ExposureError, match=r"shot\.0007\.exr: no exposure in its header"):
        meter(frame(picture(), source="shot.0007.exr"))
    with pytest.raises(ExposureError, match="no number of stops"):
        meter(frame(picture(), exposure=-np.inf))


def test_metering_half_a_megapixel_is_cheap() -> None:
    """In this thread's own time: by the clock a busy machine takes as long as it likes."""
    colour = picture(height=540, width=960)
    measure(colour)
    seconds = []
    for _ in range(20):
        start = time.thread_time()
        measure(colour)
        seconds.append(time.thread_time() - start)
    assert min(seconds) < 0.005


@pytest.mark.parametrize("name", ("living_room", "staircase", "garage"))
def test_noisy_renders_meter_like_their_references(name: str, shared_dir) -> None:
    import OpenImageIO as oiio

    def ev(kind: str) -> float:
        pixels = (oiio.ImageBuf(str(shared_dir / "sequences" / name / f"{kind}.0004.exr"))
                  .get_pixels("float"))
        return measure(np.ascontiguousarray(pixels[..., :3]))

    assert ev("noisy") == pytest.approx(ev("reference"), abs=0.35)


def readings(ev: np.ndarray, cuts: tuple[int, ...] = ()) -> list[MeterReading]:
    return [MeterReading(index + 1, value, index in cuts) for index, value in enumerate(ev)]


def curve(ev: np.ndarray, cuts: tuple[int, ...] = ()) -> np.ndarray:
    found = smooth_ev(readings(ev, cuts), WIDTH)
    assert list(found) == list(range(1, len(ev) + 1))
    return np.array(list(found.values()))


def test_a_steady_change_is_followed_exactly_up_to_both_ends() -> None:
    ramp = np.linspace(-1, 2, 60)
    np.testing.assert_allclose(curve(ramp), ramp, atol=1e-9)


def test_a_step_is_met_half_way_on_its_frame_and_alike_on_both_sides() -> None:
    step = np.repeat([0.0, 1.0], 100)
    found = curve(step)
    # no phase: backwards it is the same curve
    np.testing.assert_allclose(found + found[::-1], 1.0, atol=1e-9)
    assert abs(found[:40]).max() < 1e-6 and 0.4 < found[99] < 0.5 < found[100] < 0.6
    # as wide as it is said to be
    assert found[111] == pytest.approx(NormalDist(sigma=WIDTH).cdf(11.5), abs=0.002)
    meter = ExposureMeter()
    late = [np.log2(meter(frame)) for frame in scene(step)]
    assert np.argmax(np.array(late) > 0.5) > 110  # what looks back only is late


def test_noise_of_the_meter_is_taken_out() -> None:
    noise = np.random.default_rng(1).normal(0, 0.1, 240)
    found = curve(noise)
    assert found.std() < 0.03 and abs(np.diff(found)).max() < 0.01


def test_shots_do_not_know_of_each_other() -> None:
    ev = np.concatenate([np.linspace(0, 1, 20), np.full(20, -3.0), np.linspace(2, 0, 20)])
    np.testing.assert_allclose(curve(ev, (0, 20, 40)), ev, atol=1e-9)
    assert abs(curve(ev)[19] - 1.0) > 1  # and without the cuts they do


def test_black_frames_are_bridged_and_a_black_shot_has_no_exposure() -> None:
    ev = list(np.linspace(0, 1, 30))
    ev[10:14] = [None] * 4
    np.testing.assert_allclose(curve(ev), np.linspace(0, 1, 30), atol=1e-9)
    assert curve([None, None, 1.5], (0, 2)).tolist() == [0.0, 0.0, 1.5]
    assert curve([2.0, *[None] * 80])[-1] == 2.0


def test_it_is_metered_once_and_used_as_a_meter() -> None:
    needed = np.linspace(0, 1, 8)
    once = iter(list(scene(needed)))
    smooth = SmoothExposure(once)
    frames = list(scene(needed))
    forwards = [smooth(frame) for frame in frames]
    np.testing.assert_allclose(np.log2(forwards), np.linspace(0, 1, 8), atol=0.03)
    assert [smooth(frame) for frame in reversed(frames)] == forwards[::-1]
    smooth.reset()
    assert smooth(frames[3]) == forwards[3]


def test_the_pipeline_takes_it() -> None:
    frames = list(scene([0.0, 1.0], cuts=(1,)))
    pipeline = Pipeline([Probe()], Device("cpu"), SmoothExposure(frames))
    found = []
    for frame in frames:
        pipeline(frame)
        found.append(pipeline.exposure)
    np.testing.assert_allclose(found, [0, 1], atol=0.03)


def test_frames_before_the_sequence_have_the_first_ones_exposure() -> None:
    first, second = scene([1.0, 3.0], cuts=(1,))
    smooth = SmoothExposure([first, second])
    early, late = next(scene([0.0])), next(scene([0.0]))
    early.number, late.number = -5, 99
    assert (smooth(early), smooth(late)) == (smooth(first), smooth(second))


def test_metering_reads_colour_only_and_disturbs_no_other_reader(write_exr) -> None:
    for number in (1, 2, 3):
        planes = {name: np.full((8, 8), 0.5) for name in ("R", "G", "B", "depth.Z")}
        folder = write_exr(f"in/shot.{number:04d}.exr", planes).parent
    sequence = postfx.read_sequence(folder)
    sequence.read(1)
    seen = [(frame.number, tuple(frame.planes), frame.reset) for frame in colours_of(sequence)]
    assert seen == [(number, (Role.COLOUR,), False) for number in (1, 2, 3)]
    assert not sequence.read(2).reset and sequence.warnings == []


@pytest.mark.parametrize("name", ("living_room", "staircase", "garage"))
def test_the_curve_of_a_render_stays_with_its_readings(name: str, shared_dir) -> None:
    sequence = postfx.read_sequence(shared_dir / "sequences" / name / "noisy.####.exr")
    found = list(meter_frames(colours_of(sequence)))
    smooth = np.array(list(smooth_ev(found, WIDTH).values()))
    raw = np.array([reading.ev for reading in found])
    assert (abs(smooth - raw).max() < 0.1
            and abs(np.diff(smooth, 2)).max() < abs(np.diff(raw, 2)).max() / 3)
