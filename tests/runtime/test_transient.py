"""Transient tensors: who shares memory with whom, who must not, and every misuse by name."""

import numpy as np
import pytest

from postfx.runtime import ArgumentTable, BindingError, HazardError, heap
from postfx.runtime.heap import Plan
from tests import toys
from tests.runtime.chain import Chain, shared, spans

TO_NETWORK = {"after": "compute", "before": "machine-learning"}
TO_KERNEL = {"after": "machine-learning", "before": "compute"}


def test_tensors_that_are_used_one_after_the_other_share_memory(any_chain):
    chain, heap = any_chain, any_chain.device.heap
    before = heap.used
    chain.run()
    assert chain.right() and shared(chain.first, chain.second)
    assert heap.used - before == 8192 == heap.arena.plan.bound and heap.arena.plan.total == 16384


def test_tensors_that_are_used_in_no_certain_order_do_not(chain):
    chain.run(barrier=False)
    assert chain.right() and not shared(chain.first, chain.second)


def test_tensors_that_are_used_at_once_do_not(chain):
    commands = chain.device.command_buffer("frame")
    with commands.machine_learning_encoder("both") as encoder:
        chain.double(encoder, chain.x, chain.first)
        chain.double(encoder, chain.x, chain.second)
        encoder.barrier()
        chain.double(encoder, chain.first, chain.totals[0])
        chain.double(encoder, chain.second, chain.totals[1])
    commands.commit()
    commands.wait(10)
    assert chain.right() and not shared(chain.first, chain.second)


@pytest.mark.parametrize(("barrier", "shares"), [(None, False), (TO_KERNEL, True)])
def test_a_barrier_between_stages_decides(bench, barrier, shares):
    one, other = (bench.device.heap.transient(name, (1, 4, 5)) for name in ("one", "other"))
    x, y, total = bench.tensor("x", True), bench.tensor("y"), bench.tensor("total")
    commands = bench.device.command_buffer("frame")
    with commands.compute_encoder("a") as encoder:
        encoder.dispatch(*bench.add(x, x, one))
    with commands.machine_learning_encoder("b") as encoder:
        encoder.barrier(**TO_NETWORK)
        encoder.dispatch_network(*bench.double(one, y))
    with commands.compute_encoder("c") as encoder:
        if barrier:
            encoder.barrier(**barrier)
        encoder.dispatch(*bench.add(x, x, other))
        encoder.barrier()
        encoder.dispatch(*bench.add(other, x, total))
    commands.commit()
    commands.wait(10)
    assert np.all(y.array == 4) and np.all(total.array == 3) and shared(one, other) == shares


def test_sharing_without_a_barrier_is_found_and_named(chain, monkeypatch):
    def all_at_the_start(sizes, *rest):
        return Plan((0,) * len(sizes), max(sizes), max(sizes), sum(sizes), (None,) * len(sizes))

    monkeypatch.setattr(heap, "make_plan", all_at_the_start)
    with pytest.raises(HazardError,
                       match=r"'two' \(network 'double'\) writes 'second', which 'one'") as caught:
        chain.record(barrier=False).commit()
    assert caught.value.kind in ("write after write", "write after read")


def test_two_buffers_in_flight_need_a_barrier_between_them(chain):
    chain.record(barrier=False, label="frame 1").commit()
    other = chain.record(barrier=False, label="frame 2")
    with pytest.raises(HazardError,
                       match="'one' .* of 'frame 2' writes 'first', which 'one' .* of 'frame 1'"):
        other.commit()
    last = chain.record(label="frame 3")
    last.commit()
    last.wait(10)
    assert chain.right()


def test_reading_what_this_buffer_did_not_write_is_an_error(chain):
    chain.run()
    commands = chain.device.command_buffer("frame 2")
    with commands.machine_learning_encoder("late") as encoder:
        chain.double(encoder, chain.first, chain.totals[0])
    with pytest.raises(HazardError,
                       match="'late' .* reads transient 'first', which nothing in this command "
                       "buffer"):
        commands.commit()


def test_reading_it_before_it_is_written_is_an_error(chain):
    commands = chain.device.command_buffer("frame")
    with commands.machine_learning_encoder("early") as encoder:
        chain.double(encoder, chain.first, chain.totals[0])
        encoder.barrier()
        chain.double(encoder, chain.x, chain.first)
    with pytest.raises(HazardError,
                       match="reads transient 'first', .*: only 'early' .* writes it, later"):
        commands.commit()


def test_the_host_reads_it_until_its_memory_is_taken(any_chain):
    chain = any_chain
    with pytest.raises(HazardError, match="'first' is read by the host, but no command wrote it"):
        chain.first.download()
    chain.run()
    assert np.all(chain.second.download() == 2) and chain.second.state.kind == "defined"
    with pytest.raises(HazardError,
                       match=r"transient 'first' .* but 'second' took .* 'frame 1': "
                       r".*commands\.keep"):
        chain.first.download()
    chain.record(label="frame 2").commit()
    for tensor in (chain.first, chain.second):
        with pytest.raises(HazardError):
            tensor.download()
    chain.device.wait_idle(10)


def test_the_host_cannot_read_it_after_the_next_frame_began(chain, library):
    chain.run()
    Chain(chain.device, library).run(label="frame 2")
    assert chain.second.state.kind == "undefined"
    with pytest.raises(HazardError,
                       match="transient 'second' is read by the host, but 'frame 2' was committed "
                       "since"):
        chain.second.array.sum()


def test_what_is_kept_keeps_its_memory_to_the_end(any_chain):
    chain = any_chain
    commands = chain.record()
    commands.keep(chain.first, chain.totals[0])
    commands.commit()
    commands.wait(10)
    assert not shared(chain.first, chain.second)
    assert np.all(chain.first.download() == 2) and np.all(chain.second.download() == 2)


def test_the_host_does_not_write_it(chain):
    for write in (lambda: chain.first.fill(0.0),
                  lambda: chain.first.view("part", (3,)).upload([1, 2, 3])):
        with pytest.raises(BindingError,
                           match="is transient, so only commands write it: .*heap.tensor"):
            write()


def test_views_lie_in_it(chain):
    flat = chain.first.view("rows", chain.shape)
    commands = chain.device.command_buffer("frame")
    with commands.machine_learning_encoder("view") as encoder:
        chain.double(encoder, chain.x, flat)
        encoder.barrier()
        chain.double(encoder, chain.first, chain.totals[0])
    commands.commit()
    commands.wait(10)
    assert np.all(chain.totals[0].array == 4) and spans(flat) == spans(chain.first)
    assert np.all(chain.first.view("end", (2,), 1998).download() == 2)


def test_released_ones_are_refused(chain):
    commands, recorded = chain.run(), chain.record(label="frame 2")
    chain.first.release()
    for late in (commands, recorded):
        with pytest.raises(HazardError, match="uses 'first', which was released before commit"):
            late.commit()


def test_after_a_failed_command_the_buffer_runs_again(device, library):
    state = device.pipeline_state(library, "pick")
    index = device.heap.tensor("index", (1,), "int64")
    total = device.heap.tensor("total", (1, 1, 1))
    picked = device.heap.transient("picked", (1,))
    x = device.wrap("x", np.ones((1, 1, 1), np.float32))
    kernel = device.compute_state(toys.ADD)
    index.fill(7)
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("pick") as encoder:
        encoder.dispatch_network(state, ArgumentTable(state, {"index": index, "picked": picked}))
    with commands.compute_encoder("add") as encoder:
        encoder.barrier(**TO_KERNEL)
        tensors = {"a": picked.view("a", (1, 1, 1)), "b": x, "total": total}
        encoder.dispatch(kernel, ArgumentTable(kernel, tensors))
    commands.commit()
    with pytest.raises(Exception, match="'pick' .* failed"):
        commands.wait(10)
    with pytest.raises(HazardError, match="'picked' is read by the host, but 'pick'"):
        picked.download()
    index.fill(2)
    commands.commit()
    commands.wait(10)
    assert total.download() == 31
