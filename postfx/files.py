"""Files that other programs write, read or lose: bounded reads, retries, reading ahead, atomic
writes, live processes.

Everything that postfx writes in place of an older file goes through `atomic_file`, so readers see
the old content or the new one, never half of it.
"""

from __future__ import annotations

import codecs
import ctypes
import errno
import hashlib
import json
import mmap
import os
import re
import shutil
import socket
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache, partial
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from postfx.errors import ReadError, WriteError
from postfx.workers import Workers

MAX_BYTES = 1 << 30
"""Largest file that `read_text` reads unless told otherwise."""
_MOST_DOTS = 200
"""Dots in a line of TOML: time grows with the square of their number."""
DEVICES = "/dev"
"""Folder of devices where there is one."""
PARTIAL = ".part"
"""Suffix of files that are being written; no frame pattern matches it."""
FILE_PIECE_BYTES = 1 << 22
"""Bytes that are read, hashed or written at once."""
# of the final name within the temporary one: file systems limit the length of names
_NAME_BYTES = 120
_TEMPORARY = re.compile(
    rf"\.(?P<name>.+)\.(?P<host>[\w-]+)-(?P<process>\d{{1,9}})-\d+{re.escape(PARTIAL)}", re.DOTALL
)
_numbers = count()


def read_text(path: Path, most: int = MAX_BYTES) -> str:
    """Read a UTF-8 file of at most `most` bytes, without the byte order mark that Windows' editors
    put first; also one of UTF-16 or UTF-32 with such a mark, as PowerShell writes.

    Raises OSError for a larger file and for anything that is not a regular file, such as a pipe or
    an endless device; ValueError when the content is none of these.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not a file", str(path))
    if path.stat().st_size > most:
        raise OSError(errno.EFBIG, f"it has more than {most} bytes", str(path))
    content = path.read_bytes()
    encoding = next((name for mark, name in _MARKS.items() if content.startswith(mark)), "utf-8")
    try:
        return content.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start + 1} is no {encoding.upper()}: save it as "
                         "UTF-8") from None


_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32",
          codecs.BOM_UTF32_BE: "utf-32",
          codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
"""Encodings by the mark that a file begins with, the longer marks first."""


def parse_json(text: str | bytes) -> Any:
    """Parse JSON; ValueError when it is malformed or nested too deeply."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its values are nested without end") from None


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; ValueError when it is malformed, nested too deeply, or has a line of too many
    dots, which takes tomllib time by the square of their number."""
    import tomllib  # most commands can do without

    if any(line.count(".") > _MOST_DOTS for line in text.splitlines()):
        raise ValueError(f"it has a line of more than {_MOST_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its values are nested without end") from None


def with_slashes(name: str) -> str:
    """A path with / between folders. Windows also takes a backslash for that, which elsewhere is a
    letter of a name."""
    return name.replace("\\", "/") if os.name == "nt" else name


def is_utf8(name: str) -> bool:
    """Whether a file name is valid UTF-8; other bytes reach Python as lone surrogates."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def hash_file(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits. OSError for what is no file, such as a pipe."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is not a file", str(path))
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(FILE_PIECE_BYTES):
            digest.update(piece)
    return digest.hexdigest()


Result = TypeVar("Result")


def despite_readers(work: Callable[[], Result]) -> Result:
    """The result of `work`, which removes or replaces a file. On Windows it is tried again for a
    moment, as it is refused while another process reads the file."""
    for pause in (0.01, 0.03, 0.1, 0.3, 1.0) if os.name == "nt" else ():
        try:
            return work()
        except PermissionError:
            time.sleep(pause)
    return work()


def remove(path: Path) -> None:
    """Remove a file if it is there."""
    despite_readers(lambda: path.unlink(missing_ok=True))


@contextmanager
def memory_file(suffix: str, room: int = 0) -> Iterator[Path]:
    """Path of a file to write and to read, which is gone afterwards: in memory where the system has
    such files, else in the temporary folder. OSError where that has less than `room` bytes."""
    if hasattr(os, "memfd_create"):
        with os.fdopen(os.memfd_create("postfx"), "rb") as file:
            yield Path(f"/dev/fd/{file.fileno()}")
        return
    with tempfile.TemporaryDirectory(prefix="postfx-") as folder:
        if shutil.disk_usage(folder).free < room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), folder)
        yield Path(folder, f"file{suffix}")


def read_to_end(pipe: int, most: int) -> memoryview:
    """At most so many bytes that come through a pipe, which is then closed. One call of the C
    library reads them all without the interpreter's lock, so what writes into the pipe may hold
    it."""
    content, library = mmap.mmap(-1, most), ctypes.CDLL(None)
    library.fdopen.restype, library.fread.restype = ctypes.c_void_p, ctypes.c_size_t
    file = ctypes.c_void_p(library.fdopen(pipe, b"rb"))
    start = ctypes.byref(ctypes.c_char.from_buffer(content))
    size = library.fread(start, ctypes.c_size_t(1), ctypes.c_size_t(most), file)
    library.fclose(file)
    return memoryview(content)[:size]


@contextmanager
def atomic_file(path: Path, durable: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside `path`. When the block ends, that file replaces `path` in one
    step; when the block raises, the file is removed.

    durable: flush the file and its name to the disk first, so that they survive a power cut.

    Raises OSError where `path` is a device, such as /dev/null or /dev/stdout: an administrator
    would replace it for all programs.
    """
    if _is_device(path):
        raise OSError(errno.EINVAL, "it is a device, not a file", str(path))
    temporary = _temporary(path)
    try:
        yield temporary
        if durable:
            _sync(temporary, os.O_RDWR)
        despite_readers(partial(os.replace, temporary, path))
        if durable:
            with suppress(OSError):  # some file systems, and Windows, cannot sync a folder
                _sync(path.parent, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    finally:
        with suppress(OSError):
            temporary.unlink()


def _is_device(path: Path) -> bool:
    """Whether a path leads to a device, or lies in the folder of devices, which has links to
    them."""
    if os.name == "posix" and os.path.realpath(path.parent) == DEVICES:
        return True
    return path.is_char_device() or path.is_block_device()


def create_whole(path: Path, content: bytes) -> bool:
    """Make a file that is not there yet, with its content from the first moment on; False where
    anything is there.

    It is written aside and linked, which is atomic on NFS, too. Where a file system has no links,
    it is made by O_EXCL, and may be seen empty.
    """
    temporary = _temporary(path)
    try:
        temporary.write_bytes(content)
        try:
            os.link(temporary, path)
            return True
        except FileExistsError:
            return False
        except OSError:
            if temporary.stat().st_nlink > 1:  # NFS made the link, and lost the answer
                return True
        with path.open("xb") as file:
            file.write(content)
        return True
    except FileExistsError:
        return False
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def output_file(path: Path) -> Iterator[Path]:
    """`atomic_file` for what a user asked for: makes the folder, removes what processes of this
    machine that were killed before left behind for `path`, and raises WriteError where the file
    system refuses."""
    temporary = path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if _shorten(path.name) in _names_left(path.parent):
            remove_leftovers(path.parent, [path.name])
        with atomic_file(path) as temporary:
            yield temporary
    except OSError as error:
        reason = (error.strerror or str(error)).replace(str(temporary), str(path))
        raise refusal(path, reason) from error


def refusal(path: Path, reason: str) -> WriteError:
    """The error for a file that a user asked for and the file system refuses; `reason` in its
    words."""
    in_the_way = [str(one) for one in path.parents
                  if os.path.lexists(one) and not os.path.isdir(one)]
    if in_the_way:
        return WriteError(f"{path}: cannot be written: '{in_the_way[0]}' is no folder: choose "
                          "another")
    return WriteError(f"{path}: cannot be written: {reason}; check the folder's rights and free "
                      "space")


def write_atomically(path: Path, write: Callable[[BinaryIO], object],
                     durable: bool = False) -> None:
    """Replace `path` by a file that `write` fills; see `atomic_file`."""
    with atomic_file(path, durable) as temporary, temporary.open("wb") as file:
        write(file)


def write_text(path: Path, text: str) -> None:
    """Replace `path` by a UTF-8 file with this text, whole or not at all."""
    write_texts({path: text})


def write_texts(texts: Mapping[Path, str]) -> None:
    """Replace UTF-8 files by ones with these texts, all of them whole or none."""
    with ExitStack() as stack:
        for path, text in texts.items():
            stack.enter_context(atomic_file(path)).write_bytes(text.encode())


def remove_leftovers(folder: Path, names: Iterable[str], any_host: bool = False) -> None:
    """Remove temporary files that killed writers of these file names left in a folder.

    Files of living processes of this machine stay. `any_host` also removes files that other
    machines wrote: use it only while nobody else may write these names.
    """
    own, meant = _host(), set(map(_shorten, names))
    for entry in os.scandir(folder):
        found = entry.name.endswith(PARTIAL) and _TEMPORARY.fullmatch(entry.name)
        if not found or found["name"] not in meant:
            continue
        if any_host if found["host"] != own else not is_process_alive(int(found["process"])):
            with suppress(OSError):
                os.unlink(entry.path)


@lru_cache(64)
def _names_left(folder: Path) -> frozenset[str]:
    """Names whose temporary files lay in a folder when this process first wrote there. So a folder
    is listed once, not for each of its frames."""
    found = [_TEMPORARY.fullmatch(name) for name in os.listdir(folder) if name.endswith(PARTIAL)]
    return frozenset(match["name"] for match in found if match)


def is_process_alive(pid: int) -> bool:
    """Whether a process of this number runs on this machine, as far as its process numbers are
    visible from here."""
    import psutil  # only where a lock or a leftover is found

    try:
        return pid > 0 and bool(psutil.pid_exists(pid))
    except OverflowError:
        return False


@cache
def _host() -> str:
    """This machine's name, without the characters that separate the fields of a temporary name."""
    return re.sub(r"[^\w-]", "_", socket.gethostname())[:60]


def _temporary(path: Path) -> Path:
    return path.with_name(f".{_shorten(path.name)}.{_host()}-{os.getpid()}-{next(_numbers)}"
                          f"{PARTIAL}")


def _shorten(name: str) -> str:
    return os.fsencode(name)[:_NAME_BYTES].decode("utf-8", "ignore")


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


PAUSES = (0.1, 0.4)
"""Seconds before the second and the third try."""


def read_patiently(read: Callable[[], Result],
                   failed: Callable[[ReadError], None] = lambda error: None) -> Result:
    """The result of `read`. A ReadError is told to `failed` and `read` called again, twice at most;
    then it is raised."""
    for pause in PAUSES:
        try:
            return read()
        except ReadError as error:
            failed(error)
            time.sleep(pause)
    return read()


Item = TypeVar("Item")
Content = TypeVar("Content")


def read_ahead(items: Iterable[Item],
               read: Callable[[Item], Content]) -> Iterator[tuple[Item, Content]]:
    """Each item with the result of `read`, in order. At most one more is read ahead, by a thread of
    its own.

    An error of `read` is raised when it is the item's turn, so that earlier items are not lost.
    """
    with Workers(1, "postfx read") as reader:
        coming: tuple[Item, Future[Content]] | None = None
        for item in items:
            ready, coming = coming, (item, reader.submit(read, item))
            if ready is not None:
                yield ready[0], ready[1].result()
        if coming is not None:
            yield coming[0], coming[1].result()


@cache
def file_threads(count: int) -> Workers:
    """Threads that unpack and pack files. They stay, as starting them costs time."""
    return Workers(count, "postfx zip")


if hasattr(os, "register_at_fork"):
    # a forked process has none of them
    os.register_at_fork(after_in_child=file_threads.cache_clear)


def run_in_order(threads: Workers, tasks: Iterable[Callable[[], Result]],
                 most: int) -> Iterator[Result]:
    """The results of tasks, in their order; at most so many are begun before their turn."""
    begun: deque[Future[Result]] = deque()
    try:
        for task in tasks:
            begun.append(threads.submit(task))
            if len(begun) > most:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
    finally:
        for left in begun:
            left.cancel()


class WriteBehind:
    """Runs one task at a time in a thread of its own. Use it as a context manager: leaving it waits
    for the last one.

    An error of a task is raised by the next `put` or `wait`, or on leaving, where no other error is
    on its way.
    """

    def __init__(self) -> None:
        self._writer = Workers(1, "postfx write")
        self._last: Future[None] | None = None

    def put(self, task: Callable[[], None]) -> None:
        """Wait for the task before, then begin this one; so at most one result waits to be
        written."""
        self.wait()
        self._last = self._writer.submit(task)

    def __enter__(self) -> WriteBehind:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._writer.shutdown(wait=True)
        if kind is None:
            self.wait()

    def wait(self) -> None:
        """Wait for the last task."""
        last, self._last = self._last, None
        if last is not None:
            last.result()
