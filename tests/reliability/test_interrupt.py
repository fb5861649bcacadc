"""Ctrl-C and SIGTERM end a run cleanly; what is there then is whole."""

import signal
import threading
import time

import pytest

from postfx.cli.interruptions import Stop
from postfx.errors import Interrupted
from tests.reliability.faulty import Faulty

SLOW = {"at": "postfx.flow.Flow._run", "do": "sleep", "seconds": 0.3}
STUCK = {"at": "postfx.flow.Flow._run", "do": "sleep", "seconds": 100, "calls": [3]}


def stopped(process: Faulty, number: int) -> str:
    process.send_signal(number)
    code, said = process.finished(60)
    assert code == 128 + number, said
    return said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stopped_and_resumed(runs, unbroken, number):
    process = runs.start([SLOW])
    runs.wait_for(process, "frame", 2)
    said = stopped(process, number)
    assert ("stopping when this frame is finished" in said and "interrupted: finished frames are "
            "kept" in said)
    done = runs.files()
    assert 2 <= len(done) < 8 and all(unbroken[name] == content for name, content in done.items())
    code, found = runs.verify()
    assert code == 1 and found["whole"] == list(done) and len(found["unfinished"]) == 8 - len(done)
    assert list(found["runs"].values()) == ["stopped"]
    (end,) = runs.events("end")
    assert (end["status"], end["exit_code"], end["written"]) == ("stopped", 128 + number, len(done))
    assert runs("--skip-existing")[0] == 0
    assert runs.files() == unbroken and len(runs.events("recall")) == 1


def test_second_signal_stops_at_once(runs, unbroken):
    process = runs.start([STUCK])
    runs.wait_for(process, "frame", 1)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    begin = time.monotonic()
    stopped(process, signal.SIGTERM)
    assert time.monotonic() - begin < 60
    assert all(unbroken[name] == content for name, content in runs.files().items())
    assert runs.verify()[1]["altered"] == [] and not list(runs.folder.glob(".out*"))
    assert runs("--skip-existing")[0] == 0
    assert runs.files() == unbroken


def test_outside_of_the_main_thread_nothing_changes():
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def work():
        with Stop(seen.append) as stop:
            seen.append(signal.getsignal(signal.SIGINT))
            stop.check()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]


def test_handlers_are_put_back():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with Stop(lambda _: None) as stop:
        signal.raise_signal(signal.SIGTERM)
        assert stop.signal == signal.SIGTERM
        with pytest.raises(Interrupted) as caught:
            stop.check()
        assert caught.value.exit_code == 143
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
