"""The doctor: finds what is wrong with the planes of a sequence, and says why and how to fix it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from postfx.doctor.checks import COMPARING_CHECKS, GUIDE_CHECKS, SEQUENCE_CHECKS, VALUE_CHECKS, WHOLE_PLANE_CHECKS
from postfx.doctor.findings import Finding, Level, most_important_first
from postfx.doctor.material import Material
from postfx.frame import Frame


def examine(material: Material) -> list[Finding]:
    """Findings of all checks, the most important first; evidence about guides begins with 'guides:'."""
    found = [finding for check in (*SEQUENCE_CHECKS, *VALUE_CHECKS) for finding in check(material)]
    whole = [finding for check in WHOLE_PLANE_CHECKS for finding in check(material)]
    compared = material.without({finding.role for finding in whole})
    found += whole + [finding for check in COMPARING_CHECKS for finding in check(compared)]
    return most_important_first([*found, *_findings_of_guides(material.middle)])


def _findings_of_guides(frame: Frame) -> Iterator[Finding]:
    if not frame.guides:
        return
    guides = Frame(dict(frame.guides), frame.number, frame.guide_jitter, world_to_camera=frame.world_to_camera,
                   fov_x=frame.fov_x, source=frame.guide_source)
    for check in GUIDE_CHECKS:
        for finding in check(Material([guides])):
            if finding.level is not Level.INFO:
                yield replace(finding, evidence=f"guides: {finding.evidence}")
