"""The three forms of barriers: what each orders, and what stage masks are refused."""

import pytest

from postfx.runtime import EncodingError, HazardError

BOTH = ("compute", "machine-learning")
PRODUCER = {"after": "compute", "before_queue": "machine-learning"}


class Chain:
    """'first' (compute) writes y in two dispatches, 'second' (a network) reads y, each with
    barriers of choice."""

    def __init__(self, bench):
        self.bench = bench
        self.x, self.y, self.z = bench.tensor("x", True), bench.tensor("y"), bench.tensor("z")

    def first(self, commands, *barriers, at_begin=False):
        with commands.compute_encoder("first") as encoder:
            for barrier in barriers if at_begin else ():
                encoder.barrier(**barrier)
            encoder.dispatch(*self.bench.add(self.x, self.x, self.y))
            for barrier in () if at_begin else barriers:
                encoder.barrier(**barrier)
        return commands

    def second(self, commands, *barriers):
        with commands.machine_learning_encoder("second") as encoder:
            for barrier in barriers:
                encoder.barrier(**barrier)
            encoder.dispatch_network(*self.bench.double(self.y, self.z))
        return commands

    def buffer(self, label="frame"):
        return self.bench.device.command_buffer(label)


@pytest.fixture
def chain(bench):
    return Chain(bench)


@pytest.mark.parametrize("masks", [PRODUCER, {"after": BOTH, "before_queue": BOTH}])
def test_producer_barrier_orders_what_is_recorded_before_it(chain, masks):
    commands = chain.second(chain.first(chain.buffer(), masks))
    commands.commit()
    commands.wait(10)
    assert (chain.z.array == 4).all()


@pytest.mark.parametrize("masks", [
    {"after": "machine-learning", "before_queue": BOTH}, {"after": BOTH, "before_queue": "compute"},
])
def test_producer_barrier_that_misses_a_stage_is_none(chain, masks):
    with pytest.raises(HazardError, match="read after write"):
        chain.second(chain.first(chain.buffer(), masks)).commit()


def test_producer_barrier_does_not_order_what_follows_it(chain):
    with pytest.raises(HazardError, match="read after write"):
        chain.second(chain.first(chain.buffer(), PRODUCER, at_begin=True)).commit()


def test_producer_barrier_does_not_order_its_own_encoder(bench):
    x, y = bench.tensor("x", True), bench.tensor("y")
    commands = bench.device.command_buffer("frame")
    with commands.compute_encoder("first") as encoder:
        encoder.dispatch(*bench.add(x, x, y))
        encoder.barrier(after="compute", before_queue="compute")
        encoder.dispatch(*bench.add(y, x, bench.tensor("z")))
    with pytest.raises(HazardError, match=r"record barrier\(\) between them in 'first'"):
        commands.commit()


def test_producer_barrier_waits_for_earlier_encoders_too(chain):
    commands = chain.first(chain.buffer())
    with commands.machine_learning_encoder("between") as encoder:
        encoder.barrier(**PRODUCER)
    chain.second(commands)
    commands.commit()
    commands.wait(10)


def test_producer_barrier_holds_in_later_command_buffers(chain):
    chain.first(chain.buffer("frame 1"), PRODUCER).commit()
    second = chain.second(chain.buffer("frame 2"))
    second.commit()
    second.wait(10)


def test_missing_barrier_between_buffers_names_both_forms_and_both_buffers(chain):
    chain.first(chain.buffer("frame 1")).commit()
    with pytest.raises(HazardError) as caught:
        chain.second(chain.buffer("frame 2")).commit()
    assert (str(caught.value) == (
        "read after write: 'second' (network 'double') of 'frame 2' reads 'y', which 'first' "
        "(kernel 'add') of 'frame 1' writes, in no certain order: record barrier(after='compute', "
        "before='machine-learning') in 'second' before it, or barrier(after='compute', "
        "before_queue='machine-learning') in 'first' after it"
    ))


@pytest.mark.parametrize(("masks", "message"), [
    ({"after": "", "before": "compute"}, "the after= stage mask names '', which is not a stage"),
    ({"after": (), "before": "compute"},
     "the after= stage mask is empty: name 'compute' and 'machine-learning'"),
    ({"after": "compute", "before": []}, "the before= stage mask is empty"),
    ({"after": "compute", "before_queue": []}, "the before_queue= stage mask is empty"),
    ({"after": "compute", "before": "blit"},
     "the before= stage mask names 'blit', which is not a stage: stages are 'compute' and "
     "'machine-learning'"),
    ({"after": 3, "before": "compute"}, "the after= stage mask names '3', which is not a stage"),
    ({"after": "compute", "before_queue": ("compute", "ml")},
     "the before_queue= stage mask names 'ml'"),
    ({"after": "compute"},
     r"give before= \(this and later encoders\) or before_queue= \(later encoders\) too"),
    ({"before": "compute"}, r"give after= too, with before=; .*barrier\(\) takes no stages"),
    ({"before_queue": "compute"}, "give after= too, with before_queue="),
    ({"after": "compute", "before": "compute", "before_queue": "compute"},
     "record one barrier with before= and another with before_queue="),
])
def test_bad_stage_masks(device, masks, message):
    commands = device.command_buffer("frame")
    with commands.compute_encoder("prepare") as encoder:
        with pytest.raises(EncodingError, match=f"barrier in 'prepare': {message}"):
            encoder.barrier(**masks)
    assert commands.records == []
