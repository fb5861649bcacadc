"""The hazard search against a brute-force one, on random graphs of dispatches and barriers."""

from __future__ import annotations

import itertools
import random
from types import SimpleNamespace

import pytest

from postfx.runtime.ordering import find_conflict, predecessors
from postfx.runtime.records import STAGES, Dispatch, EncoderBarrier, QueueBarrier

MEMORY = 12


def tensor(rng):
    start = rng.randrange(MEMORY)
    end = min(MEMORY, start + rng.randint(1, 3))
    return SimpleNamespace(name=f"{start}-{end}", start=start, end=end, nbytes=end - start)


def random_records(rng, encoders):
    records, stages = [], [rng.choice(STAGES) for _ in range(encoders)]
    for encoder, stage in enumerate(stages):
        for _ in range(rng.randint(0, 4)):
            kind = rng.random()
            if kind < 0.55:
                reads, writes = ([tensor(rng) for _ in range(rng.randint(0, 2))] for _ in range(2))
                records.append(Dispatch("label", "command", stage, encoder, tuple(reads), tuple(writes), lambda: None))
            elif kind < 0.75:
                records.append(EncoderBarrier(encoder))
            else:
                masks = [frozenset(rng.sample(STAGES, rng.randint(1, 2))) for _ in range(2)]
                records.append(QueueBarrier(encoder, *masks))
    return records


def ordered_pairs(records):
    """Pairs of dispatch indices that barriers order: the definition, written down plainly, then closed."""
    places = [place for place, record in enumerate(records) if isinstance(record, Dispatch)]
    pairs = set()
    for (i, first), (j, second) in itertools.combinations(enumerate(places), 2):
        one, two = records[first], records[second]
        for place, barrier in enumerate(records):
            if isinstance(barrier, EncoderBarrier):
                holds = first < place < second and one.encoder == two.encoder == barrier.encoder
            elif isinstance(barrier, QueueBarrier):
                scopes = one.stage in barrier.after and two.stage in barrier.before
                holds = scopes and one.encoder < barrier.encoder and place < second
            else:
                holds = False
            if holds:
                pairs.add((i, j))
    for k, i, j in itertools.product(range(len(places)), repeat=3):
        if (i, k) in pairs and (k, j) in pairs:
            pairs.add((i, j))
    return pairs


def brute_force(records, first_new):
    """All (first, second) pairs of unordered dispatches that share a byte which one of them writes."""
    dispatches = [record for record in records if isinstance(record, Dispatch)]
    pairs, found = ordered_pairs(records), []
    touched = [
        ({b for t in d.reads for b in range(t.start, t.end)}, {b for t in d.writes for b in range(t.start, t.end)})
        for d in dispatches
    ]
    for i, j in itertools.combinations(range(len(dispatches)), 2):
        (reads, writes), (later_reads, later_writes) = touched[i], touched[j]
        clash = writes & later_reads or writes & later_writes or reads & later_writes
        if clash and (i, j) not in pairs and j >= first_new:
            found.append((j, i))
    return found


@pytest.mark.parametrize("seed", range(20))
def test_finds_what_brute_force_finds(seed):
    rng = random.Random(seed)
    clean = 0
    for _ in range(100):
        records = random_records(rng, encoders=rng.randint(1, 6))
        count = sum(isinstance(record, Dispatch) for record in records)
        first_new = rng.randint(0, count)
        expected = brute_force(records, first_new)
        conflict = find_conflict(records, first_new)
        assert (conflict is None) == (not expected)
        clean += conflict is None
        if conflict is not None:
            assert (conflict.second, conflict.first) == min(expected)
    assert 0 < clean < 100


@pytest.mark.parametrize("seed", range(5))
def test_orders_are_those_of_the_definition(seed):
    rng = random.Random(1000 + seed)
    for _ in range(100):
        records = random_records(rng, encoders=5)
        found = {
            (i, j) for j, mask in enumerate(predecessors(records)) for i in range(j) if mask >> i & 1
        }
        assert found == ordered_pairs(records)
