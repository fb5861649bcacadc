"""Command buffers that are committed again as they are, or begun again."""

import numpy as np
import pytest

from postfx.runtime import ArgumentTable, CommandError, Device, EncodingError, HazardError, hazards
from postfx.runtime.encoders import Recordings
from tests import toys
from tests.runtime.conftest import Bench

TO_KERNEL = {"after": "machine-learning", "before": "compute"}
WAIT = r"it was committed, call wait\(\) first"


class Frame:
    """total = 2 x + x, by a network and a kernel."""

    def __init__(self, bench, label="frame 1"):
        self.bench = bench
        self.x = bench.tensor("x", True)
        self.doubled = bench.tensor("doubled")
        self.total = bench.tensor("total")
        self.tables = bench.double(self.x, self.doubled), bench.add(self.doubled, self.x,
                                                                    self.total)
        self.commands = bench.device.command_buffer(label)

    def encode(self):
        with self.commands.machine_learning_encoder("double") as encoder:
            encoder.dispatch_network(*self.tables[0])
        with self.commands.compute_encoder("add") as encoder:
            encoder.barrier(**TO_KERNEL)
            encoder.dispatch(*self.tables[1])

    def run(self):
        self.commands.commit()
        self.commands.wait(10)


@pytest.fixture
def frame(bench):
    frame = Frame(bench)
    frame.encode()
    return frame


def test_the_same_commands_run_again_on_new_content(frame, ones):
    frame.run()
    for value in (5, 7):
        frame.x.upload(value * ones)
        frame.run()
        assert np.array_equal(frame.total.array, 3 * value * ones)


def test_timings_are_those_of_the_last_run(frame):
    frame.run()
    first = frame.commands.timings
    frame.run()
    assert [label for label, _ in frame.commands.timings] == ["double", "add"]
    assert frame.commands.timings is not first and len(first) == 2


def test_what_cannot_be_captured_runs_one_by_one(frame, ones, monkeypatch):
    asked, memory = [], frame.bench.device.memory
    monkeypatch.setattr(memory, "replays", True)
    monkeypatch.setattr(memory, "replay", lambda *arguments: asked.append(arguments), raising=False)
    frame.run()
    assert len(asked) == 1
    monkeypatch.setattr(frame.tables[1][0], "capturable", False)
    frame.x.upload(5 * ones)
    frame.run()
    assert len(asked) == 1 and np.array_equal(frame.total.array, 15 * ones)


def test_search_among_its_own_commands_is_done_once(frame, monkeypatch):
    searches = []
    find = hazards.find_conflict
    monkeypatch.setattr(hazards, "find_conflict",
                        lambda *args: searches.append(args) or find(*args))
    for _ in range(3):
        frame.run()
    assert len(searches) == 1


def test_replay_takes_no_memory(frame):
    frame.run()
    heap = frame.bench.device.heap
    before = heap.used, heap.peak, heap.size
    for _ in range(20):
        frame.run()
    assert (heap.used, heap.peak, heap.size) == before


def test_released_since_the_last_commit(frame):
    frame.run()
    frame.x.release()
    with pytest.raises(HazardError, match="'double' .* uses 'x', which was released before commit"):
        frame.commands.commit()


def test_content_lost_since_the_last_commit(bench, library, device):
    pick = device.pipeline_state(library, "pick")
    index, picked, copy = (device.heap.tensor("index", (1,), "int64"),
                           *(device.heap.tensor(n, (1, 1, 1)) for n in "pc"))
    flat = picked.view("picked", (1,))
    index.upload([1])
    look_up, use = device.command_buffer("look up"), device.command_buffer("use")
    with look_up.machine_learning_encoder("pick") as encoder:
        encoder.dispatch_network(pick, ArgumentTable(pick, {"index": index, "picked": flat}))
    with use.compute_encoder("add") as encoder:
        encoder.dispatch(*bench.add(picked, picked, copy))

    for commands in (look_up, use):
        commands.commit()
        commands.wait(10)
    assert copy.array[0, 0, 0] == 40
    index.upload([7])
    look_up.commit()
    with pytest.raises(CommandError,
                       match=r"^'pick' \(network 'pick'\) of 'look up' failed: .*out of data "
                       r"bounds"):
        look_up.wait(10)
    with pytest.raises(HazardError) as caught:
        use.commit()
    assert (caught.value.first, caught.value.second) == ("pick", "add")
    assert ("'add' (kernel 'add') reads 'p', but 'pick' (network 'pick') of 'look up' "
            "failed: " in str(caught.value))
    assert str(caught.value).endswith(": commit that again, or upload to 'p'")
    index.upload([2])
    look_up.commit()
    look_up.wait(10)
    assert picked.array[0, 0, 0] == 30


def test_conflict_with_what_was_committed_since(frame):
    frame.run()
    other = Frame(frame.bench, "other")
    other.tables = frame.bench.double(other.x, frame.x), other.tables[1]
    with other.commands.machine_learning_encoder("make") as encoder:
        encoder.dispatch_network(*other.tables[0])
    other.commands.commit()
    with pytest.raises(HazardError,
                       match=r"'double' .* of 'frame 1' reads 'x', which 'make' .* of 'other' "
                       r"writes"):
        frame.commands.commit()
    other.commands.wait(10)


def test_replay_beside_others_in_flight_that_share_nothing(frame, ones):
    other = Frame(frame.bench, "other")
    other.encode()
    for _ in range(3):
        frame.commands.commit()
        other.commands.commit()
        frame.commands.wait(10)
        other.commands.wait(10)
    assert np.array_equal(other.total.array, 3 * ones)


def test_commit_in_flight_is_refused(frame):
    frame.commands.commit()
    assert frame.commands.is_done(10)
    with pytest.raises(EncodingError, match=f"'frame 1' cannot be committed: {WAIT}"):
        frame.commands.commit()
    frame.commands.wait(10)
    frame.commands.commit()
    frame.commands.wait(10)


def test_a_failed_run_can_be_repeated(device, failing):
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("look up") as encoder:
        encoder.dispatch_network(*failing.dispatch)
    commands.commit()
    for _ in range(2):
        with pytest.raises(CommandError, match="'look up'"):
            commands.wait(10)
    failing.index.upload([2])
    commands.commit()
    commands.wait(10)
    assert failing.picked.array[0] == 30


def test_begin_drops_records_timings_and_tensors(frame, ones):
    frame.run()
    frame.commands.begin("frame 2")
    assert (frame.commands.label, frame.commands.records, frame.commands.timings) == ("frame 2", [],
                                                                                      [])
    before = frame.bench.device.heap.used
    frame.tables = frame.doubled = None
    assert frame.bench.device.heap.used < before
    with frame.commands.compute_encoder("add") as encoder:
        encoder.dispatch(*frame.bench.add(frame.x, frame.x, frame.total))
    frame.run()
    assert np.array_equal(frame.total.array, 2 * ones)
    assert [label for label, _ in frame.commands.timings] == ["add"]


def test_begin_keeps_the_label_unless_told_otherwise(frame):
    frame.commands.begin()
    assert frame.commands.label == "frame 1"


def test_what_is_begun_again_is_checked_again(frame):
    frame.run()
    frame.commands.begin("frame 2")
    with frame.commands.machine_learning_encoder("double") as encoder:
        encoder.dispatch_network(*frame.tables[0])
    with frame.commands.compute_encoder("add") as encoder:
        encoder.dispatch(*frame.tables[1])
    with pytest.raises(HazardError, match="read after write: 'add'"):
        frame.commands.commit()


def test_uploads_are_refused_between_recording_and_commit_only(frame, ones):
    with pytest.raises(HazardError, match="would see the new values"):
        frame.x.upload(ones)
    frame.run()
    frame.x.upload(ones)
    frame.commands.begin()
    frame.x.upload(ones)
    frame.encode()
    with pytest.raises(HazardError, match="would see the new values"):
        frame.x.upload(ones)


def test_begin_in_flight_or_with_an_open_encoder_is_refused(frame):
    frame.commands.commit()
    with pytest.raises(EncodingError, match=f"'frame 1' cannot begin again: {WAIT}"):
        frame.commands.begin()
    frame.commands.wait(10)
    frame.commands.begin()
    frame.commands.compute_encoder("late")
    with pytest.raises(EncodingError,
                       match="'frame 1' cannot begin again: encoder 'late' is still open: end it"):
        frame.commands.begin()


def test_discarded_buffers_can_begin_again(frame, ones):
    late = frame.commands.compute_encoder("late")
    frame.commands.discard()
    frame.commands.begin("frame 2")
    with pytest.raises(EncodingError, match="encoder 'late' has ended"):
        late.dispatch(*frame.tables[1])
    frame.encode()
    frame.run()
    assert np.array_equal(frame.total.array, 3 * ones)


def test_a_later_wait_does_not_stand_in_for_ones_own(frame):
    later = frame.bench.device.command_buffer("later")
    frame.commands.commit()
    later.commit()
    later.wait(10)
    with pytest.raises(EncodingError, match=WAIT):
        frame.commands.begin()
    frame.commands.wait(0)
    frame.commands.begin()


def record(frame, known, barrier=True):
    """The frame's commands in a new buffer, which looks them up."""
    commands = frame.bench.device.command_buffer("again", known=known)
    with commands.machine_learning_encoder("double") as encoder:
        if barrier:
            encoder.barrier(after=("compute", "machine-learning"), before="machine-learning")
        encoder.dispatch_network(*frame.tables[0])
    with commands.compute_encoder("add") as encoder:
        encoder.barrier(**TO_KERNEL)
        encoder.dispatch(*frame.tables[1])
    return commands


def run(commands):
    commands.commit()
    commands.wait(10)


def test_commands_that_were_recorded_before_are_searched_once(bench, ones, monkeypatch):
    frame, known, made, real = Frame(bench), Recordings(), [], hazards.Footprint
    monkeypatch.setattr("postfx.runtime.commands.Footprint",
                        lambda records: made.append(1) or real(records))
    for value in (1, 5, 7):
        frame.x.upload(value * ones)
        run(record(frame, known))
        assert np.array_equal(frame.total.array, 3 * value * ones)
    assert len(made) == 1
    run(record(frame, known, barrier=False))
    assert len(made) == 2
    table = frame.tables[1][1]
    table[list(table)[-1]] = bench.tensor("other total")
    run(record(frame, known))
    assert len(made) == 3


def test_commands_behind_a_passage_are_known_again_with_it(library, ones, monkeypatch):
    """As those of a pass behind the denoiser, whose commands are such a passage."""
    bench = Bench(Device("cpu", threads=2), library)
    frame, known, made, real = Frame(bench), Recordings(), [], hazards.Footprint
    monkeypatch.setattr("postfx.runtime.commands.Footprint",
                        lambda records: made.append(1) or real(records))

    def again(*labels):
        commands = bench.device.command_buffer("again", known=known)
        commands.repeat(("doubled",), lambda: commands.run(bench.network, "double", x=frame.x,
                                                           y=frame.doubled))
        for label in labels:
            commands.run(toys.ADD, label, a=frame.x, b=frame.doubled, total=frame.total)
        return commands

    run(again("add", "add again"))
    searched = len(made)
    for value in (1, 5, 7):
        frame.x.upload(value * ones)
        run(again("add", "add again"))
        assert np.array_equal(frame.total.array, 3 * value * ones)
    assert len(made) == searched
    run(again("add"))
    assert len(made) > searched


def test_known_commands_are_still_searched_beside_others_in_flight(bench):
    frame, known = Frame(bench), Recordings()
    run(record(frame, known, barrier=False))
    first = record(frame, known, barrier=False)
    first.commit()
    with pytest.raises(HazardError, match="in no certain order"):
        record(frame, known, barrier=False).commit()
    first.wait(10)
    run(record(frame, known, barrier=False))


def test_known_commands_with_a_released_tensor_are_refused(bench):
    frame, known = Frame(bench), Recordings()
    run(record(frame, known))
    again = record(frame, known)
    frame.doubled.release()
    with pytest.raises(HazardError, match="'doubled', which was released before commit"):
        again.commit()
