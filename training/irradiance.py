"""Irradiance of one scene by the direction of the normal: a small network for the pass
`irradiance`, which `python -m training.train_scene irradiance` trains.

It learns the logarithm of the irradiance of diffuse surfaces, colour / albedo * pi, from frames
with diffuse albedo and normals and little noise. The fused kernels of `postfx.neural` train it on
the CPU; it needs no PyTorch.
"""

from __future__ import annotations

import numpy as np

from postfx import Device, Frame, Role
from postfx.errors import FrameError
from postfx.neural import Learner, Network

LEAST_ALBEDO = 0.05
"""Darker surfaces tell little about light."""
MIRRORS = 0.5
"""Specular over diffuse albedo up to which a surface counts as diffuse."""
LEAST_LIGHT = 1e-4
NEEDED = (Role.COLOUR, Role.NORMAL, Role.DIFFUSE_ALBEDO)


def examples(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Normals (count, 3) of a frame's diffuse surfaces, and the logarithm of their irradiance.

    Raises FrameError if planes are missing.
    """
    lacking = [str(role) for role in NEEDED if role not in frame.planes]
    if lacking:
        raise FrameError(f"frame {frame.number} has no {', '.join(lacking)}: render these planes, "
                         "too")
    albedo, normal = frame[Role.DIFFUSE_ALBEDO], frame[Role.NORMAL]
    length = np.linalg.norm(normal, axis=-1)
    known = ((length > 0.1) & (albedo.min(-1) > LEAST_ALBEDO) & np.isfinite(frame[Role.COLOUR])
             .all(-1))
    if Role.SPECULAR_ALBEDO in frame.planes:
        known &= frame[Role.SPECULAR_ALBEDO].max(-1) < MIRRORS * albedo.max(-1)
    light = frame[Role.COLOUR][known] / albedo[known] * np.pi
    logs = np.log(np.maximum(light, LEAST_LIGHT))
    return (normal[known] / length[known, None]).astype(np.float32), logs.astype(np.float32)


def train(frames: list[Frame], hidden: tuple[int, ...], steps: int) -> tuple[Network, np.ndarray]:
    """The network and its parameters. Raises FrameError if no frame has diffuse surfaces."""
    points, targets = (np.concatenate(arrays)
                       for arrays in zip(*map(examples, frames), strict=True))
    if not len(points):
        raise FrameError("no frame has diffuse surfaces to learn from: check normals and diffuse "
                         "albedo")
    device, network = Device("cpu"), Network(3, hidden, 3, "gelu")
    learner = Learner(device, network, seed=1)
    learner.fit(points, targets, steps, 1e-2)
    return network, learner.parameters.download()


def error(network: Network, parameters: np.ndarray, frames: list[Frame]) -> float:
    """Mean squared error of the logarithm over the surfaces of frames."""
    points, targets = (np.concatenate(arrays)
                       for arrays in zip(*map(examples, frames), strict=True))
    device = Device("cpu")
    learner, values = Learner(device, network, seed=1), device.heap.tensor("values", targets.shape)
    learner.parameters.upload(parameters)
    commands = device.command_buffer("held out")
    with commands.compute_encoder("held out") as encoder:
        learner.run(encoder, device.wrap("points", points), values)
    commands.commit()
    commands.wait()
    return float(np.mean((values.array - targets) ** 2))

