"""A network of 3-4-4-3 learns the sky while the sun moves, fills the misses of a frame with it and
lights the rest.

python samples/sky_probe.py [PICTURE] [--frames 120] [--steps 8] [--points 256]

Each frame is one command buffer: the sky in random directions, some steps of learning, then the
network in the directions of all misses and in directions around every surface. The logarithm of 1 +
radiance is learnt. Prints the error against the analytic sky of the network, and of one that learns
in the first third of the frames only, and draws both. Needs matplotlib.
"""
import argparse
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from sky import SKY, rel_mse, scene, shown, sky_of, sphere_directions, sun_at

from postfx import Device
from postfx.neural import Learner, Network
from postfx.runtime import ArgumentTable

parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "sky_probe.png")
parser.add_argument("--frames", type=int, default=120)
parser.add_argument("--steps", type=int, default=8, help="of learning in each frame")
parser.add_argument("--points", type=int, default=256, help="directions of a step")
parser.add_argument("--width", type=int, default=480)
chosen = parser.parse_args()

device, random = Device("cpu", threads=2), np.random.default_rng(0)
network = Network(3, (4, 4), 3, "gelu")
learners = [Learner(device, network, 2e-2, seed=1) for _ in range(2)]  # one learns on, one stops
rays, normals, albedo = scene(chosen.width, chosen.width * 9 // 16)
missed = ~normals.any(-1)
around = sphere_directions(1024)
# error and light are taken from the first, the picture from the rest
asked = np.concatenate([around, rays[missed]])

state = device.compute_state(SKY)
sky = device.heap.tensor("sky", (21,))
directions = [device.heap.tensor(f"directions {k}", (chosen.points, 3))
              for k in range(chosen.steps)]
logs = [device.heap.tensor(f"logs {k}", (chosen.points, 3)) for k in range(chosen.steps)]
places = device.wrap("asked", asked)
values = [device.heap.tensor(f"values {k}", asked.shape) for k in range(2)]
truth = np.empty_like(asked)
table = [ArgumentTable(state, {"sky": sky, "directions": one, "logs": other})
         for one, other in zip(directions, logs, strict=True)]
errors, times = [], []
for frame in range(chosen.frames):
    share = frame / max(1, chosen.frames - 1)
    sky.upload(sky_of(sun_at(60 * np.sin(np.pi * (0.1 + 0.8 * share)), -80 + 160 * share)))
    for one in directions:
        spread = random.normal(size=one.shape)
        one.upload((spread / np.linalg.norm(spread, axis=1, keepdims=True)).astype(np.float32))
    commands = device.command_buffer("frame")
    with commands.compute_encoder("sky") as encoder:
        for arguments in table:
            encoder.dispatch(state, arguments)
    with commands.compute_encoder("learn") as encoder:
        encoder.barrier(after="compute", before="compute")
        for one, other in zip(directions, logs, strict=True):
            learners[0].learn(encoder, one, other)
            if 3 * frame < chosen.frames:
                learners[1].learn(encoder, one, other)
        for learner, value in zip(learners, values, strict=True):
            learner.run(encoder, places, value)
    commands.commit()
    commands.wait()
    times.append(dict(commands.timings)["learn"])
    SKY.rows(0, len(asked), sky.array, asked, truth)
    errors.append([rel_mse(np.expm1(value.array[:len(around)]), np.expm1(truth[:len(around)]))
                   for value in values])


def lit(light: np.ndarray) -> np.ndarray:
    """The frame by light from the directions asked for: irradiance of every normal, and misses
    filled."""
    facing = np.maximum(normals.reshape(-1, 3) @ around.T, 0)
    irradiance = (facing @ light[:len(around)]).reshape(normals.shape) * 4 * np.pi / len(around)
    picture = albedo / np.pi * irradiance
    picture[missed] = light[len(around):]
    return shown(picture)


errors = np.array(errors)
late = errors[2 * chosen.frames // 3:].mean(0)
print(f"{network.count} parameters, {chosen.steps} steps of {chosen.points} directions a frame: "
      f"{np.median(times):.2f} ms a frame with all {len(asked)} directions of the picture")
print(f"relMSE over the last third of {chosen.frames} frames: {late[0]:.4f} where it learns on, "
      f"{late[1]:.4f} where it stopped")
figure = Figure((12, 7), layout="constrained")
panels = figure.subplot_mosaic([["a", "b", "c"], ["d", "d", "d"]])
for name, title, log in (("a", "analytic sky", truth),
                         ("b", "network that learns on", values[0].array),
                         ("c", "network that stopped", values[1].array)):
    panels[name].imshow(lit(np.expm1(log)))
    panels[name].set_title(f"last frame by the {title}")
    panels[name].axis("off")
for column, name in enumerate(("learns on", "stopped after a third")):
    panels["d"].semilogy(1 + np.arange(chosen.frames), errors[:, column], label=name)
panels["d"].set(xlabel="frame", ylabel="relMSE of the sky")
panels["d"].legend()
figure.savefig(chosen.picture, dpi=80)
print(f"wrote {chosen.picture}")
