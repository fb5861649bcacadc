"""Networks in fp16 and int8 are as good as in float32, on sequences that other software rendered."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("flip_evaluator", reason="needs the extra 'bench'")
pytest.importorskip("skimage", reason="needs the extra 'bench'")
from postfx.bench.material import Material, Sources  # noqa: E402
from postfx.bench.metrics import psnr, shown  # noqa: E402
from postfx.frame import Role  # noqa: E402
from postfx.runtime import Device  # noqa: E402
from tests.stress.scenes import pipeline  # noqa: E402

LOST = 0.1
"""Decibels of the mean over a sequence that a precision may lose."""


@cache
def quality(folder: Path, model: str, guided: bool) -> float:
    """Mean PSNR in dB of the frames of a folder, exposed as metered."""
    guides = str(folder / "guides.####.exr") if guided else None
    material = Material(Sources(str(folder / "noisy.####.exr"), str(folder / "reference.####.exr"), guides))
    chain, found = pipeline(model, Device("cpu"), "auto", scale=material.scale), []
    for frame in material.noisy:
        colour, reference = chain(frame)[Role.COLOUR], material.reference(frame.number)
        found.append(psnr(*(shown(light, chain.exposure) for light in (colour, reference[Role.COLOUR]))))
    return float(np.mean(found))


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["fp16", "int8"])
@pytest.mark.parametrize("size", ["s", "m", "l", "m with guides"])
@pytest.mark.parametrize("name", ["living_room", "staircase", "garage"])
def test_as_good_as_in_float32(name: str, size: str, precision: str, shared_dir: Path) -> None:
    """Every network that there is; the garage has no guides."""
    folder, guided = shared_dir / "sequences" / name, "guides" in size
    if guided and not list(folder.glob("guides.*.exr")):
        pytest.skip(f"no guides in {folder}")
    exact, fast = (quality(folder, f"{size[0]}.{end}", guided) for end in ("fp32", precision))
    print(f"{name} {size}: fp32 {exact:.3f} dB, {precision} {fast:.3f} dB")
    assert fast > exact - LOST
