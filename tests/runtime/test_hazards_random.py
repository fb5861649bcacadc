"""The hazard search against a brute-force one, on random graphs of dispatches and the three forms
of barriers."""

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
from postfx.runtime.hazards import Footprint, find_conflict, predecessors, with_barriers
from postfx.runtime.tensor import Tensor

MEMORY = 12


class Bytes:
    """The part of a tensor that the search looks at."""

    overlaps = Tensor.overlaps
    allocation = "the one"

    def __init__(self, rng):
        self.start = rng.randrange(MEMORY)
        self.end = min(MEMORY, self.start + rng.randint(0, 3))
        self.nbytes = self.end - self.start
        self.span = self.start, self.end


def random_records(rng, encoders):
    """Encoders in turn; their numbers are in no order, as when recorded buffers are committed in
    another order."""
    records, numbers = [], rng.sample(range(100), encoders)
    for encoder in numbers:
        stage = rng.choice(STAGES)
        for _ in range(rng.randint(0, 4)):
            kind = rng.random()
            if kind < 0.55:
                reads, writes = ([Bytes(rng) for _ in range(rng.randint(0, 2))] for _ in range(2))
                records.append(Dispatch("label", "command", stage, encoder, tuple(reads),
                                        tuple(writes), lambda: None))
            elif kind < 0.7:
                records.append(EncoderBarrier(encoder))
            else:
                masks = [frozenset(rng.sample(STAGES, rng.randint(1, 2))) for _ in range(2)]
                records.append(rng.choice((ConsumerBarrier, ProducerBarrier))(encoder, *masks))
    return records


def holds(barrier, place, one, first, two, second, turn):
    """Whether the barrier recorded at `place` puts dispatch `one`, recorded at `first`, before
    `two`, at `second`."""
    earlier = turn[one.encoder] - turn[barrier.encoder]
    later = turn[two.encoder] - turn[barrier.encoder]
    if isinstance(barrier, EncoderBarrier):
        return earlier == later == 0 and first < place < second
    scopes = one.stage in barrier.after and two.stage in barrier.before
    if isinstance(barrier, ConsumerBarrier):
        return scopes and earlier < 0 and later >= 0 and place < second
    return scopes and earlier <= 0 and first < place and later > 0


def ordered_pairs(records):
    """Pairs of dispatch indices that barriers order: the definition, written down plainly, then
    closed."""
    places = [place for place, record in enumerate(records) if isinstance(record, Dispatch)]
    barriers = [(place, record)
                for place, record in enumerate(records) if not isinstance(record, Dispatch)]
    turn = {encoder: index
            for index, encoder in enumerate(dict.fromkeys(record.encoder for record in records))}
    pairs = set()
    for (i, first), (j, second) in itertools.combinations(enumerate(places), 2):
        one, two = records[first], records[second]
        if any(holds(barrier, place, one, first, two, second, turn) for place, barrier in barriers):
            pairs.add((i, j))
    for k, i, j in itertools.product(range(len(places)), repeat=3):
        if (i, k) in pairs and (k, j) in pairs:
            pairs.add((i, j))
    return pairs


def brute_force(records, first_new, across):
    """All (second, first, kinds) of unordered dispatches that share a byte which one of them
    writes."""
    dispatches = [record for record in records if isinstance(record, Dispatch)]
    pairs, found = ordered_pairs(records), []
    touched = [
        ({b for t in d.reads for b in range(t.start, t.end)},
         {b for t in d.writes for b in range(t.start, t.end)})
        for d in dispatches
    ]
    for i, j in itertools.combinations(range(len(dispatches)), 2):
        (reads, writes), (later_reads, later_writes) = touched[i], touched[j]
        shared = {"read after write": writes & later_reads,
                  "write after write": writes & later_writes,
                  "write after read": reads & later_writes}
        kinds = {kind for kind, bytes_ in shared.items() if bytes_}
        if kinds and (i, j) not in pairs and j >= first_new and (i < first_new or not across):
            found.append((j, i, kinds))
    return found


def split(rng, records):
    """The records cut into command buffers, between encoders."""
    ends = [i for i in range(1, len(records)) if records[i].encoder != records[i - 1].encoder]
    cuts = [0, *sorted(rng.sample(ends, rng.randint(0, len(ends)))), len(records)]
    return [Footprint(records[i:j]) for i, j in itertools.pairwise(cuts)]


@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_finds_what_brute_force_finds(seed, ordered):
    rng = random.Random(seed)
    clean = 0
    for _ in range(100):
        records = random_records(rng, encoders=rng.randint(1, 6))
        *earlier, new = split(rng, records)
        new.ordered = ordered
        expected = brute_force(records, sum(len(part.dispatches) for part in earlier), ordered)
        conflict = find_conflict(earlier, new)
        assert (conflict is None) == (not expected)
        clean += conflict is None
        if conflict is not None:
            second, first, kinds = min(expected, key=lambda item: item[:2])
            assert (conflict.second, conflict.first) == (second, first) and conflict.kind in kinds
    assert 0 < clean < 100


@pytest.mark.parametrize("seed", range(20))
def test_barriers_are_made_where_brute_force_finds_conflicts(seed):
    """And only there, where some commands leave threads to others."""
    rng, added = random.Random(7000 + seed), 0
    for _ in range(50):
        *earlier, new = split(rng, random_records(rng, encoders=rng.randint(1, 6)))
        new.narrow = True
        in_flight = [record for part in earlier for record in part.records]
        first_new = sum(len(part.dispatches) for part in earlier)
        alone = with_barriers(new)
        assert not brute_force(alone, 0, False)
        assert (alone == new.records) == (not brute_force(new.records, 0, False))
        new.records = alone
        both = with_barriers(new, earlier) if earlier else alone
        assert not brute_force([*in_flight, *both], first_new, False)
        assert [record for record in both if isinstance(record, Dispatch)] == new.dispatches
        added += len(both) - len(alone)
    assert added


def test_encoders_that_take_the_whole_device_come_one_after_the_other():
    rng = random.Random(1)
    records = [Dispatch("label", "command", STAGES[i // 2 % 2], i // 2, (), (Bytes(rng),),
                        lambda: None)
               for i in range(6)]
    records[0].writes = records[1].writes = records[3].writes = ()
    before = predecessors(with_barriers(Footprint(records)))
    assert [mask & 0b11 for mask in before[2:]] == [0b11] * 4


@pytest.mark.parametrize("seed", range(5))
def test_needs_are_the_bytes_read_before_they_are_written(seed):
    rng = random.Random(3000 + seed)
    for _ in range(100):
        records = random_records(rng, encoders=5)
        written, needed = set(), set()
        for dispatch in (record for record in records if isinstance(record, Dispatch)):
            needed |= {b for t in dispatch.reads for b in range(*t.span)} - written
            written |= {b for t in dispatch.writes for b in range(*t.span)}
        footprint = Footprint(records)
        found = [ranges for _, _, ranges in footprint.needs.values()]
        assert {b for ranges in found for span in ranges.spans for b in range(*span)} == needed
        assert {b for r in footprint.writes.values() for span in r.spans
                for b in range(*span)} == written


@pytest.mark.parametrize("seed", range(5))
def test_orders_are_those_of_the_definition(seed):
    rng = random.Random(1000 + seed)
    for _ in range(100):
        records = random_records(rng, encoders=5)
        found = {
            (i, j) for j, mask in enumerate(predecessors(records))
            for i in range(j) if mask >> i & 1
        }
        assert found == ordered_pairs(records)


@pytest.mark.parametrize("seed", range(5))
def test_commands_before_do_not_order_later_ones_among_themselves(seed):
    """What lets the search among one buffer's own commands be done once."""
    rng = random.Random(2000 + seed)
    for _ in range(100):
        records = random_records(rng, encoders=5)
        ends = [i for i in range(1, len(records)) if records[i].encoder != records[i - 1].encoder]
        cut = rng.choice(ends) if ends else 0
        skipped = sum(isinstance(record, Dispatch) for record in records[:cut])
        alone = predecessors(records[cut:])
        assert [mask >> skipped for mask in predecessors(records)[skipped:]] == alone
