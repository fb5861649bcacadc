"""What this process may use of its machine, and where its files lie.

Cores and memory, as affinity and control groups limit them; threads that share work; a memory
budget, beyond which arrays lie in temporary files; arrays of other libraries; folders for what can
be remade, such as compiled kernels; and the folder of the models that ship with the code.
"""

from __future__ import annotations

import ctypes
import errno
import getpass
import math
import mmap
import os
import re
import stat
import sys
import tempfile
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import FrameError, MemoryBudgetError
from postfx.workers import Workers

_PACKAGE_FOLDER = Path(__file__).resolve().parent
MOST_HEAPS = -8  # M_ARENA_MAX of glibc's malloc.h
_GROUPS = Path("/sys/fs/cgroup")
_OWN = Path("/proc/self/cgroup")

# Files


def models_dir() -> Path:
    """Folder of the model packages (*.onnx + *.json): inside an installed wheel, or `models/` of a
    checkout."""
    packaged = _PACKAGE_FOLDER / "_models"
    return packaged if packaged.is_dir() else _PACKAGE_FOLDER.parent / "models"


def is_plain_name(name: str) -> bool:
    """Whether a file's name has no folder in it."""
    return bool(name) and name not in (".", "..") and not set(name) & set("/\\\0")


def private_folder(name: str) -> Path | None:
    """A folder that nobody else may write to, since what lies there is run: in the user's cache,
    else with the temporary files; None where neither can be had."""
    for base in _private_bases():
        folder = base / name
        try:
            base.parent.mkdir(parents=True, exist_ok=True)
            for part in (base, folder):
                part.mkdir(mode=0o700, exist_ok=True)
            if all(map(_is_private, (base, folder))) and os.access(folder, os.W_OK):
                return folder
        except OSError:
            continue
    return None


def _private_bases() -> Iterator[Path]:
    """Where a private folder may lie. Python finds the folder of temporary files by writing one,
    which stays if the process is killed then: so only where the cache does not serve."""
    with suppress(ImportError):  # machines that only train do without
        from platformdirs import user_cache_path

        yield user_cache_path("postfx", appauthor=False)
    owner = getattr(os, "getuid", getpass.getuser)()
    yield Path(tempfile.gettempdir()) / f"postfx-{owner}"


def _is_private(folder: Path) -> bool:
    """Whether a folder, and the link if it is one, is this user's, and not for everyone to write
    to. On Windows both places lie in the user's profile, which no other user may write to."""
    if not hasattr(os, "getuid"):
        return True
    status = folder.stat()
    return ({status.st_uid, folder.lstat().st_uid} == {os.getuid()}
            and not status.st_mode & stat.S_IWOTH)


# Cores and memory


def usable_cores() -> int:
    """Cores that this process may use: by its affinity, or fewer if its container gets less
    time."""
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    times = _limits("cpu", ("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us"))
    # -1: no limit
    return max(1,
               min([cores, *(math.ceil(quota / period) for quota, period in times if quota > 0)]))


def share_one_heap() -> None:
    """Let all threads of this process take memory from one heap of the C library, where that is
    glibc's. Frames are read, run and written by different threads: with a heap for each of them,
    the memory that one frees serves no other.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt:
        mallopt(MOST_HEAPS, 1)


def return_free_memory() -> None:
    """Give pages that the C library keeps for later back to the system, where it is glibc: pages
    that were touched before would not be counted when they are touched again."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim:
        trim(0)


HELD_BY_PROCESS = Path("/proc/self/status")
"""Where Linux says how many pages a process has touched. Its count may lag behind by a quarter of a
MiB a thread. To count them one by one (smaps_rollup) takes 84 ms in a process of 4 GiB."""
ANONYMOUS = re.compile(r"^RssAnon:\s+(\d+) kB$", re.MULTILINE)


def held_bytes() -> int | None:
    """Bytes of this process's memory that belong to no file and that it has touched; None where the
    system does not tell."""
    try:
        told = ANONYMOUS.search(HELD_BY_PROCESS.read_text(encoding="ascii"))
    except OSError:
        return None
    return int(told[1]) << 10 if told else None


def usable_memory() -> int:
    """Bytes that this process may have: the machine's, or fewer if its container gets less."""
    return min([_machine_memory(), *(most for most, in _limits("memory", ("memory.max",),
                                                               ("memory.limit_in_bytes",)))])


def _machine_memory() -> int:
    """Bytes of the machine's memory."""
    if hasattr(os, "sysconf"):  # psutil would take 10 ms of every start
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    import psutil

    total: int = psutil.virtual_memory().total
    return total


def _limits(controller: str, *names: tuple[str, ...]) -> Iterator[list[int]]:
    """The numbers in files of these names, together, of each limited control group around this
    process, of version 2 and 1 (the Linux kernel's cgroup-v2.rst, sched-bwc.rst and
    cgroup-v1/memory.rst)."""
    with suppress(OSError):
        for line in _OWN.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if not controllers or controller in controllers.split(","):
                for folder in _around(_GROUPS / (controller if controllers else ""), path):
                    yield from _numbers(folder, names)


def _around(top: Path, path: str) -> Iterator[Path]:
    """A group and those around it; in a container the path may be the host's, and only the top is
    there."""
    group = top / path.strip("/")
    yield from (group, *(one for one in group.parents if one.is_relative_to(top)))


def _numbers(folder: Path, names: tuple[tuple[str, ...], ...]) -> Iterator[list[int]]:
    for together in names:
        with suppress(OSError, ValueError):  # no such file, or 'max'
            yield [int(word) for name in together for word in (folder / name).read_text().split()]


# Work that threads share


@cache
def _shared_cores() -> int:
    """Threads that work: asked for once, as the answer lies in files."""
    return usable_cores()


@cache
def _threads(waiting: bool) -> Workers:
    """Threads that work, or those that mostly wait for them."""
    return Workers(4 if waiting else _shared_cores(), "postfx")


def begin(task: Callable[[], Any]) -> Future[Any]:
    """Start a function that mostly waits for others."""
    return _threads(True).submit(task)


def at_once(tasks: Iterable[Callable[[], Any]], waiting: bool = False) -> list[Any]:
    """Results of functions that run side by side. waiting: they do so themselves with others."""
    return [task.result() for task in [_threads(waiting).submit(task) for task in tasks]]


def in_bands(height: int, kernel: Callable[..., None], *arguments: Any) -> None:
    """Run a kernel on all rows, in bands side by side: small ones, as some rows take longer than
    others."""
    cores = _shared_cores()
    band = max(4, -(-height // (16 * cores))) * 2
    firsts = deque(range(0, height, band))

    def work() -> None:
        while True:
            try:
                first = firsts.popleft()
            except IndexError:  # another thread took the last one
                return
            kernel(first, min(height, first + band), *arguments)

    at_once([work] * min(cores, len(firsts)))


# A memory budget

_SIZE_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_SIZE_TEXT = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)
PROCESS = 320 << 20
"""Bytes of a process in which nothing is worked on yet, and of small things."""
LEAST_BUDGET_PART = 16
"""A budget that is no larger than PROCESS leaves this part of itself."""
SMALL_ARRAY_PART = 128
"""Arrays below this part of what is left stay in memory."""
WORK_PIECE_PART = 16
"""Work on large arrays goes in pieces of this part of what is left."""


def parse_size(size: str | int) -> int:
    """Bytes of '4G', '512M' or a number; MemoryBudgetError for anything else."""
    found = _SIZE_TEXT.fullmatch(str(size).strip())
    if found is None or not float(found[1]):
        raise MemoryBudgetError(f"memory budget '{size}' is not a size: give bytes, or a number "
                                "with K, M, G or T: 4G")
    if isinstance(size, str) and not found[2] and float(found[1]) < _SIZE_UNITS["M"]:
        raise MemoryBudgetError(f"memory budget '{size}' has no unit: give {found[1]}G for "
                                "gigabytes")
    return int(float(found[1]) * _SIZE_UNITS[found[2].upper()])


class Scratch:
    """Arrays within a budget.

    Attributes:
        budget: bytes that the process may have in memory.
        left: bytes of it beside those that a process has anyway.
    """

    def __init__(self, budget: str | int) -> None:
        self.budget = parse_size(budget)
        self.left = max(self.budget - PROCESS, self.budget // LEAST_BUDGET_PART)
        self._maps: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self._lock = threading.Lock()  # one thread reads, another writes

    def empty(self, shape: tuple[int, ...], dtype: np.typing.DTypeLike = "float32") -> np.ndarray:
        """An array of any content, in a temporary file if it is large."""
        nbytes = math.prod(shape) * np.dtype(dtype).itemsize
        if nbytes < self.left // SMALL_ARRAY_PART:
            return np.empty(shape, dtype)
        return np.frombuffer(self.map_file(nbytes), dtype, math.prod(shape)).reshape(shape)

    def full(self, shape: tuple[int, ...], value: float) -> np.ndarray:
        """An array of float32 of one value. A new file is 0 and needs no writing."""
        found = self.empty(shape)
        if value or found.base is None:
            for first, last in self.pieces(len(found), found[0].nbytes):
                found[first:last] = value
        return found

    def map_file(self, nbytes: int) -> mmap.mmap:
        """A temporary file of zeros; it is gone when nothing refers to its mapping."""
        try:
            with tempfile.TemporaryFile(prefix="postfx-") as file:
                file.truncate(nbytes)
                found = mmap.mmap(file.fileno(), nbytes)
        except OSError as error:
            raise MemoryBudgetError(_explain_refusal(error, nbytes)) from error
        with self._lock:
            self._maps.add(found)
        return found

    def relax(self) -> None:
        """Release the pages that were read, where the system can be told so; their content stays in
        the files."""
        if hasattr(mmap, "MADV_DONTNEED"):
            with self._lock:
                held = list(self._maps)
            for each in held:
                each.madvise(mmap.MADV_DONTNEED)

    def pieces(self, rows: int, row_bytes: int) -> Iterator[tuple[int, int]]:
        """First and last row, not included, of pieces of something large; pages are let go of after
        each."""
        step = max(1, self.left // WORK_PIECE_PART // max(1, row_bytes))
        for first in range(0, rows, step):
            yield first, min(rows, first + step)
            self.relax()


def _explain_refusal(error: OSError, nbytes: int) -> str:
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return ("too many open files, as every large plane that is kept is one: keep fewer frames, "
                "or raise 'ulimit -n'")
    return f"{tempfile.gettempdir()}: no room for {nbytes >> 20} MB: set TMPDIR to a larger disk"


def host_floats(given: Any, what: str) -> np.ndarray:
    """An array of floats of any library that has `__dlpack__`, as NumPy's; not copied where that
    can be.

    Raises FrameError, which begins with `what`, for other types and for arrays in the memory of a
    device.
    """
    array = given
    if not isinstance(given, np.ndarray) and hasattr(given, "__dlpack__"):
        try:
            # the host's memory, plain or pinned by CUDA
            if given.__dlpack_device__()[0] not in (1, 3):
                raise BufferError("it lies in the memory of a device, for Pipeline.on_device")
            array = np.asarray(np.from_dlpack(given))
        except (BufferError, RuntimeError, TypeError, ValueError) as error:
            reason = str(error).partition("\n")[0].rstrip(".")
            raise FrameError(f"{what} cannot be read from {type(given).__name__} "
                             f"({reason}): give an array of float32 in the host's memory, as by "
                             "tensor.detach().cpu().float()") from error
    if not isinstance(array, np.ndarray) or not np.issubdtype(array.dtype, np.floating):
        found = getattr(array, "dtype", type(array).__name__)
        files = "; postfx.read_sequence reads files" if isinstance(array, str | Path) else ""
        raise FrameError(f"{what} is {found}: give a NumPy array of floats, or one of a library "
                         f"with DLPack{files}")
    return array
