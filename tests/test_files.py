"""Reading patiently, reading ahead and writing behind."""

from __future__ import annotations

import os
import threading
import time

import pytest

from postfx import files
from postfx.errors import ReadError, WriteError
from postfx.files import PAUSES, WriteBehind, read_ahead, read_patiently


def test_what_cannot_be_read_is_tried_twice_more_after_growing_pauses(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """PAUSES as imported here, before the tests do without them."""
    assert PAUSES == (0.1, 0.4)
    monkeypatch.setattr(files, "PAUSES", PAUSES)
    log: list[object] = []
    monkeypatch.setattr(files.time, "sleep", log.append)

    def read() -> str:
        log.append("read")
        if len(log) < needed:
            raise ReadError("not there")
        return "content"

    needed = 7
    assert read_patiently(read, lambda error: log.append(str(error))) == "content"
    assert log == ["read", "not there", 0.1, "read", "not there", 0.4, "read"]
    needed = 99
    log.clear()
    with pytest.raises(ReadError):
        read_patiently(read)
    assert log == ["read", 0.1, "read", 0.4, "read"]


def test_items_come_in_order_and_at_most_one_is_read_ahead() -> None:
    begun: list[int] = []
    for number, content in read_ahead(range(6), lambda item: begun.append(item) or item * 10):
        assert content == number * 10
        time.sleep(0.01)
        assert max(begun) <= number + 1
    assert begun == list(range(6))


def test_the_next_item_is_read_while_this_one_is_worked_on() -> None:
    second = threading.Event()
    for number, _ in read_ahead(range(2), lambda item: item == 1 and second.set()):
        if number == 0:
            assert second.wait(60)


def test_an_error_of_reading_is_raised_at_the_items_turn() -> None:
    def read(item: int) -> int:
        if item == 2:
            raise ValueError("broken")
        return item

    done = []
    with pytest.raises(ValueError, match="broken"):
        done.extend(content for _, content in read_ahead(range(5), read))
    found = []
    with pytest.raises(ValueError, match="broken"):
        for number, _ in read_ahead(range(5), read):
            found.append(number)
    assert found == [0, 1]


def test_nothing_is_read_of_nothing_and_leaving_early_ends_the_thread() -> None:
    assert list(read_ahead([], int)) == []
    before = set(threading.enumerate())  # some of which may end meanwhile
    for _ in read_ahead(range(9), int):
        break
    assert set(threading.enumerate()) <= before


def test_tasks_run_one_after_the_other_and_all_are_done_on_leaving() -> None:
    done: list[int] = []

    def task(number: int) -> None:
        time.sleep(0.01)
        done.append(number)

    with WriteBehind() as behind:
        for number in range(4):
            behind.put(lambda number=number: task(number))
            assert len(done) >= number  # only the last one may still run
    assert done == [0, 1, 2, 3]


def test_an_error_of_writing_is_raised_by_the_next_task_or_on_leaving() -> None:
    def fail() -> None:
        raise OSError("disk full")

    done = []
    with pytest.raises(OSError, match="disk full"), WriteBehind() as behind:
        behind.put(fail)
        behind.put(lambda: done.append(1))
    with pytest.raises(OSError, match="disk full"), WriteBehind() as behind:
        behind.put(fail)
    assert not done


def test_another_error_waits_for_the_last_task_and_is_not_hidden() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), WriteBehind() as behind:
        behind.put(lambda: (time.sleep(0.05), done.append(1)))
        raise KeyboardInterrupt
    assert done == [1]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32"])
def test_texts_with_a_mark_of_their_encoding_are_read(tmp_path, encoding):
    """PowerShell writes UTF-16 where a command's output goes into a file."""
    path = tmp_path / "a.toml"
    path.write_bytes("# é\r\n[run]\r".encode(encoding))
    assert files.read_text(path) == "# é\n[run]\n"


@pytest.mark.parametrize("content", [b"\xe9", b"\xff\xfea", b"\xef\xbb\xbf\xff"])
def test_other_encodings_are_refused_with_the_fix(tmp_path, content):
    (tmp_path / "a.toml").write_bytes(content)
    with pytest.raises(ValueError, match="save it as UTF-8"):
        files.read_text(tmp_path / "a.toml")


@pytest.mark.skipif(os.name != "posix", reason="this system has no folder of devices")
def test_no_device_is_replaced_by_a_file(tmp_path, monkeypatch):
    """An administrator's report to /dev/full replaced it for all programs."""
    link = tmp_path / "link"
    link.symlink_to("/dev/null")
    with pytest.raises(OSError, match="it is a device, not a file"):
        files.write_text(link, "text")
    with pytest.raises(WriteError, match="it is a device, not a file"), files.output_file(link):
        pass
    monkeypatch.setattr(files, "DEVICES", str(tmp_path))
    with pytest.raises(OSError, match="it is a device, not a file"):
        files.write_text(tmp_path / "stdout", "text")
    assert sorted(tmp_path.iterdir()) == [link] and link.is_symlink()
