"""Kernels that fill what the upscaler's network looks at, row by row so that loops become vector
code, and judge how far to trust guides.

Channels: colour 0, accumulated colour 3 and last output 6 (demodulated, log-encoded), diffuse
albedo 9, specular albedo 12, normal 15, roughness 18, depth 19, its change 20, valid history 21,
sample count 22, jitter 23, length of motion 25, inverse scale 26, hidden state 27. The torch
definition is ``training.denoise.model.features``.
"""

import numpy as np

from postfx.compiled.library import Rows
from postfx.kernels import Kernel
from postfx.kernels.denoise import (
    FEATURES,
    GUIDE_PLANES,
    GUIDE_REFLECTANCE,
    IN_HALF,
    MIRRORED_PLANES,
    REFLECTANCE,
    kernel,
)
from postfx.kernels.denoise.network_io import PACK, width

LOOKS = ("colour", *REFLECTANCE, "normal", "roughness", "depth", "moved", "state", "last_depth",
         "warped", "depth_scale", "params", "window", "keep", "seen_rows", "seen_columns")
FEATURE = kernel("features", LOOKS, ("past", "features"), None, ("features", 2))


def packed_feature_rows(y0: int, y1: int, *tensors: np.ndarray) -> None:
    """Rows of `FEATURE` with channels last, in half precision."""
    *reads, past, packed = tensors
    features = np.empty((1, FEATURES, *packed.shape[1:3]), np.float32)
    FEATURE.rows(y0, y1, *reads, past, features)
    PACK.rows(y0, y1, features, packed)


IN_HALF[FEATURE] = Kernel(
    f"{FEATURE.name}_half", FEATURE.reads, ("past", "packed_features"), packed_feature_rows,
    ("packed_features", 1),
    {name: shape for name, shape in FEATURE.shapes.items() if name != "features"}
    | {"packed_features": (1, "hp", "wp", width(FEATURES))}, {"packed_features": "float16"})

STORED_FEATURE = Kernel(
    f"{FEATURE.name}_stored", (*LOOKS, "coding"), ("past", "stored"),
    Rows(f"{FEATURE.name}_stored"), ("stored", 1),
    {name: shape for name, shape in FEATURE.shapes.items() if name != "features"}
    | {"coding": (2, "wide"), "stored": (1, "stored_h", "stored_w", "wide")}, {"stored": "uint8"})
"""Features in 8 bits, with a border or without."""

# Planes of what mirrors and glass show: albedo 0, normal 3. The torch definition is
# ``training.denoise.model.mirrored_features``.

MIRROR = kernel("mirrored", (*MIRRORED_PLANES, "window", "seen_rows", "seen_columns"),
                ("mirrored",), None, ("mirrored", 2))

# Guides: planes at output size, where the network predicts its filters. Channels of ``guides``, for
# the corners of a render pixel at top left, top right, bottom left and bottom right: diffuse albedo
# 0, specular albedo 3, normal 6, roughness 9, depth 10. The torch definition is
# ``training.denoise.model.guide_features``.

GUIDE = kernel("guides", (*GUIDE_PLANES, "depth_scale", "window", "seen_rows", "seen_columns"),
               ("guides",), None, ("guides", 2))
TRUST = kernel("trust", (*REFLECTANCE, *GUIDE_REFLECTANCE, "window", "part_rows", "part_columns"),
               ("trust",), None, ("trust", 0))
