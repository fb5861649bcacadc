"""Every integration mistake is found and named, on the sample and on sequences of other renderers."""

from pathlib import Path

import pytest

from postfx.doctor.motion_variants import VARIANTS
from tests.doctor.breakages import BREAKAGES

SHARED = ("living_room", "staircase", "garage")


def check(broken, breakage, diagnose):
    """The mistake is named, and nothing else is called an error that is not a consequence of it."""
    if broken is None:
        pytest.skip(f"the sequence has nothing to break so: {breakage.name}")
    findings = diagnose(broken)
    named = [finding for finding in findings if (finding.code, finding.role) == (breakage.code, str(breakage.role))]
    assert named, [(finding.code, finding.evidence) for finding in findings]
    assert any(character.isdigit() for character in named[0].evidence) and named[0].cause and named[0].mend
    others = {finding.code for finding in findings if finding.level == "error"} - {breakage.code}
    assert others <= set(breakage.consequences)


@pytest.mark.parametrize("breakage", BREAKAGES, ids=lambda breakage: breakage.name)
def test_room(room, breakage, diagnose):
    check(breakage.apply(room), breakage, diagnose)


@pytest.mark.slow
@pytest.mark.parametrize("breakage", BREAKAGES, ids=lambda breakage: breakage.name)
def test_other_renderers(shared_frames, breakage, diagnose):
    """On one sequence each, of those that have what is to be broken, in turn."""
    first = BREAKAGES.index(breakage) % len(SHARED)
    names = SHARED[first:] + SHARED[:first]
    broken = (breakage.apply(shared_frames(name)) for name in names)
    check(next((frames for frames in broken if frames is not None), None), breakage, diagnose)


@pytest.mark.soak
@pytest.mark.parametrize("name", SHARED)
def test_all_sequences_of_other_renderers(shared_frames, name, diagnose):
    for breakage in BREAKAGES:
        if (broken := breakage.apply(shared_frames(name))) is not None:
            check(broken, breakage, diagnose)


def test_at_least_twenty_mistakes():
    assert len({breakage.code for breakage in BREAKAGES}) >= 20


def test_the_page_shows_every_mistake_found():
    page = (Path(__file__).parent.parent.parent / "docs" / "doctor.md").read_text(encoding="utf-8")
    assert f"with {len(VARIANTS)} variants" in page and "missed" not in page.partition("<!-- table -->")[2]
    for breakage in BREAKAGES:
        assert f"| {breakage.name} |" in page and f"`{breakage.code}`" in page
