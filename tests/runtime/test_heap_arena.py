"""The arena: plans that are found again, addresses that stay, and memory that comes and goes."""

import gc

from tests.runtime.chain import Chain, spans


def test_a_plan_is_made_once_for_commands_of_one_shape(chain, library):
    heap = chain.device.heap
    chain.run()
    made = heap.allocations
    for _ in range(3):
        chain.run()
    assert (heap.arena.plans, heap.allocations) == (1, made)
    Chain(chain.device, library, rows=8).run()
    assert heap.arena.plans == 2
    Chain(chain.device, library).run()
    chain.run(barrier=False)
    assert heap.arena.plans == 3  # back to the first size; then another order


def test_other_work_recorded_between_makes_no_other_plan(chain):
    chain.run()
    commands = chain.device.command_buffer("frame 2")
    for name, between, total in (("one", chain.first, chain.totals[0]),
                                 ("two", chain.second, chain.totals[1])):
        chain.device.next_encoder()  # as when another thread records
        with commands.machine_learning_encoder(name) as encoder:
            encoder.barrier(after="machine-learning", before="machine-learning")
            chain.double(encoder, chain.x, between)
            encoder.barrier()
            chain.double(encoder, between, total)
    commands.commit()
    commands.wait(10)
    assert chain.device.heap.arena.plans == 1


def test_tensors_stay_where_they_are_when_another_plan_allows_it(chain):
    chain.run(barrier=False)  # apart
    places = spans(chain.first, chain.second)
    chain.run(barrier=True)   # might share
    assert spans(chain.first, chain.second) == places
    assert chain.device.heap.arena.plans == 2


def test_commands_run_again_also_after_their_memory_was_replaced(any_chain, library):
    chain = any_chain
    commands = chain.run()
    commands.commit()
    commands.wait(10)
    large = Chain(chain.device, library, rows=400)
    large.run(label="large")
    for total in chain.totals:
        total.fill(0.0)
    commands.commit()
    commands.wait(10)
    assert chain.right() and large.right()
    assert spans(chain.first)[0][0] >= spans(large.first)[0][0]  # in the new memory


def test_memory_is_given_back_with_the_last_tensor(device, library):
    before = device.heap.used
    chain = Chain(device, library)
    chain.run()
    assert ("arena", 8192) in device.heap.tensors()
    del chain
    gc.collect()
    assert device.heap.used == before


def test_memory_shrinks_when_who_needed_more_is_gone(device, library, chain):
    large = Chain(device, library, rows=400)
    for one in (chain, large, chain):
        one.run()
    assert device.heap.tensors()[0] == ("arena", 800_000)
    del large
    chain.run()
    gc.collect()
    assert ("arena", 8192) in device.heap.tensors() and chain.right()
    made = device.heap.allocations
    chain.run()
    assert device.heap.allocations == made


def test_memory_that_was_replaced_goes_back_to_the_system(device, library, monkeypatch):
    """Also where nothing is allocated after it, as from the second frame of a run on."""
    monkeypatch.setattr("postfx.runtime.heap.CHUNK_BYTES", 1)
    one, large = Chain(device, library), Chain(device, library, rows=400)
    for chain in (one, large, one):
        chain.run()
    assert device.heap.size == device.heap.used and one.right() and large.right()
