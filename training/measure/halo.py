"""How far a window's edge reaches: the largest difference to the whole frame, by the halo.

    python -m training.measure.halo SEQUENCE ... --halos 48 56 72 [--model s] [--scale 2] [--guides]
        [--centred] [--in-use] [--frames 1] [--history 48]

Denoises the first frame or frames of each sequence (a pattern such as samples/room/noisy.####.exr),
whole and masked but for their top rows, in windows that end exactly a halo below these rows. Prints
the largest difference where strength is 1, in [0, 1] of (x / (1 + x))^(1 / 2.2) of exposed light.
With guides the frame's own planes, repeated, stand in for sharp ones. `halo_of` in
postfx/passes/denoise/models.py has the halos in use. With --in-use they stay, and the given ones
only say where windows end; two networks in a row, which centred samples get, have two of them.
Several frames in a row go on from the history that windows leave, in --history rows around what is
denoised, by default HISTORY_REACH_PX of postfx/passes/denoise/geometry.py.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from unittest import mock

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline, Role, read_sequence
from postfx.frame import GUIDE_ROLES
from postfx.passes.denoise import assembly as windows
from postfx.passes.denoise import geometry
from postfx.passes.denoise.activity import STRENGTH_REACH_PX
from postfx.passes.denoise.geometry import SIDE_MULTIPLE

GAMMA = 1 / 2.2
WINDOWS = 8
"""Most windows of different heights for each frame."""


def seen(light: np.ndarray, exposure: float) -> np.ndarray:
    """Light as a display shows it."""
    exposed = light * exposure
    result: np.ndarray = (exposed / (1 + exposed)) ** GAMMA
    return result


def masked(frame: Frame, rows: int) -> Frame:
    """The frame with strength in its top rows only."""
    strength = np.zeros((*frame[Role.COLOUR].shape[:2], 1), np.float32)
    strength[:rows] = 1
    return replace(frame, planes={**frame.planes, Role.STRENGTH: strength})


def guided(frame: Frame, scale: int) -> Frame:
    """The frame with its own planes, repeated, as guides."""
    block = np.ones((scale, scale, 1), np.float32)
    roles = [role for role in GUIDE_ROLES if role in frame.planes]
    return replace(frame, guides={role: np.kron(frame[role], block) for role in roles})


def rows_for(halo: int, height: int) -> list[int]:
    """How many rows to denoise, so that their windows end a halo below, on the grid and within the
    frame."""
    ends = range(SIDE_MULTIPLE, height - SIDE_MULTIPLE, SIDE_MULTIPLE)
    return [end - halo - STRENGTH_REACH_PX
            for end in ends if end - halo - STRENGTH_REACH_PX > 2 * STRENGTH_REACH_PX][:WINDOWS]


def difference(
    frames: Sequence[Frame], whole: Sequence[np.ndarray], exposure: float,
    options: dict[str, object], halo: int, in_use: bool = False
) -> float:
    """The largest of some windows, which have this halo, or those in use. ValueError where frames
    are too low for any."""
    device, found = Device("cpu"), []
    for rows in rows_for(halo, frames[0][Role.COLOUR].shape[0]):
        with nullcontext() if in_use else mock.patch.object(windows, "halo_of", lambda _: halo):
            part = pipeline(options, exposure, device)
            colours = [part(masked(frame, rows))[Role.COLOUR] for frame in frames]
        if not any("strength is 0 there" in skip.why for skip in part.explain().skips):
            continue
        for colour, wanted in zip(colours, whole, strict=True):
            scale = len(colour) // frames[0][Role.COLOUR].shape[0]
            error = np.abs(seen(colour, exposure) - seen(wanted, exposure))
            found.append(float(error[:(rows - STRENGTH_REACH_PX) * scale].max()))
    if not found:
        rows = frames[0][Role.COLOUR].shape[0]
        raise ValueError(f"a frame of {rows} rows has no window with a halo of {halo}")
    return max(found)


def pipeline(options: dict[str, object], exposure: float | None, device: Device) -> Pipeline:
    """A new denoiser; without an exposure it finds its own."""
    instance = DenoiseUpscale(**options)  # type: ignore[arg-type]
    if exposure is None:
        return Pipeline([instance], device)
    return Pipeline([instance], device, exposure=np.log2(exposure))


def main(words: Sequence[str] | None = None) -> None:
    """Print a line for each sequence."""
    as_written = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=as_written)
    parser.add_argument("sequences", nargs="+")
    parser.add_argument("--model", default="s")
    parser.add_argument("--scale", type=int, default=2)
    parser.add_argument("--guides", action="store_true")
    parser.add_argument("--centred", action="store_true",
                        help="samples lie at the centres of pixels: frames have no jitter")
    parser.add_argument("--in-use", action="store_true", help="keep the networks' own halos")
    parser.add_argument("--frames", type=int, default=1, help="in a row, the first ones")
    parser.add_argument("--history", type=int, default=geometry.HISTORY_REACH_PX, help="rows")
    parser.add_argument("--halos", type=int, nargs="+", required=True, help="render pixels")
    given = parser.parse_args(words)
    geometry.HISTORY_REACH_PX = given.history
    options: dict[str, object] = {"model": given.model, "scale": given.scale}
    for pattern in given.sequences:
        frames = list(itertools.islice(read_sequence(pattern), given.frames))
        frames = [guided(frame, given.scale) for frame in frames] if given.guides else frames
        if given.centred:
            frames = [replace(frame, jitter=(0.0, 0.0)) for frame in frames]
        exposed = pipeline(options, None, Device("cpu"))
        exposed(frames[0])
        exposure = exposed.exposure_factor
        assert exposure is not None, "a pass ran"
        way = pipeline(options, exposure, Device("cpu"))
        whole = [way(frame)[Role.COLOUR].copy() for frame in frames]
        found = (f"{halo}: {difference(frames, whole, exposure, options, halo, given.in_use):.1e}"
                 for halo in given.halos)
        name = f"{given.model} {given.scale}x{' guides' * given.guides}{' centred' * given.centred}"
        if given.frames > 1:
            name += f", {given.frames} frames, {given.history} rows of history"
        print(f"{name}, {pattern}: {', '.join(found)}", flush=True)


if __name__ == "__main__":
    main()
