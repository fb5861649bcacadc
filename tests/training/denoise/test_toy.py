"""The toy training of docs/howto/train.md, by the page's own commands: held-out quality rises."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch")

from training.measure import toy  # noqa: E402

LEAST_GAIN = 0.3
"""dB, of clips that are not learnt."""


@pytest.mark.soak
def test_held_out_quality_rises(tmp_path: Path) -> None:
    start, end = toy.run(tmp_path)
    assert end > start + LEAST_GAIN


def test_a_page_without_the_commands_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("# Train\n")
    with pytest.raises(ValueError, match=r"page.md has no block of code below '## In a minute'"):
        toy.lines_of(tmp_path / "page.md")
    assert [line.split()[0] for line in toy.lines_of(toy.PAGE)] == ["export", *["python"] * 3]
