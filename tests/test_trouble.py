"""Pipelines in programs: interrupted, given what does not fit, asked from other processes."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.errors import ExposureError, FrameError, MissingPlaneError
from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device, DeviceError, HazardError
from tests import toys
from tests.toys import make_frame


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=1)


def moving(number: int, **facts) -> Frame:
    frame = make_frame(number, **facts)
    frame.planes[Role.MOTION] = np.ones((*frame[Role.COLOUR].shape[:2], 2), np.float32)
    return frame


def test_an_interrupted_frame_is_waited_for(device, monkeypatch):
    """Its planes are in use until then; the frame after it begins anew."""
    pipeline = Pipeline([toys.Sum()], device)
    pipeline(make_frame(1))
    wait = threading.Event.wait

    def interrupted(event, timeout=None):
        monkeypatch.setattr(threading.Event, "wait", wait)
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Event, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pipeline(make_frame(2))
    frame = make_frame(3)
    assert np.array_equal(pipeline(frame)[Role.COLOUR], frame[Role.COLOUR])


@pytest.mark.parametrize(("role", "plane", "message"), [
    (Role.ALPHA, np.ones((8, 16, 1), np.float32),
     "planes of frame 1 differ in size: colour 6x4, alpha 16x8"),
    (Role.STRENGTH, np.ones((2, 3), np.float32),
     "planes of frame 1 differ in size: colour 6x4, strength 3x2"),
    (Role.DEPTH, np.ones((4, 6, 1), np.int32),
     "plane 'depth' of frame 1 is int32: give a NumPy array of floats"),
])
def test_planes_put_into_a_frame_are_looked_at(device, role, plane, message):
    frame = make_frame(1, (6, 4))
    frame.planes[role] = plane
    with pytest.raises(FrameError, match=message):
        Pipeline([ToneMap()], device)(frame)


def test_planes_put_into_a_frame_may_be_of_any_float_and_flat(device):
    frame, other = make_frame(1, (6, 4)), make_frame(1, (6, 4))
    mask = np.linspace(0, 1, 24, dtype=np.float32).reshape(4, 6)
    frame.planes[Role.STRENGTH], other.planes[Role.STRENGTH] = mask.astype(">f4"), mask[:, :, None]
    found, wanted = (Pipeline([DenoiseUpscale(model="s")], device)(each) for each in (frame, other))
    assert np.array_equal(found[Role.COLOUR], wanted[Role.COLOUR])


def test_what_is_noted_in_a_result_is_not_in_the_frame(device):
    frame = make_frame(1, metadata={"shot": "a"})
    Pipeline([toys.Sum()], device)(frame).metadata["shot"] = "b"
    assert frame.metadata == {"shot": "a"}


@pytest.mark.parametrize("trouble", ["colour", "exposure"])
def test_a_frame_that_fails_before_the_passes_ends_the_history_too(device, trouble):
    pipeline = Pipeline([toys.Sum()], device, "metadata", "none")
    pipeline(make_frame(1, exposure=0.0))
    bad = make_frame(2, exposure=None if trouble == "exposure" else 0.0)
    if trouble == "colour":
        bad = Frame({Role.DEPTH: np.ones((4, 6, 1), np.float32)}, exposure=0.0)
    with pytest.raises((ExposureError, MissingPlaneError)):
        pipeline(bad)
    frame = make_frame(3, exposure=0.0)
    assert np.array_equal(pipeline(frame)[Role.COLOUR], frame[Role.COLOUR])


@pytest.mark.parametrize("other", [[ToneMap(look="local")], [DenoiseUpscale(model="m")]])
def test_a_history_of_others_is_refused(device, other):
    foreign = Pipeline(other, device)
    foreign(moving(1))
    pipeline = Pipeline([DenoiseUpscale(model="s")], device)
    with pytest.raises(FrameError, match="frame 1: the history does not fit the passes"):
        pipeline.recall(moving(1), foreign.history())


def test_a_history_of_a_network_is_refused_where_none_runs(device):
    denoised = Pipeline([DenoiseUpscale(model="s")], device)
    denoised(moving(1))
    plain = Pipeline([DenoiseUpscale(model="s", strength=0)], device)
    with pytest.raises(FrameError, match="pass 'denoise_upscale' has no history at strength 0"):
        plain.recall(moving(1), denoised.history())


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_has_a_device_of_its_own(monkeypatch):
    """Threads do not come along: what was made before would wait for ever."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")  # CUDA itself does not survive a fork
    before = Pipeline([ToneMap()], Device("cpu", threads=1))
    before(make_frame(1))
    shared = Pipeline([ToneMap()]).device.name == "cpu"

    def work(results):
        try:
            before(make_frame(2))
        except DeviceError as error:
            results.put(error)
        results.put(Pipeline([ToneMap()],
                             None if shared else Device("cpu"))(make_frame(2))[Role.COLOUR])

    context = multiprocessing.get_context("fork")
    results = context.Queue()
    process = context.Process(target=work, args=(results,))
    process.start()
    error, colour = results.get(timeout=60), results.get(timeout=60)
    process.join()
    assert "make devices and pipelines here" in str(error)
    assert np.array_equal(colour, Pipeline([ToneMap()], Device("cpu"))(make_frame(2))[Role.COLOUR])


LEAVES = """
import os, signal, sys, threading, time
import numpy as np
import postfx
from postfx.frame import Frame, Role
signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
passes = postfx.Pipeline([postfx.DenoiseUpscale(model="m.fp32")], postfx.Device("cpu", threads=1))
frame = Frame({Role.COLOUR: np.ones((270, 480, 3), np.float32)})
passes(frame)
def run():
    while True:
        passes(frame)
if sys.argv[1] == "main":
    threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    run()
threading.Thread(target=run, daemon=True).start()
time.sleep(0.2)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals are others")
@pytest.mark.parametrize(("thread", "code"), [("main", -signal.SIGINT), ("other", 0)])
def test_a_process_ends_while_a_frame_is_computed(thread, code):
    """Not by an abort, which its thread inside of a library would cause."""
    found = subprocess.run([sys.executable, "-c", LEAVES, thread], capture_output=True, text=True,
                           timeout=120)
    assert found.returncode == code, found.stderr
    assert "terminate called" not in found.stderr


LOADS = """
import sys, threading, time
import numpy as np
import postfx
def run():
    size = 16
    while True:
        size += 2  # a network is loaded for each
        frame = postfx.Frame({"colour": np.ones((size, size, 3), np.float32)})
        device = postfx.Device("cpu", threads=2)
        postfx.Pipeline([postfx.DenoiseUpscale(model="m.fp32")], device)(frame)
for _ in range(2):
    threading.Thread(target=run, daemon=True).start()
time.sleep(float(sys.argv[1]))
"""


@pytest.mark.parametrize("seconds", ["0.1", "0.3"])
def test_a_process_ends_while_libraries_and_networks_are_loaded(seconds):
    found = subprocess.run([sys.executable, "-c", LOADS, seconds], capture_output=True, text=True,
                           timeout=120)
    assert found.returncode == 0, found.stderr


MEASURES = """
import sys, threading, time
import numpy as np
import postfx
frame = postfx.Frame({"colour": np.ones((16, 16, 3), np.float32)})
postfx.Pipeline([postfx.DenoiseUpscale(model="m.fp32")], postfx.Device("cpu", threads=1))(frame)
def run():
    while True:
        np.quantile(frame["colour"], 0.5)  # takes the interpreter's lock in a destructor of C++
for _ in range(2):
    threading.Thread(target=run, daemon=True).start()
time.sleep(float(sys.argv[1]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="threads are stopped without unwinding them")
@pytest.mark.parametrize("seconds", ["0.01", "0.03"])
def test_a_process_ends_while_threads_are_in_libraries_in_cpp(seconds):
    found = subprocess.run([sys.executable, "-c", MEASURES, seconds], capture_output=True,
                           text=True, timeout=120)
    assert found.returncode == 0, found.stderr


READS = """
import sys, threading, time
from pathlib import Path
from postfx.io.image_file import ImageFile
def run():
    while True:
        ImageFile(Path(sys.argv[1])).close()
for _ in range(12):
    threading.Thread(target=run, daemon=True).start()
time.sleep(float(sys.argv[2]))
"""


@pytest.mark.parametrize("seconds", ["0.02", "0.05"])
def test_a_process_ends_while_files_are_read(seconds):
    """No library of ours is open that could keep threads from an abort."""
    file = Path(__file__).parents[1] / "samples/room/noisy.0001.exr"
    found = subprocess.run([sys.executable, "-c", READS, str(file), seconds], capture_output=True,
                           text=True, timeout=120)
    assert found.returncode == 0, found.stderr


SERVES = """
import time
from postfx.runtime.threads import CommandQueue
from postfx.workers import finished_before_the_end
def work():
    time.sleep(0.3)  # the main thread is done by now
    with finished_before_the_end():
        print("done", flush=True)
queue = CommandQueue("commands")
queue.submit(work)
"""


def test_committed_work_ends_before_the_process():
    found = subprocess.run([sys.executable, "-c", SERVES], capture_output=True, text=True,
                           timeout=30)
    assert (found.returncode, found.stdout) == (0, "done\n"), found.stderr


STANDS_IN = """
import atexit, time
from postfx import workers
from postfx.workers import Workers, end_work
class Slow(workers.Server):
    def run(self):
        time.sleep(0.3)  # before it begins its work
        super().run()
def submit():
    workers.Server = Slow
    pool.submit(lambda: (time.sleep(0.3), print("done", flush=True)))
    end_work()
    print("ended")
pool = Workers(1)
atexit.register(submit)
"""


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="exit functions can start no thread")
def test_threads_begun_while_the_process_ends_are_waited_for():
    found = subprocess.run([sys.executable, "-c", STANDS_IN], capture_output=True, text=True,
                           timeout=30)
    assert found.stdout == "done\nended\n", found.stderr


SUBMITS = """
import atexit, threading, time
from postfx.workers import Workers
pool = Workers(1)
def run():
    while True:
        pool.submit(time.sleep, 0.05).result()
for _ in range(8):
    threading.Thread(target=run, daemon=True).start()
begin = time.monotonic()
atexit.register(lambda: print(time.monotonic() - begin))
"""


def test_a_process_does_not_wait_for_work_that_begins_all_the_time():
    found = subprocess.run([sys.executable, "-c", SUBMITS], capture_output=True, text=True,
                           timeout=30)
    assert found.returncode == 0, found.stderr
    assert float(found.stdout) < 5  # half a minute was not enough


LATER = """
import atexit
import numpy as np
def compute():
    frame = postfx.Frame({"colour": np.ones((40, 60, 3), np.float32)})
    print(passes(frame)["colour"].shape, flush=True)
atexit.register(compute)  # before those of the library, so it runs after them
import postfx
passes = postfx.Pipeline([postfx.DenoiseUpscale(model="m.fp32")], postfx.Device("cpu", threads=2))
passes(postfx.Frame({"colour": np.ones((40, 60, 3), np.float32)}))
"""


def test_frames_are_computed_in_exit_functions():
    found = subprocess.run([sys.executable, "-c", LATER], capture_output=True, text=True,
                           timeout=120)
    assert found.stdout == "(40, 60, 3)\n", found.stderr


def test_errors_come_back_from_other_processes(device):
    with pytest.raises(HazardError) as caught:
        _ = device.heap.tensor("x", (3,)).array
    again = pickle.loads(pickle.dumps(caught.value))
    assert type(again) is HazardError and str(again) == str(caught.value)
    assert (again.kind, again.tensor, again.second) == (caught.value.kind, "x", caught.value.second)


FORKED = """
import os, sys
import numpy as np
import postfx
frame = postfx.Frame({"colour": np.ones((300, 400, 3), np.float32)})
postfx.write_frame("parent.exr", frame)
child = os.fork()
if child == 0:
    for name, compression in (("a.exr", "zip"), ("b.exr", "piz"), ("c.exr", "dwaa")):
        postfx.write_frame(name, frame, compression=compression)
    for name in ("d.png", "e.jpg"):
        postfx.write_frame(name, frame)
    for name in ("parent.exr", "a.exr", "b.exr"):
        assert all((one["colour"] == 1).all() for one in postfx.read_sequence(name))
    sys.exit(0)  # as a program ends, with all that waits for threads
postfx.write_frame("parent2.exr", frame)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_reads_and_writes_files(tmp_path):
    """OpenEXR's threads do not come along, and it would wait for them for ever."""
    subprocess.run([sys.executable, "-c", FORKED], cwd=tmp_path, env=with_sources(), check=True,
                   timeout=60)
    assert {path.name for path in tmp_path.iterdir()} == {"parent.exr", "parent2.exr", "a.exr",
                                                          "b.exr", "c.exr", "d.png", "e.jpg"}


AFTER_MAIN = """
import sys, threading, time
import numpy as np
import postfx
frame = postfx.Frame({"colour": np.random.default_rng(1).random((60, 80, 3), np.float32)})
shown = postfx.Frame(frame.planes, encoding="srgb")
def refuse(self):
    raise RuntimeError("can't create new thread at interpreter shutdown")
def work():
    threading.main_thread().join()
    time.sleep(0.2)
    if sys.argv[1] == "none begin":
        threading.Thread.start = refuse
    for name, picture in {"a.exr": frame, "b.png": shown, "c.jpg": shown}.items():
        postfx.write_frame(name, picture)
    read, = postfx.read_sequence("a.exr")
    pipeline = postfx.Pipeline([postfx.DenoiseUpscale(model="s")], postfx.Device("cpu"))
    postfx.write_frame("d.exr", pipeline(read))
    other = postfx.Frame({"colour": np.roll(frame["colour"], 2, 1)})
    postfx.write_frame("e.exr", postfx.Between(frame, other).frame(0.5))
threading.Thread(target=work).start()
"""


@pytest.mark.parametrize("others", ["may begin", "none begin"])
def test_threads_of_the_program_go_on_after_its_main_thread(others, tmp_path):
    """Python's pools refuse work from then on; frames would be lost, and the exit status 0. From
    3.12 on no other thread can begin."""
    done = subprocess.run([sys.executable, "-c", AFTER_MAIN, others], cwd=tmp_path,
                          env=with_sources(), capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert {path.name for path in tmp_path.iterdir()} >= {"a.exr", "b.png", "c.jpg", "d.exr",
                                                          "e.exr"}


SILENT = """
import time
import numpy as np
import postfx
from postfx.runtime.session import ort
postfx.denoise(np.ones((64, 64, 3), np.float32))
time.sleep(1)
print(ort.__version__)
"""


def test_nothing_of_others_is_stored_in_the_home(tmp_path):
    """ONNX Runtime keeps a device id there, and looks for its maker's host, unless it is told not
    to."""
    environment = {**with_sources(), "HOME": str(tmp_path), "XDG_CACHE_HOME": ""}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    subprocess.run([sys.executable, "-c", SILENT], env=environment, check=True, timeout=300)
    found = [path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()]
    assert {path.parts[:2] for path in found} <= {(".cache", "postfx")}
    assert not (tmp_path / ".cache/Microsoft").exists()


def with_sources():
    """Variables of a process that imports these sources."""
    return {**os.environ, "PYTHONPATH": str(Path(postfx.__file__).parents[1])}
