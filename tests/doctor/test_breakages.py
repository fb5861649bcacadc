"""Every integration mistake is found and named, on the sample and on a sequence of another
renderer."""

import pytest

from postfx.doctor.motion_variants import VARIANTS
from tests.doctor.breakages import BREAKAGES
from tests.doctor.conftest import middle_of
from tests.doctor.table import PAGE, REPOSITORY, with_table

LEAST = 30


def mistakes(breakages, frames, size, diagnose):
    """Breakages that are not named, and errors that are not consequences of them; and how many were
    tried."""
    wrong, tried = [], 0
    middle = [middle_of(frame, *size) for frame in frames]
    for breakage in breakages:
        broken = breakage.apply((frames if breakage.whole else middle)[:breakage.frames])
        if broken is None:
            continue
        tried += 1
        findings = diagnose(broken)
        named = [f for f in findings if (f.code, f.role) == (breakage.code, str(breakage.role))]
        others = {f.code for f in findings if f.level == "error"} - {breakage.code,
                                                                     *breakage.consequences}
        if (not named or others
            or not (named[0].cause and named[0].fix and any(map(str.isdigit, named[0].evidence)))):
            wrong.append((breakage.name, [(f.level.value, f.role, f.code) for f in findings]))
    return wrong, tried


def test_the_sample(room, diagnose, same_once):
    """Every other mistake."""
    wrong, tried = mistakes(BREAKAGES[::2], room, (200, 144), diagnose)
    assert not wrong and tried > 3 * LEAST // 2


@pytest.mark.soak
def test_the_sample_with_every_mistake(room, diagnose, same_once):
    wrong, tried = mistakes(BREAKAGES, room, (200, 144), diagnose)
    assert not wrong and tried > 3 * LEAST


def test_another_renderer(shared_frames, diagnose, same_once):
    """Every twelfth mistake."""
    wrong, tried = mistakes(BREAKAGES[1::12], shared_frames("staircase"), (240, 160), diagnose)
    assert not wrong and tried > LEAST // 6


@pytest.mark.soak
def test_another_renderer_with_every_mistake(shared_frames, diagnose):
    wrong, tried = mistakes(BREAKAGES, shared_frames("staircase"), (240, 160), diagnose)
    assert not wrong and tried > 2 * LEAST


def test_the_page_shows_every_mistake():
    page = PAGE.read_text(encoding="utf-8")
    assert with_table(page) == page, "run python -m tests.doctor.table"
    assert (f" {len(VARIANTS)} "
            "variants" in (REPOSITORY / "docs/howto/doctor.md").read_text(encoding="utf-8"))
