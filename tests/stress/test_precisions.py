"""Networks in fp16 and int8 are as good as in float32, on sequences that other software
rendered."""

from __future__ import annotations

from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("flip_evaluator", reason="needs the extra 'bench'")
pytest.importorskip("skimage", reason="needs the extra 'bench'")
from postfx.frame import Role  # noqa: E402
from postfx.runtime import Device  # noqa: E402
from postfx.tools.bench.measure import Material, Sources  # noqa: E402
from postfx.tools.bench.metrics import psnr, to_codes  # noqa: E402
from tests.stress.scenes import pipeline  # noqa: E402

FRAMES = 3
ON = (("s", "living_room"), ("m", "staircase"), ("l", "garage"), ("m with guides", "living_room"),
      ("s at 1x", "staircase"), ("m at 1x", "garage"))
"""Networks, and the sequence that each is measured on."""
LOST = 0.1
"""Decibels of the mean over a sequence that a precision may lose."""


@cache
def quality(folder: Path, model: str, kind: str) -> float:
    """Mean PSNR in dB of the frames of a folder, exposed as metered; at 1x against the mean of 2x2
    reference pixels."""
    guides = str(folder / "guides.####.exr") if kind == "with guides" else None
    material = Material(Sources(str(folder / "noisy.####.exr"), str(folder / "reference.####.exr"),
                                guides))
    chain = pipeline(model, Device("cpu"), "auto", scale=1 if kind == "at 1x" else material.scale)
    found = []
    for frame in islice(material.noisy, FRAMES):
        colour, reference = chain(frame)[Role.COLOUR], material.reference(frame.number)[Role.COLOUR]
        if kind == "at 1x":
            reference = reference.reshape(colour.shape[0], 2, colour.shape[1], 2, 3).mean((1, 3))
        found.append(psnr(*(to_codes(light, chain.exposure_factor)
                            for light in (colour, reference))))
    return float(np.mean(found))


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "size", "name"), [
    pytest.param(precision, size, name,
                 marks=pytest.mark.soak if precision == "fp16" and size != "s" else [])
    for size, name in ON for precision in ("fp16", "int8")])
def test_as_good_as_in_float32(name: str, size: str, precision: str, shared_dir: Path) -> None:
    """Every network that there is, each on a sequence; the garage has no guides."""
    folder, (tag, _, kind) = shared_dir / "sequences" / name, size.partition(" ")
    if kind == "with guides" and not list(folder.glob("guides.*.exr")):
        pytest.skip(f"no guides in {folder}")
    exact, fast = (quality(folder, f"{tag}.{end}", kind) for end in ("fp32", precision))
    print(f"{name} {size}: fp32 {exact:.3f} dB, {precision} {fast:.3f} dB")
    assert fast > exact - LOST
