"""Write a clip's noisy variant as an EXR sequence with the generic plane names, half float, ZIP.

python -m training.datagen.to_exr CLIP.npz OUT_FOLDER [--variant 0]
    ->  noisy.0001.exr ..., reference.0001.exr ... and, of clips that have them, guides.0001.exr ... at output size
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from training.datagen.clip_file import GUIDES, exposure_of, guide_depth, load_clip, to_half

CHANNELS = {
    "colour": ("R", "G", "B"),
    "diffuse_albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "specular_albedo": ("specular_albedo.R", "specular_albedo.G", "specular_albedo.B"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "roughness": ("roughness.Y",),
    "depth": ("depth.Z",),
    "motion": ("motion.X", "motion.Y"),
}
FULL = ("depth",)  # misses are 1e10, beyond half float


def write_exr(path: Path, planes: dict[str, np.ndarray], header: dict) -> None:
    """Write planes (H, W) or (H, W, C), named as in CHANNELS, atomically; header values: number, (2,) or (4, 4)."""
    names = [channel for plane in planes for channel in CHANNELS[plane]]
    formats = [oiio.FLOAT if plane in FULL else oiio.HALF for plane in planes for _ in CHANNELS[plane]]
    pixels = np.concatenate([values.reshape(*values.shape[:2], -1) for values in planes.values()], -1)
    pixels = pixels.astype(np.float32)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], len(names), oiio.HALF)
    spec.channelnames, spec.channelformats = names, formats
    spec.attribute("compression", "zip")
    for name, value in header.items():
        _set(spec, name, value)
    partial = path.with_name(f".{path.stem}.partial.exr")
    out = oiio.ImageOutput.create(str(partial))
    if not out.open(str(partial), spec) or not out.write_image(np.ascontiguousarray(pixels)):
        raise OSError(f"{path}: {out.geterror()}")
    out.close()
    partial.replace(path)


def _set(spec: oiio.ImageSpec, name: str, value: float | int | np.ndarray) -> None:
    if np.ndim(value) == 2:
        spec.attribute(name, oiio.TypeMatrix44, tuple(float(x) for x in np.ravel(value)))
    elif np.ndim(value) == 1:
        spec.attribute(name, oiio.TypeDesc(oiio.FLOAT, oiio.VEC2), tuple(float(x) for x in value))
    else:
        spec.attribute(name, value)


def frame_header(to_world: np.ndarray, fov: float, jitter: np.ndarray, spp: int, exposure: float, reset: bool) -> dict:
    """Headers of a noisy frame; worldToCamera is for row vectors: the camera looks along +Z, +X is left."""
    return {
        "postfx:jitter": np.asarray(jitter, float), "postfx:exposure": exposure, "postfx:spp": int(spp),
        "postfx:reset": int(reset), "postfx:fovX": float(fov), "worldToCamera": np.linalg.inv(to_world).T,
    }


def guide_planes(clip: dict, frame: int) -> dict[str, np.ndarray]:
    """A frame's guides (H, W) or (H, W, 3) float32, by plane."""
    planes = {name: clip[f"guide_{name}"][frame].astype(np.float32) for name in GUIDES}
    return planes | {"depth": guide_depth(clip["guide_depth"][frame])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--variant", type=int, default=0)
    args = parser.parse_args()
    clip, v = load_clip(args.clip), f"v{args.variant}_"
    if f"{v}colour" not in clip:
        count = sum(name.endswith("_colour") for name in clip)
        parser.error(f"{args.clip} has {count} variants: give --variant 0 to {count - 1}")
    args.out.mkdir(parents=True, exist_ok=True)
    meta, exposure = clip["meta"], exposure_of(clip["reference"].astype(np.float32))
    for t, reference in enumerate(clip["reference"]):
        planes = {name: clip[v + name][t].astype(np.float32) for name in CHANNELS}
        pose, jitter = np.array(meta["to_world"][t]), clip[v + "jitter"][t]
        fov, reset = np.broadcast_to(meta["fov"], len(clip["reference"]))[t], clip["reset"][t]
        header = frame_header(pose, fov, jitter, clip[v + "spp"], exposure, bool(reset))
        write_exr(args.out / f"noisy.{t + 1:04d}.exr", planes, header)
        facts = {"postfx:exposure": exposure, "postfx:spp": meta["reference_spp"]}
        write_exr(args.out / f"reference.{t + 1:04d}.exr", {"colour": to_half(reference).astype(np.float32)}, facts)
        if "guide_jitter" in clip:
            header = {"postfx:jitter": clip["guide_jitter"][t].astype(float)}
            write_exr(args.out / f"guides.{t + 1:04d}.exr", guide_planes(clip, t), header)


if __name__ == "__main__":
    main()
