"""The doctor: finds what is wrong with the planes of a sequence, and says why and how to fix it.

Here: what its checks find, and the exit code that follows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad a finding is, the worst first."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


EXIT_CODES = {Level.ERROR: 2, Level.WARNING: 1, Level.INFO: 0}


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or that the doctor could not check.

    Attributes:
        level: an error spoils the result, a warning costs quality, information is good to know.
        role: the plane concerned, a `Role`, or 'sequence'.
        code: stable name of the mistake.
        evidence: what was measured, with numbers.
        cause: the most likely mistake.
        fix: what to do.
    """

    level: Level
    role: str
    code: str
    evidence: str
    cause: str
    fix: str

    def as_dict(self) -> dict[str, str]:
        """The finding in plain types."""
        return {key: str(value) for key, value in asdict(self).items()}


def error(role: str, code: str, evidence: str, cause: str, fix: str) -> Finding:
    """A finding that spoils the result."""
    return Finding(Level.ERROR, str(role), code, evidence, cause, fix)


def warning(role: str, code: str, evidence: str, cause: str, fix: str) -> Finding:
    """A finding that costs quality."""
    return Finding(Level.WARNING, str(role), code, evidence, cause, fix)


def info(role: str, code: str, evidence: str, cause: str, fix: str) -> Finding:
    """Something good to know."""
    return Finding(Level.INFO, str(role), code, evidence, cause, fix)


def most_important_first(findings: Iterable[Finding]) -> list[Finding]:
    """Findings sorted by level; findings of one level keep their order."""
    levels = list(Level)
    return sorted(findings, key=lambda finding: levels.index(finding.level))


def exit_code(findings: Iterable[Finding]) -> int:
    """0 when there are neither warnings nor errors, 1 for warnings only, 2 with at least one error."""
    return max((EXIT_CODES[finding.level] for finding in findings), default=0)
