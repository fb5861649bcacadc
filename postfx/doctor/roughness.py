"""Whether roughness is linear: specular albedo seen at an angle depends on it in a known way.

Split-sum directional albedo (Karis 2014, "Physically based shading on mobile"): specular = F0 scale + bias, where scale
and bias follow from roughness and the cosine of the view angle. On surfaces of one material F0 is constant, so under
the right reading of the roughness plane one F0 explains all angles; and F0 is no less than that of water.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from postfx.doctor.geometry import normals_of_depth, smooth_points
from postfx.doctor.statistics import finite
from postfx.frame import Frame, Role
from postfx.integrate.materials import split_sum

Model = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

LEAST_F0, MOST_F0 = 0.015, 1.0
LEAST_PIXELS = 150
LEAST_ERROR = 2e-4
TELLING = 0.5


@dataclass(frozen=True)
class Kind:
    """A reading of the stored values: how linear roughness follows from them."""

    code: str
    name: str
    cause: str
    mend: str
    linear: Callable[[np.ndarray], np.ndarray]


KINDS = (
    Kind("", "linear roughness", "", "", lambda stored: stored),
    Kind("roughness-squared", "squared roughness (alpha)", "alpha of the microfacet model was written",
         "write the square root of alpha", np.sqrt),
    Kind("roughness-root", "the square root of roughness", "linear roughness was taken for alpha, or display-encoded",
         "write it without the square root or transfer curve", np.square),
    Kind("roughness-smoothness", "smoothness", "smoothness or glossiness was written",
         "write 1 - smoothness, or in a profile scale = [-1], offset = [-1]", lambda stored: 1 - stored),
    Kind("roughness-smoothness", "smoothness of squared roughness", "smoothness was written as 1 - alpha",
         "write the square root of 1 - smoothness", lambda stored: np.sqrt(1 - stored)),
)


@dataclass(frozen=True)
class RoughnessFit:
    """Median error of specular albedo by each reading, without any dependence on the angle, and the count of pixels."""

    errors: dict[Kind, float]
    without_angle: float
    pixels: int

    @property
    def as_it_is(self) -> float:
        """Error of the plane as linear roughness."""
        return self.errors[KINDS[0]]

    @property
    def best(self) -> Kind:
        """The reading with the least error."""
        return min(self.errors, key=lambda kind: self.errors[kind])

    @property
    def is_telling(self) -> bool:
        """Whether specular albedo follows the view angle as the model says; that of some renderers does not."""
        return max(self.errors[self.best], LEAST_ERROR) < TELLING * self.without_angle

    @property
    def certainty(self) -> float:
        """0 when the best reading is no better than the plane as it is, 1 when it leaves no error."""
        best = max(self.errors[self.best], LEAST_ERROR)
        return max(0.0, 1 - best / max(self.as_it_is, LEAST_ERROR))


def environment_brdf(roughness: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale and bias of F0 in the directional albedo (Karis 2014); all arrays of one shape, 0..1."""
    x, y = 1 - roughness, 0.0425 - 0.0275 * roughness
    z, w = 1.04 - 0.572 * roughness, -0.04 + 0.022 * roughness
    a = np.minimum(x * x, np.exp2(-9.28 * cosine)) * x + y
    return z - 1.04 * a, w + 1.04 * a


def fit_roughness(frame: Frame) -> RoughnessFit | None:
    """Errors of all readings; None without the planes, a field of view or enough smooth surfaces."""
    needed = (Role.SPECULAR_ALBEDO, Role.DEPTH)
    if frame.fov_x is None or any(role not in frame for role in needed):
        return None
    points = smooth_points(frame[Role.DEPTH])
    _, cosine = normals_of_depth(frame, frame.fov_x, points)
    stored = finite(frame[Role.ROUGHNESS])[points.rows, points.columns, 0].astype(np.float64)
    specular = finite(frame[Role.SPECULAR_ALBEDO]).min(2)[points.rows, points.columns].astype(np.float64)
    known = (specular > 0.005) & (stored >= 0) & (stored <= 1) & (cosine > 0.05)
    groups = _groups(stored[known])
    if not groups:
        return None
    values = stored[known], specular[known], cosine[known]
    errors = {kind: _error(kind, groups, *values) for kind in KINDS}
    without = [np.median(np.abs(values[1][group] - np.median(values[1][group]))) for group in groups]
    sizes = [group.size for group in groups]
    return RoughnessFit(errors, float(np.average(without, weights=sizes)), sum(sizes))


def _groups(stored: np.ndarray) -> list[np.ndarray]:
    """Indices of pixels whose roughness is the same to 1/256, of groups large enough."""
    steps = np.rint(stored * 256).astype(int)
    counts = np.bincount(steps, minlength=257)
    return [np.nonzero(steps == step)[0] for step in np.nonzero(counts >= LEAST_PIXELS)[0]]


MODELS = (environment_brdf, split_sum)
"""Renderers use either, and they differ by more than small errors of a reading."""


def _error(kind: Kind, groups: list[np.ndarray], *planes: np.ndarray) -> float:
    """By the model that fits better."""
    return min(_error_by(model, kind, groups, *planes) for model in MODELS)


def _error_by(model: Model, kind: Kind, groups: list[np.ndarray], stored: np.ndarray, specular: np.ndarray,
              cosine: np.ndarray) -> float:
    """Mean over the groups of the median error of specular albedo, with the F0 that suits most pixels."""
    errors = []
    for group in groups:
        scale, bias = model(kind.linear(stored[group]), cosine[group])
        f0 = np.clip(np.median((specular[group] - bias) / scale), LEAST_F0, MOST_F0)
        errors.append(np.median(np.abs(f0 * scale + bias - specular[group])))
    return float(np.average(errors, weights=[group.size for group in groups]))
