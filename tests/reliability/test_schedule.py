"""Which frames run, held against a search over all histories, and which existing files are kept."""

import random
from dataclasses import replace
from pathlib import Path

from postfx.files import hash_file
from postfx.runs.manifest import Output
from postfx.runs.schedule import EarlierRuns, Judgement, Work, judge, schedule
from tests.reliability.conftest import SIZE, write_frame


def plan(numbers, wanted, starts=(), checkpoints=(), most=None, missing=()):
    known = EarlierRuns(set(starts), {number: Path(str(number)) for number in checkpoints})
    return schedule(numbers, set(wanted), known, most, lambda number: number not in missing)


def test_all_frames_of_a_new_run():
    assert plan(range(1, 4), range(1, 4)) == [Work(1, True), Work(2, True), Work(3, True)]


def test_the_shot_so_far_before_a_lost_frame():
    assert plan(range(1, 5), [3]) == [Work(1, False), Work(2, False), Work(3, True)]
    assert plan(range(1, 5), [4], starts=[3]) == [Work(3, False), Work(4, True)]
    assert plan(range(1, 5), [3], starts=[3]) == [Work(3, True)]


def test_a_checkpoint_instead_of_frames():
    assert plan(range(1, 9), [6, 7], checkpoints=[4]) == [Work(4, False, Path("4")), Work(5, False),
                                                          Work(6, True), Work(7, True)]
    assert plan(range(1, 9), [6], checkpoints=[2, 4]) == plan(range(1, 9), [6], checkpoints=[4])
    assert plan(range(1, 9), [6], checkpoints=[4], starts=[6]) == [Work(6, True)]
    assert plan(range(1, 9), [3], checkpoints=[4]) == [Work(1, False), Work(2, False),
                                                       Work(3, True)]


def test_at_most_so_many():
    assert plan(range(1, 9), [6], most=2) == [Work(4, False), Work(5, False), Work(6, True)]
    assert plan(range(1, 9), [6], most=0, checkpoints=[3]) == [Work(6, True)]
    rest = [Work(4, False), Work(5, False), Work(6, True)]
    assert plan(range(1, 9), [6], most=2, checkpoints=[2]) == rest
    assert plan(range(1, 9), [6], most=2, checkpoints=[3]) == [Work(3, False, Path("3")), *rest]
    found = plan(range(1, 9), [2, 6], checkpoints=[3])
    assert found == [Work(1, False), Work(2, True), Work(3, False, Path("3")), *rest]


def test_history_ends_at_a_hole():
    assert plan(range(1, 9), [6], missing=[3]) == [Work(4, False), Work(5, False), Work(6, True)]


def test_every_written_frame_has_its_whole_history():
    """Follows the works as the passes would: a state is the set of frames that it remembers since
    its shot began."""
    for seed in range(300):
        follow(seed)


def follow(seed):
    chance = random.Random(seed)
    numbers = list(range(10, 10 + chance.randint(1, 12)))
    some = lambda share: {number for number in numbers if chance.random() < share}  # noqa: E731
    wanted, starts, checkpoints = some(0.3), some(0.2), some(0.2)

    def remembered(number):
        begin = max([numbers[0], *(start for start in starts if start <= number)])
        return list(range(begin, number + 1))

    works = plan(numbers, wanted, starts, checkpoints)
    state: list[int] = []
    for work in works:
        if work.checkpoint:
            assert work.checkpoint == Path(str(work.number))
            state = remembered(work.number)
            continue
        jumps = bool(state) and state[-1] != work.number - 1
        state = [work.number] if work.number in starts or jumps else [*state, work.number]
        if work.write:
            assert state == remembered(work.number), seed
    assert [work.number for work in works if work.write] == sorted(wanted), seed
    shown = [work.number for work in works]
    assert shown == sorted(set(shown)), seed


def test_which_files_are_kept(tmp_path):
    """`a` is as its run wrote it, `b` was altered since, `c` is cut off."""
    for number, name in enumerate("abc"):
        write_frame(tmp_path / f"{name}.exr", number)
    size, inputs, (a, b, c) = SIZE[::-1], {"in": (5, 6)}, sorted(tmp_path.iterdir())
    c.write_bytes(c.read_bytes()[:-99])
    known = Output("run", 1, hash_file(a), a.stat().st_size, *size, inputs)
    assert judge(a, known, size, {}) == judge(a, known, size,
                                              inputs) == judge(a, None, size, {}) == Judgement(True)
    assert judge(a, known, size, {"new": (1, 2), **inputs}).kept
    refused = {
        "does not exist": judge(tmp_path / "d", known, size, inputs),
        "is not complete": judge(c, None, size, inputs),
        "is older than the run that should have written "
        "it": judge(a, Output("run", 1), size, inputs),
        "is 48x32, not 32x48": judge(a, known, SIZE, inputs),
        "was made of an input that has changed since": judge(a, known, size, {"in": (5, 7)}),
        "is damaged": judge(c, known, size, inputs),
    }
    assert refused == {why: Judgement(False, why) for why in refused}
    altered = judge(b, replace(known, bytes=b.stat().st_size), size, inputs)
    assert altered == (True, "was altered since it was written: kept; delete it to make it again")
