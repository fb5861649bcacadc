"""Light groups denoised with the picture, against Open Image Denoise on each alone, and graded
after or before.

python -m training.measure.parts SEQUENCE.npz [--model m] [--scales 1,2]
python -m training.measure.parts --cost [--threads 2] [--model m]
python -m training.measure.parts --below ../shared/sequences/staircase [--model m]

SEQUENCE.npz holds, for frame i, `albedo{i}`, `normal{i}`, `depth{i}`, `motion{i}`, a light group's
`NAME{i}`, and for the last frame references `ref{size}_NAME{i}`, where size is the width. The light
groups add up to the picture. PSNR and sums are those of the last frame; PSNR compares displayed
pictures, each exposed like its reference. `--cost` measures a part's share of a frame's passes:
frames of 960x540 to 1920x1080 without parts, with three and with six, in turn; the time on
`--threads`, and the processor time of the device's threads, by Linux, which other work disturbs
less. `--below` takes frames `noisy.*` of a folder apart into three parts, of which `shadow` takes
light away, and compares the fourth with `reference.*`, on a scale with both signs.
"""

from __future__ import annotations

import argparse
import threading
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from postfx.colour.displays import srgb_encode
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes.denoise import PART_FILTERS, DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.tools.bench.baselines import HostKernels, Oidn
from postfx.tools.bench.metrics import grey_factor, psnr

FRAMES, WARM_UP = 12, 3
"""Frames that run, and how many of them are not timed."""
SHOWN = 4
"""Frame of a sequence that is compared with its reference."""
COUNTS = 0, 3, 6
"""Numbers of parts, in turn."""
GRADE = {"key": 2.0, "fill": 0.5}


def load(path: Path) -> tuple[list[Frame], dict[str, dict[int, np.ndarray]]]:
    """The frames, and each group's references of the last frame by their width."""
    arrays = {name: array.astype(np.float32) for name, array in np.load(path).items()}
    count = sum(name.startswith("albedo") for name in arrays)
    names = sorted({name.split("_")[1].rstrip("0123456789")
                    for name in arrays if name.startswith("ref")})
    frames = []
    for i in range(count):
        parts = {name: arrays[f"{name}{i}"] for name in names}
        planes = {Role.COLOUR: sum(parts.values()), Role.DIFFUSE_ALBEDO: arrays[f"albedo{i}"],
                  Role.NORMAL: arrays[f"normal{i}"], Role.DEPTH: arrays[f"depth{i}"],
                  Role.MOTION: arrays[f"motion{i}"]}
        frames.append(Frame(planes, number=i, parts=parts, samples=4))
    references: dict[str, dict[int, np.ndarray]] = {name: {} for name in names}
    for key, array in arrays.items():
        if key.startswith("ref"):
            size, name = key.removeprefix("ref").split("_")
            references[name.rstrip("0123456789")][int(size)] = array
    return frames, references


def added(lights: Iterable[np.ndarray]) -> np.ndarray:
    """The sum of lights (h, w, 3), in their order."""
    first, *others = lights
    return sum(others, first)


def graded(frame: Frame) -> Frame:
    """The frame with graded lights."""
    planes = {**frame.planes,
              Role.COLOUR: added(GRADE.get(name, 1.0) * part
                                 for name, part in frame.parts.items())}
    return Frame(planes, number=frame.number, samples=frame.samples)


def shown_psnr(result: np.ndarray, reference: np.ndarray) -> float:
    """PSNR of a displayed picture, exposed like its reference."""
    exposure = grey_factor(reference)
    exposed = [exposure * np.maximum(light, 0) for light in (result, reference)]
    return psnr(*(srgb_encode(light / (1 + light)) for light in exposed))


def by_oidn(frame: Frame, light: np.ndarray, scale: int, kernels: HostKernels) -> np.ndarray:
    """A light denoised alone with the frame's planes, and enlarged."""
    alone = Frame({**frame.planes, Role.COLOUR: light}, number=frame.number)
    return enlarged(Oidn("high", "cpu", 2)(alone), scale, kernels)


def enlarged(light: np.ndarray, scale: int, kernels: HostKernels) -> np.ndarray:
    """A picture, so many times as large, by cubic interpolation."""
    height, width = light.shape[:2]
    return light if scale == 1 else kernels.enlarge(light, scale * height, scale * width,
                                                    (0.0, 0.0))


def measure(frames: list[Frame], references: dict[str, dict[int, np.ndarray]], model: str,
            scale: int) -> None:
    """Print a row for each group, and the errors of sums and of graded sums."""
    names, device = list(references), Device("cpu")
    size, kernels = scale * frames[0][Role.COLOUR].shape[1], HostKernels(device)
    together, own_filters = (Pipeline(
        [DenoiseUpscale(scale=scale, model=model, parts=names, part_filters=filters)], device
    ) for filters in PART_FILTERS)
    before = Pipeline([DenoiseUpscale(scale=scale, model=model)], device)
    for frame in frames:
        found, own = together(frame), own_filters(frame).parts
        picture_graded_before = before(graded(frame))[Role.COLOUR]
    print(f"{scale}x {model} | part | input | the picture's filters | own filters | OIDN high on "
          "it alone |")
    for name in names:
        reference, part = references[name][size], frames[-1].parts[name]
        row = [shown_psnr(light, reference) for light in (
            enlarged(part, scale, kernels), found.parts[name], own[name],
            by_oidn(frames[-1], part, scale, kernels))]
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in row) + " |")
    picture, whole = found[Role.COLOUR], added(references[name][size] for name in names)
    print(f"picture {shown_psnr(picture, whole):.2f} dB")
    wanted = added(GRADE.get(name, 1.0) * references[name][size] for name in names)
    grade = ", ".join(f"{name} x{factor:g}" for name, factor in GRADE.items())
    for filters, parts in zip(PART_FILTERS, (found.parts, own), strict=True):
        after = added(GRADE.get(name, 1.0) * parts[name] for name in names)
        apart = np.abs(added(parts[name] for name in names) - picture).sum() / picture.sum()
        print(f"filters {filters}: sum apart by {apart:.1e} of the light; graded ({grade}) after "
              f"{shown_psnr(after, wanted):.2f} dB")
    oidn = added(GRADE.get(name, 1.0) * by_oidn(frames[-1], frames[-1].parts[name], scale, kernels)
                 for name in names)
    first, others = shown_psnr(picture_graded_before, wanted), shown_psnr(oidn, wanted)
    print(f"graded before {first:.2f} dB, OIDN's parts {others:.2f} dB")


def cost(model: str, threads: int) -> None:
    """Print a part's share of a frame's time."""
    random, device = np.random.default_rng(0), Device("cpu", threads=threads)
    colour = random.random((540, 960, 3), np.float32)
    planes = {Role.COLOUR: colour, Role.DIFFUSE_ALBEDO: colour, Role.NORMAL: colour,
              Role.DEPTH: 1 + colour[..., :1].copy(), Role.MOTION: 0.5 * colour[..., :2].copy()}
    frames = {count: Frame(planes, parts={f"light {i}": colour / count for i in range(count)})
              for count in COUNTS}
    pipelines = {count: Pipeline([DenoiseUpscale(scale=2, model=model, parts=list(frame.parts))],
                                 device, exposure=0.0)
                 for count, frame in frames.items()}
    times: dict[str, dict[int, list[float]]] = {name: {count: [] for count in COUNTS}
                                                for name in ("time", "processor")}
    for _ in range(FRAMES):
        for count, pipeline in pipelines.items():
            before = busy()
            pipeline(frames[count])
            times["time"][count].append(sum(pipeline.timings.values()))
            times["processor"][count].append(busy() - before)
    for name, found in times.items():
        alone, *among = (float(np.median(one[WARM_UP:])) for one in found.values())
        print(f"{model}, {name}: {alone:.0f} ms a frame" + "".join(
            f", with {count} parts {time:.0f} ms: {(time - alone) / count / alone:.1%} for each"
            for count, time in zip(COUNTS[1:], among, strict=True)))


def with_shadow(light: np.ndarray) -> dict[str, np.ndarray]:
    """Parts of a picture (h, w, 3): one takes light away in the middle, and gives some on the
    right."""
    height, width, _ = light.shape
    x = np.linspace(0, 1, width, dtype=np.float32)[None, :, None]
    y = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    middle = np.exp(-((x - 0.5) ** 2 + (y - 0.5) ** 2) / 0.05)
    shadow, key = (0.2 * x - 0.8 * middle) * light, (1 - 0.5 * x) * light
    return {"shadow": shadow, "key": key, "fill": light - shadow - key}


def shown(light: np.ndarray) -> np.ndarray:
    """Light of either sign as a display would show it."""
    return np.sign(light) * srgb_encode(np.abs(light) / (1 + np.abs(light)))


def below(folder: Path, model: str) -> None:
    """Print how parts come out of which one has light below 0."""
    reference = next(iter(read_sequence(folder / "reference.####.exr", frames=str(SHOWN))))
    truth = reference[Role.COLOUR]
    pipeline = Pipeline([DenoiseUpscale(size=truth.shape[1::-1], model=model,
                                        parts=list(with_shadow(truth)))], Device("cpu"))
    for frame in read_sequence(folder / "noisy.####.exr", frames=f"1-{SHOWN}"):
        frame.parts = with_shadow(frame[Role.COLOUR])
        found = pipeline(frame).parts
    for name, wanted in with_shadow(truth).items():
        cut, whole = (psnr(shown(light), shown(wanted))
                      for light in (np.maximum(found[name], 0), found[name]))
        print(f"{folder.name} {name}: cut at 0 {cut:.2f} dB, as it is {whole:.2f} dB")


def busy() -> float:
    """Milliseconds of processor time of all threads but this one so far, by Linux's /proc."""
    others = {task for task in Path("/proc/self/task").iterdir()
              if task.name != str(threading.get_native_id())}
    return sum(int((task / "schedstat").read_text().split()[0]) for task in others) / 1e6


def main() -> None:
    """Measure as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path, nargs="?")
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--below", type=Path, nargs="*", default=[])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--model", default="m")
    parser.add_argument("--scales", default="1,2")
    arguments = parser.parse_args()
    if arguments.cost:
        cost(arguments.model, arguments.threads)
    for folder in arguments.below:
        below(folder, arguments.model)
    if arguments.sequence is None:
        return
    frames, references = load(arguments.sequence)
    for scale in arguments.scales.split(","):
        measure(frames, references, arguments.model, int(scale))


if __name__ == "__main__":
    main()
