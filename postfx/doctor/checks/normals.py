"""Normals: encoding, length, space, and the side they point to."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from postfx.doctor.findings import Finding, error, info, warning
from postfx.doctor.geometry import (
    CAMERA_AXES,
    Fit,
    angle_by,
    are_unit,
    is_unsigned,
    lengths_of,
    normals_of_depth,
    smooth_points,
    surface_normals,
    unit_normals,
)
from postfx.doctor.material import Material
from postfx.doctor.statistics import percent
from postfx.frame import Frame, Role

SAME = 3.0  # degrees
TELLING = 4.0
_FLIPS = [np.diag(signs) for signs in product((-1.0, 1.0), repeat=3)]


def normal_encoding(material: Material) -> Iterator[Finding]:
    """Normals stored as 0..1."""
    if Role.NORMAL not in material.middle:
        return
    normal = surface_normals(material.middle)
    if len(normal) < 16:
        return
    if is_unsigned(material.middle):
        decoded = np.median(lengths_of(2 * normal - 1))
        evidence = f"no value below {normal.min():.2g}, and 2 n - 1 has length {decoded:.3f} in the median"
        yield error(Role.NORMAL, "normal-unsigned", evidence, "normals stored as colours, (n + 1) / 2",
                    "store signed values, or in a profile offset = [-0.5, -0.5, -0.5], scale = [2, 2, 2]")
    elif not are_unit(normal):
        lengths = np.percentile(lengths_of(normal), (5, 50, 95))
        evidence = f"lengths {lengths[0]:.3g} / {lengths[1]:.3g} / {lengths[2]:.3g} (5th, 50th, 95th percentile)"
        yield error(Role.NORMAL, "normal-length", evidence, "scaled, filtered, or not a normal", "write unit normals; "
                    "where samples are averaged, of each sample before averaging")


def normal_space(material: Material) -> Iterator[Finding]:
    """Camera space, inverted normals, or a matrix that does not fit, by the normals that follow from depth."""
    frame, fit = material.middle, material.fit
    if Role.NORMAL not in frame or is_unsigned(frame):
        return
    if fit is None or fit.angle > TELLING:
        yield info(Role.NORMAL, "normal-space-untested", "the space of the normals cannot be told",
                   "it needs depth along the view axis and smooth surfaces", "look at its picture (--pictures): world "
                   "normals keep their colours when the camera turns")
        return
    camera = min(_turn(fit.matrix, flip) for flip in _FLIPS)
    if frame.world_to_camera is None:
        yield from _without_matrix(camera)
        return
    if _explained(frame, fit) is not None:
        return
    world = min(_worlds(frame), key=lambda matrix: _turn(fit.matrix, matrix))
    off = _turn(fit.matrix, world)
    evidence = (f"normals are turned by {off:.3g} degrees from the world as worldToCamera has it, "
                f"by {camera:.2g} degrees from the camera's axes")
    if camera < SAME:
        yield error(Role.NORMAL, "normal-camera-space", evidence, "normals are in camera space",
                    "write world normals, or in a profile space = \"camera\"")
    elif (inverted := min(_turn(fit.matrix, -matrix) for matrix in _worlds(frame))) < SAME:
        evidence = f"negated, they are within {inverted:.2g} degrees of what depth and camera say"
        yield error(Role.NORMAL, "normal-inverted", evidence, "normals point away from the viewer",
                    "negate them, in a profile scale = [-1, -1, -1]")
    elif min(_turn(fit.matrix, axes @ frame.world_to_camera[:3, :3]) for axes in CAMERA_AXES) < SAME:
        yield error("sequence", "matrix-transposed", evidence, "worldToCamera stored for column vectors, or inverted",
                    "store it for row vectors (p_camera = p_world M)")
    else:
        yield warning("sequence", "matrix-mismatch", evidence, "worldToCamera of another frame or with other axes",
                      "give the matrix of this frame, for row vectors (p_camera = p_world M)")


def normal_facing(material: Material) -> Iterator[Finding]:
    """Normals of some surfaces that point away from the viewer."""
    frame, fit = material.middle, material.fit
    if fit is None or fit.angle > TELLING or is_unsigned(frame):
        return
    points = smooth_points(frame[Role.DEPTH])
    seen, _ = normals_of_depth(frame, fit.fov_x, points)
    explained = _explained(frame, fit)
    cosines = ((seen @ (fit.matrix if explained is None else explained)) * unit_normals(frame, points)).sum(-1)
    if (share := percent(cosines < -0.7)) > 1:
        yield warning(Role.NORMAL, "normal-facing", f"{share:.3g} % of the pixels point away from the viewer",
                      "normals of the geometry, not turned towards the viewer", "negate those with normal . view > 0")


def _without_matrix(camera: float) -> Iterator[Finding]:
    if camera < SAME:
        evidence = f"normals are within {camera:.2g} degrees of the camera's axes; certain only with worldToCamera"
        yield warning(Role.NORMAL, "normal-camera-space", evidence, "normals are in camera space, or the camera looks "
                      "along an axis of the world and stands still", "write world normals and a worldToCamera header")


def _explained(frame: Frame, fit: Fit) -> np.ndarray | None:
    """The header's matrix, if it takes the normals of depth to the stored ones hardly worse than what fits best: where
    one plane fills the picture that may be turned about its normal."""
    if frame.world_to_camera is None:
        return None
    found = {angle_by(frame, fit.fov_x, matrix): matrix for matrix in _worlds(frame)}
    return found[min(found)] if min(found) < fit.angle + SAME else None


def _worlds(frame: Frame) -> list[np.ndarray]:
    """Matrices from the picture's axes to the world's, by the axes that a camera may have."""
    assert frame.world_to_camera is not None  # without it nobody asks
    rotation = frame.world_to_camera[:3, :3]
    rotation = rotation / np.maximum(np.linalg.norm(rotation, axis=0, keepdims=True), 1e-12)
    return [(rotation @ axes).T for axes in CAMERA_AXES]


def _turn(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two orthogonal matrices; 180 where one mirrors and the other does not."""
    sine = np.linalg.norm(one - other) / (2 * np.sqrt(2))
    return 2 * float(np.degrees(np.arcsin(min(sine, 1.0))))
