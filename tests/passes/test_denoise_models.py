"""Which network runs for a tag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postfx.frame import Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.models import GUIDED, exact, model_of, parted
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import noisy

CPU = Device("cpu", threads=2)


class Remote:
    """Memory that the host does not see."""

    host_visible = False


@pytest.mark.parametrize(("tag", "ending", "model"), [
    ("m", "", "denoise_upscale.m.int8"),
    ("m", GUIDED, "denoise_upscale.m.int8.guides"),
    ("m.fp32", "", "denoise_upscale.m"),
    ("m.fp32", GUIDED, "denoise_upscale.m.guides"),
    ("s.int8", "", "denoise_upscale.s.int8"),
    ("mine", "", "denoise_upscale.mine"),
])
def test_a_cpu_runs_integers_unless_asked_otherwise(tag: str, ending: str, model: str) -> None:
    assert model_of(tag, ending, CPU) == model


def test_a_gpu_runs_half_precision_unless_asked_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device("cpu", threads=1)
    monkeypatch.setattr(device, "memory", Remote())
    assert model_of("m", "", device) == "denoise_upscale.m.fp16"
    assert model_of("m.fp32", "", device) == "denoise_upscale.m"


def test_a_network_without_another_precision_runs_as_it_is(small_models: Path) -> None:
    assert model_of("small", "", CPU) == model_of("small") == "denoise_upscale.small"


def test_tags_of_the_float_network() -> None:
    assert [exact(tag) for tag in ("m", "m.int8", "m.fp32")] == ["m.fp32", "m.int8", "m.fp32"]


def test_endings_of_networks_that_are_taken_by_themselves() -> None:
    found = [parted(name) for name in ("m", "m.int8.1x", "denoise_upscale.m.fp16.guides", "m.fp32")]
    assert found == [("m", ""), ("m.int8", ".1x"), ("denoise_upscale.m.fp16", ".guides"), ("m.fp32", "")]


def test_both_precisions_give_nearly_the_same() -> None:
    frame = noisy(1)
    results = [Pipeline([DenoiseUpscale(model=tag)], CPU, exposure=0.0)(frame)[Role.COLOUR]
               for tag in ("s", "s.int8", "s.fp32")]
    np.testing.assert_array_equal(results[0], results[1])
    error = np.abs(results[0] - results[2]).mean() / np.abs(results[2]).mean()
    assert 0 < error < 0.1
