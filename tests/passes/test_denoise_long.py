"""Long shots: the history does not grow beyond what networks were trained on, eight frames a
clip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postfx import DenoiseUpscale, Pipeline, Role, read_sequence
from postfx.frame import Frame
from postfx.runtime import Device
from tests.stress.scenes import display_psnr

WIDTH, HEIGHT, SPEED = 240, 136, 0.37
SURFACES = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL)


def around(plane: np.ndarray, scale: int) -> np.ndarray:
    """A piece of a picture and its mirror image, side by side: it can be moved around without an
    edge."""
    piece = plane[:HEIGHT * scale, :WIDTH * scale]
    return np.concatenate([piece, piece[:, ::-1]], 1)


def shifted(picture: np.ndarray, pixels: float) -> np.ndarray:
    """The left half after a shift to the left, linear between pixels."""
    part = pixels % 1
    moved = np.roll(picture, -int(pixels), 1)
    return ((1 - part) * moved + part * np.roll(moved, -1,
                                                1))[:, :picture.shape[1] // 2].astype(np.float32)


@pytest.mark.parametrize(("model", "frames"), [
    pytest.param("m.fp32", 120, marks=pytest.mark.soak), ("s.fp32", 70)])
def test_a_slow_pan_does_not_get_worse(model: str, frames: int, shared_dir: Path) -> None:
    """History is moved often by parts of a pixel, by exact vectors. With a bias of distrust that is
    lower by 1, `m` lost 3.5 dB in 120 frames."""
    folder = shared_dir / "sequences" / "garage"
    room, truth = (next(iter(read_sequence(folder / f"{name}.####.exr")))
                   for name in ("noisy", "reference"))
    light = around(truth[Role.COLOUR], 2)
    planes = {role: around(room[role], 1) for role in SURFACES}
    motion = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    motion[..., 0] = SPEED
    still = {Role.MOTION: motion, Role.DEPTH: np.full((HEIGHT, WIDTH, 1), 5, np.float32)}
    passes = Pipeline([DenoiseUpscale(scale=2, model=model)], Device("cpu"), exposure=0.0,
                      cuts="none")
    random, quality = np.random.default_rng(3), []
    for number in range(frames):
        wanted = shifted(light, 2 * SPEED * number)
        mean = wanted.reshape(HEIGHT, 2, WIDTH, 2, 3).mean((1, 3))
        noisy = (mean * random.gamma(1, 1, mean.shape)).astype(np.float32)
        moved = {role: shifted(plane, SPEED * number) for role, plane in planes.items()}
        found = passes(Frame({Role.COLOUR: noisy, **moved, **still}, number + 1))[Role.COLOUR]
        quality.append(display_psnr(found, wanted))
    early, late = np.mean(quality[10:50]), np.mean(quality[-20:])
    assert late > early - 1, f"{early:.2f} dB, then {late:.2f} dB"
