"""Plans against a brute-force check on random graphs: what may share bytes, and how much memory it
takes."""

from __future__ import annotations

import itertools
import random

import pytest

from postfx.runtime.encoders import (
    STAGES,
    ConsumerBarrier,
    Dispatch,
    EncoderBarrier,
    ProducerBarrier,
)
from postfx.runtime.hazards import predecessors
from postfx.runtime.heap import Present, make_plan

SERIAL = 8


def random_graph(rng: random.Random):
    """Records with barriers, sizes of tensors, and which of them every dispatch uses; each is used
    at least once."""
    records, uses, count = [], [], rng.randint(1, 8)
    for encoder in range(rng.randint(1, 6)):
        stage = rng.choice(STAGES)
        if rng.random() < 0.7:
            records.append(ConsumerBarrier(encoder, frozenset(STAGES), frozenset({stage})))
        for _ in range(rng.randint(1, 4)):
            records.append(Dispatch("label", "command", stage, encoder, (), (), None))
            uses.append(tuple(rng.sample(range(count), min(count, rng.randint(0, 3)))))
            if rng.random() < 0.5:
                records.append(EncoderBarrier(encoder))
        if rng.random() < 0.2:
            records.append(ProducerBarrier(encoder, frozenset({stage}), frozenset(STAGES)))
    for tensor in set(range(count)).difference(*uses):
        place = rng.randrange(len(uses))
        uses[place] = (*uses[place], tensor)
    return records, [rng.randint(1, 20) * 256 for _ in range(count)], uses


def done_before(one, other, uses, before):
    """Whether every dispatch that uses tensor `one` comes before every one that uses `other`."""
    return all(
        before[second] >> first & 1
        for first, used in enumerate(uses) if one in used
        for second, others in enumerate(uses) if other in others
    )


def overlap(one, other, offsets, sizes):
    return (offsets[one] < offsets[other] + sizes[other]
            and offsets[other] < offsets[one] + sizes[one])


def check(plan, records, sizes, uses, kept, memory=0):
    before = predecessors(records)
    for one, other in itertools.combinations(range(len(sizes)), 2):
        if overlap(one, other, plan.offsets, sizes):
            first = done_before(one, other, uses, before) and one not in kept
            assert first or (done_before(other, one, uses, before) and other not in kept)
    for item, taker in enumerate(plan.takers):
        later = [o for o in range(len(sizes)) if o != item and overlap(item, o, plan.offsets, sizes)
                 and done_before(item, o, uses, before)]
        assert (taker in later) if later else taker is None
    assert plan.bound <= plan.nbytes <= max(plan.total, memory) and plan.total == sum(sizes)
    assert plan.nbytes == max(offset + size
                              for offset, size in zip(plan.offsets, sizes, strict=True))
    assert all(offset % 256 == 0 for offset in plan.offsets)


@pytest.mark.parametrize("first", [0, 50, 100])
def test_random_graphs(first):
    for seed in range(first, first + 50):
        check_random_graph(seed)


def check_random_graph(seed):
    rng = random.Random(seed)
    records, sizes, uses = random_graph(rng)
    kept = rng.sample(range(len(sizes)), rng.randint(0, 1))
    plan = make_plan(sizes, uses, kept, records)
    check(plan, records, sizes, uses, kept)
    spans = [[index for index, used in enumerate(uses) if item in used]
             for item in range(len(sizes))]
    alive = [sum(size for item, size in enumerate(sizes)
                 if spans[item][0] <= time and (time <= spans[item][-1] or item in kept))
             for time in range(len(uses))]
    assert (max(alive) <= plan.bound <= most_that_must_be_apart(records, sizes, uses, kept)
            <= plan.nbytes)


def most_that_must_be_apart(records, sizes, uses, kept):
    """Largest sum of tensors of which no two may share a byte, from all sets of tensors."""
    before = predecessors(records)
    free = {frozenset((one, other)) for one, other in itertools.permutations(range(len(sizes)), 2)
            if one not in kept and done_before(one, other, uses, before)}
    sets = (items for count in range(len(sizes) + 1)
            for items in itertools.combinations(range(len(sizes)), count))
    return max(sum(sizes[item] for item in items) for items in sets
               if not any(frozenset(pair) in free for pair in itertools.combinations(items, 2)))


def test_commands_that_may_run_at_once_count_together():
    records = [Dispatch("label", "command", STAGES[0], 0, (), (), None) for _ in range(2)]
    assert make_plan([256, 512], [(0,), (1,)], [], records).bound == 768


def test_tensors_stay_only_where_they_may():
    for seed in range(100):
        rng = random.Random(seed)
        records, sizes, uses = random_graph(rng)
        offsets = [rng.choice([-1, 256 * rng.randint(0, 40)]) for _ in sizes]
        memory = (max(offset + size for offset, size in zip(offsets, sizes, strict=True))
                  + 256 * rng.randint(0, 20))
        plan = make_plan(sizes, uses, [], records, Present(memory, offsets))
        check(plan, records, sizes, uses, [], memory)
        stay = all(old in (-1, new) for old, new in zip(offsets, plan.offsets, strict=True))
        assert stay or plan == make_plan(sizes, uses, [], records), seed


def test_what_is_present_stays():
    records = [Dispatch("label", "command", STAGES[0], index, (), (), None) for index in range(3)]
    plan = make_plan([256] * 3, [(0,), (1,), (2,)], [], records, Present(4096, [1024, -1, 512]))
    assert (plan.offsets[0], plan.offsets[2]) == (1024, 512)
    check(plan, records, [256] * 3, [(0,), (1,), (2,)], [], 4096)


def test_memory_in_which_none_of_them_lies_changes_nothing():
    for seed in range(50):
        records, sizes, uses = random_graph(random.Random(seed))
        empty = Present(1 << 20, [-1] * len(sizes))
        assert make_plan(sizes, uses, [], records, empty) == make_plan(sizes, uses, [], records)


def test_a_chain_takes_what_two_links_take():
    records, uses = [], []
    for index in range(SERIAL):
        records.append(Dispatch("label", "command", STAGES[0], 0, (), (), None))
        records.append(EncoderBarrier(0))
        uses.append(tuple(item for item in (index - 1, index) if 0 <= item < SERIAL - 1))
    plan = make_plan([512] * (SERIAL - 1), uses, [], records)
    assert plan.nbytes == plan.bound == 1024
    assert str(plan) == "0.0 MiB for 0.0 MiB in 7 tensors, 0.0 % over the bound 0.0 MiB"
