"""The shipped networks at 1x on a view of few and of many samples a pixel.

many_samples.npz is of the data factory (`training.measure.equivalent_samples render`, an outdoor
view that no network was trained on, 96x64): colour and planes of 4 and of 64 samples a pixel, and
the mean of 4096.
"""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("flip_evaluator", reason="needs the extra 'bench'")
from postfx.frame import Frame, Role  # noqa: E402
from postfx.passes.denoise import DenoiseUpscale  # noqa: E402
from postfx.pipeline import Pipeline  # noqa: E402
from postfx.runtime import Device  # noqa: E402
from postfx.tools.bench.metrics import grey_factor, psnr, to_codes  # noqa: E402

VIEW = Path(__file__).parent / "many_samples.npz"
AVERAGED = (Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL, Role.ROUGHNESS)
GAINS = {4: 8.0, 64: 3.0}
"""Samples a pixel -> decibels that the result must have above its input; networks for all scales
had 0.4 at 64."""


def frame(view: np.lib.npyio.NpzFile, samples: int) -> Frame:
    planes = {role: view[f"{role}_{samples}"] for role in AVERAGED} | {
        role: view[str(role)] for role in (Role.DEPTH, Role.MOTION)}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 samples=samples, reset=True)


@pytest.mark.parametrize("samples", GAINS)
@pytest.mark.parametrize("model", ["s.fp32", "s.int8", "m.fp32", "m.int8"])
def test_a_result_is_better_than_its_input_however_many_samples_that_has(model: str,
                                                                         samples: int) -> None:
    with np.load(VIEW) as view:
        noisy, reference = frame(view, samples), view["reference"].astype(np.float32)
    result = Pipeline([DenoiseUpscale(model=model, scale=1)], Device("cpu"))(noisy)[Role.COLOUR]
    exposure = grey_factor(reference)
    before, after = (psnr(to_codes(picture, exposure), to_codes(reference, exposure))
                     for picture in (noisy[Role.COLOUR], result))
    print(f"{model}, {samples} samples a pixel: {before:.2f} dB, then {after:.2f} dB")
    assert after > before + GAINS[samples]
