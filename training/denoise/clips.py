"""Clips of the data factory as training reads them: tensors on the device.

A clip (``training/datagen/clip_file.py``) is a reference and several independent noisy renders of
it. Everything stays on the device as float16, so that a batch costs no transfer; depth is stored as
its logarithm, which fits the range.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from postfx.passes.denoise.planes import HAZY, shows_volume
from training.datagen.clip_file import MIRRORED

PLANES = (("colour", 3), ("diffuse_albedo", 3), ("specular_albedo", 3), ("normal", 3),
          ("roughness", 1), ("depth", 1),
          ("denoising_albedo", 3), ("denoising_normal", 3), ("motion", 2))
"""Planes of a clip in their order, and how many channels each has."""
GUIDES = PLANES[1:6]
"""Planes that clips may have at output size, too."""
CHANNELS = sum(channels for _, channels in PLANES)
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of channels in how bright a colour is (BT.709)."""

# First channels of these planes in a clip.
NORMAL = 9
DEPTH = 13
MIRRORED_ALBEDO = 14
MIRRORED_NORMAL = 17
MOTION = 20
"""Further kinds of motion follow this one."""

COLOUR = slice(0, 3)
"""Channels of the colour."""
SURFACE = slice(3, 13), slice(14, 20)
"""Channels of albedos, normals and roughness: means over a pixel's samples, where those are
spread."""
ABSENT = {"diffuse_albedo": 0.0, "specular_albedo": 0.0, "normal": 0.0, "roughness": 0.5,
          "depth": 1.0, "denoising_albedo": 0.0, "denoising_normal": 0.0, "motion": 0.0}
"""Values of planes that a file lacks; postfx/passes/denoise/planes.py fills in the same ones."""


@dataclass
class Clip:
    """A clip of T frames, of which there are V noisy renders.

    Attributes:
        name: of the file.
        planes: (V, T, C, h, w) float16: the 22 channels of ``PLANES``, then two for each of
            ``motions``.
        jitter: (V, T, 2) pixels.
        spread: of each render, whether it spreads its samples over the pixel.
        keep: (T,) 0 at cuts and at the first frame, else 1.
        reference: (T, 3, H, W) float16 at output size.
        guides: (T, 11, H, W) float16, planes at output size, if asked for.
        exposure: what light is multiplied by.
        half: (T, 3, H, W) float16, made of half of the reference's samples, if the file has it.
        halved: marks renders that are made of the other half, and so are compared with ``half``.
        exact: marks renders whose planes are the true ones.
        hazy: marks renders of a volume, which have no depth and albedo, as in the product.
        samples: samples a pixel of each render.
        motions: further kinds of motion, by their names in ``MOTIONS``.
        weight: a clip of weight 2 is drawn twice as often as one of weight 1.
    """

    name: str
    planes: Tensor
    jitter: Tensor
    spread: list[bool]
    keep: Tensor
    reference: Tensor
    guides: Tensor | None
    exposure: float
    half: Tensor | None
    halved: list[bool]
    exact: list[bool]
    hazy: list[bool]
    samples: list[int]
    motions: tuple[str, ...] = ()
    weight: float = 1.0


def grey_factor(colour: np.ndarray) -> float:
    """Multiplier that brings the log-average luminance of (H, W, 3) to 0.18."""
    # samples of volumes may be negative
    luminance = (colour.astype(np.float64) @ np.array(LUMINANCE)).clip(min=0)
    return float(0.18 / np.exp(np.mean(np.log(luminance + 1e-3 * luminance.mean() + 1e-9))))


def load(path: Path, device: torch.device, guides: bool = False, motions: tuple[str, ...] = (),
         blank_volumes: bool = True) -> Clip:
    """Read one clip file and move it to ``device``, with its guides and further kinds of motion, if
    asked for.

    ``blank_volumes``: renders of a volume have no depth and albedo, as for networks that do not
    read such planes. Raises ValueError if it lacks the guides.
    """
    data = np.load(path)
    if guides and "guide_depth" not in data.files:
        raise ValueError(f"{path}: no planes at output size, which --guides needs")
    names = {key.split("_", 1)[0] for key in data.files}
    variants = sorted(name for name in names if name[0] == "v" and name[1:].isdigit())
    hazy = {v: blank_volumes and shows_volume(data[f"{v}_depth"][0, ..., None].astype(np.float32))
            for v in variants}

    def plane(key: str) -> Tensor:
        variant, _, name = key.partition("_")
        if name in MIRRORED and key not in data.files:
            return torch.zeros_like(plane(f"{variant}_normal"))
        values = torch.from_numpy(data[key]).to(device)
        if hazy.get(variant) and name in HAZY:
            values = torch.full_like(values, ABSENT[name])
        values = values.movedim(-1, 1) if values.ndim == 4 else values[:, None]
        if key.startswith("v") and key.endswith("_depth"):
            values = values.clamp(1e-4, 1e10).log2()
        return values.half()

    def render(variant: str) -> Tensor:
        planes = [plane(f"{variant}_{name}") for name, _ in PLANES]
        further = [torch.from_numpy(MOTIONS[name](data, variant)).movedim(-1, 1).to(device).half()
                   for name in motions]
        return torch.cat([*planes, *further], 1)

    def is_marked(variant: str, mark: str) -> bool:
        key = f"{variant}_{mark}"
        return key in data.files and bool(data[key])

    reference = data["reference"]
    resets = data["reset"] if "reset" in data.files else np.zeros(len(reference))
    jitter = np.stack([data[f"{v}_jitter"] for v in variants]).astype(np.float32)
    return Clip(
        name=path.stem,
        planes=torch.stack([render(v) for v in variants]),
        jitter=torch.from_numpy(jitter).to(device),
        spread=[str(data[f"{v}_style"]) != "realtime" for v in variants],
        keep=torch.from_numpy(1 - resets.astype(np.float32)).to(device),
        reference=plane("reference"),
        guides=torch.cat([plane(f"guide_{name}") for name, _ in GUIDES], 1) if guides else None,
        exposure=grey_factor(reference[0]),
        half=plane("half") if "half" in data.files else None,
        halved=[is_marked(v, "half") for v in variants],
        exact=[is_marked(v, "exact") for v in variants],
        hazy=[hazy[v] for v in variants],
        samples=[int(data[f"{v}_spp"]) for v in variants],
        motions=motions,
    )


def inverse_motion(data: Mapping[str, np.ndarray], variant: str) -> np.ndarray:
    """Motion (T, h, w, 2) from each pixel to its position in the next frame; 0 in the last
    frame."""
    from postfx.temporal.reverse_motion import invert_motion

    motion = data[f"{variant}_motion"].astype(np.float32)
    depth = data[f"{variant}_depth"][..., None].astype(np.float32)
    frames = pairwise(zip(motion, depth, strict=True))
    return np.stack([*(invert_motion(*after, shown) for (_, shown), after in frames),
                     np.zeros_like(motion[-1])])


def static_motion(data: Mapping[str, np.ndarray], variant: str) -> np.ndarray:
    """Motion (T, h, w, 2) as if only the camera moved: moving objects get the vectors of a world at
    rest.

    It follows from depth and the camera's poses (x left, y up, z forward), which only the Mitsuba
    clips hold. The first frame, cuts and clips without poses keep the motion of the file.
    """
    motion = data[f"{variant}_motion"].astype(np.float32)
    depth = data[f"{variant}_depth"].astype(np.float64)
    meta = json.loads(str(data["meta"])) if "meta" in data else {}
    if "to_world" not in meta:
        return motion
    poses, fov = np.array(meta["to_world"]), np.broadcast_to(meta["fov"], len(motion))
    frames, h, w = depth.shape
    cuts = data["reset"] if "reset" in data else np.zeros(frames)
    y, x = np.meshgrid(np.arange(h) + 0.5, np.arange(w) + 0.5, indexing="ij")
    for t in range(1, frames):
        if cuts[t]:
            continue
        # focal lengths in pixels
        now, before = (w / (2 * math.tan(math.radians(fov[k]) / 2)) for k in (t, t - 1))
        local = np.stack([(w / 2 - x) / now, (h / 2 - y) / now, np.ones((h, w))],
                         -1) * depth[t][..., None]
        world = local @ poses[t, :3, :3].T + poses[t, :3, 3]
        seen = (world - poses[t - 1, :3, 3]) @ poses[t - 1, :3, :3]
        far = np.maximum(seen[..., 2], 1e-6)
        there = np.stack([w / 2 - before * seen[..., 0] / far, h / 2 - before * seen[..., 1] / far],
                         -1)
        motion[t] = np.where(seen[..., 2:] > 1e-6, there - np.stack([x, y], -1), motion[t])
    return motion


MOTIONS = {"inverse": inverse_motion, "static": static_motion}
