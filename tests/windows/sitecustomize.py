"""Python with this folder in PYTHONPATH runs postfx's own code as it would find itself on Windows:

    PYTHONPATH=tests/windows python -m pytest tests/files tests/io tests/cli
    PYTHONPATH=tests/windows python -m postfx run ...

What Windows does not have is missing from os, mmap and signal, as seen from postfx, and so are
modules of POSIX alone. `os.name` says nt, glob puts backslashes between folders, and a file that
this process has open or mapped can be neither removed nor replaced. Other packages keep the real
modules: their Windows builds are theirs to test.
"""

from __future__ import annotations

import builtins
import glob
import importlib.machinery
import mmap
import os
import pathlib
import signal
import types
from collections.abc import Callable
from typing import Any

MISSING = {
    "os": {"getuid", "geteuid", "getgid", "sysconf", "O_DIRECTORY", "O_NOFOLLOW", "kill",
           "memfd_create", "fork", "sched_getaffinity", "sched_setaffinity", "statvfs", "uname",
           "mkfifo", "killpg", "getpgid", "setsid", "pipe2", "nice", "register_at_fork",
           "posix_fadvise", "fchmod", "chown", "pread", "readv"},
    "mmap": {"MADV_DONTNEED", "MADV_WILLNEED", "MAP_SHARED", "MAP_PRIVATE", "PROT_READ"},
    "signal": {"SIGKILL", "SIGHUP", "SIGUSR1", "SIGALRM", "SIGCHLD", "alarm", "pthread_sigmask",
               "sigwait"},
}
ABSENT = {"resource", "fcntl", "pwd", "grp", "termios", "tty", "pty", "syslog"}
FOLDERS = ("/proc", "/sys", "/dev")
"""Folders that are not there, for what goes through pathlib or os."""


class Refused(PermissionError):
    """What Windows says of a file that is open."""


def _is_open(path: Any) -> bool:
    """Whether this process has a file open or mapped: the real /proc knows."""
    name = os.path.realpath(path)
    opened = {os.path.realpath(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")}
    with open("/proc/self/maps") as maps:
        return name in opened or any(line.rstrip("\n").endswith(f" {name}") for line in maps)


def _refuse_open(work: Callable[..., Any], *places: int) -> Callable[..., Any]:
    def refusing(*arguments: Any, **named: Any) -> Any:
        for place in places:
            if _is_open(arguments[place]):
                raise Refused(13, "The process cannot access the file because it is being used",
                              str(arguments[place]))
        return work(*arguments, **named)

    return refusing


def _without_folders(work: Callable[..., Any]) -> Callable[..., Any]:
    def hiding(path: Any, *arguments: Any, **named: Any) -> Any:
        if str(path).startswith(FOLDERS):
            raise FileNotFoundError(2, "No such file or directory", str(path))
        return work(path, *arguments, **named)

    return hiding


class Proxy(types.ModuleType):
    """A module without some of its names, and with others in their place."""

    def __init__(self, module: types.ModuleType, missing: set[str],
                 instead: dict[str, Any]) -> None:
        super().__init__(module.__name__)
        self._module, self._missing = module, missing
        vars(self).update(instead)

    def __getattr__(self, name: str) -> Any:
        if name in self._missing:
            raise AttributeError(f"module '{self._module.__name__}' has no attribute '{name}' on "
                                 "Windows")
        return getattr(self._module, name)


class _Map(mmap.mmap):
    """A mapping without madvise."""

    def __getattribute__(self, name: str) -> Any:
        if name == "madvise":
            raise AttributeError(name)
        return super().__getattribute__(name)


class _WindowsPath(type(pathlib.Path())):  # type: ignore[misc]
    """Paths of postfx's modules: files that are open stay, and some folders are not there."""

    read_text = _without_folders(pathlib.Path.read_text)
    read_bytes = _without_folders(pathlib.Path.read_bytes)
    open = _without_folders(pathlib.Path.open)
    unlink = _refuse_open(pathlib.Path.unlink, 0)

    def is_dir(self, *arguments: Any) -> bool:
        return not str(self).startswith(FOLDERS) and super().is_dir(*arguments)

    def is_file(self, *arguments: Any) -> bool:
        return not str(self).startswith(FOLDERS) and super().is_file(*arguments)


def _backslashed(pattern: str, **named: Any) -> list[str]:
    return [os.path.dirname(name).replace("/", "\\") + "\\" * bool(os.path.dirname(name))
            + os.path.basename(name) for name in glob.glob(pattern.replace("\\", "/"), **named)]


COMPILES = "postfx.compiled.build"
"""A checkout compiles its kernels for the system that runs it, and locks them as that one does."""
PROXIES = {
    "os": Proxy(os, MISSING["os"], {
        "name": "nt", "unlink": _refuse_open(os.unlink, 0),
        # looked up, for tests
        "replace": _refuse_open(lambda *given, **named: os.replace(*given, **named), 0, 1),
        "readlink": _without_folders(os.readlink), "scandir": os.scandir}),
    "mmap": Proxy(mmap, MISSING["mmap"], {"mmap": _Map}),
    "signal": Proxy(signal, MISSING["signal"], {}),
    "glob": Proxy(glob, set(), {"glob": _backslashed}),
    "pathlib": Proxy(pathlib, set(), {"Path": _WindowsPath}),
}


def _import(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (),
            level: int = 0) -> Any:
    if name in ABSENT and (globals or {}).get("__name__") != COMPILES:
        raise ModuleNotFoundError(f"No module named '{name}' on Windows", name=name)
    if level == 0 and name in PROXIES:
        return PROXIES[name]
    return builtins.__import__(name, globals, locals, fromlist, level)


def install() -> None:
    """Have modules of postfx that are loaded from now on see such a system."""
    seen = {**vars(builtins), "__import__": _import}
    load = importlib.machinery.SourceFileLoader.exec_module

    def exec_module(self: Any, module: types.ModuleType) -> None:
        if module.__name__.partition(".")[0] == "postfx":
            module.__dict__["__builtins__"] = seen
        load(self, module)

    importlib.machinery.SourceFileLoader.exec_module = exec_module  # type: ignore[method-assign]


install()
