"""Whether albedo shows what is to be seen on surfaces, by one frame."""

from __future__ import annotations

import math

import numpy as np

SPAN_PX = 6
"""Pixels in a row or column that are compared."""
APART_PX = 4
"""Distance of two pixels whose difference is a sample of the texture."""
ALIKE = 0.01
"""Relative difference of albedo within a surface of one colour, and the darkest that counts."""
PLAIN_SHARE = 0.9
"""Share of a picture in which albedo is of one colour, in renders at most 0.6."""
TEXTURE_COVARIANCE = 0.01
"""Covariance of relative differences of light above which it has textures: a contrast of a
tenth."""
LARGEST_PRODUCT = 4.0
"""Product of two relative differences, at most: more is a firefly."""
MOST_LINES = 500
"""Rows, and columns, of a frame that are looked at."""
DARKEST = 1e-12
"""Level that a darker pixel counts as, so that parts of it are finite."""


def is_plain(albedo: np.ndarray, colour: np.ndarray) -> bool:
    """Whether albedo is of one colour everywhere, or of one over each surface while the light has
    textures: as of an override material, or of renderers that leave textures out of it.

    albedo, colour: (height, width, 3); pixels that are not finite do not count. Noise of pixels is
    taken as independent: two differences of pixels, one beside the other, have only the texture in
    common.
    """
    if albedo[0, 0].any() and (albedo == albedo[0, 0]).all():
        return True
    plain, products = [], []
    for axis in (0, 1):
        step = math.ceil(colour.shape[1 - axis] / MOST_LINES)
        light, reflected = (np.moveaxis(plane.mean(axis=2), axis, 0)[:, ::step]
                            for plane in (colour, albedo))
        count = len(light) - SPAN_PX + 1
        if count < 1:
            continue
        places = np.stack([reflected[first:first + count] for first in range(SPAN_PX)])
        most = places.max(axis=0)
        is_alike = (most - places.min(axis=0) <= ALIKE * most) & (most > ALIKE)
        one, beside, other, last = (light[first:first + count]
                                    for first in (0, 1, APART_PX, APART_PX + 1))
        level = np.maximum((one + beside + other + last) / 4, DARKEST)
        product = np.clip((one - other) * (beside - last) / level**2,
                          -LARGEST_PRODUCT, LARGEST_PRODUCT)
        plain.append(is_alike.ravel())
        products.append(product[is_alike & np.isfinite(product)])
    found = np.concatenate(products) if products else np.empty(0)
    if not found.size or np.concatenate(plain).mean() < PLAIN_SHARE:
        return False
    return float(found.mean()) > TEXTURE_COVARIANCE
