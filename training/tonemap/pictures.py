"""Pictures for the tone mapper: read, exposed, held out; packed in one .npz together with baked
looks.

    python -m training.tonemap.pictures -o set.npz --looks local auto --photos 'hdr/*.exr' \\
        --panoramas 'env/*.hdr'

makes a pack for `training.tonemap.train --set`, on a machine without OpenColorIO. Pictures named by
--hold-out are never trained on, only measured, against the colour pipeline itself and not its baked
cube. --clips takes a folder of .npz files with a `reference` (T, H, W, 3).
"""

from __future__ import annotations

import argparse
import glob
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from postfx.colour import LINEAR_SPACES, REC709, matrix_between
from postfx.io.colours import InputColours
from training.tonemap.looks import Look, bake, describe, exact_target, find_look, look_from
from training.tonemap.model import MID_GREY

# Charts -------------------------------------------------------------------------------------------
# Charts of light that is rare in photographs, exposed scene-linear Rec.709 (H,W,3) float32.

RAMP_EV = (-8.0, 6.0)


def ramp(width: int = 4096, height: int = 64) -> np.ndarray:
    """Grey from 8 stops below to 6 above mid grey, (height, width, 3)."""
    light = MID_GREY * np.exp2(np.linspace(*RAMP_EV, width, dtype=np.float32))
    return np.ascontiguousarray(np.broadcast_to(light[None, :, None], (height, width, 3)))


def hue_chart(stops: float = 23.0, hues: int = 24, size: int = 8) -> np.ndarray:
    """Patches of all hues in two saturations, over `stops` stops about mid grey."""
    levels = np.exp2(np.linspace(-stops / 2, stops / 2, 24)) * MID_GREY
    angles = np.arange(hues) * 2 * np.pi / hues
    colours = np.clip(0.5 + np.cos(angles[:, None] - np.array([0, 2, 4]) * np.pi / 3), 0, 1)
    rows = [colours, 0.3 + 0.7 * colours]
    chart = np.concatenate([levels[None, :, None] * row[:, None] for row in rows])
    return np.ascontiguousarray(chart.repeat(size, 0).repeat(size, 1), np.float32)


# Panoramas ----------------------------------------------------------------------------------------
# Perspective views of equirectangular environment maps.

def perspective(sphere: torch.Tensor, yaw: float, pitch: float, fov: float,
                size: tuple[int, int]) -> torch.Tensor:
    """View (3,H,W) of an environment (3,h,w); angles in degrees, `fov` along the longer side,
    bilinear."""
    h, w = size
    device = sphere.device
    focal = max(h, w) / (2 * math.tan(math.radians(fov) / 2))
    x = (torch.arange(w, device=device) + 0.5 - w / 2) / focal
    y = (torch.arange(h, device=device) + 0.5 - h / 2) / focal
    y, x = torch.meshgrid(y, x, indexing="ij")
    c, s = math.cos(math.radians(pitch)), math.sin(math.radians(pitch))
    up, forward = y * c - s, y * s + c
    longitude = torch.atan2(x, forward) / math.pi + yaw / 180
    longitude = torch.remainder(longitude + 1, 2) - 1
    latitude = torch.atan2(up, torch.hypot(x, forward)) / (math.pi / 2)
    where = torch.stack([longitude, latitude], -1)[None]
    return F.grid_sample(sphere[None], where, mode="bilinear", padding_mode="border",
                         align_corners=False)[0]


# The set ------------------------------------------------------------------------------------------

WIDE_SPACES = ("rec2020", "acescg")
LARGEST = 2.0**14  # after exposure; the shaper ends at 2**8, so nothing visible is lost
FIELD = 85.0
"""Field of view along the longer side of a view, in degrees."""
VIEW_SIZE = (288, 512)
"""Height and width of a view."""
VALIDATION_VIEWS = ((0.0, 0.0), (120.0, 10.0), (240.0, -15.0))  # yaw, pitch in degrees
WIDE = [torch.from_numpy(matrix_between(LINEAR_SPACES[name], REC709).astype(np.float32))
        for name in WIDE_SPACES]


@dataclass
class Pictures:
    """Exposed linear Rec.709 (H,W,3) by name: for training, and held out; and the names that are
    full panoramas."""

    train: dict[str, np.ndarray] = field(default_factory=dict)
    panoramas: set[str] = field(default_factory=set)
    held: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Lesson:
    """A look, its view's cube (size,size,size,3), and the pipeline's results for the held-out
    pictures."""

    look: Look
    cube: torch.Tensor
    wanted: dict[str, np.ndarray]


def read(path: str, space: str | None = None) -> np.ndarray:
    """First three channels of an HDR picture as linear Rec.709, float32; non-finite values and
    negative light are 0.

    `space` is the file's space, a name in `postfx.colour.LINEAR_SPACES`; None reads it from the
    header, like a run. Colours of formats with straight alpha are not multiplied by it.
    """
    import OpenImageIO as oiio

    wish = oiio.ImageSpec()
    wish["oiio:UnassociatedAlpha"] = 1
    image = oiio.ImageBuf(path, 0, 0, wish)
    pixels = image.get_pixels("float")
    if pixels is None or pixels.ndim != 3 or pixels.shape[2] < 3:
        raise SystemExit(f"{path}: not a readable RGB picture")
    light = np.maximum(np.nan_to_num(pixels[..., :3], nan=0.0, posinf=LARGEST, neginf=0.0), 0.0)
    names = ("chromaticities", "colorInteropID")
    header = {name: image.spec().getattribute(name) for name in names}
    own = InputColours(LINEAR_SPACES[space] if space else None).space(header)
    light = own.decode(light) if own.decode else light
    return (light @ own.matrix.T).astype(np.float32)


def expose(rgb: np.ndarray) -> np.ndarray:
    """Scale so that the geometric mean of the luminance between the 2nd and 98th percentile is mid
    grey, 0.18."""
    log = np.log2(np.maximum(rgb @ np.array([0.2126, 0.7152, 0.0722], np.float32), 2.0**-30))
    log = log[log > -30]
    if not log.size:  # black
        return rgb
    low, high = np.percentile(log, [2, 98])
    mean = log[(log >= low) & (log <= high)].mean()
    return (rgb * np.float32(0.18 / 2.0**mean)).clip(-LARGEST, LARGEST)


def shrink(rgb: np.ndarray, side: int) -> np.ndarray:
    """Area average to at most `side` pixels on the longer side."""
    h, w = rgb.shape[:2]
    if max(h, w) <= side:
        return rgb
    size = (round(h * side / max(h, w)), round(w * side / max(h, w)))
    x = torch.from_numpy(np.ascontiguousarray(rgb)).permute(2, 0, 1)[None]
    return F.interpolate(x, size=size, mode="area")[0].permute(1, 2, 0).numpy()


def collect(
    photos: Iterable[str], panoramas: Iterable[str] = (), clips: str | None = None,
    clip_limit: int = 0,
    hold_out: Iterable[str] | None = (), side: int = 768, space: str | None = None,
) -> Pictures:
    """Pictures from patterns of files and a folder of rendered clips; stems in `hold_out` are never
    trained on."""
    sources = [(p, False) for p in files(photos)] + [(p, True) for p in files(panoramas)]
    found, held = Pictures(), held_among([Path(p).stem for p, _ in sources], hold_out or ())
    for path, panorama in sources:
        name, picture = Path(path).stem, read(path, space)
        if name in held:
            found.held |= _held_views(name, picture, panorama)
        else:
            found.train[name] = expose(shrink(picture,
                                              1024 if panorama else side)).astype(np.float16)
            found.panoramas |= {name} if panorama else set()
    for i, frame in enumerate(_clip_frames(clips, clip_limit) if clips else []):
        found.train[f"clip_{i}"] = expose(frame).astype(np.float16)
    found.held = found.held or charts()
    return found


def files(patterns: Iterable[str]) -> list[str]:
    """Files of patterns; ends the program if a pattern matches none."""
    found = {pattern: sorted(glob.glob(pattern)) for pattern in patterns}
    for pattern in (pattern for pattern, paths in found.items() if not paths):
        raise SystemExit(f"{pattern}: no such file")
    return [path for paths in found.values() for path in paths]


def held_among(stems: Sequence[str], names: Iterable[str]) -> set[str]:
    """Names of pictures to hold out; ends the program if one is unknown, or if no picture would be
    left."""
    held = set(names)
    for name in sorted(held - set(stems)):
        raise SystemExit(f"--hold-out {name}: no such picture: there are "
                         f"{', '.join(stems) or 'none'}")
    if stems and held == set(stems):
        raise SystemExit("--hold-out: names all pictures: leave some to train on")
    return held


def charts() -> dict[str, np.ndarray]:
    """Charts that replace held-out pictures if there are none."""
    return {"chart": hue_chart(), "ramp": ramp(512)}


def find_pictures(photos: Iterable[str], panoramas: Iterable[str],
                  side: int) -> dict[str, np.ndarray]:
    """Linear Rec.709 by name, of patterns of files; a perspective view of each panorama; shrunk to
    `side`."""
    found = {_name(p): shrink(read(p), side) for p in files(photos)}
    for path in files(panoramas):
        sphere = torch.from_numpy(read(path)).permute(2, 0, 1)
        view = perspective(sphere, *VALIDATION_VIEWS[0], FIELD, VIEW_SIZE)
        found[_name(path)] = shrink(view.permute(1, 2, 0).numpy(), side)
    return found


def _name(path: str) -> str:
    """A file's stem; for a frame of a sequence, whose stem says little, with its folder."""
    stem = Path(path).stem
    return f"{Path(path).parent.name}" if stem.startswith("reference") else stem


def _held_views(name: str, picture: np.ndarray, panorama: bool) -> dict[str, np.ndarray]:
    if not panorama:
        return {name: expose(shrink(picture, 640)).astype(np.float16)}
    sphere = torch.from_numpy(picture).permute(2, 0, 1)
    views = [perspective(sphere, yaw, pitch, FIELD, VIEW_SIZE) for yaw, pitch in VALIDATION_VIEWS]
    return {f"{name}.{i}": expose(v.permute(1, 2, 0).numpy()).astype(np.float16)
            for i, v in enumerate(views)}


def _clip_frames(folder: str, limit: int) -> list[np.ndarray]:
    """Up to `limit` rendered references, the first frame of evenly spread clips (.npz with
    `reference` (T,H,W,3))."""
    paths = sorted(glob.glob(f"{folder}/*.npz"))
    paths = paths[:: max(1, len(paths) // limit)][:limit] if limit else []
    return [np.load(path)["reference"][0].astype(np.float32) for path in paths]


def lesson(look: Look, pictures: Pictures) -> Lesson:
    """Bake a look and run its pipeline on the held-out pictures."""
    wanted = {name: exact_target(rgb.astype(np.float32), look)
              for name, rgb in pictures.held.items()}
    return Lesson(look, torch.from_numpy(bake(look.view)), wanted)


def save(path: str, pictures: Pictures, lessons: dict[str, Lesson]) -> None:
    arrays: dict[str, Any] = {f"train/{name}": picture for name, picture in pictures.train.items()}
    arrays |= {f"held/{name}": picture for name, picture in pictures.held.items()}
    arrays["panoramas"] = np.array(sorted(pictures.panoramas))
    for name, one in lessons.items():
        arrays[f"look/{name}"] = np.array(json.dumps(describe(one.look)))
        arrays[f"cube/{name}"] = one.cube.numpy().astype(np.float16)
        arrays |= {f"wanted/{name}/{of}": np.round(x * 65535).astype(np.uint16)
                   for of, x in one.wanted.items()}
    np.savez_compressed(path, **arrays)


def load(path: str, name: str) -> tuple[Pictures, Lesson]:
    """Pictures and one lesson of a saved set."""
    with np.load(path) as packed:
        if f"look/{name}" not in packed:
            there = sorted(key[5:] for key in packed if key.startswith("look/"))
            raise SystemExit(f"{path} has no look '{name}': it has {', '.join(there)}")
        part = {kind: {key.removeprefix(kind): packed[key]
                       for key in packed if key.startswith(kind)}
                for kind in ("train/", "held/", f"wanted/{name}/")}
        pictures = Pictures(part["train/"], set(packed["panoramas"].tolist()), part["held/"])
        look = look_from(json.loads(str(packed[f"look/{name}"])))
        wanted = {of: x.astype(np.float32) / 65535 for of, x in part[f"wanted/{name}/"].items()}
        return pictures, Lesson(look, torch.from_numpy(packed[f"cube/{name}"].astype(np.float32)),
                                wanted)


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--looks", nargs="+", default=["local", "auto"],
                        help="built-in looks, or .toml files")
    parser.add_argument("--photos", nargs="*", default=[], help="HDR photographs (patterns)")
    parser.add_argument("--panoramas", nargs="*", default=[],
                        help="equirectangular HDR environments (patterns)")
    parser.add_argument("--clips", help="folder of rendered clips (.npz with `reference`)")
    parser.add_argument("--clip-limit", type=int, default=12)
    parser.add_argument("--hold-out", nargs="*", default=[], help="file stems kept for validation")
    parser.add_argument("--side", type=int, default=768, help="longest side of a photograph")
    parser.add_argument("--space", choices=LINEAR_SPACES,
                        help="primaries of the files, linear; default: by header")
    return parser


def main() -> None:
    args = options().parse_args()
    pictures = collect(args.photos, args.panoramas, args.clips, args.clip_limit, args.hold_out,
                       args.side, args.space)
    lessons = {Path(name).stem: lesson(find_look(name), pictures) for name in args.looks}
    save(args.output, pictures, lessons)
    size = Path(args.output).stat().st_size / 2**20
    print(f"{args.output}: {len(pictures.train)} pictures, {len(pictures.held)} held out, "
          f"{size:.1f} MiB")


if __name__ == "__main__":
    main()
