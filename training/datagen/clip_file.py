"""Training clips: one uncompressed .npz a clip.

Keys: `reference` (T, H, W, 3) float16 linear Rec.709; for each noisy variant v = 0..V-1 at (h, w) = (H, W) / scale:
`v{v}_colour` (T, h, w, 3) float16 clamped to 65504; `v{v}_diffuse_albedo`, `v{v}_specular_albedo`, `v{v}_normal`
(T, h, w, 3) float16, world space, facing the viewer, zero at misses; `v{v}_roughness` (T, h, w) float16;
`v{v}_depth` (T, h, w) float32 along the view axis, misses 1e10; `v{v}_motion` (T, h, w, 2) float32, previous minus
current position in noisy pixels, x right, y down, without jitter; `v{v}_jitter` (T, 2) float32, sample position minus
0.5, x right, y down; `v{v}_spp` int; `v{v}_style` 'realtime', 'box' or 'blackman-harris'.
`half` (T, H, W, 3) is optional: one half of the reference's samples. Noisy renders with `v{v}_half` true were made from
the other half, and are compared with this one. The planes of one with `v{v}_exact` true are the truth for all renders.
Guides, the first-hit planes at output size: `guide_diffuse_albedo`, `guide_specular_albedo`, `guide_normal`
(T, H, W, 3), `guide_roughness` (T, H, W), `guide_depth` (T, H, W), all float16; depth is the base-2 logarithm of the
depth within 1e-4..1e10, so that it fits. `guide_jitter` (T, 2) float32 in output pixels: position of the one sample in
the pixel, minus 0.5, or 0 if the planes average samples spread over the pixel (depth is the first sample's).
`reset` (T,) uint8: 1 where history starts, at the first frame and after a cut (there motion has no meaning); files
without it have no cuts.
Also `scale` float, `seed` int, `scene` str, `meta` str (JSON: cameras, field of view, filter, gain, samples).
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

PLANES = {
    "colour": np.float16,
    "diffuse_albedo": np.float16,
    "specular_albedo": np.float16,
    "normal": np.float16,
    "roughness": np.float16,
    "depth": np.float32,
    "motion": np.float32,
}
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
    return np.where(stored >= half_depth(np.float32(DEPTH_RANGE[1])), np.float32(DEPTH_RANGE[1]), depth)


def exposure_of(colour: np.ndarray, key: float = 0.18, block: int = 4) -> float:
    """Multiplier that brings the geometric mean luminance of frames (T, H, W, 3) to `key`.

    Luminance is averaged over `block` x `block` pixels first: the logarithm of noisy pixels is too low.
    """
    luminance = colour.astype(np.float64) @ LUMINANCE
    frames, height, width = luminance.shape
    cut = luminance[:, : height // block * block, : width // block * block]
    mean = cut.reshape(frames, height // block, block, width // block, block).mean((2, 4))
    return float(key / np.exp(np.log(mean + 1e-4).mean()))


def save_clip(path: Path, reference: np.ndarray, variants: list[dict], facts: dict) -> None:
    """Write a clip atomically.

    `variants` hold the planes by name plus jitter, spp and style; `facts` hold scale, seed, scene, meta and perhaps
    guides by name plus jitter.
    """
    arrays = {"reference": to_half(reference)}
    if "half" in facts:
        arrays["half"] = to_half(facts["half"])
    if "guides" in facts:
        arrays |= _guide_arrays(facts["guides"])
    for index, variant in enumerate(variants):
        for name, dtype in PLANES.items():
            values = variant[name]
            arrays[f"v{index}_{name}"] = to_half(values) if dtype is np.float16 else values.astype(dtype)
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
    return arrays | {"guide_depth": half_depth(guides["depth"]), "guide_jitter": guides["jitter"].astype(np.float32)}


def load_clip(path: Path) -> dict:
    """All of a clip: arrays by key, scalars as Python values, `meta` decoded, `variants` the number of variants."""
    with np.load(path) as file:
        clip = {key: file[key] if file[key].ndim else file[key].item() for key in file.files}
    clip["meta"] = json.loads(clip["meta"])
    clip.setdefault("reset", first_only(len(clip["reference"])))
    clip["variants"] = sum(key.endswith("_style") for key in clip)
    return clip
