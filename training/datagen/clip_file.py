"""Training clips: one uncompressed .npz a clip.

Keys: `reference` (T, H, W, 3) float16 linear Rec.709; for each noisy variant v = 0..V-1 at (h, w) =
(H, W) / scale: `v{v}_colour` (T, h, w, 3) float16 clamped to 65504; `v{v}_diffuse_albedo`,
`v{v}_specular_albedo`, `v{v}_normal` (T, h, w, 3) float16, world space, facing the viewer, zero at
misses; `v{v}_roughness` (T, h, w) float16; `v{v}_depth` (T, h, w) float32 along the view axis,
misses 1e10; `v{v}_motion` (T, h, w, 2) float32, previous minus current position in noisy pixels, x
right, y down, without jitter; `v{v}_denoising_albedo`, `v{v}_denoising_normal` (T, h, w, 3)
float16, optional: Blender's planes of that name, which follow mirrors and glass; `v{v}_jitter`
(T, 2) float32, sample position minus 0.5, x right, y down; `v{v}_spp` int; `v{v}_style` 'realtime',
'box' or 'blackman-harris'. `half` (T, H, W, 3) is optional: one half of the reference's samples.
Noisy renders with `v{v}_half` true were made from the other half, and are compared with this one.
The planes of one with `v{v}_exact` true are the truth for all renders. Guides, the first-hit planes
at output size: `guide_diffuse_albedo`, `guide_specular_albedo`, `guide_normal` (T, H, W, 3),
`guide_roughness` (T, H, W), `guide_depth` (T, H, W), all float16; depth is the base-2 logarithm of
the depth within 1e-4..1e10, so that it fits. `guide_jitter` (T, 2) float32 in output pixels:
position of the one sample in the pixel, minus 0.5, or 0 if the planes average samples spread over
the pixel (depth is the first sample's). `reset` (T,) uint8: 1 where history starts, at the first
frame and after a cut (there motion has no meaning); files without it have no cuts.
Also `scale` float, `seed` int, `scene` str, `meta` str (JSON: cameras, field of view, filter, gain,
samples).

    python -m training.datagen.clip_file sheet FOLDER OUT.png [--rows 12] [--frame 4] [--skip 0]
    python -m training.datagen.clip_file exr CLIP.npz OUT_FOLDER [--variant 0]

sheet: many clips in one picture, one row a clip: noisy | diffuse albedo | specular albedo |
normal | motion | reference.
exr: one clip as noisy.0001.exr ..., reference.0001.exr ... and, if the clip has guides,
guides.0001.exr ... at output size; with the generic plane names, half float, ZIP.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # files are read and written where neither is installed
    import OpenImageIO as oiio

PLANES = {
    "colour": np.float16,
    "diffuse_albedo": np.float16,
    "specular_albedo": np.float16,
    "normal": np.float16,
    "roughness": np.float16,
    "depth": np.float32,
    "motion": np.float32,
}
MIRRORED = ("denoising_albedo", "denoising_normal")  # planes that only some renderers write
GUIDES = ("diffuse_albedo", "specular_albedo", "normal", "roughness", "depth")
DEPTH_RANGE = (1e-4, 1e10)
HALF_MAX = 65504.0
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def to_half(values: np.ndarray) -> np.ndarray:
    return np.clip(values, -HALF_MAX, HALF_MAX).astype(np.float16)


def first_only(frames: int) -> np.ndarray:
    """The `reset` of a clip without cuts, (frames,) uint8."""
    return np.eye(1, frames, dtype=np.uint8)[0]


def half_depth(depth: np.ndarray) -> np.ndarray:
    """Depth in the form that guides are stored in: float16 base-2 logarithm, within DEPTH_RANGE."""
    return np.log2(np.clip(depth, *DEPTH_RANGE)).astype(np.float16)


def guide_depth(stored: np.ndarray) -> np.ndarray:
    """Depth float32, the inverse of `half_depth`; misses become 1e10 again."""
    depth = np.exp2(stored.astype(np.float32))
    farthest = np.array(DEPTH_RANGE[1], np.float32)
    return np.where(stored >= half_depth(farthest), farthest, depth)


def exposure_of(colour: np.ndarray, key: float = 0.18, block: int = 4) -> float:
    """Multiplier that brings the geometric mean luminance of frames (T, H, W, 3) to `key`.

    Luminance is averaged over `block` x `block` pixels first: the logarithm of noisy pixels is too
    low.
    """
    luminance = colour.astype(np.float64) @ LUMINANCE
    frames, height, width = luminance.shape
    cut = luminance[:, : height // block * block, : width // block * block]
    mean = cut.reshape(frames, height // block, block, width // block, block).mean((2, 4))
    return float(key / np.exp(np.log(mean + 1e-4).mean()))


def save_clip(path: Path, reference: np.ndarray, variants: list[dict[str, Any]],
              facts: dict[str, Any]) -> None:
    """Write a clip atomically.

    `variants` hold the planes by name plus jitter, spp and style; `facts` hold scale, seed, scene,
    meta and perhaps guides by name plus jitter.
    """
    arrays: dict[str, Any] = {"reference": to_half(reference)}
    if "half" in facts:
        arrays["half"] = to_half(facts["half"])
    if "guides" in facts:
        arrays |= _guide_arrays(facts["guides"])
    for index, variant in enumerate(variants):
        for name, dtype in PLANES.items():
            values = variant[name]
            arrays[f"v{index}_{name}"] = (to_half(values) if dtype is np.float16
                                          else values.astype(dtype))
        for name in MIRRORED:
            if name in variant:
                arrays[f"v{index}_{name}"] = to_half(variant[name])
        arrays[f"v{index}_jitter"] = np.asarray(variant["jitter"], np.float32)
        arrays[f"v{index}_spp"] = np.int32(variant["spp"])
        arrays[f"v{index}_style"] = np.str_(variant["style"])
        arrays[f"v{index}_half"] = np.bool_(variant.get("half", False))
        arrays[f"v{index}_exact"] = np.bool_(variant.get("exact", False))
    arrays["reset"] = np.asarray(facts.get("reset", first_only(len(reference))), np.uint8)
    arrays["scale"] = np.float32(facts["scale"])
    arrays["seed"] = np.int64(facts["seed"])
    arrays["scene"] = np.str_(facts["scene"])
    arrays["meta"] = np.str_(json.dumps(facts["meta"]))
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial.npz")
    np.savez(partial, **arrays)
    partial.replace(path)


def _guide_arrays(guides: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    arrays = {f"guide_{name}": to_half(guides[name]) for name in GUIDES if name != "depth"}
    return arrays | {"guide_depth": half_depth(guides["depth"]),
                     "guide_jitter": guides["jitter"].astype(np.float32)}


def load_clip(path: Path) -> dict[str, Any]:
    """All of a clip: arrays by key, scalars as Python values, `meta` decoded, `variants` the number
    of variants."""
    with np.load(path) as file:
        clip = {key: file[key] if file[key].ndim else file[key].item() for key in file.files}
    clip["meta"] = json.loads(clip["meta"])
    clip.setdefault("reset", first_only(len(clip["reference"])))
    clip["variants"] = sum(key.endswith("_style") for key in clip)
    return clip


# An EXR sequence ----------------------------------------------------------------------------------

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


def write_exr(path: Path, planes: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Write planes (H, W) or (H, W, C), named as in CHANNELS, atomically; header values: number,
    (2,) or (4, 4)."""
    import OpenImageIO as oiio

    names = [channel for plane in planes for channel in CHANNELS[plane]]
    formats = [oiio.FLOAT if plane in FULL else oiio.HALF for plane in planes
               for _ in CHANNELS[plane]]
    pixels = np.concatenate([values.reshape(*values.shape[:2], -1) for values in planes.values()],
                            -1)
    pixels = pixels.astype(np.float32)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], len(names), oiio.HALF)
    spec.channelnames, spec.channelformats = names, formats
    spec.attribute("compression", "zip")
    for name, value in header.items():
        _set(spec, name, value)
    partial = path.with_name(f".{path.stem}.partial.exr")
    out = oiio.ImageOutput.create(str(partial))
    if out is None:
        raise OSError(f"{path}: {oiio.geterror()}")
    if not out.open(str(partial), spec) or not out.write_image(np.ascontiguousarray(pixels)):
        raise OSError(f"{path}: {out.geterror()}")
    out.close()
    partial.replace(path)


def _set(spec: oiio.ImageSpec, name: str, value: float | int | np.ndarray) -> None:
    import OpenImageIO as oiio

    if np.ndim(value) == 2:
        spec.attribute(name, oiio.TypeMatrix44, tuple(float(x) for x in np.ravel(value)))
    elif np.ndim(value) == 1:
        spec.attribute(name, oiio.TypeDesc(oiio.FLOAT, oiio.VEC2),
                       tuple(float(x) for x in np.ravel(value)))
    else:
        spec.attribute(name, value)


def frame_header(to_world: np.ndarray, fov: float, jitter: np.ndarray, spp: int, exposure: float,
                 reset: bool) -> dict[str, Any]:
    """Headers of a noisy frame; worldToCamera is for row vectors: the camera looks along +Z, +X is
    left."""
    return {
        "postfx:jitter": np.asarray(jitter, float), "postfx:exposure": exposure,
        "postfx:spp": int(spp), "postfx:reset": int(reset), "postfx:fovX": float(fov),
        "worldToCamera": np.linalg.inv(to_world).T,
    }


def guide_planes(clip: dict[str, Any], frame: int) -> dict[str, np.ndarray]:
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
        write_exr(args.out / f"reference.{t + 1:04d}.exr",
                  {"colour": to_half(reference).astype(np.float32)}, facts)
        if "guide_jitter" in clip:
            header = {"postfx:jitter": clip["guide_jitter"][t].astype(float)}
            write_exr(args.out / f"guides.{t + 1:04d}.exr", guide_planes(clip, t), header)


# A picture of many clips --------------------------------------------------------------------------

def row(clip: dict[str, Any], frame: int, size: int) -> np.ndarray:
    """One clip's frame, or its last one, as (size, 6 size, 3) uint8."""
    frame = min(frame, len(clip["reference"]) - 1)
    from PIL import Image

    from postfx.colour.views import to_codes

    panels = [to_codes(clip["v0_colour"][frame].astype(np.float32), 1.0)]
    for name in ("diffuse_albedo", "specular_albedo"):
        panels.append(clip[f"v0_{name}"][frame].astype(np.float32) ** (1 / 2.2))
    panels.append(clip["v0_normal"][frame].astype(np.float32) * 0.5 + 0.5)
    motion = clip["v0_motion"][frame] / 20 + 0.5
    panels.append(np.concatenate([motion, np.full_like(motion[..., :1], 0.5)], -1))
    panels.append(to_codes(clip["reference"][frame].astype(np.float32), 1.0))
    images = [Image.fromarray((np.clip(p, 0, 1) * 255).astype(np.uint8)).resize((size, size), 0)
              for p in panels]
    return np.concatenate([np.asarray(i) for i in images], 1)


def draw_sheet(args: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Write the picture; more than twelve clips go into two columns."""
    from PIL import Image

    paths = sorted(args.folder.glob("clip.*.npz"))[args.skip : args.skip + args.rows]
    if not paths:
        parser.error(f"{args.folder} holds no clip.*.npz")
    rows = [row(load_clip(path), args.frame, args.size) for path in paths]
    half = (len(rows) + 1) // 2 if len(rows) > 12 else len(rows)
    rows += [np.zeros_like(rows[0])] * (-len(rows) % half)
    columns = [np.concatenate(rows[k : k + half]) for k in range(0, len(rows), half)]
    Image.fromarray(np.concatenate(columns, 1)).save(args.out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    sheet = commands.add_parser("sheet", help="a picture of many clips")
    sheet.add_argument("folder", type=Path)
    sheet.add_argument("out", type=Path, help="picture to write")
    sheet.add_argument("--rows", type=int, default=12, help="clips to show (default: %(default)s)")
    sheet.add_argument("--frame", type=int, default=4,
                       help="which frame of each (default: %(default)s)")
    sheet.add_argument("--skip", type=int, default=0, help="clips to leave out first")
    sheet.add_argument("--size", type=int, default=128,
                       help="pixels of a panel (default: %(default)s)")
    sheet.set_defaults(act=draw_sheet)
    exr = commands.add_parser("exr", help="a clip as an EXR sequence")
    exr.add_argument("clip", type=Path)
    exr.add_argument("out", type=Path, help="folder to write to")
    exr.add_argument("--variant", type=int, default=0,
                     help="which noisy render (default: %(default)s)")
    exr.set_defaults(act=export_exr)
    args = parser.parse_args()
    args.act(args, commands.choices[args.command])


if __name__ == "__main__":
    main()
