"""The faults that are put into postfx have their places, and the tests that should find them are
there."""

import shlex
from pathlib import Path

from tests.mutants import CHECKOUT, ROOMS, chosen, sources


def test_every_room_has_sources_and_tests() -> None:
    everything = [source for suffix in ("py", "cu", "cuh") for source in sources(suffix)]
    for room in ROOMS:
        assert any(source.startswith(room.sources) for source in everything), room.sources
        words = shlex.split(room.tests)
        paths = words[:words.index("-k")] if "-k" in words else words
        assert paths and all(Path(CHECKOUT, path).exists() for path in paths), room.tests


def test_faults_chosen_by_hand_have_one_place(capsys) -> None:
    assert len(list(chosen())) > 30
    assert capsys.readouterr().err == ""
