"""Neural deferred shading of one scene: a small network learns its light from frames, and shades
others from planes.

python samples/neural_shading.py [PICTURE] [--noisy PATTERN --reference PATTERN] \\
    [--held-out 3 6] [--steps 4000]

The network, 33-64-64-64-3, reads position with four bands of Fourier features, normal and reflected
view direction, and gives the logarithm of light without reflectance, which the albedos put back. It
learns from the references of all frames but the held-out ones, at render size, by the fused kernels
of postfx.neural, and shades the held-out ones in a command buffer. Also measured: the frame before
as it is. Prints PSNR after x/(1+x) and the sRGB curve, relMSE of light, and frames a second; draws
the held-out frames. Needs matplotlib.
"""
import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from sky import cleaned, rel_mse, shown

import postfx
from postfx import Device, Frame, Role
from postfx.neural import Learner, Network
from postfx.passes.scene import camera_of
from postfx.passes.scene_points import (
    SceneBox,
    light_to_learn,
    places_of,
    points_of,
    reflectance_of,
)

ROOM = Path(__file__).parent / "room"


def light_of(reference: Frame, frame: Frame) -> np.ndarray:
    """The reference at the frame's size: mean over the pixels in each of its own."""
    (h, w), colour = frame[Role.DEPTH].shape[:2], reference[Role.COLOUR]
    colour = cleaned(colour) if chosen.clean else colour
    by = len(colour) // h
    return colour.reshape(h, by, w, by, 3).mean((1, 3))


parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "neural_shading.png")
parser.add_argument("--noisy", default=str(ROOM / "noisy.####.exr"), help="whose planes are read")
parser.add_argument("--reference", default=str(ROOM / "reference.####.exr"))
parser.add_argument("--held-out", type=int, nargs="+", default=[3, 6],
                    help="frames that are not learnt")
parser.add_argument("--clean", action="store_true",
                    help="denoise the reference by OIDN, by which both are judged")
parser.add_argument("--steps", type=int, default=4000)
parser.add_argument("--threads", type=int, default=1)
chosen = parser.parse_args()

frames = list(postfx.read_sequence(chosen.noisy))
wanted = {frame.number: light_of(reference, frame) for frame, reference in
          zip(frames, postfx.read_sequence(chosen.reference), strict=True)}
known = [frame for frame in frames if frame.number not in chosen.held_out]
held = [frame for frame in frames if frame.number in chosen.held_out]
raw = [places_of(camera_of(frame), frame[Role.DEPTH])[frame[Role.DEPTH][..., 0] < 1e9]
       for frame in known]
box = SceneBox.around(np.concatenate(raw))


def seen_in(frame: Frame) -> np.ndarray:
    """What the network reads of each pixel."""
    return points_of(camera_of(frame), frame[Role.DEPTH], frame[Role.NORMAL], box)


def divisor_of(frame: Frame) -> np.ndarray:
    """What light is divided by."""
    return reflectance_of(frame[Role.DIFFUSE_ALBEDO], frame[Role.SPECULAR_ALBEDO])


points = np.concatenate([seen_in(frame) for frame in known])
targets = np.concatenate([light_to_learn(wanted[frame.number], divisor_of(frame))
                          for frame in known])

device = Device("cpu", threads=chosen.threads)
network = Network(9, (64, 64, 64), 3, "gelu", bands=4, encoded=3)
learner, began = Learner(device, network, seed=0), time.process_time()
learner.fit(points, targets, chosen.steps, 4e-3)
print(f"{len(points)} pixels of {len(known)} frames, {network.count} parameters, learnt in "
      f"{time.process_time() - began:.0f} s of the processor")


def errors(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """PSNR of what is shown, in dB, and relMSE of light."""
    codes = np.mean((shown(np.maximum(found, 0)) - shown(truth)) ** 2)
    return float(-10 * np.log10(codes)), rel_mse(found, truth)


def told(found: tuple[float, float]) -> str:
    return f"{found[0]:.2f} dB, relMSE {found[1]:.4f}"


rows, times, pictures = [], [], []
for frame in held:
    truth, places = wanted[frame.number], device.wrap("points", seen_in(frame))
    values = device.heap.tensor("values", (truth.shape[0] * truth.shape[1], 3))
    for _ in range(5):
        commands = device.command_buffer("shade")
        with commands.compute_encoder("shade") as encoder:
            learner.run(encoder, places, values)
        commands.commit()
        commands.wait()
        times.append(sum(taken for _, taken in commands.timings))
    found = np.expm1(np.clip(values.array.reshape(truth.shape), 0, 20)) * divisor_of(frame)
    near = max((number for number in wanted if number < frame.number), default=known[0].number)
    rows.append([errors(light, truth) for light in (found, frame[Role.COLOUR], wanted[near])])
    shaded, render, before = rows[-1]
    pictures.append((f"frame {frame.number}: reference", truth))
    pictures.append((f"shaded, {shaded[0]:.1f} dB", found))
    print(f"frame {frame.number}: shaded {told(shaded)}; the noisy render {told(render)}; "
          f"frame {near} as it is {told(before)}")
shaded, render, before = np.mean(rows, 0)
print(f"mean {told(shaded)}; of the frames before as they are {told(before)}; "
      f"{1000 / statistics.median(times):.0f} frames a second of "
      f"{held[0][Role.DEPTH].shape[1]}x{held[0][Role.DEPTH].shape[0]}, the network alone")

figure = Figure((10, 3 * len(held)), layout="constrained")
for panel, (name, picture) in zip(figure.subplots(len(held), 2).ravel(), pictures, strict=True):
    panel.imshow(shown(np.maximum(picture, 0)))
    panel.set_title(name)
    panel.axis("off")
figure.savefig(chosen.picture, dpi=80)
print(f"wrote {chosen.picture}")
