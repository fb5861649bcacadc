"""What `postfx inspect` finds out."""

from __future__ import annotations

from typing import Any

import numpy as np

from postfx.frame import DEPTH_MISS, ROLES, Frame, Role
from postfx.io.aov import FrameFiles
from postfx.io.layout import Match
from postfx.io.sequence import Sequence


def inspect(source: str, frames: str | None, profile: str | None, guides: str | None = None) -> dict[str, Any]:
    """Facts about a sequence and one of its frames, in plain types.

    Raises SequenceError, MissingFrameError, MissingPlaneError, GuideError, ReadError or ProfileError.
    """
    sequence = Sequence(source, frames, profile, guides=guides)
    with sequence.open(sequence.numbers[0]) as files:
        frame = files.read(sequence.numbers[0])
        spec, layout = frame.spec, files.layout
        return {
            "source": str(sequence.pattern),
            "frames": {"count": len(sequence), "first": sequence.numbers[0], "last": sequence.numbers[-1]},
            "absent_frames": [number for number in sequence.numbers if number not in sequence.present()],
            "profile": {"name": layout.profile.name, "title": layout.profile.title},
            "width": spec.width,
            "height": spec.height,
            "planes": [_plane(frame[role], role, layout.planes[role]) for role in spec.roles],
            "guides": _guides(frame, files),
            "missing": [{"role": str(role), "mend": _mend(files, role)} for role in Role if role not in frame],
            "header": _header(frame),
            "warnings": sequence.warnings,
        }


def text_of(found: dict[str, Any]) -> str:
    """The facts as lines for people."""
    frames, profile = found["frames"], found["profile"]
    lines = [
        f"{found['source']}: {_frames_text(frames)}",
        f"profile {profile['name']} ({profile['title'] or 'own'}), {found['width']}x{found['height']}",
        "",
        *(_plane_line(plane) for plane in found["planes"]),
        "",
        *_guide_lines(found["guides"]),
        *(f"missing  {item['role']}{': ' + item['mend'] if item['mend'] else ''}" for item in found["missing"]),
        *(f"header   {name}: {value}" for name, value in found["header"].items()),
        *(f"warning  {warning}" for warning in found["warnings"]),
    ]
    if found["absent_frames"]:
        lines.append(f"warning  frames without a file: {', '.join(map(str, found['absent_frames'][:10]))}")
    return "\n".join(lines)


def _frames_text(frames: dict[str, int]) -> str:
    return f"{frames['count']} frames, {frames['first']} to {frames['last']}" if frames["count"] > 1 else "1 frame"


def _guides(frame: Frame, files: FrameFiles) -> dict[str, Any] | None:
    if not frame.guides:
        return None
    planes = [_plane(frame.guides[role], role, files.guides.planes[role]) for role in frame.spec.guide_roles]
    jitter = list(frame.guide_jitter) if any(frame.guide_jitter) else None
    width, height = frame.guide_size
    return {"source": frame.guide_source, "width": width, "height": height, "jitter": jitter, "planes": planes}


def _guide_lines(guides: dict[str, Any] | None) -> list[str]:
    if guides is None:
        return []
    jitter = f", jitter {guides['jitter']}" if guides["jitter"] else ""
    head = f"guides {guides['width']}x{guides['height']} in {guides['source']}{jitter}"
    return [head, "", *map(_plane_line, guides["planes"]), ""]


def _plane(pixels: np.ndarray, role: Role, match: Match) -> dict[str, Any]:
    valid = np.isfinite(pixels)
    valid &= (pixels < DEPTH_MISS) if role is Role.DEPTH else True
    low, high = (float(pixels[valid].min()), float(pixels[valid].max())) if valid.any() else (None, None)
    return {
        "role": str(role),
        "channels": match.names,
        "min": low,
        "max": high,
        "misses": int((pixels >= DEPTH_MISS).sum()) if role is Role.DEPTH else 0,
        "non_finite": int(pixels.size - np.isfinite(pixels).sum()),
        "unit": ROLES[role].unit,
    }


def _plane_line(plane: dict[str, Any]) -> str:
    values = "no value" if plane["min"] is None else f"{plane['min']:.4g} .. {plane['max']:.4g}"
    odd = [f"{plane[key]} {words}" for key, words in (("misses", "misses"), ("non_finite", "not finite")) if plane[key]]
    text = f"{plane['role']:<22}{plane['channels']:<38}{values}"
    return f"{text} ({', '.join(odd)})" if odd else text


def _mend(files: FrameFiles, role: Role) -> str:
    return next((rule.enable for rule in files.layout.profile.rules(role) if rule.enable), "")


def _header(frame: Frame) -> dict[str, Any]:
    found = {
        "jitter": list(frame.jitter) if any(frame.jitter) else None,
        "exposure": frame.exposure,
        "samples": frame.samples,
        "reset": frame.reset or None,
        "fov_x": frame.fov_x,
        "world_to_camera": "present" if frame.world_to_camera is not None else None,
    }
    return {name: value for name, value in found.items() if value is not None}
