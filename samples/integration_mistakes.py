"""What typical mistakes of a renderer's planes cost, on frames of ray_caster.py with a reference of
the last one.

python samples/ray_caster.py out/ray_caster --reference 8
python samples/integration_mistakes.py [FOLDER]
"""
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import postfx
from postfx import Frame, Role, integrate

Change = Callable[[Frame, Frame], Frame]  # of a frame and the one before it


def plane(role: Role, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda frame, _: with_plane(frame, role, change(frame[role]))


def with_plane(frame: Frame, role: Role, values: np.ndarray) -> Frame:
    return replace(frame, planes={**frame.planes, role: values})


def jitter_left_in(frame: Frame, before: Frame) -> Frame:
    return with_plane(frame, Role.MOTION,
                      frame[Role.MOTION] + np.subtract(frame.jitter, before.jitter))


def normals_of_camera(frame: Frame, _: Frame) -> Frame:
    return with_plane(frame, Role.NORMAL,
                      integrate.normals_to_camera(frame[Role.NORMAL], frame.world_to_camera))


def in_uv(frame: Frame, _: Frame) -> Frame:
    return with_plane(frame, Role.MOTION,
                      frame[Role.MOTION] / (frame.spec.width, frame.spec.height))


MISTAKES: dict[str, Change] = {
    "none": lambda frame, _: frame,
    "every frame marked with postfx:reset (no "
    "history)": lambda frame, _: replace(frame, reset=True),
    "motion from previous to current": plane(Role.MOTION, lambda motion: -motion),
    "motion with y up": plane(Role.MOTION, lambda motion: motion * (1, -1)),
    "motion in UV units": in_uv, "motion 0": plane(Role.MOTION, lambda motion: 0 * motion),
    "motion of jittered matrices": jitter_left_in,
    "no postfx:jitter header": lambda frame, _: replace(frame, jitter=(0.0, 0.0)),
    "postfx:jitter with y "
    "up": lambda frame, _: replace(frame, jitter=(frame.jitter[0], -frame.jitter[1])),
    "depth is a reversed "
    "buffer": plane(Role.DEPTH, lambda depth: integrate.depth_to_device(depth, 0.1, np.inf, True)),
    "normals stored as 0..1": plane(Role.NORMAL, lambda normal: normal / 2 + 0.5),
    "normals in camera space": normals_of_camera,
    "roughness squared": plane(Role.ROUGHNESS, np.square),
    "smoothness": plane(Role.ROUGHNESS, lambda roughness: 1 - roughness),
    "albedo sRGB-encoded": plane(Role.DIFFUSE_ALBEDO, lambda albedo: albedo ** (1 / 2.2)),
}


def shown(frame: Frame, exposure_factor: float) -> np.ndarray:
    """Code values 0..1 of x / (1 + x), x exposed."""
    exposed = np.maximum(frame[Role.COLOUR] * exposure_factor, 0)
    return (exposed / (1 + exposed)) ** (1 / 2.2)


def psnr_with(mistake: Change, passes: postfx.Pipeline, frames: list[Frame],
              reference: Frame) -> float:
    """PSNR (dB) of the last frame when all frames have a mistake."""
    passes.reset()
    for before, frame in zip([frames[0], *frames], frames, strict=False):
        result = passes(mistake(frame, before))
    error = shown(result, reference.exposure_factor) - shown(reference, reference.exposure_factor)
    return float(-10 * np.log10(np.square(error).mean()))


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/ray_caster")
    (reference,) = postfx.read_sequence(sorted(folder.glob("reference.*.exr"))[-1])
    frames = [frame for frame in postfx.read_sequence(folder / "noisy.####.exr")
              if frame.number <= reference.number]
    passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=2)], exposure="metadata", cuts="none")
    for name, mistake in MISTAKES.items():
        print(f"{psnr_with(mistake, passes, frames, reference):6.2f} dB  {name}", flush=True)


if __name__ == "__main__":
    main()
