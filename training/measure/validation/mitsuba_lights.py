"""The room of `mitsuba_room` by three lights, each a light group, for `training.measure.parts`.

python -m training.measure.validation.mitsuba_lights SEQUENCE.npz

Four frames of 96x56 at 4 samples a pixel, with a camera that moves; references of the last one at
twice the size, 256 samples a pixel, and their means over 2x2 pixels for the render's size.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

WIDTH, HEIGHT, FRAMES = 96, 56, 4
SAMPLES, REFERENCE_SAMPLES = 4, 256
FIELD = 58
"""Degrees across the picture."""
EYE, TARGET = np.array((1.2, 1.35, 2.3)), np.array((-0.15, 0.75, -0.6))
STEP = np.array((0.02, 0.005, 0.0))
"""Metres that the camera moves from frame to frame."""
DARK = (0.0, 0.0, 0.0)
KEY, SPOT, PANEL = (90.0, 72.0, 48.0), (10.0, 40.0, 25.0), (2.0, 2.4, 3.2)
"""Radiance of the lights."""


def emitter(radiance: tuple[float, ...]) -> dict[str, Any]:
    return {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}}


def lights(only: str) -> dict[str, Any]:
    """All three lights, of which one shines."""
    turn = mi.ScalarTransform4f
    panel = turn().translate((0.6, 2.48, 0.6)).rotate((1, 0, 0), 90).scale((0.5, 0.5, 1))
    found = {
        "key": ({"type": "sphere", "center": [-1.75, 1.2, -1.45], "radius": 0.09}, KEY),
        "fill": ({"type": "rectangle", "to_world": panel}, PANEL),
        "spot": ({"type": "sphere", "center": [1.6, 0.7, -1.5], "radius": 0.05}, SPOT),
    }
    return {name: {**shape, "emitter": emitter(radiance if name == only else DARK)}
            for name, (shape, radiance) in found.items()}


def camera(frame: int, size: int) -> dict[str, Any]:
    """The camera of a frame, for pictures `size` times as large."""
    moved = frame * STEP
    place = mi.ScalarTransform4f().look_at(origin=list(EYE + moved), target=list(TARGET + moved),
                                           up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": size * WIDTH, "height": size * HEIGHT,
            "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    return {"type": "perspective", "fov": FIELD, "fov_axis": "x", "to_world": place, "film": film,
            "sampler": {"type": "independent"}}


def scene(frame: int, size: int, only: str, integrator: dict[str, Any] | None = None) -> mi.Scene:
    """The room by one of the lights."""
    from training.measure.validation import mitsuba_room

    made = {**mitsuba_room.build(frame), **lights(only), "sensor": camera(frame, size)}
    return mi.load_dict(made | ({"integrator": integrator} if integrator else {}))


def planes(frame: int) -> dict[str, np.ndarray]:
    """Albedo, normal, depth and motion of a frame."""
    aovs = {"type": "aov", "aovs": "albedo:albedo,normal:sh_normal,place:position",
            "picture": {"type": "direct"}}
    found = np.array(mi.render(scene(frame, 1, "key", aovs), spp=SAMPLES, seed=frame), np.float32)
    albedo, normal, place = np.split(found[..., -9:], 3, axis=-1)
    now, depth = projected(place, frame)
    before, _ = projected(place, max(frame - 1, 0))
    return {"albedo": albedo.clip(0, 1), "normal": normal, "depth": depth, "motion": before - now}


def projected(place: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Where a frame's camera sees places (h, w, 3): pixels from the middle (h, w, 2), and depth
    (h, w, 1)."""
    to_camera = np.linalg.inv(np.array(camera(frame, 1)["to_world"].matrix))
    whole = np.concatenate([place, np.ones_like(place[..., :1])], -1) @ to_camera.T
    depth, focal = whole[..., 2:3], WIDTH / 2 / np.tan(np.radians(FIELD / 2))
    return (-focal * whole[..., :2] / depth).astype(np.float32), depth.astype(np.float32)


def main() -> None:
    """Render as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    given = parser.parse_args()
    arrays: dict[str, Any] = {}
    for number, name in enumerate(lights("")):
        for frame in range(FRAMES):
            light = mi.render(scene(frame, 1, name), spp=SAMPLES, seed=100 * number + frame)
            arrays[f"{name}{frame}"] = np.array(light, np.float32)
        large = np.array(mi.render(scene(FRAMES - 1, 2, name), spp=REFERENCE_SAMPLES,
                                   seed=1000 + number), np.float32)
        arrays[f"ref{2 * WIDTH}_{name}{FRAMES - 1}"] = large
        small = large.reshape(HEIGHT, 2, WIDTH, 2, 3).mean((1, 3))
        arrays[f"ref{WIDTH}_{name}{FRAMES - 1}"] = small
    for frame in range(FRAMES):
        arrays |= {f"{name}{frame}": plane for name, plane in planes(frame).items()}
    given.sequence.parent.mkdir(parents=True, exist_ok=True)
    np.savez(given.sequence, **arrays)


if __name__ == "__main__":
    mi.set_variant("llvm_ad_rgb")
    main()
