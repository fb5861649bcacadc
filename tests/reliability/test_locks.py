"""Several runs, one folder: nothing is written twice at once, and what dead processes left is taken
over."""

import errno
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from postfx.errors import RunError
from postfx.runs import locks as claim_module
from postfx.runs.folder import RunFolder
from postfx.runs.locks import (
    EMPTY,
    LOCK_TIMEOUT_SECONDS,
    OLD,
    Claim,
    FolderLock,
    Process,
    age_of,
    is_alive,
)
from postfx.runs.manifest import MANIFEST_NAME, Output, load_manifest, update_manifest
from tests.reliability.faulty import WRITE

SLOW = {"at": WRITE, "do": "sleep", "seconds": 0.5}


def dead() -> Process:
    """A process of this machine that is gone."""
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return Process.me()._replace(pid=child.pid, begun=1)


ELSEWHERE = Process.me()._replace(host="another-machine")


def test_two_runs_of_the_same_frames(runs, unbroken):
    first = runs.start([SLOW])
    runs.wait_for(first, "begin")
    code, said = runs("--overwrite", "--frames", "5-8")
    assert code == 2
    assert (f"out.0005.exr: is being written by process {first.pid} on" in said and "wait for "
            "it" in said)
    assert first.wait(60) == 0
    assert runs.files() == unbroken and runs.verify()[0] == 0


def test_two_runs_of_different_frames(runs, unbroken):
    first = runs.start([{**SLOW, "seconds": 0.2}], "--frames", "1-4")
    second = runs.start([{**SLOW, "seconds": 0.2}], "--frames", "5-8", "--preroll", "4")
    assert (first.wait(60), second.wait(60)) == (0, 0)
    assert runs.files() == unbroken
    code, found = runs.verify()
    assert (code == 0 and len(found["whole"]) == 8
            and list(found["runs"].values()) == ["finished"] * 2)


def test_run_after_a_killed_one_takes_over(runs, unbroken):
    runs.killed(WRITE, 3)
    assert list((runs.folder / ".postfx").glob("*.claim"))
    assert runs("--skip-existing")[0] == 0 and runs.files() == unbroken


def test_killed_while_it_held_the_lock(runs, unbroken):
    runs.killed("postfx.runs.manifest.write_atomically", 1)
    assert (runs.folder / ".postfx/lock").exists()
    assert runs("--skip-existing")[0] == 0 and runs.files() == unbroken


@pytest.fixture
def lock(tmp_path):
    return tmp_path / "lock"


def test_lock_is_given_back(lock):
    with FolderLock(lock):
        assert Process.of(json.loads(lock.read_text())) == Process.me()
    assert not lock.exists()


def test_lock_that_someone_took_over_is_left_to_them(lock):
    with FolderLock(lock):
        lock.write_text(json.dumps(ELSEWHERE.as_dict()))
    assert Process.of(json.loads(lock.read_text())) == ELSEWHERE


def test_lock_of_a_dead_process_is_taken_over(lock):
    lock.write_text(json.dumps(dead().as_dict()))
    with FolderLock(lock, patience=5):
        assert Process.of(json.loads(lock.read_text())) == Process.me()


@pytest.mark.parametrize("number", [0, -1, 1 << 31, 1 << 70])
def test_lock_of_a_process_that_cannot_be(lock, number):
    lock.write_text(json.dumps(Process.me()._replace(pid=number).as_dict()))
    with FolderLock(lock, patience=5):
        assert Process.of(json.loads(lock.read_text())) == Process.me()


def test_lock_of_a_process_whose_number_was_used_again(lock):
    lock.write_text(json.dumps(Process.me()._replace(begun=1).as_dict()))
    with FolderLock(lock, patience=5):
        assert Process.of(json.loads(lock.read_text())) == Process.me()


@pytest.mark.parametrize("holder", [Process.me(), ELSEWHERE])
def test_lock_of_a_living_process_is_waited_for(lock, holder):
    lock.write_text(json.dumps(holder.as_dict()))
    with pytest.raises(
        RunError, match=rf"lock: held by process {holder.pid} on {holder.host}"
    ), FolderLock(lock, 0.1):
        pass
    assert lock.exists()


@pytest.mark.parametrize(
    "content", [json.dumps(ELSEWHERE.as_dict()), "", "{", "[]"],
    ids=("whole", "empty", "cut", "list")
)
def test_old_lock_of_another_machine_is_taken_over(lock, content):
    lock.write_text(content)
    long_ago = time.time() - OLD - 10
    os.utime(lock, (long_ago, long_ago))
    with FolderLock(lock, patience=5):
        assert Process.of(json.loads(lock.read_text())) == Process.me()


@pytest.mark.parametrize("content", ["", "{"])
def test_lock_that_names_nobody_is_taken_over_before_patience_ends(lock, content):
    """A run that is killed between making the file and writing it leaves one."""
    lock.write_text(content)
    a_while_ago = time.time() - EMPTY - 1
    os.utime(lock, (a_while_ago, a_while_ago))
    with FolderLock(lock, patience=1):
        assert Process.of(json.loads(lock.read_text())) == Process.me()
    assert EMPTY < LOCK_TIMEOUT_SECONDS / 2


def test_lock_is_never_seen_empty(lock, monkeypatch):
    seen = []
    link = os.link
    monkeypatch.setattr(os, "link",
                        lambda one, other: seen.append(Path(one).read_text()) or link(one, other))
    with FolderLock(lock):
        assert [Process.of(json.loads(text)) for text in seen] == [Process.me()]
        assert sorted(path.name for path in lock.parent.iterdir()) == ["lock"]


def test_lock_on_a_file_system_without_links(lock, monkeypatch):
    def refuse(one, other):
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(os, "link", refuse)
    with FolderLock(lock):
        assert Process.of(json.loads(lock.read_text())) == Process.me()
        with pytest.raises(RunError, match="held by"), FolderLock(lock, 0.1):
            pass
    assert not list(lock.parent.iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("name", ["lock", "lock.breaking"])
@pytest.mark.parametrize("kind", ["pipe", "dangling link", "link to a pipe"])
def test_what_is_no_file_is_no_lock(lock, name, kind):
    place = lock.with_name(name)
    if kind == "pipe":
        os.mkfifo(place)
    else:
        target = lock.with_name("elsewhere")
        if kind == "link to a pipe":
            os.mkfifo(target)
        place.symlink_to(target)
    if name != "lock":
        lock.write_text(json.dumps(dead().as_dict()))
    with FolderLock(lock, patience=5):
        assert Process.of(json.loads(lock.read_text())) == Process.me()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_pipes_and_dangling_links_among_a_runs_files_hold_nobody_up(tmp_path):
    work = tmp_path / ".postfx"
    work.mkdir()
    for name in ("a.claim", "b.checkpoint", "lock"):
        os.mkfifo(work / name)
        (work / f"x{name}").symlink_to("nowhere")
    folder = RunFolder(tmp_path, "run", ["a.exr"])
    assert folder.checkpoints("a.#.exr", "0") == {}
    folder.release()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("make", [
    Path.touch, os.mkfifo, lambda path: path.symlink_to("nowhere")])
def test_what_has_the_name_of_a_runs_folder_is_named(tmp_path, make):
    make(tmp_path / ".postfx")
    with pytest.raises(RunError, match=r"/\.postfx: is no folder, .*: delete it"):
        RunFolder(tmp_path, "run", ["a.exr"])


def test_process_that_died_while_taking_over(lock):
    lock.write_text(json.dumps(dead().as_dict()))
    lock.with_name("lock.breaking").write_text(json.dumps(dead().as_dict()))
    with FolderLock(lock, patience=5):
        pass


def _count(folder, times):
    for _ in range(times):
        with FolderLock(folder / "lock"):
            value = int((folder / "count").read_text())
            time.sleep(0.001)
            (folder / "count").write_text(str(value + 1))


def test_only_one_at_a_time(tmp_path):
    """Four processes, the first lock of which is left by a dead one, count to a hundred without
    losing one."""
    (tmp_path / "count").write_text("0")
    (tmp_path / "lock").write_text(json.dumps(dead().as_dict()))
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_count, args=(tmp_path, 25), daemon=True) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(300)
    assert (tmp_path / "count").read_text() == "100"


def _enter(folder, first):
    (folder / ".postfx").mkdir(exist_ok=True)
    for number in range(first, first + 20):
        update_manifest(folder, lambda manifest, n=number: manifest.outputs.update(
            {f"{n}.exr": Output("r", n)}
        ))


def test_no_entry_of_the_manifest_is_lost(tmp_path):
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_enter, args=(tmp_path, 100 * index), daemon=True)
               for index in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(300)
    assert len(load_manifest(tmp_path).outputs) == 60
    assert sorted(path.name for path in tmp_path.iterdir()) == [".postfx", MANIFEST_NAME]


def test_claims_of_different_files(tmp_path):
    one, other = Claim(tmp_path, "one", ["a", "b"]), Claim(tmp_path, "other", ["c"])
    assert is_alive(tmp_path, "one")
    one.release()
    other.release()
    assert not is_alive(tmp_path, "one") and list(tmp_path.iterdir()) == []


def test_partial_files_of_runs_that_live_stay(tmp_path):
    """A run that starts removes those that killed runs left, of checkpoints and of the manifest."""
    work = tmp_path / ".postfx"
    work.mkdir()
    living = Claim(work, "living", ["a"])
    partial = {run: work / f".{run}.checkpoint.host-1-0.part" for run in ("living", "killed")}
    for path in partial.values():
        path.touch()
    RunFolder(tmp_path, "new", ["b"]).release()
    assert partial["living"].exists() and not partial["killed"].exists()
    living.release()


def test_a_claim_that_a_killed_run_had_begun_leaves_nothing(tmp_path):
    work = tmp_path / ".postfx"
    work.mkdir()
    (work / ".killed.claim.host-1-0.part").touch()
    RunFolder(tmp_path, "new", ["a"]).release()
    assert not work.exists()


def test_partial_manifest_is_removed_under_the_lock_only(tmp_path, monkeypatch):
    """Another run may be writing it: it holds the lock meanwhile."""
    (tmp_path / f".{MANIFEST_NAME}.host-1-0.part").touch()
    unlink, locked = Path.unlink, []

    def watched(path, missing_ok=False):
        if path.name.startswith(f".{MANIFEST_NAME}."):
            locked.append((tmp_path / ".postfx/lock").exists())
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", watched)
    RunFolder(tmp_path, "new", ["b"]).release()
    assert locked == [True]


def test_claim_of_another_machine_counts_while_it_beats(tmp_path):
    folder = tmp_path / ".postfx"
    folder.mkdir()
    path = folder / "other.claim"
    path.write_text(json.dumps({"process": ELSEWHERE.as_dict(), "files": ["a"]}))
    with pytest.raises(RunError,
                       match="a: is being written by process .* on another-machine: wait for it, "
                       "or choose"):
        Claim(folder, "mine", ["a"])
    os.utime(path, (time.time() - claim_module.SILENT_SECONDS - 10,) * 2)
    Claim(folder, "mine", ["a"]).release()
    assert not path.exists()


def test_claims_beat(tmp_path, monkeypatch):
    monkeypatch.setattr(claim_module, "BEAT", 0.02)
    claim = Claim(tmp_path, "mine", ["a"])
    os.utime(claim.path, (time.time() - 1000,) * 2)
    end = time.monotonic() + 60
    while age_of(claim.path) > 100 and time.monotonic() < end:
        time.sleep(0.02)
    assert age_of(claim.path) < 100
    claim.release()


def test_stopped_process_is_alive(tmp_path):
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        os.kill(child.pid, signal.SIGSTOP)
        begun = claim_module._begun(child.pid)
        assert Process.me()._replace(pid=child.pid, begun=begun).is_alive() is True
    finally:
        child.kill()
        child.wait()
    assert Process.me()._replace(pid=child.pid, begun=begun).is_alive() is False
