"""Inspect clips: many of them in one picture, or one of them as an EXR sequence.

    python -m training.datagen.clip_export sheet FOLDER OUT.png [--rows 12] [--frame 4] [--skip 0]
    python -m training.datagen.clip_export exr CLIP.npz OUT_FOLDER [--variant 0]

sheet: one row a clip: noisy | diffuse albedo | specular albedo | normal | motion | reference.
exr: noisy.0001.exr ..., reference.0001.exr ... and, if the clip has guides, guides.0001.exr ... at output size; with
the generic plane names, half float, ZIP.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from PIL import Image

from postfx.colour.views import to_codes
from training.datagen.clip_file import GUIDES, exposure_of, guide_depth, load_clip, to_half

# An EXR sequence ----------------------------------------------------------------------------------------------------

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


def export_exr(args: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Write one noisy render of a clip, its references and its guides."""
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


# A picture of many clips --------------------------------------------------------------------------------------------

def row(clip: dict, frame: int, size: int) -> np.ndarray:
    """One clip's frame, or its last one, as (size, 6 size, 3) uint8."""
    frame = min(frame, len(clip["reference"]) - 1)
    panels = [to_codes(clip["v0_colour"][frame].astype(np.float32), 1.0)]
    for name in ("diffuse_albedo", "specular_albedo"):
        panels.append(clip[f"v0_{name}"][frame].astype(np.float32) ** (1 / 2.2))
    panels.append(clip["v0_normal"][frame].astype(np.float32) * 0.5 + 0.5)
    motion = clip["v0_motion"][frame] / 20 + 0.5
    panels.append(np.concatenate([motion, np.full_like(motion[..., :1], 0.5)], -1))
    panels.append(to_codes(clip["reference"][frame].astype(np.float32), 1.0))
    images = [Image.fromarray((np.clip(p, 0, 1) * 255).astype(np.uint8)).resize((size, size), 0) for p in panels]
    return np.concatenate([np.asarray(i) for i in images], 1)


def draw_sheet(args: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Write the picture; more than twelve clips go into two columns."""
    paths = sorted(args.folder.glob("clip.*.npz"))[args.skip : args.skip + args.rows]
    if not paths:
        parser.error(f"{args.folder} holds no clip.*.npz")
    rows = [row(load_clip(path), args.frame, args.size) for path in paths]
    half = (len(rows) + 1) // 2 if len(rows) > 12 else len(rows)
    rows += [np.zeros_like(rows[0])] * (-len(rows) % half)
    columns = [np.concatenate(rows[k : k + half]) for k in range(0, len(rows), half)]
    Image.fromarray(np.concatenate(columns, 1)).save(args.out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    sheet = commands.add_parser("sheet", help="a picture of many clips")
    sheet.add_argument("folder", type=Path)
    sheet.add_argument("out", type=Path, help="picture to write")
    sheet.add_argument("--rows", type=int, default=12, help="clips to show (default: %(default)s)")
    sheet.add_argument("--frame", type=int, default=4, help="which frame of each (default: %(default)s)")
    sheet.add_argument("--skip", type=int, default=0, help="clips to leave out first")
    sheet.add_argument("--size", type=int, default=128, help="pixels of a panel (default: %(default)s)")
    sheet.set_defaults(act=draw_sheet)
    exr = commands.add_parser("exr", help="a clip as an EXR sequence")
    exr.add_argument("clip", type=Path)
    exr.add_argument("out", type=Path, help="folder to write to")
    exr.add_argument("--variant", type=int, default=0, help="which noisy render (default: %(default)s)")
    exr.set_defaults(act=export_exr)
    args = parser.parse_args()
    args.act(args, commands.choices[args.command])


if __name__ == "__main__":
    main()
