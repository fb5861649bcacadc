"""What the user says about the depth plane, in place of what the profile says: the text after `--depth`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from postfx.errors import DepthOptionError, ProfileError
from postfx.io.convert import Camera
from postfx.io.profile import PlaneRule

KINDS = {
    "planar": ("planar", False),
    "ray": ("ray", False),
    "device": ("device", False),
    "reversed": ("device", True),
    "normalised": ("normalised", False),
    "normalised-reversed": ("normalised", True),
}
"""Words of `--depth` -> kind of the plane, and whether near is 1 instead of 0."""

_NUMBERS = ("near", "far", "fov", "miss", "scale")
_ENDLESS = ("far", "miss")


@dataclass(frozen=True)
class DepthOption:
    """What a depth plane holds. Numbers that are None come from headers or the profile.

    Attributes:
        kind: planar, ray, device or normalised, as in profiles.
        reversed: whether device or normalised depth is 1 at the near plane.
        near, far: distances of the planes; without a far plane of a device it is infinitely far.
        fov: horizontal field of view in degrees, for ray distance.
        miss: stored value of pixels that hit nothing.
        scale: factor of stored values, such as -1 for the z of a camera that looks along -z.
    """

    kind: str
    reversed: bool
    near: float | None = None
    far: float | None = None
    fov: float | None = None
    miss: float | None = None
    scale: float | None = None

    def rule(self, rule: PlaneRule) -> PlaneRule:
        """A profile's rule for depth, with this in place of its own meaning."""
        scale = (1.0,) if self.scale is None else (self.scale,)
        return replace(rule, kind=self.kind, reversed=self.reversed, miss=self.miss, scale=scale, offset=(0.0,))

    def camera(self, camera: Camera) -> Camera:
        """A header's camera, with the numbers given here in place of its own."""
        given = {"near": self.near, "far": self.far, "fov_x": self.fov}
        return replace(camera, **{name: value for name, value in given.items() if value is not None})


def parse_depth(text: str) -> DepthOption:
    """Option of a text: one of `KINDS`, then near=, far=, fov= (degrees), miss= or scale=, parted by commas.

    'reversed,near=0.1' is a reversed depth buffer with an infinite far plane, 'device,near=0.1,far=100' a usual one,
    'ray,fov=54.4,miss=0' the distance from the eye. Raises DepthOptionError for anything else.
    """
    kind, *pairs = [word.strip() for word in text.split(",")]
    if kind not in KINDS:
        raise DepthOptionError(f"depth '{text}': begin with {', '.join(KINDS)}")
    numbers: dict[str, float] = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        if name in numbers:
            raise DepthOptionError(f"depth '{text}': {name} is given twice: give it once")
        try:
            numbers[name] = float(value)
        except ValueError:
            raise DepthOptionError(f"depth '{text}': '{pair}' is not a number after {'=, '.join(_NUMBERS)}=") from None
        endless = math.isinf(numbers[name]) and name in _ENDLESS
        if not (math.isfinite(numbers[name]) or endless) or (name == "scale" and not numbers[name]):
            raise DepthOptionError(f"depth '{text}': {name} cannot be {value}")
    unknown = sorted(set(numbers) - set(_NUMBERS))
    if unknown:
        raise DepthOptionError(f"depth '{text}': unknown '{unknown[0]}': use {', '.join(_NUMBERS)}")
    return DepthOption(*KINDS[kind], **numbers)


def missing_number(rule: PlaneRule, camera: Camera) -> str | None:
    """What is needed to convert a depth plane and not known: 'near', 'far' or 'fov'; None when nothing is."""
    if rule.kind == "ray":
        return "fov" if camera.fov_x is None else None
    if rule.kind in ("device", "normalised") and camera.near is None:
        return "near"
    return "far" if rule.kind == "normalised" and camera.far is None else None


def missing_error(path: object, names: str, rule: PlaneRule, number: str) -> ProfileError:
    """Error that says what a depth plane needs and where to give it."""
    meaning = {"ray": "distance from the eye", "device": "a depth buffer", "normalised": "normalised"}[rule.kind]
    wanted = {"near": "near plane", "far": "far plane", "fov": "horizontal field of view"}[number]
    key = "fov_x" if number == "fov" else number
    return ProfileError(
        f"{path}: plane 'depth' ({names}) is {meaning} and its {wanted} is not known: "
        f"give {number}= after --depth, {key} under [camera] in a profile, or the header postfx:{_header(key)}"
    )


def _header(key: str) -> str:
    return "fovX" if key == "fov_x" else key
