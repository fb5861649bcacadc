"""The text of `postfx inspect`, for people: findings first, then what was found in the files."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

STYLES = {"error": "bold red", "warning": "yellow", "info": "cyan"}
VERDICTS = {0: "nothing wrong was found", 1: "there are warnings", 2: "there are errors"}
INDENT = " " * 9


def print_text(facts: dict[str, Any], exit_code: int) -> None:
    """Print facts as lines; findings are coloured on a terminal."""
    console = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)
    for line in _lines(facts, exit_code):
        console.print(line)


def _lines(facts: dict[str, Any], exit_code: int) -> list[str | Text]:
    profile, examined = facts["profile"], len(facts["examined"])
    looked = f", {examined} examined" if facts["frames"]["count"] > 1 else ""
    return [
        f"{facts['source']}: {_frames_text(facts['frames'])}{looked}: {VERDICTS[exit_code]}",
        f"profile {profile['name']} ({profile['title'] or 'own'}), {facts['width']}x{facts['height']}",
        "",
        *(line for finding in facts["findings"] for line in _finding_lines(finding)),
        *([""] if facts["findings"] else []),
        *(_plane_line(plane) for plane in facts["planes"]),
        "",
        *_guide_lines(facts["guides"]),
        *(f"missing  {item['role']}{': ' + item['mend'] if item['mend'] else ''}" for item in facts["missing"]),
        *(f"header   {name}: {value}" for name, value in facts["header"].items()),
        *(f"warning  {warning}" for warning in facts["warnings"]),
        *_absent_lines(facts["absent_frames"]),
        *([f"wrote    {len(facts['pictures'])} pictures: {facts['pictures'][0]} ..."] if facts["pictures"] else []),
    ]


def _finding_lines(finding: dict[str, str]) -> list[str | Text]:
    level = finding["level"]
    head = Text.assemble((f"{level:<9}", STYLES[level]), (finding["code"], "bold"),
                         f" ({finding['role']}): {finding['evidence']}")
    return [head, f"{INDENT}likely: {finding['cause']}", f"{INDENT}mend:   {finding['mend']}"]


def _frames_text(frames: dict[str, int]) -> str:
    return f"{frames['count']} frames, {frames['first']} to {frames['last']}" if frames["count"] > 1 else "1 frame"


def _guide_lines(guides: dict[str, Any] | None) -> list[str]:
    if guides is None:
        return []
    jitter = f", jitter {guides['jitter']}" if guides["jitter"] else ""
    head = f"guides {guides['width']}x{guides['height']} in {guides['source']}{jitter}"
    return [head, "", *map(_plane_line, guides["planes"]), ""]


def _plane_line(plane: dict[str, Any]) -> str:
    values = "no value" if plane["min"] is None else f"{plane['min']:.4g} .. {plane['max']:.4g}"
    signed = plane["role"] in ("motion", "normal")
    counts = (("misses", "misses"), ("non_finite", "not finite"), *(() if signed else (("negative", "negative"),)))
    odd = [f"{plane[key]} {words}" for key, words in counts if plane[key]]
    odd += [f"noise {plane['noise']:.2g}"] if (plane["noise"] or 0) >= 1e-3 else []
    text = f"{plane['role']:<22}{plane['channels']:<38}{values}"
    return f"{text} ({', '.join(odd)})" if odd else text


def _absent_lines(numbers: list[int]) -> list[str]:
    return [f"warning  frames without a file: {', '.join(map(str, numbers[:10]))}"] if numbers else []
