"""Caches compiled kernels between runs, under a digest of everything they depend on.

Numba's own cache looks at the time stamp of one file: a comment makes it compile the whole file again, and a constant
changed in another file leaves wrong code. Here each file is named by a digest of the function's bytecode, its
compile options, the constants and functions that it uses, its argument types, the processor, and the versions of Python
and Numba.
"""

from __future__ import annotations

import hashlib
import pickle
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.event import Event, Listener, register
from numba.core.extending import _Intrinsic
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from postfx.files import write_atomically
from postfx.kernels.native import Intrinsic, KernelFunction, watches
from postfx.system import private_folder

FOLDER = "kernels"
SUFFIX = ".nbc"
UNUSED = 30 * 86400
"""Seconds after which a file that no run has loaded is removed."""
OUTDATED = 86400
"""Seconds after which an older version's folder is removed."""
FOREIGN = {"numba", "llvmlite", "numpy", *sys.stdlib_module_names}
"""Packages whose functions are identified by name alone; the versions of Numba and Python cover them."""


@cache
def cache_folder() -> Path | None:
    """The folder of compiled kernels; None if there cannot be one.

    Files there are unpickled, so a folder that another user owns or may write to is not used.
    """
    return private_folder(FOLDER)


class _Watched(Listener):
    """Tells the watches what Numba compiles."""

    def on_start(self, event: Event) -> None:
        for watch in watches:
            watch.start()

    def on_end(self, event: Event) -> None:
        for watch in watches:
            watch.end()


register("numba:compile", _Watched())  # type: ignore[no-untyped-call]  # Numba has no types


def make_dispatcher(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Numba's dispatcher of a function: no lock held, compiled code kept between runs."""
    dispatcher = numba.njit(nogil=True, error_model="numpy", **options)(function)
    dispatcher._cache = KernelCache(dispatcher)
    return dispatcher


class KernelCache(_Cache):
    """The compiled forms of one function; a dispatcher loads and saves them."""

    def __init__(self, dispatcher: Dispatcher) -> None:
        self._dispatcher = dispatcher

    @property
    def cache_path(self) -> str:
        """The folder as text; empty without a cache."""
        return str(cache_folder() or "")

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """The compiled function for a signature; None if it is not cached."""
        rtsys.initialize(target_context)  # of what Numba makes ready before it compiles, all that loading needs
        path = self._path(sig, target_context.codegen())
        try:
            content = path.read_bytes() if path else None
        except OSError:
            return None
        if path is None or content is None:
            return None
        with suppress(OSError):
            path.touch()  # marks it as used
        try:
            facts = pickle.loads(_unseal(content))
            return CompileResult._rebuild(target_context, *facts)  # type: ignore[no-any-return,no-untyped-call]
        except Exception:  # of a damaged file anything may be raised: it is compiled again, and the file replaced
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Cache a compiled function, unless it refers to addresses of this process or the disk is full."""
        path = self._path(sig, data.codegen)
        if path is None or data.lifted or data.library.has_dynamic_globals:
            return
        with suppress(OSError):
            content: bytes = dumps(data._reduce())  # type: ignore[no-untyped-call]
            write_atomically(path, lambda file: file.write(_seal(content)), durable=True)
            _remove_unused(path.parent)

    def enable(self) -> None:
        """Does nothing: the cache is always enabled."""

    def disable(self) -> None:
        """Does nothing."""

    def flush(self) -> None:
        """Does nothing: a file under a digest never becomes wrong."""

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        folder = cache_folder()
        try:
            made_of = digest(self._dispatcher)  # only now: a function may use later definitions
        except TypeError:  # another author's pass may use anything
            return None
        facts = (made_of, str(sig), codegen.magic_tuple(), numba.__version__, sys.implementation.cache_tag)
        name = self._dispatcher.py_func.__qualname__.replace("<locals>.", "")
        name = f"{name}-{hashlib.sha256(repr(facts).encode()).hexdigest()[:32]}{SUFFIX}"
        return folder / name if folder else None


@cache
def digest(function: Callable[..., Any]) -> str:
    """Hexadecimal digest of everything that a function's compiled code depends on, without comments, docstrings and
    line numbers. Raises TypeError for a global value that it cannot digest."""
    function = function.dispatcher if isinstance(function, KernelFunction) else function
    if isinstance(function, Dispatcher):
        parts = _all_parts((dict(function.targetoptions), function.py_func))
    elif isinstance(function, FunctionType):
        parts = _function_parts(function)
    else:
        raise TypeError(f"{function!r} is not a function")
    found = hashlib.sha256()
    for part in parts:
        found.update(part.encode() if isinstance(part, str) else part)
        found.update(b"\0")
    return found.hexdigest()


def _seal(content: bytes) -> bytes:
    """What a file holds: the content, and its hash, which pickle does not look at."""
    return content + hashlib.sha256(content).digest()


def _unseal(stored: bytes) -> bytes:
    """The content again; ValueError where a file is damaged."""
    content = stored[:-hashlib.sha256().digest_size]
    if _seal(content) != stored:
        raise ValueError("the file is damaged")
    return content


def _function_parts(function: FunctionType) -> Iterator[str | bytes]:
    yield _name(function)
    names: set[str] = set()
    for code in _codes(function.__code__):
        names.update(code.co_names)
        yield code.co_code
        yield repr((code.co_names, code.co_varnames, code.co_argcount, code.co_kwonlyargcount, code.co_flags))
        constants = [one for one in code.co_consts if not isinstance(one, CodeType)]
        yield from _all_parts(constants[function.__doc__ is not None and code is function.__code__:])
    yield from _all_parts(function.__defaults__ or ())
    used = [(name, function.__globals__[name]) for name in sorted(names) if name in function.__globals__]
    used += zip(function.__code__.co_freevars, (cell.cell_contents for cell in function.__closure__ or ()), strict=True)
    for module in [value for _, value in used if isinstance(value, ModuleType)]:
        if not _is_foreign(module.__name__):  # all that may be read of it
            used += [(name, getattr(module, name)) for name in sorted(names) if hasattr(module, name)]
    for name, value in used:
        yield name
        if getattr(value, "py_func", value) is not function:  # it may call itself
            yield from _parts(value)


def _parts(value: Any) -> Iterator[str | bytes]:
    """What a value is, as texts and bytes; of functions, the digest."""
    if isinstance(value, Dispatcher | KernelFunction):
        yield digest(value)
    elif isinstance(value, Intrinsic):
        yield digest(value.function)
    elif isinstance(value, _Intrinsic):
        yield digest(value._defn)
    elif isinstance(value, FunctionType):
        yield _name(value) if _is_foreign(value.__module__) else digest(value)
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes):
        yield repr(value)
    elif isinstance(value, np.ndarray | np.generic):
        yield f"{value.dtype} {value.shape}"
        yield value.tobytes()
    elif isinstance(value, dict):
        yield from _all_parts(sorted(value.items(), key=repr))
    elif isinstance(value, set | frozenset):
        yield from _all_parts(sorted(value, key=repr))
    elif isinstance(value, tuple | list | range):
        yield from _all_parts(value)
    elif isinstance(value, ModuleType | np.ufunc):
        yield value.__name__
    elif isinstance(value, numba.types.Type | ir.Type):
        yield str(value)
    elif hasattr(value, "__qualname__"):  # classes, functions written in C
        yield _name(value)
    else:
        raise TypeError(f"a kernel uses {value!r}, of which no digest can be made")


def _all_parts(values: Iterable[Any]) -> Iterator[str | bytes]:
    yield "("
    for value in values:
        yield from _parts(value)
    yield ")"


def _name(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}"


def _is_foreign(module: str) -> bool:
    return module.split(".")[0] in FOREIGN


def _codes(code: CodeType) -> Iterator[CodeType]:
    """A function's code and that of the functions inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


@cache
def _remove_unused(folder: Path) -> None:
    """Remove, once a process, files that no run loaded for long, and what older versions kept."""
    now = time.time()
    for path in folder.iterdir():
        with suppress(OSError):
            if now - path.stat().st_mtime > UNUSED:
                path.unlink()
    for path in folder.parent.glob(f"{FOLDER}-*"):  # a folder for each version of all sources
        with suppress(OSError):
            if now - path.stat().st_mtime > OUTDATED:
                shutil.rmtree(path)
