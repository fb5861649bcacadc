"""Threads that help with bands of rows: all is done when `work` returns, whatever happens in one of
them."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from postfx.compiled.calls import BoundRows, bind_rows
from postfx.compiled.library import Rows
from postfx.runtime import threads
from postfx.runtime.threads import NANOSECONDS, SPIN_SECONDS, Band, Helpers

HEADER = """
#include "rows.h"

static void count_rows(Long first, Long last, View<double, 1> counts) {
    for (Long y = first; y < last; y++) counts.at[y] += 1.0;
}
EXPORT(count, count_rows)

static Status fail_rows(Long first, Long last, View<double, 1> counts) {
    if (first <= 6 && last > 6) return NO_MEMORY;
    count_rows(first, last, counts);
    return DONE;
}
EXPORT(fail, fail_rows)
"""


@pytest.fixture(scope="module")
def header(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rows") / "count.h"
    path.write_text(HEADER)
    return path


def count_rows(first: int, last: int, counts: np.ndarray) -> None:
    counts[first:last] += 1


def bands_of(rows, edges: list[int], *arrays: np.ndarray) -> list[Band]:
    return [Band(lambda first, last: rows(first, last, *arrays), *edge)
            for edge in zip(edges, edges[1:], strict=False)]


@pytest.mark.parametrize(("pause", "times"),
                         [(0, 200), (3 * SPIN_SECONDS, 20), (6e-9 * NANOSECONDS, 4)],
                         ids=["at once", "while they doze", "after they went"])
def test_every_row_is_worked_on_once(header: Path, pause: float, times: int) -> None:
    helpers, counts, compiled_counts = Helpers(3), np.zeros(40), np.zeros(40)
    bound = bind_rows(Rows("count", header), [compiled_counts])
    assert isinstance(bound, BoundRows)
    for done in range(1, times):
        helpers.work(bands_of(count_rows, [0, 11, 12, 30, 40], counts))
        assert (counts == done).all()
        time.sleep(pause)
        helpers.run(bound, bound.blocks([0, 11, 12, 30, 40]))
        assert (compiled_counts == done).all()


def test_fewer_bands_than_helpers_and_one_alone() -> None:
    helpers, counts = Helpers(3), np.zeros(8)
    helpers.work(bands_of(count_rows, [0, 8], counts))
    helpers.work(bands_of(count_rows, [0, 3, 8], counts))
    assert (counts == 2).all()


def test_bands_run_beside_each_other() -> None:
    """Two that wait for each other, in Python."""
    meet = threading.Barrier(3, timeout=120)
    Helpers(2).work(bands_of(lambda first, last: meet.wait(), [0, 1, 2, 3]))


def test_what_a_helper_raises_is_raised_and_the_next_work_is_done() -> None:
    helpers, counts = Helpers(1), np.zeros(8)

    def failing(first: int, last: int, _: np.ndarray) -> None:
        if first:
            raise ValueError(f"rows {first} to {last}")

    for _ in range(3):
        with pytest.raises(ValueError, match="rows 4 to 8"):
            helpers.work(bands_of(failing, [0, 4, 8], counts))
        helpers.work(bands_of(count_rows, [0, 4, 8], counts))
    assert (counts == 3).all()


def test_compiled_rows_that_fail_are_an_error_and_the_next_work_is_done(header: Path) -> None:
    helpers, counts = Helpers(1), np.zeros(8)
    failing, counting = (bind_rows(Rows(name, header), [counts]) for name in ("fail", "count"))
    for _ in range(3):
        with pytest.raises(RuntimeError, match="kernel fail failed, probably for want of memory"):
            helpers.run(failing, failing.blocks([0, 4, 8]))
    before = counts.copy()
    helpers.run(counting, counting.blocks([0, 4, 8]))
    assert (counts == before + 1).all()


def test_a_band_that_fails_waits_for_the_others() -> None:
    """Their arrays must not be handed on before."""
    ended = []

    def rows(first: int, last: int) -> None:
        if not first:
            raise ValueError("own")
        time.sleep(0.05)
        ended.append(first)

    with pytest.raises(ValueError, match="own"):
        Helpers(2).work(bands_of(rows, [0, 1, 2, 3]))
    assert sorted(ended) == [1, 2]


def test_a_helper_keeps_no_array_once_it_is_done() -> None:
    helpers, counts = Helpers(1), np.zeros(8)
    helpers.work(bands_of(count_rows, [0, 4, 8], counts))
    assert helpers._bands == [None]


def test_a_helper_that_is_not_called_goes() -> None:
    """So a pipeline that rests takes no processor's time."""
    helpers, counts = Helpers(1), np.zeros(8)
    helpers.work(bands_of(count_rows, [0, 4, 8], counts))
    deadline = time.monotonic() + 60
    while helpers._board[0, 0] != threads.AWAY and time.monotonic() < deadline:
        time.sleep(0.01)
    assert helpers._board[0, 0] == threads.AWAY


def test_pauses_are_counted_by_the_clock() -> None:
    assert threads.pauses_in(1e-9) == 1
    assert 0.2 < threads.pauses_in(1e-3) / (10 * threads.pauses_in(1e-4)) < 5
