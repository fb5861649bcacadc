"""The facts and findings of `postfx inspect`, in plain types and as text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from postfx.doctor import examine
from postfx.doctor.findings import Finding, exit_code
from postfx.doctor.material import Reading, explain_roles, read_material
from postfx.doctor.pictures import write_pictures
from postfx.doctor.statistics import Range, Values, count_values, noise_level, range_of
from postfx.frame import ERROR_ROLES, ROLES, Frame, Role
from postfx.io.layout import Match
from postfx.io.profile import SOURCES
from postfx.io.sequence import Sequence

STYLES = {"error": "bold red", "warning": "yellow", "info": "cyan"}
VERDICTS = {0: "nothing wrong was found", 1: "there are warnings", 2: "there are errors"}
INDENT = " " * 9


class Inspection:
    """A sequence looked at: facts about its first frame, and findings of a few frames.

    Raises SequenceError, MissingFrameError, MissingPlaneError, GuideError, ReadError, ColourError
    or ProfileError.

    Attributes:
        sequence: what was looked at.
        findings: the most important first.
        exit_code: 0 fine, 1 warnings only, 2 errors.
        pictures: paths of the pictures that were written.
    """

    def __init__(
        self, source: str, frames: str | Iterable[int] | None, profile: str | None, guides: str | None = None,
        depth: str | None = None, colourspace: str | None = None, layer: str | None = None, view: str | None = None,
    ) -> None:
        self.sequence = Sequence(source, frames, profile, guides=guides, depth=depth, colourspace=colourspace,
                                 layer=layer, view=view).first_view()
        self._reading: Reading = read_material(self.sequence)
        self.findings: list[Finding] = examine(self._reading.material)
        self.exit_code = exit_code(self.findings)
        self.pictures: list[str] = []

    @property
    def frames(self) -> list[Frame]:
        """The frames that were looked at, in order, neither clamped nor repaired."""
        return list(self._reading.material.frames)

    def write_pictures(self, folder: str) -> None:
        """Write a picture of every plane and guide of the first frame; WriteError when the folder cannot be written."""
        self.pictures = [str(path) for path in write_pictures(self._reading.material.first, folder)]

    def facts(self) -> dict[str, Any]:
        """Everything in plain types."""
        sequence, layout, material = self.sequence, self._reading.layout, self._reading.material
        frame, spec = material.first, material.first.spec
        return {
            "source": str(sequence.pattern),
            "frames": {"count": len(sequence), "first": sequence.numbers[0], "last": sequence.numbers[-1]},
            "examined": [frame.number for frame in material.frames],
            "measured": material.measured,
            "absent_frames": [number for number in sequence.numbers if number not in sequence.present()],
            "profile": {"name": layout.profile.name, "title": layout.profile.title, "source": layout.profile.source},
            "width": spec.width,
            "height": spec.height,
            "roles": explain_roles(self._reading),
            "findings": [finding.as_dict() for finding in self.findings],
            "planes": [
                _plane(frame[role], role, layout.planes[role], material.stored[role], material.ranges[role])
                for role in spec.roles
            ],
            "guides": _guides(frame, self._reading),
            "missing": [
                {"role": str(role), "fix": material.enable.get(role, "")}
                for role in Role if role not in frame and role not in (*ERROR_ROLES, Role.LATER)
            ],
            "header": _header(frame),
            "warnings": sequence.warnings,
            "pictures": self.pictures,
        }


def _guides(frame: Frame, reading: Reading) -> dict[str, Any] | None:
    if not frame.guides or reading.guides is None or frame.guide_size is None:
        return None
    matches = reading.guides.planes
    held = [(role, frame.guides[role]) for role in frame.spec.guide_roles]
    planes = [_plane(plane, role, matches[role], count_values(plane), range_of(plane, role is Role.DEPTH))
              for role, plane in held]
    jitter = list(frame.guide_jitter) if any(frame.guide_jitter) else None
    width, height = frame.guide_size
    return {"source": frame.guide_source, "width": width, "height": height, "jitter": jitter, "planes": planes}


def _plane(pixels: np.ndarray, role: Role, match: Match, stored: Values, extent: Range) -> dict[str, Any]:
    return {
        "role": str(role),
        "channels": match.names,
        "source": match.rule.source,
        "min": extent.low,
        "max": extent.high,
        "misses": extent.misses,
        "non_finite": stored.nan + stored.infinite,
        "nan": stored.nan,
        "infinite": stored.infinite,
        "negative": stored.negative,
        "noise": noise_level(pixels),
        "unit": ROLES[role].unit,
    }


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


def print_text(facts: dict[str, Any], exit_code: int) -> None:
    """Print facts as lines; findings are coloured on a terminal."""
    console = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)
    for line in _lines(facts, exit_code):
        console.print(line)


def _lines(facts: dict[str, Any], exit_code: int) -> list[str | Text]:
    profile, examined = facts["profile"], len(facts["examined"])
    looked = f", {examined} examined" if facts["frames"]["count"] > 1 else ""
    looked += f", ranges of {len(facts['measured'])}" if len(facts["measured"]) > examined else ""
    return [
        f"{facts['source']}: {_frames_text(facts['frames'])}{looked}: {VERDICTS[exit_code]}",
        f"profile {profile['name']} ({profile['title'] or 'own'}), {facts['width']}x{facts['height']}",
        *([f"names are {SOURCES[profile['source']]}"] if profile["source"] else []),
        "",
        *(line for finding in facts["findings"] for line in _finding_lines(finding)),
        *([""] if facts["findings"] else []),
        *(_plane_line(plane, profile["source"]) for plane in facts["planes"]),
        "",
        *_guide_lines(facts["guides"]),
        *(f"missing  {item['role']}{': ' + item['fix'] if item['fix'] else ''}" for item in facts["missing"]),
        *(f"header   {name}: {value}" for name, value in facts["header"].items()),
        *(f"warning  {warning}" for warning in facts["warnings"]),
        *_absent_lines(facts["absent_frames"]),
        *([f"wrote    {len(facts['pictures'])} pictures: {facts['pictures'][0]} ..."] if facts["pictures"] else []),
    ]


def _finding_lines(finding: dict[str, str]) -> list[str | Text]:
    level = finding["level"]
    head = Text.assemble((f"{level:<9}", STYLES[level]), (finding["code"], "bold"),
                         f" ({finding['role']}): {finding['evidence']}")
    fix, *lines = finding["fix"].splitlines()
    return [head, f"{INDENT}likely: {finding['cause']}", f"{INDENT}fix:    {fix}", *(INDENT + line for line in lines)]


def _frames_text(frames: dict[str, int]) -> str:
    return f"{frames['count']} frames, {frames['first']} to {frames['last']}" if frames["count"] > 1 else "1 frame"


def _guide_lines(guides: dict[str, Any] | None) -> list[str]:
    if guides is None:
        return []
    jitter = f", jitter {guides['jitter']}" if guides["jitter"] else ""
    head = f"guides {guides['width']}x{guides['height']} in {guides['source']}{jitter}"
    return [head, "", *map(_plane_line, guides["planes"]), ""]


def _plane_line(plane: dict[str, Any], source: str = "") -> str:
    """One line; it says where the plane's names are from if that is neither `source` nor the user's own profile."""
    values = "no value" if plane["min"] is None else f"{plane['min']:.4g} .. {plane['max']:.4g}"
    signed = plane["role"] in ("motion", "normal")
    counts = (("misses", "misses"), ("non_finite", "not finite"), *(() if signed else (("negative", "negative"),)))
    odd = [f"{plane[key]} {words}" for key, words in counts if plane[key]]
    odd += [f"noise {plane['noise']:.2g}"] if (plane["noise"] or 0) >= 1e-3 else []
    odd += [f"name {SOURCES[plane['source']]}"] if plane["source"] not in ("", source) else []
    text = f"{plane['role']:<22}{plane['channels']:<38}{values}"
    return f"{text} ({', '.join(odd)})" if odd else text


def _absent_lines(numbers: list[int]) -> list[str]:
    return [f"warning  frames without a file: {', '.join(map(str, numbers[:10]))}"] if numbers else []
