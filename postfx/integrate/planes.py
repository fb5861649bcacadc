"""Writing all planes of a rendered frame, as the profile `generic` reads them."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from postfx.errors import WriteError
from postfx.files import output_file
from postfx.frame import VARIANCES, Frame, Role
from postfx.io.light_plan import OVERLAY_LAYER
from postfx.planes import LARGEST_HALF

PLANE_CHANNELS = {
    Role.COLOUR: ("R", "G", "B"),
    Role.ALPHA: ("A",),
    Role.DEPTH: ("depth.Z",),
    Role.MOTION: ("motion.X", "motion.Y"),
    Role.NORMAL: ("normal.X", "normal.Y", "normal.Z"),
    Role.DIFFUSE_ALBEDO: ("albedo.R", "albedo.G", "albedo.B"),
    Role.SPECULAR_ALBEDO: ("specular_albedo.R", "specular_albedo.G", "specular_albedo.B"),
    Role.ROUGHNESS: ("roughness.Y",),
    Role.SPECULAR_HIT_DISTANCE: ("specular_hit_distance.Y",),
    Role.STRENGTH: ("strength.Y",),
    Role.REACTIVE: ("reactive.Y",),
    Role.OPAQUE_COLOUR: ("opaque_colour.R", "opaque_colour.G", "opaque_colour.B"),
    Role.OVERLAY: OVERLAY_LAYER,
    Role.VARIANCE_OF_MEAN: ("variance_of_mean.R", "variance_of_mean.G", "variance_of_mean.B"),
    Role.SAMPLE_VARIANCE: ("sample_variance.R", "sample_variance.G", "sample_variance.B"),
    Role.SECOND_MOMENT: ("second_moment.R", "second_moment.G", "second_moment.B"),
    Role.SAMPLE_COUNT: ("sample_count.Y",),
}
"""Channel names of each plane."""

FULL_FLOAT = (Role.DEPTH, Role.SPECULAR_HIT_DISTANCE, *VARIANCES)
"""Planes that half floats cannot hold: a miss is 1e10, and squares of radiance are tiny or huge.
Motion would only lose fractions beyond 2048 pixels."""


def write_planes(path: str | PathLike[str], frame: Frame) -> Path:
    """Write all planes of a frame and its headers into one EXR file; returns the path.

    Half floats, those of `FULL_FLOAT` 32 bit, ZIP. Headers: `frame_header`. The file appears under
    its name only when it is complete; folders are made. Raises WriteError when it cannot be written
    or is not named .exr.
    """
    path = Path(path)
    if path.suffix.lower() != ".exr":
        raise WriteError(f"{path}: planes can only be written as OpenEXR: name it .exr")
    roles = [role for role in Role if role in frame]
    storage = {role: oiio.FLOAT if role in FULL_FLOAT else oiio.HALF for role in roles}
    pixels = [frame[role] if role in FULL_FLOAT
              else np.clip(frame[role], -LARGEST_HALF, LARGEST_HALF) for role in roles]
    spec = oiio.ImageSpec(frame.spec.width, frame.spec.height,
                          sum(len(PLANE_CHANNELS[role]) for role in roles), oiio.HALF)
    spec.channelnames = [name for role in roles for name in PLANE_CHANNELS[role]]
    spec.channelformats = [storage[role] for role in roles for _ in PLANE_CHANNELS[role]]
    spec.attribute("compression", "zip")
    for name, value in frame_header(frame).items():
        _set(spec, name, value)
    with output_file(path) as temporary:
        _write(temporary, spec, np.concatenate(pixels, axis=-1))
    return path


def frame_header(frame: Frame) -> dict[str, Any]:
    """Header attributes that tell postfx about a frame: name -> number, pair or (4, 4) matrix.

    `postfx:jitter` and `postfx:reset` always; `postfx:exposureEV` (stops), `postfx:spp`,
    `postfx:fovX` (degrees) and `worldToCamera` (row vectors) where the frame has them.
    """
    known = {
        "postfx:exposureEV": frame.exposure,
        "postfx:spp": frame.samples,
        "postfx:fovX": frame.fov_x,
        "worldToCamera": frame.world_to_camera,
    }
    always = {"postfx:jitter": tuple(map(float, frame.jitter)), "postfx:reset": int(frame.reset)}
    return always | {name: value for name, value in known.items() if value is not None}


def _set(spec: oiio.ImageSpec, name: str, value: Any) -> None:
    if np.size(value) == 16:
        spec.attribute(name, oiio.TypeMatrix44, tuple(map(float, np.ravel(value))))
    elif np.size(value) == 2:
        spec.attribute(name, oiio.TypeDesc(oiio.FLOAT, oiio.VEC2), value)
    else:
        spec.attribute(name, value.item() if isinstance(value, np.generic) else value)


def _write(path: Path, spec: oiio.ImageSpec, pixels: np.ndarray) -> None:
    output = oiio.ImageOutput.create("exr")
    if output is None:
        raise OSError(oiio.geterror().splitlines()[0])
    done = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(pixels))
    if not (done and output.close()):
        raise OSError(output.geterror().splitlines()[0])
