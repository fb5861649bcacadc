"""Every hazard that the encoder promises to find is found, and named; correct graphs pass."""

import random
from types import SimpleNamespace

import numpy as np
import pytest

from postfx.runtime import HazardError
from postfx.runtime.encoders import Dispatch
from postfx.runtime.hazards import UsedMemory

BOTH = ("compute", "machine-learning")


def record(bench, *steps, barrier=None):
    """Commands of one encoder a step; `barrier` (after, before) opens every encoder but the
    first."""
    commands = bench.device.command_buffer("frame 7")
    for index, (label, (state, table)) in enumerate(steps):
        begin = (commands.compute_encoder if state.stage == "compute"
                 else commands.machine_learning_encoder)
        with begin(label) as encoder:
            if barrier and index:
                encoder.barrier(after=barrier[0], before=barrier[1])
            (encoder.dispatch if state.stage == "compute"
             else encoder.dispatch_network)(state, table)
    return commands


def graph(bench, kind):
    """Two steps on 'shared' that need an order, a network first."""
    one = bench.tensor("one", True)
    shared = bench.tensor("shared", True)
    other = bench.tensor("other")
    return {
        "read after write": (bench.double(one, shared), bench.add(shared, one, other)),
        "write after write": (bench.double(one, shared), bench.add(one, one, shared)),
        "write after read": (bench.double(shared, other), bench.add(one, one, shared)),
    }[kind]


KINDS = ("read after write", "write after write", "write after read")


@pytest.mark.parametrize("kind", KINDS)
def test_missing_barrier_names_both_commands_the_tensor_and_the_mend(bench, kind):
    first, second = graph(bench, kind)
    commands = record(bench, ("denoise", first), ("apply", second))
    with pytest.raises(HazardError) as caught:
        commands.commit()
    error = caught.value
    assert (error.kind, error.tensor, error.first, error.second) == (kind, "shared", "denoise",
                                                                     "apply")
    does, did = ("writes" if word == "write" else "reads" for word in kind.split(" after "))
    assert (str(error) == (
        f"{kind}: 'apply' (kernel 'add') {does} 'shared', which 'denoise' (network 'double') "
        f"{did}, in no certain order: record barrier(after='machine-learning', before='compute') "
        "in 'apply' before it, or barrier(after='machine-learning', before_queue='compute') in "
        "'denoise' after it"
    ))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("barrier", [("machine-learning", "compute"), (BOTH, BOTH)])
def test_covering_barrier_passes(bench, kind, barrier):
    first, second = graph(bench, kind)
    commands = record(bench, ("denoise", first), ("apply", second), barrier=barrier)
    commands.commit()
    commands.wait(10)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("barrier", [("compute", "compute"),
                                     ("machine-learning", "machine-learning"),
                                     ("compute", "machine-learning"), ("compute", BOTH),
                                     (BOTH, "machine-learning")])
def test_barrier_that_misses_a_stage_is_none(bench, kind, barrier):
    first, second = graph(bench, kind)
    with pytest.raises(HazardError, match=kind):
        record(bench, ("denoise", first), ("apply", second), barrier=barrier).commit()


@pytest.mark.parametrize("kind", KINDS)
def test_within_one_encoder_only_a_plain_barrier_orders(bench, kind):
    one = bench.tensor("one", True)
    shared = bench.tensor("shared", True)
    other = bench.tensor("other")
    first, second = {
        "read after write": (bench.add(one, one, shared), bench.add(shared, one, other)),
        "write after write": (bench.add(one, one, shared), bench.add(one, one, shared)),
        "write after read": (bench.add(shared, one, other), bench.add(one, one, shared)),
    }[kind]

    def commands_with(barrier):
        commands = bench.device.command_buffer("frame")
        with commands.compute_encoder("prepare") as encoder:
            encoder.dispatch(*first)
            barrier(encoder)
            encoder.dispatch(*second)
        return commands

    with pytest.raises(HazardError, match=r"record barrier\(\) between them in 'prepare'"):
        commands_with(lambda encoder: None).commit()
    with pytest.raises(HazardError, match=kind):
        commands_with(lambda encoder: encoder.barrier(after="compute", before="compute")).commit()
    commands = commands_with(lambda encoder: encoder.barrier())
    commands.commit()
    commands.wait(10)


def test_order_is_transitive_through_a_dispatch_but_not_through_nothing(bench):
    x, y, z, unrelated = (bench.tensor(name, True) for name in ("x", "y", "z", "unrelated"))

    def chain(middle):
        commands = bench.device.command_buffer("frame")
        with commands.compute_encoder("first") as encoder:
            encoder.dispatch(*bench.add(x, x, y))
        with commands.machine_learning_encoder("second") as encoder:
            encoder.barrier(after="compute", before="machine-learning")
            if middle:
                encoder.dispatch_network(*bench.double(unrelated, z))
        with commands.compute_encoder("third") as encoder:
            encoder.barrier(after="machine-learning", before="compute")
            encoder.dispatch(*bench.add(y, y, x))
        return commands

    with pytest.raises(HazardError, match="read after write"):
        chain(middle=False).commit()
    chain(middle=True).commit()


def test_reads_need_no_order(bench):
    x, y, z = bench.tensor("x", True), bench.tensor("y"), bench.tensor("z")
    commands = record(bench, ("one", bench.double(x, y)), ("two", bench.add(x, x, z)))
    commands.commit()
    commands.wait(10)
    assert np.array_equal(y.array, z.array)


def test_read_before_write_names_the_later_writer(bench):
    x, empty, y = bench.tensor("x", True), bench.tensor("empty"), bench.tensor("y")
    commands = record(bench, ("use", bench.double(empty, y)), ("make", bench.add(x, x, empty)),
                      barrier=(BOTH, BOTH))
    with pytest.raises(HazardError) as caught:
        commands.commit()
    assert (caught.value.kind, caught.value.first, caught.value.second) == ("read before write",
                                                                            "make", "use")
    assert str(caught.value) == (
        "read before write: 'use' (network 'double') reads 'empty', which nothing wrote before: "
        "only 'make' (kernel 'add') writes it, later: record it first"
    )


def test_reading_what_nothing_ever_writes(bench):
    with pytest.raises(HazardError,
                       match="'use' .* reads 'empty', .*: upload to it, or write it by a command"):
        record(bench, ("use", bench.double(bench.tensor("empty"), bench.tensor("y")))).commit()


def test_memory_that_is_used_again_is_undefined_again(bench):
    old = bench.tensor("old", True)
    start = old.start
    old.release()
    new = bench.tensor("new")
    assert new.start == start
    with pytest.raises(HazardError, match="reads 'new', which nothing wrote"):
        record(bench, ("use", bench.double(new, bench.tensor("y")))).commit()


def test_partly_written_is_not_written(bench):
    whole = bench.device.heap.tensor("whole", (2, 4, 5))
    upper, lower = whole.view("upper", (1, 4, 5)), whole.view("lower", (1, 4, 5), offset=20)
    upper.fill(1.0)
    out = bench.device.heap.tensor("out", (2, 4, 5))
    with pytest.raises(HazardError, match="read before write"):
        record(bench, ("use", bench.add(whole, whole, out))).commit()
    lower.fill(1.0)
    commands = record(bench, ("use", bench.add(whole, whole, out)))
    commands.commit()
    commands.wait(10)
    assert np.all(out.array == 2)


def test_the_same_tensor_read_and_written_in_one_dispatch(bench):
    x = bench.tensor("x", True)
    with pytest.raises(HazardError) as caught:
        record(bench, ("in place", bench.double(x, x)))
    assert (caught.value.kind, caught.value.second) == ("aliasing", "in place")
    assert (str(caught.value) == (
        "'in place' (network 'double') has 'x' on the same memory, one of them written: bind "
        "separate tensors"
    ))


def test_overlapping_views_in_one_dispatch(bench):
    whole = bench.device.heap.tensor("whole", (40,))
    whole.fill(1.0)
    first, second = whole.view("first", (1, 4, 5)), whole.view("second", (1, 4, 5), offset=19)
    with pytest.raises(HazardError, match="'first' and 'second' on the same memory"):
        record(bench, ("in place", bench.double(first, second)))
    commands = record(bench,
                      ("apart", bench.double(first, whole.view("third", (1, 4, 5), offset=20))))
    commands.commit()
    commands.wait(10)
    assert np.array_equal(whole.array, [1] * 20 + [2] * 20)


def test_overlapping_views_in_two_dispatches(bench):
    whole, x = bench.device.heap.tensor("whole", (40,)), bench.tensor("x", True)
    whole.fill(1.0)
    first, second = whole.view("first", (1, 4, 5)), whole.view("second", (1, 4, 5), offset=19)
    steps = ("one", bench.double(x, first)), ("two", bench.add(second, x, bench.tensor("y")))
    with pytest.raises(HazardError, match="read after write"):
        record(bench, *steps).commit()


def test_two_wraps_of_one_array_are_the_same_memory(bench, ones):
    read, write = bench.device.wrap("read", ones), bench.device.wrap("write", ones)
    with pytest.raises(HazardError, match="'read' and 'write' on the same memory"):
        record(bench, ("in place", bench.double(read, write)))


def test_one_argument_written_twice(bench, device):
    from postfx.kernels import Kernel

    state = device.compute_state(Kernel("split", ("a",), ("b", "c"), lambda y0, y1, a, b, c: None,
                                        ("b", 0)))
    from postfx.runtime import ArgumentTable

    x, y = bench.tensor("x", True), bench.tensor("y")
    with pytest.raises(HazardError, match="aliasing|same memory"):
        record(bench, ("split", (state, ArgumentTable(state, {"a": x, "b": y, "c": y}))))


def test_released_between_recording_and_commit(bench):
    x, y = bench.tensor("x", True), bench.tensor("y")
    commands = record(bench, ("use", bench.double(x, y)))
    x.release()
    with pytest.raises(HazardError,
                       match="'use' .* uses 'x', which was released before commit: record it with "
                       "a new"):
        commands.commit()


def test_hazards_between_buffers_end_with_wait_and_not_before(bench):
    x, y, z = bench.tensor("x", True), bench.tensor("y"), bench.tensor("z")
    first = record(bench, ("one", bench.double(x, y)))
    first.commit()
    with pytest.raises(HazardError, match="'two' .*reads 'y', which 'one'"):
        record(bench, ("two", bench.add(y, x, z))).commit()
    ordered = bench.device.command_buffer("ordered")
    with ordered.compute_encoder("two") as encoder:
        encoder.barrier(after="machine-learning", before="compute")
        encoder.dispatch(*bench.add(y, x, z))
    ordered.commit()
    ordered.wait(10)
    third = record(bench, ("three", bench.add(y, z, bench.tensor("w"))))
    third.commit()
    third.wait(10)


def test_a_failed_commit_leaves_nothing_behind(bench, ones):
    x, y = bench.tensor("x", True), bench.tensor("y")
    commands = record(bench, ("one", bench.double(x, y)),
                      ("two", bench.add(y, x, bench.tensor("z"))))
    with pytest.raises(HazardError):
        commands.commit()
    x.upload(ones)
    with pytest.raises(HazardError, match="read before write|no command wrote"):
        y.download()


def command(start, end):
    """A dispatch that reads the bytes from `start` to `end`."""
    return Dispatch("use", "kernel 'use'", "compute", 0, (place(start, end),), (), None)


def place(start, end):
    return SimpleNamespace(start=start, end=end)


def test_used_memory_is_found_by_its_bytes():
    rng, used, records = random.Random(4), UsedMemory(), []
    for _ in range(300):
        start, first = rng.randrange(400), rng.randrange(400)
        last = first + rng.choice((0, 1, 5))
        records.append(command(start, start + rng.choice((0, 1, 3, 20))))
        spans = [(record.reads[0].start, record.reads[0].end) for record in records]
        assert (used.touches(records, place(first, last))
                == any(max(begin, first) < min(end, last) for begin, end in spans))


def test_an_upload_beside_many_commands_looks_at_new_ones_alone():
    """A frame of 3840x2160 within 700 MB records 5,656 commands, and uploads as often: looking
    through all of them for each took 19 of 46 s, and four times as long for twice as many."""

    class Counted(list):
        looked = 0

        def __getitem__(self, which):
            found = super().__getitem__(which)
            Counted.looked += len(found)
            return found

    records, used = Counted(), UsedMemory()
    for number in range(400):
        records.append(command(10 * number, 10 * number + 5))
        assert not used.touches(records, place(10 * number + 6, 10 * number + 9))
        assert used.touches(records, place(4, 6))
    assert Counted.looked == len(records)
