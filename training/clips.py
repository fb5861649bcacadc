"""Training clips: one uncompressed .npz a clip.

Keys: `reference` (T, H, W, 3) float16 linear Rec.709; for each noisy variant v = 0..V-1 at (h, w) = (H, W) / scale:
`v{v}_colour` (T, h, w, 3) float16 clamped to 65504; `v{v}_diffuse_albedo`, `v{v}_specular_albedo`, `v{v}_normal`
(T, h, w, 3) float16, world space, facing the viewer, zero at misses; `v{v}_roughness` (T, h, w) float16;
`v{v}_depth` (T, h, w) float32 along the view axis, misses 1e10; `v{v}_motion` (T, h, w, 2) float32, previous minus
current position in noisy pixels, x right, y down, without jitter; `v{v}_jitter` (T, 2) float32, sample position minus
0.5, x right, y down; `v{v}_spp` int; `v{v}_style` 'realtime', 'box' or 'blackman-harris'.
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
HALF_MAX = 65504.0


def to_half(values: np.ndarray) -> np.ndarray:
    return np.clip(values, -HALF_MAX, HALF_MAX).astype(np.float16)


def save_clip(path: Path, reference: np.ndarray, variants: list[dict], facts: dict) -> None:
    """Write a clip atomically. `variants` holds the planes by name plus jitter, spp, style; `facts` scale, seed, ..."""
    arrays = {"reference": to_half(reference)}
    for index, variant in enumerate(variants):
        for name, dtype in PLANES.items():
            values = variant[name]
            arrays[f"v{index}_{name}"] = to_half(values) if dtype is np.float16 else values.astype(dtype)
        arrays[f"v{index}_jitter"] = np.asarray(variant["jitter"], np.float32)
        arrays[f"v{index}_spp"] = np.int32(variant["spp"])
        arrays[f"v{index}_style"] = np.str_(variant["style"])
    arrays["scale"] = np.float32(facts["scale"])
    arrays["seed"] = np.int64(facts["seed"])
    arrays["scene"] = np.str_(facts["scene"])
    arrays["meta"] = np.str_(json.dumps(facts["meta"]))
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial.npz")
    np.savez(partial, **arrays)
    partial.replace(path)


def load_clip(path: Path) -> dict:
    """All of a clip: arrays by key, scalars as Python values, `meta` decoded, `variants` the number of variants."""
    with np.load(path) as file:
        clip = {key: file[key] if file[key].ndim else file[key].item() for key in file.files}
    clip["meta"] = json.loads(clip["meta"])
    clip["variants"] = sum(key.endswith("_style") for key in clip)
    return clip
