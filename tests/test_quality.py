"""The shipped networks against references of scenes that they were not trained on.

The sample sequence is there for everyone. The shared sequences, of other scenes and another
renderer, are slow.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("flip_evaluator", reason="needs the extra 'bench'")
pytest.importorskip("skimage", reason="needs the extra 'bench'")
from postfx.frame import GUIDE_ROLES, Frame, Role  # noqa: E402
from postfx.kernels.denoise import KERNEL  # noqa: E402
from postfx.passes.denoise import models  # noqa: E402
from postfx.passes.denoise.models import UNSCALED, exact, split_ending
from postfx.runtime import Device, Library  # noqa: E402
from postfx.sampling import motion_at  # noqa: E402
from postfx.tools.bench.measure import Material, Sources  # noqa: E402
from postfx.tools.bench.methods import (  # noqa: E402
    OTHERS,
    Method,
    catalogue,
    make,  # noqa: E402
)
from postfx.tools.bench.metrics import Pictures, flicker, flip, grey_factor, psnr, ssim, to_codes  # noqa: E402
from tests.made_once import copy_made_once  # noqa: E402

REPOSITORY = Path(__file__).parent.parent
ROOM = REPOSITORY / "samples" / "room"
OURS = {method.name: method
        for method in catalogue(Library().names(), "cpu", guides=True, motion=True).methods
        if method.model}
SHIPPED = [method for method in OURS.values() if not (method.alone or method.run_up or method.both)]
# one is enough: it has the weights of s
SHIPPED += [Method("s-fp16", "s fp16", "ours", "s.fp16", "fp16")]
BASELINES = {method.name: method for method in OTHERS}
PLAIN = [method for method in OTHERS if method.family == "plain"]

# PSNR in dB of frames 5 to 8 of the sample, of the networks in models/: what `postfx bench` calls
# psnr_late, and what a failing test prints. Whoever ships other networks writes theirs here.
MEASURED = {
    "s": 26.89, "s-int8": 26.94, "s-fp16": 26.89, "l": 27.31, "l-int8": 27.30,
    "m": 27.33, "m-int8": 27.34, "m-guides": 27.00, "m-int8-guides": 27.00, "xl": 27.22,
}
SLACK = 0.4
ABOVE_PLAIN = 4.0
SLACK_AT_1X = 0.2
FOR_1X = [exact(split_ending(name)[0].removeprefix("denoise_upscale."))
          for name in Library().names() if name.endswith(UNSCALED) and "fp16" not in name]
"""Tags of networks that have one of their own for 1x."""


class Bar(NamedTuple):
    """The best of Open Image Denoise 2.5.1 (high, albedo and normal, a frame alone or accumulated
    at output size), accumulation before it and cubic enlargement, over the second half of the
    frames; the best for each figure."""

    psnr: float
    ssim: float
    flip: float
    flicker: float


BARS = {
    "living_room": Bar(23.25, 0.6784, 0.1647, 26.57),
    "staircase": Bar(31.65, 0.8645, 0.07535, 12.10),
    "garage": Bar(32.59, 0.8973, 0.07379, 10.50),
}


def with_guides(frame: Frame) -> Frame:
    """The frame with its own planes as guides, every pixel four times: enough to see whether a
    network works."""
    guides = {role: frame[role].repeat(2, 0).repeat(2, 1) for role in GUIDE_ROLES}
    return replace(frame, guides=guides, guide_jitter=(2 * frame.jitter[0], 2 * frame.jitter[1]))


def results(material: Material, method: Method) -> Iterator[tuple[Frame, np.ndarray]]:
    """Noisy frames, and what a method makes of them."""
    chain = make(method, Device("cpu"), material.scale, material.size, material.noisy)
    for frame in material.noisy:
        result = chain(with_guides(frame) if method.guides else frame)
        assert np.isfinite(result).all()
        yield frame, result


@cache
def material(folder: Path) -> Material:
    return Material(Sources(str(folder / "noisy.####.exr"), str(folder / "reference.####.exr")))


@cache
def target(folder: Path, number: int) -> tuple[np.ndarray, float]:
    """Code values of a reference, and the exposure that they were made with."""
    reference, first = (material(folder).reference(at)
                        for at in (number, material(folder).noisy.numbers[0]))
    exposure = reference.exposure_factor or grey_factor(first[Role.COLOUR])
    return to_codes(reference[Role.COLOUR], exposure), exposure


def score(folder: Path, method: Method) -> np.ndarray:
    """PSNR in dB of each frame: of all figures what takes no time."""
    found = []
    for frame, result in results(material(folder), method):
        wanted, exposure = target(folder, frame.number)
        found.append(psnr(to_codes(result, exposure), wanted))
    return np.array(found)


@cache
def psnrs(folder: Path, name: str) -> np.ndarray:
    """PSNR in dB of each frame, by a method's name. `m` is scored by all figures on the sequences
    anyway."""
    if name == "m" and folder.name in BARS:
        return figures(folder, name).psnr
    return score(folder, OURS.get(name) or BASELINES[name])


def psnrs_of_peer(folder: Path, name: str, version: str) -> np.ndarray:
    """The same of another denoiser of a version: measured once for these frames by the same
    code."""
    measuring = REPOSITORY / "postfx"
    sources = [*folder.glob("noisy.*.exr"), *folder.glob("reference.*.exr"),
               *(measuring / "tools/bench").glob("*.py"), measuring / "oidn.py", Path(__file__)]
    with TemporaryDirectory() as copied:
        copy_made_once(f"psnr-{name}-{folder.name}", sources, version,
                       lambda made: np.save(made / "psnr.npy", psnrs(folder, name)), Path(copied))
        return np.load(Path(copied) / "psnr.npy")


def mean_of_late(figures: np.ndarray) -> float:
    """Mean over the second half of the frames."""
    return float(figures[len(figures) // 2:].mean())


def check_room(found: float, name: str) -> None:
    """Fails, with the figure for MEASURED, where a network lost quality on the sample."""
    assert name in MEASURED, f"{name} is new: write down its {found:.2f} dB in MEASURED"
    assert found >= MEASURED[name] - SLACK, (f"{name} scores {found:.2f} dB, was "
                                             f"{MEASURED[name]:.2f} dB")


@pytest.mark.parametrize("method", SHIPPED, ids=lambda method: method.name)
def test_room_is_as_good_as_measured(method):
    found = psnrs(ROOM, method.name) if method.name in OURS else score(ROOM, method)
    check_room(mean_of_late(found), method.name)


def room_at_1x(tag: str) -> float:
    """PSNR in dB over the second half of the sample, not enlarged, against the mean of every 2x2
    reference pixels."""
    sample, found = material(ROOM), []
    chain = make(Method(tag, tag, "ours", tag), Device("cpu"), 1, sample.size, sample.noisy)
    for frame in sample.noisy:
        result = chain(frame)
        if frame.number > len(sample.noisy.numbers) // 2:
            reference = sample.reference(frame.number)
            wanted = reference[Role.COLOUR].reshape(*result.shape[:1], 2, result.shape[1], 2,
                                                    3).mean((1, 3))
            found.append(psnr(*(to_codes(colour, reference.exposure_factor)
                                for colour in (result, wanted))))
    return float(np.mean(found))


class WithoutThoseFor1x(Library):
    """The networks that ship, but for those of outputs of the render size."""

    def __contains__(self, name: str) -> bool:
        return super().__contains__(name) and not name.endswith(UNSCALED)


@pytest.mark.parametrize("tag", [
    pytest.param(tag, marks=[] if tag in ("m.fp32", "s.int8") else pytest.mark.soak)
    for tag in FOR_1X])
def test_at_1x_a_network_for_it_is_not_worse_than_the_plain_one(tag, monkeypatch):
    found = room_at_1x(tag)
    monkeypatch.setattr(models, "Library", WithoutThoseFor1x)
    plain = room_at_1x(tag)
    assert found >= plain - SLACK_AT_1X, (f"{tag} scores {found:.2f} dB at 1x, the plain network "
                                          f"{plain:.2f} dB")


@pytest.mark.parametrize("plain", PLAIN, ids=lambda method: method.name)
def test_room_is_better_than_without_a_denoiser(plain):
    baseline = mean_of_late(psnrs(ROOM, plain.name))
    assert min(MEASURED.values()) - SLACK >= baseline + ABOVE_PLAIN, (f"{plain.title} scores "
                                                                      f"{baseline:.2f} dB")


def test_wrong_weights_are_noticed(tmp_path, monkeypatch):
    """All taps of the finest level's filter equally strong: what a faulty conversion could make of
    a network."""
    onnx = pytest.importorskip("onnx")
    model = onnx.load(Library().path("denoise_upscale.s"))
    head = [item for item in model.graph.initializer
            if item.name.startswith(("fine.weight", "fine.bias"))]
    assert len(head) == 2
    for weights in head:
        values = onnx.numpy_helper.to_array(weights).copy()
        values[:4 * KERNEL] = 0  # of each channel four phases
        weights.CopyFrom(onnx.numpy_helper.from_array(values, weights.name))
    onnx.save(model, tmp_path / "denoise_upscale.s.onnx")
    monkeypatch.setattr(models, "Library", lambda: Library(tmp_path))
    with pytest.raises(AssertionError, match="s scores .* dB, was"):
        check_room(mean_of_late(score(ROOM, OURS["s"])), "s")


class Figures(NamedTuple):
    """PSNR in dB of each frame, and means of all figures over the second half of the frames."""

    psnr: np.ndarray
    late: Bar


@cache
def figures(folder: Path, name: str) -> Figures:
    """All figures of a network. FLIP takes longer than the network, so earlier frames go
    without."""
    psnrs, rows, before = [], [], None
    half = len(material(folder).noisy.numbers) // 2
    for frame, result in results(material(folder), OURS[name]):
        wanted, exposure = target(folder, frame.number)
        now = Pictures(to_codes(result, exposure), wanted)
        psnrs.append(psnr(now.result, wanted))
        if len(psnrs) > half:
            assert before is not None and not frame.reset
            height, width = wanted.shape[:2]
            motion = motion_at(frame[Role.MOTION], np.arange(height), np.arange(width), height,
                               width)
            steps = flicker(before, now, motion)
            rows.append((psnrs[-1], ssim(now.result, wanted), flip(now.result, wanted), steps))
        before = now
    return Figures(np.array(psnrs), Bar(*np.mean(rows, axis=0)))


BY_ONE = [pytest.param(name, marks=[] if name == "garage" else pytest.mark.soak) for name in BARS]
"""One of the sequences, and with -m soak the others."""


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_ONE)
def test_better_and_steadier_than_the_best_baseline(shared_dir, name):
    found, bar = figures(shared_dir / "sequences" / name, "m").late, BARS[name]
    assert found.psnr >= bar.psnr + 0.5
    assert found.ssim > bar.ssim
    assert found.flip < bar.flip
    assert found.flicker < bar.flicker


@pytest.mark.soak
def test_better_in_the_mean_over_the_sequences(shared_dir):
    gains = [figures(shared_dir / "sequences" / name, "m").late.psnr - bar.psnr
             for name, bar in BARS.items()]
    assert np.mean(gains) >= 1.5


@pytest.mark.slow
def test_history_never_harms_the_garage(shared_dir):
    """Metal that moves: what the motion of its surface says of what it mirrors is wrong."""
    garage = shared_dir / "sequences" / "garage"
    kept, dropped = (psnrs(garage, name) for name in ("m", "m-alone"))
    assert (kept >= dropped).all(), (kept, dropped)


@pytest.mark.parametrize("name", ["s-int8", pytest.param("m", marks=pytest.mark.soak)])
def test_first_frames_gain_by_a_run_up_and_later_ones_hardly_lose(name):
    gains = psnrs(ROOM, f"{name}-run-up") - psnrs(ROOM, name)
    assert gains[0] >= 0.8, gains
    assert gains[:4].mean() >= 0.3, gains
    assert gains.min() >= -0.15, gains


@pytest.mark.parametrize("name", BY_ONE)
def test_with_a_run_up_no_frame_is_worse_than_by_open_image_denoise(shared_dir, name):
    pytest.importorskip("pyoidn")
    folder, other = shared_dir / "sequences" / name, OTHERS[2]
    assert other.quality == "high" and not other.accumulated
    theirs = psnrs_of_peer(folder, other.name, version("pyoidn"))
    mine = psnrs(folder, "s-int8-run-up")
    assert (mine > theirs).all(), (mine, theirs)


@pytest.mark.parametrize("name", ["s-int8", pytest.param("m", marks=pytest.mark.soak)])
def test_both_ways_first_frames_gain_most_and_none_loses(name):
    gains = psnrs(ROOM, f"{name}-both-ways") - psnrs(ROOM, name)
    assert gains[:4].mean() >= 0.6, gains
    assert gains.min() >= -0.05, gains


@pytest.mark.soak
def test_both_ways_better_in_the_mean_over_the_sequences(shared_dir):
    found = {name: figures(shared_dir / "sequences" / name, "m-both-ways").late for name in BARS}
    assert np.mean([found[name].psnr - bar.psnr for name, bar in BARS.items()]) >= 2.2
    assert np.mean([found[name].flip / bar.flip for name, bar in BARS.items()]) <= 0.82
    assert np.mean([found[name].flicker / bar.flicker for name, bar in BARS.items()]) <= 0.84


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_ONE)
def test_small_network_is_not_far_behind(shared_dir, name):
    small, middle = (mean_of_late(psnrs(shared_dir / "sequences" / name, tag))
                     for tag in ("s", "m"))
    assert small >= middle - 0.7
