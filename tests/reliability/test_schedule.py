"""Which frames run: held against a search over all histories."""

import random
from pathlib import Path

from postfx.runs.schedule import EarlierRuns, Work, schedule


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
    assert plan(range(1, 9), [6, 7], checkpoints=[4]) == [Work(4, False, Path("4")), Work(5, False), Work(6, True),
                                                          Work(7, True)]
    assert plan(range(1, 9), [6], checkpoints=[4], starts=[6]) == [Work(6, True)]
    assert plan(range(1, 9), [3], checkpoints=[4]) == [Work(1, False), Work(2, False), Work(3, True)]


def test_at_most_so_many():
    assert plan(range(1, 9), [6], most=2) == [Work(4, False), Work(5, False), Work(6, True)]
    assert plan(range(1, 9), [6], most=0, checkpoints=[3]) == [Work(6, True)]


def test_history_ends_at_a_hole():
    assert plan(range(1, 9), [6], missing=[3]) == [Work(4, False), Work(5, False), Work(6, True)]


def test_every_written_frame_has_its_whole_history():
    """Follows the works as the passes would: a state is the set of frames that it remembers since its shot began."""
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
            state = remembered(work.number)
            continue
        jumps = bool(state) and state[-1] != work.number - 1
        state = [work.number] if work.number in starts or jumps else [*state, work.number]
        if work.write:
            assert state == remembered(work.number), seed
    assert [work.number for work in works if work.write] == sorted(wanted), seed
    shown = [work.number for work in works]
    assert shown == sorted(set(shown)), seed
