"""Ambient occlusion from normals and depth: classical, and by two networks, all against ray
tracing.

python samples/occlusion.py [PICTURE] [--train FOLDER --held-out FOLDER] [--steps 2000] \\
    [--unet FOLDER]

The classical way is GTAO (postfx/kernels/occlusion.py). A small network, 101-64-64-1, reads at each
pixel what GTAO compares, and its result, and learns from ray-traced pixels by the fused kernels of
postfx.neural. Then it runs as ONNX by the machine-learning encoder, and so does a U-Net that sees
the whole picture (models/occlusion.onnx, made by `python -m training.occlusion`; `--unet` is the
folder of another). Without folders, both sets are blocks and balls that are ray-traced here, from
other seeds. With them, they are views by `python -m training.datagen.occlusion`. Sides are
multiples of 16. Prints PSNR of visibility within radii of 0.06, 0.125 and 0.25 of the median depth,
of the mean squared error of all views and as the mean over views, and milliseconds of a view; draws
one held-out view. Needs matplotlib, onnx.
"""
import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from postfx import Device, Library
from postfx.compiled.library import Rows
from postfx.kernels.occlusion import FAR, FIND_LOOKS, FIND_SURFACE, HORIZONS, LOOK, SMOOTH_OCCLUSION
from postfx.neural import Learner, Network
from postfx.runtime import ArgumentTable, Tensor
from postfx.system import models_dir

RADII, SETTINGS = (0.06, 0.125, 0.25), (0.9, 0.0)
HEADER = Path(__file__).with_suffix(".h")
FIRST_HITS, VISIBILITY = Rows("first_hits", HEADER), Rows("visibility", HEADER)


def blocks(seed: int, size: tuple[int, int], rays: int = 128) -> dict[str, np.ndarray]:
    """A view of blocks and balls on a floor between two walls, as `training.datagen.occlusion`
    stores one."""
    random, (width, height) = np.random.default_rng(seed), size
    shapes = [(0, -1, 0, 50, 1, 50, 1, 0, 0), (0, 0, -4, 50, 50, 1, 1, 0, 0),
              (-5, 0, 0, 1, 50, 50, 1, 0, 0)]
    for _ in range(24):
        half, turn = random.uniform(0.1, 0.8, 3), random.uniform(0, 2 * np.pi)
        place = random.uniform((-3.5, 0, -2.5), (3, 1, 2))
        if random.random() < 0.3:
            shapes.append((place[0], half[0] * random.uniform(0.8, 1.5), place[2], half[0], 0, 0, 1,
                           0, 0))
        else:
            lift = half[1] if random.random() < 0.8 else place[1] + half[1]
            shapes.append((place[0], lift, place[2], *half, np.cos(turn), np.sin(turn), 0))
    eye, target = random.uniform((1, 1, 3), (4, 3.5, 6)), random.uniform((-2, 0, -2), (1, 1, 1))
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0, 1, 0), back) / np.linalg.norm(np.cross((0, 1, 0), back))
    axes, tangent = np.stack([right, np.cross(back, right), back]), random.uniform(0.35, 0.7)
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1,
                       1 - (np.arange(height) + 0.5) / height * 2)
    ways = np.stack([x * tangent, y * tangent * height / width, -np.ones_like(x)], -1) @ axes
    depth, normals, known = np.empty(x.shape), np.zeros(ways.shape), np.asarray(shapes, float)
    lengths = np.linalg.norm(ways, axis=-1, keepdims=True)
    FIRST_HITS(0, size[1], known, eye, ways / lengths, depth, normals)
    depth /= lengths[..., 0]
    radii, visible = np.asarray(RADII) * np.median(depth), np.empty((len(RADII), *x.shape))
    VISIBILITY(0, size[1], known, eye, ways, depth, normals, radii, random.random((*x.shape, 2)),
               np.array([rays], float), visible)
    return {"normal": normals @ axes.T, "depth": depth, "visible": visible, "radii": radii,
            "tangent": tangent}


parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "occlusion.png")
parser.add_argument("--train", type=Path, help="folder of views to learn from")
parser.add_argument("--held-out", type=Path, help="folder of views to measure on")
parser.add_argument("--unet", type=Path, default=models_dir(),
                    help="folder with the U-Net, occlusion.onnx")
parser.add_argument("--views", type=int, default=24,
                    help="of blocks to learn from; a quarter as many are held out")
parser.add_argument("--size", type=int, nargs=2, default=(192, 128), help="of views of blocks")
parser.add_argument("--steps", type=int, default=2000)
parser.add_argument("--hidden", type=int, nargs="+", default=(64, 64))
parser.add_argument("--threads", type=int, default=1)
chosen = parser.parse_args()
device, random = Device("cpu", threads=chosen.threads), np.random.default_rng(0)
states = {kernel: device.compute_state(kernel)
          for kernel in (FIND_SURFACE, HORIZONS, SMOOTH_OCCLUSION, FIND_LOOKS)}


def views_of(folder: Path | None, seeds: range) -> list[dict[str, np.ndarray]]:
    if folder is None:
        return [blocks(seed, chosen.size) for seed in seeds]
    return [dict(np.load(path)) for path in sorted(folder.glob("*.npz"))]


def looked_at(view: dict[str, np.ndarray], k: int) -> tuple[dict[str, Tensor], float]:
    """Tensors of a view at its k-th radius: surface, the classical estimate and what the network
    reads; its time."""
    height, width = view["depth"].shape
    new, tangent = device.heap.tensor, view["tangent"]
    camera = np.float32([*np.eye(3).ravel(), view["radii"][k], tangent, tangent * height / width])
    made = {"normal": device.wrap("normal", np.ascontiguousarray(view["normal"], np.float32)),
            "depth": device.wrap("depth",
                                 np.ascontiguousarray(view["depth"][..., None], np.float32)),
            "camera": device.wrap("camera", camera),
            "settings": device.wrap("settings", np.float32(SETTINGS)),
            "first": device.wrap("first", np.zeros(1, np.float32)),
            "surface": new("surface", (height, width, 4)),
            "raw": new("raw", (height, width)), "smooth": new("smooth", (height, width)),
            "points": new("points", (height * width, LOOK))}
    commands = device.command_buffer("occlusion")
    for kernel, renamed in ((FIND_SURFACE, {}), (HORIZONS, {"visible": "raw"}),
                            (SMOOTH_OCCLUSION, {"noisy": "raw", "visible": "smooth"}),
                            (FIND_LOOKS, {})):
        with commands.compute_encoder(kernel.name) as encoder:
            encoder.barrier(after="compute", before="compute")
            names = (*kernel.reads, *kernel.writes)
            encoder.dispatch(states[kernel], ArgumentTable(
                states[kernel], {name: made[renamed.get(name, name)] for name in names}))
    commands.commit()
    commands.wait()
    return made, sum(taken for _, taken in commands.timings[:-1])


points, targets = [], []
for view in views_of(chosen.train, range(chosen.views)):
    for k in range(len(RADII)):
        made, _ = looked_at(view, k)
        there = np.flatnonzero(made["surface"].array[..., 3] < FAR)
        picked = random.choice(there, min(1500, len(there)), replace=False)
        points.append(made["points"].array[picked])
        targets.append(view["visible"][k].ravel()[picked].astype(np.float32))
every, wanted = np.concatenate(points), np.concatenate(targets)[:, None]
network = Network(LOOK, tuple(chosen.hidden), 1, "gelu")
learner, began = Learner(device, network, seed=0), time.process_time()
learner.fit(every, wanted, chosen.steps, 3e-3, random=random)
print(f"{len(every)} pixels, {network.count} parameters, learnt in "
      f"{time.process_time() - began:.0f} s")

library = tempfile.TemporaryDirectory()
network.save_onnx(Path(library.name) / "occlusion.onnx", learner.parameters.download())
held = views_of(chosen.held_out, range(1000, 1000 + max(chosen.views // 4, 1)))
names = ("classical", "network", "U-Net")
errors, times, drawn = np.zeros((len(RADII), len(names), len(held))), [], []
for at, view in enumerate(held):
    height, width = view["depth"].shape
    networks = (device.pipeline_state(
        Library(library.name), "occlusion", {"points": height * width}
    ), device.pipeline_state(Library(chosen.unet), "occlusion", {"height": height, "width": width}))
    for k in range(len(RADII)):
        made, taken = looked_at(view, k)
        there = made["surface"].array[..., 3] < FAR
        made["values"] = device.heap.tensor("values", (height * width, 1))
        made["visible"] = device.heap.tensor("visible", (height, width))
        times.append([taken])
        for name, state, bound in zip(names[1:], networks, (("points", "values"), (
                "normal", "depth", "camera", "raw", "smooth", "visible")), strict=True):
            commands = device.command_buffer(name)
            with commands.machine_learning_encoder(name) as encoder:
                encoder.dispatch_network(state,
                                         ArgumentTable(state, {key: made[key] for key in bound}))
            commands.commit()
            commands.wait()
            times[-1].append(sum(taken for _, taken in commands.timings))
        by_pixel = np.where(there, np.clip(made["values"].array.reshape(there.shape), 0, 1), 1)
        found = [made["smooth"].array.copy(), by_pixel, made["visible"].array.copy()]
        truth = view["visible"][k].astype(np.float32)
        errors[k, :, at] = [np.mean((one - truth)[there] ** 2) for one in found]
        drawn = [truth, *found] if k == 1 and at == 0 else drawn
for what, shown in (("of the error of all views", -10 * np.log10(errors.mean(-1))),
                    ("mean over views", -10 * np.log10(errors).mean(-1))):
    print(f"PSNR, {what}\n{'radius':>8} " + " ".join(f"{name:>12}" for name in names))
    for radius, row in zip(RADII, shown, strict=True):
        print(f"{radius:8} " + " ".join(f"{value:9.2f} dB" for value in row))
print("ms a view of {}x{}: ".format(*held[0]["depth"].shape[::-1]) + ", beyond it ".join(
    f"{name} {taken:.1f}" for name, taken in zip(names, np.median(times, 0), strict=True)))

figure = Figure((4 * len(drawn), 3), layout="constrained")
for panel, picture, name in zip(figure.subplots(1, len(drawn)), drawn, ("ray-traced", *names),
                                strict=True):
    panel.imshow(picture, cmap="gray", vmin=0, vmax=1)
    panel.set_title(name)
    panel.axis("off")
figure.savefig(chosen.picture, dpi=80)
print(f"wrote {chosen.picture}")
library.cleanup()
