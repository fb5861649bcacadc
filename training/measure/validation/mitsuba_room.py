"""A room by hand, for `hosts/loop/render_mitsuba.py`: a lamp in a corner that lights the rest by
the walls alone, glass, rough metal, and tiles. Units are metres; y is up."""

from typing import Any

import mitsuba as mi

SIZE = 160, 96
TURN = mi.ScalarTransform4f
Vector = tuple[float, float, float]


def diffuse(*colour: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}


def wall(at: Vector, about: Vector, degrees: float, sides: tuple[float, float],
         bsdf: dict[str, Any]) -> dict[str, Any]:
    """A rectangle that faces +z before it is turned."""
    to_world = TURN().translate(at).rotate(about, degrees).scale((sides[0] / 2, sides[1] / 2, 1))
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def ball(at: Vector, radius: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "sphere", "center": list(at), "radius": radius, "bsdf": bsdf}


def build(frame: int) -> dict[str, Any]:
    """The room; the same in all frames."""
    white, red = diffuse(0.75, 0.73, 0.7), diffuse(0.6, 0.15, 0.1)
    tiles = {"type": "diffuse", "reflectance": {
        "type": "checkerboard", "color0": {"type": "rgb", "value": [0.2, 0.16, 0.12]},
        "color1": {"type": "rgb", "value": [0.6, 0.55, 0.45]},
        "to_uv": TURN().scale((14, 10, 1))}}
    metal = {"type": "roughconductor", "material": "Au", "alpha": 0.15}
    screen = wall((-1.1, 0.9, -0.9), (0, 1, 0), 35, (0.9, 1.8), {"type": "twosided", "m": red})
    lamp = {"type": "sphere", "center": [-1.75, 1.2, -1.45], "radius": 0.09, "emitter": {
        "type": "area", "radiance": {"type": "rgb", "value": [90.0, 72.0, 48.0]}}}
    camera = {
        "type": "perspective", "fov": 58, "fov_axis": "x", "sampler": {"type": "independent"},
        "to_world": TURN().look_at(origin=(1.2, 1.35, 2.3), target=(-0.15, 0.75, -0.6),
                                   up=(0, 1, 0)),
        "film": {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1],
                 "rfilter": {"type": "box"}, "pixel_format": "rgb"},
    }
    return {
        "type": "scene", "integrator": {"type": "path", "max_depth": 10}, "sensor": camera,
        "floor": wall((0, 0, 0), (1, 0, 0), -90, (5, 5.4), tiles),
        "ceiling": wall((0, 2.5, 0), (1, 0, 0), 90, (5, 5.4), white),
        "back": wall((0, 1.25, -2), (0, 1, 0), 0, (5, 2.5), white),
        "front": wall((0, 1.25, 2.6), (0, 1, 0), 180, (5, 2.5), white),
        "left": wall((-2.2, 1.25, 0), (0, 1, 0), 90, (5.4, 2.5), white),
        "right": wall((2.2, 1.25, 0), (0, 1, 0), -90, (5.4, 2.5), diffuse(0.25, 0.45, 0.6)),
        "screen": screen, "lamp": lamp,
        "glass": ball((0.35, 0.32, -0.2), 0.32, {"type": "dielectric"}),
        "gold": ball((-0.45, 0.28, 0.35), 0.28, metal),
        "rough": ball((1.0, 0.25, -0.9), 0.25, diffuse(0.2, 0.5, 0.25)),
    }
