"""The whole upscaler, frame after frame, against the recurrent step in torch that is trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import guided, noisy

torch = pytest.importorskip("torch")

from tests.training.conftest import one_thread  # noqa: E402, F401
from tests.training.small_denoiser import DOUBTING, LOW, SMALL, small_model  # noqa: E402
from training.denoise import model as network  # noqa: E402

TOLERANCE = 1e-3
EXPOSURES = (1.0, 1.0, 2.5, 0.7)
CUT = 3  # index of the frame that starts a new shot
CONFIGS = {"small": SMALL, "low": LOW, "doubting": DOUBTING}


def as_tensors(planes: dict[Role, np.ndarray]) -> dict[str, torch.Tensor]:
    return {str(role): torch.from_numpy(plane).permute(2, 0, 1)[None]
            for role, plane in planes.items()}


def in_torch(model: network.DenoiseUpscale, frames: list[Frame],
             size: tuple[int, int]) -> list[np.ndarray]:
    """Output colours of the torch definition, not exposed."""
    results, state, last = [], None, None
    for frame in frames:
        gain = (None if last is None or frame.reset
                else torch.full((1, 1, 1, 1), frame.exposure_factor / last))
        planes, guides = as_tensors(frame.planes), as_tensors(frame.guides)
        planes["colour"] = planes["colour"] * frame.exposure_factor
        planes["jitter"] = torch.tensor([frame.jitter], dtype=torch.float32)
        inputs = network.Inputs(**planes, gain=gain,
                                guides=network.Guides(**guides) if guides else None)
        state = state or network.empty_state(inputs, *size)
        keep = torch.full((1, 1, 1, 1), 0.0 if frame.reset else 1.0)
        with torch.no_grad():
            output, state, _ = model(inputs, state.drop(keep))
        results.append(output[0].permute(1, 2, 0).numpy() / frame.exposure_factor)
        last = frame.exposure_factor
    return results


def broken_frames(size: tuple[int, int]) -> list[Frame]:
    """Four frames with what no file should hold in the second; small blocks of colour would be
    repaired."""
    frames = [noisy(i, *size, exposure=np.log2(exposure), reset=i == CUT)
              for i, exposure in enumerate(EXPOSURES)]
    frames[1][Role.COLOUR][3:9, 4:10] = frames[1][Role.DEPTH][5, 6] = np.nan
    frames[1][Role.NORMAL][7, 8] = np.inf
    return frames


@pytest.mark.parametrize(("model", "with_guides"),
                         [("small", False), ("small", True), ("low", False),
                          ("doubting", False), ("doubting", True)],
                         ids=["alone", "guides", "fewer levels", "doubting", "doubting guides"])
@pytest.mark.parametrize(("scale", "size", "compiled"), [
    (2, (48, 64), True), (2, (37, 50), True), (2, (37, 50), False), (1, (37, 50), True),
    (1.5, (37, 50), True), (3, (21, 35), True)])
def test_pass_gives_what_torch_gives(
    scale: float, size: tuple[int, int], model: str, with_guides: bool, compiled: bool,
    small_models: Path
) -> None:
    output = tuple(round(side * scale) for side in size)
    frames = broken_frames(size)
    if scale == 1:
        # samples at the centres of the output's pixels, too
        frames[1].jitter = frames[2].jitter = (0.0, 0.0)
    if with_guides:
        frames = [guided(frame, *output) for frame in frames]
        frames[1].guides[Role.DIFFUSE_ALBEDO][3, 4] = np.nan
        frames[1].guides[Role.DEPTH][5, 6] = np.inf
    device = Device("cpu", threads=2, compiled_kernels=compiled)
    pipeline = Pipeline([DenoiseUpscale(scale=scale, model=model)], device, exposure="metadata")
    reads = with_guides and scale > 1  # at render size the planes are better
    seen = frames if reads else [replace(frame, guides={}) for frame in frames]
    wanted = in_torch(small_model(reads, CONFIGS[model]).eval(), seen, output)
    for frame, expected in zip(frames, wanted, strict=True):
        found = pipeline(frame)[Role.COLOUR]
        assert np.abs(found - expected).max() <= TOLERANCE * np.abs(expected).max()
