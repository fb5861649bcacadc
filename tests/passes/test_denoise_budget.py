"""Choosing networks by a budget of time."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.errors import PassOptionError
from postfx.frame import Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.ladder import Ladder, cost, family
from postfx.passes.denoise.options import RenderSize
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import noisy, watch_histories

COSTS = (1.0, 3.5, 5.0)


def rungs(ladder: Ladder, times: list[tuple[float, ...]], noise: float = 0.0) -> list[int]:
    """What is chosen for each frame where each rung takes its time, and a first frame on a rung
    three times as long."""
    random, found = np.random.default_rng(0), []
    for now in times:
        is_first = not found or found[-1] != ladder.rung
        found.append(ladder.rung)
        ladder.note_time(now[ladder.rung] * (3 if is_first else 1)
                         * (1 + noise * random.uniform(-1, 1)))
    return found


def switches(found: list[int]) -> int:
    return sum(one != other for one, other in zip(found, found[1:], strict=False))


def test_the_best_that_fits_is_taken_soon_and_kept() -> None:
    times = [(10.0, 35.0, 50.0)] * 100
    for budget, best in ((20, 0), (45, 1), (60, 2), (5, 0)):
        found = rungs(Ladder(COSTS, budget), times, noise=0.05)
        assert found[8:] == [best] * 92, budget


def test_load_takes_a_smaller_network_in_three_frames_and_its_end_the_larger_one() -> None:
    light, heavy = (10.0, 35.0, 50.0), (30.0, 105.0, 150.0)
    found = rungs(Ladder(COSTS, 60), [light] * 20 + [heavy] * 30 + [light] * 40)
    assert found[19] == 2 and found[22] == 0 and set(found[23:50]) == {0} and found[-1] == 2


def test_one_long_frame_changes_nothing() -> None:
    times = [(10.0, 35.0, 50.0)] * 30
    times[20] = (100.0, 350.0, 500.0)
    assert set(rungs(Ladder(COSTS, 60), times)[10:]) == {2}


def test_a_network_slower_than_expected_is_tried_less_and_less() -> None:
    found = rungs(Ladder(COSTS, 60), [(10.0, 90.0, 120.0)] * 1000, noise=0.05)
    tries = [i for i, (one, other) in enumerate(zip(found, found[1:], strict=False)) if other > one]
    gaps = np.diff(tries)
    assert found.count(0) > 950 and len(tries) < 12 and (gaps[1:] >= gaps[:-1] - 5).all()


def test_it_climbs_by_the_mean_of_the_times_and_goes_back_after_two_frames() -> None:
    """A rung of twice the cost needs a mean of at most 42.5 twice in a row; the means are 60, 52.8,
    47.8, 44.2, 41.8 and 40.0. The first frame of a rung does not count."""
    ladder, found = Ladder((1.0, 2.0), 100), []
    for milliseconds in (999, 60, 36, 36, 36, 36, 36, 999, 101, 101):
        ladder.note_time(milliseconds)
        found.append(ladder.rung)
    assert found == [0, 0, 0, 0, 0, 0, 1, 1, 1, 0]


@pytest.mark.parametrize(("budget", "rung", "times", "wanted"), [
    (100, 0, (999, 10, 10), [0, 0, 2]), (40, 2, (999, 80, 80), [2, 2, 1]),
    (10, 2, (999, 80, 80), [2, 2, 0])])
def test_two_frames_decide(budget: float, rung: int, times: tuple[float, ...],
                           wanted: list[int]) -> None:
    """The slowest rung that fits, the budget itself included; the fastest where none does."""
    ladder, found = Ladder((1.0, 2.0, 4.0), budget), []
    ladder.rung = rung
    for milliseconds in times:
        ladder.note_time(milliseconds)
        found.append(ladder.rung)
    assert found == wanted


def test_a_frame_may_take_the_whole_budget() -> None:
    ladder = Ladder((1.0, 2.0), 40)
    ladder.rung = 1
    for _ in range(9):
        ladder.note_time(40.0)
    assert ladder.rung == 1
    for _ in range(2):
        ladder.note_time(40.001)
    assert ladder.rung == 0


def test_times_at_the_edge_of_the_budget_do_not_make_it_swing() -> None:
    found = rungs(Ladder(COSTS, 60), [(11.8, 41.3, 59.0)] * 500, noise=0.1)
    assert switches(found) < 12


def test_costs_are_those_of_the_precision() -> None:
    names = ("denoise_upscale.m", "denoise_upscale.m.guides", "denoise_upscale.m.int8.guides",
             "denoise_upscale.m.1x", "denoise_upscale.m.int8.1x", "denoise_upscale.mine", "classic")
    assert [cost(name) for name in names] == [3.5, 3.5, 2.1, 3.5, 2.1, 1.0, 0.5]


def test_families_are_listed_from_fast_to_slow() -> None:
    assert family("l") == ("classic", "s", "m", "l")
    assert family("m.int8") == ("classic", "s.int8", "m.int8")
    assert family("mine") == ("mine",)
    assert family("classic") == ("classic",)


def test_the_render_size_follows_the_time_of_a_frame() -> None:
    """Where most of a frame's time goes with its pixels, and some does not; first frames of a size
    take twice as long. In the middle a frame is three times as heavy."""
    random, chosen, sizes = np.random.default_rng(0), RenderSize((1920, 1080), 200), []
    taken = []
    for number in range(300):
        before = sizes[-1] if sizes else None
        sizes.append(chosen.choose())
        load = 3 if 100 <= number < 200 else 1
        now = (30 + 170e-6 * load * sizes[-1][0] * sizes[-1][1]) * random.uniform(0.95, 1.05)
        taken.append(now)
        chosen.note_time(now if sizes[-1] == before else 2 * now)
    assert chosen.sizes[0] == (640, 360) and chosen.sizes[-1] == (1920, 1080)
    for first in (0, 100, 200):
        settled = taken[first + 30:first + 100]
        assert max(settled) < 240 and 100 < np.median(settled) <= 200, (first, settled)
        assert switches([width for width, _ in sizes[first + 30:first + 100]]) <= 8
    assert 900 <= sizes[60][0] <= 1180 and 640 <= sizes[160][0] <= 720


@pytest.mark.parametrize("given", [
    {"least": 0.2}, {"most": 1.5}, {"least": 0.9, "most": 0.5}, {"count": 0}, {"milliseconds": 0}])
def test_impossible_render_sizes_are_errors(given: dict[str, float]) -> None:
    with pytest.raises(PassOptionError, match="give "):
        RenderSize(**{"size": (1920, 1080), "milliseconds": 100, **given})


@pytest.mark.parametrize("budget", [0, -3])
def test_a_budget_of_nothing_is_an_error(budget: float) -> None:
    with pytest.raises(PassOptionError, match="give a budget above 0"):
        DenoiseUpscale(budget=budget)


def test_the_history_goes_on_with_the_other_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """All but the hidden state, which it could not read."""
    kept = watch_histories(monkeypatch)
    chain = Pipeline([upscaler := DenoiseUpscale(budget=1000)], Device("cpu", threads=2),
                     exposure=0.0)
    chosen = []
    for number in range(1, 8):
        chain(noisy(number))
        chosen.append(upscaler.choice)
    at = chosen.index("m")
    assert chosen == ["s"] * at + ["m"] * (7 - at)
    _, before, after = kept[at]
    np.testing.assert_array_equal(after[..., :4], before[..., :4])
    assert before[..., 3].max() > 1 and before[..., 4:].any() and not after[..., 4:].any()
    unchanged = [i for i in range(7) if i != at]
    assert all(np.array_equal(*kept[i][1:]) for i in unchanged)


def test_strength_0_runs_no_network_and_chooses_none() -> None:
    chain = Pipeline([upscaler := DenoiseUpscale(budget=10, strength=0)], Device("cpu", threads=2),
                     exposure=0.0)
    assert upscaler.choice is None
    chain(noisy(1))
    assert upscaler.choice is None


def test_without_a_budget_one_network_runs_and_is_told() -> None:
    chain = Pipeline([upscaler := DenoiseUpscale(model="s")], Device("cpu", threads=2),
                     exposure=0.0)
    assert upscaler.choice is None
    assert np.isfinite(chain(noisy(1))[Role.COLOUR]).all()
    assert upscaler.choice == "s"
