"""Flags by which threads tell each other of their work without the interpreter's lock, and waiting for them awake.

A flag is one of ``AWAY``, ``WAITING`` and ``BUSY``, the first number of a row of ``flags`` (n, LINE) of int64: rows do
not share what a processor's cache holds at once.
"""

import platform
import time
from functools import cache

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from postfx.kernels.numeric import compiled

AWAY, WAITING, BUSY = range(3)
LINE = 8
SAMPLE = 2000
PAUSES = {"x86_64": ("llvm.x86.sse2.pause", ()), "aarch64": ("llvm.aarch64.hint", (1,))}
"""What tells a processor that a thread only waits: LLVM's name and its arguments."""


@intrinsic
def load(typingctx, flags, i):
    """The flag of row i, as other threads left it."""

    def generate(context, builder, signature, arguments):
        return builder.load_atomic(_place(context, builder, signature, arguments), "seq_cst", LINE)

    return types.int64(flags, i), generate


@intrinsic
def replace(typingctx, flags, i, known, new):
    """Set the flag of row i to `new` if it is `known`, in one step; whether it was."""

    def generate(context, builder, signature, arguments):
        place = _place(context, builder, signature, arguments)
        found = builder.cmpxchg(place, arguments[2], arguments[3], "seq_cst", "seq_cst")
        return builder.extract_value(found, 1)

    return types.boolean(flags, i, types.int64, types.int64), generate


@intrinsic
def pause(typingctx):
    """Let some moments pass."""

    def generate(context, builder, signature, arguments):
        name, given = PAUSES.get(platform.machine(), (None, ()))
        if name:
            kinds = [ir.IntType(32)] * len(given)
            function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), kinds))
            builder.call(function, [kind(value) for kind, value in zip(kinds, given, strict=True)])
        return context.get_dummy_value()

    return types.void(), generate


def _place(context, builder, signature, arguments):
    flags = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(flags.data, [builder.mul(arguments[1], arguments[1].type(LINE))])


@compiled
def pauses(count):
    for _ in range(count):
        pause()


@compiled
def is_taken(flags, i):
    """Give a helper that waits its next band; False when it does not wait any more."""
    return replace(flags, i, WAITING, BUSY)


@compiled
def is_called(flags, i, looks, delay):
    """Tell that a helper is done with its band, and look for the next one for a while.

    True when there is one, after `delay` pauses, in which the thread that gave it can let go of the interpreter's lock;
    False when the helper is away from now on.
    """
    replace(flags, i, BUSY, WAITING)
    for _ in range(looks):
        if load(flags, i) == BUSY:
            pauses(delay)
            return True
        pause()
    return not replace(flags, i, WAITING, AWAY)


@compiled
def is_done(flags, i, looks):
    """Look for a while whether a helper is done with its band."""
    for _ in range(looks):
        if load(flags, i) != BUSY:
            return True
        pause()
    return False


@cache
def pauses_in(seconds: float) -> int:
    """About how many pauses this processor makes in a time, 1 at least."""
    pauses(1)
    least = min(_timed(SAMPLE) for _ in range(3))
    return max(1, int(seconds * SAMPLE / least))


def _timed(count: int) -> float:
    begin = time.perf_counter()
    pauses(count)
    return time.perf_counter() - begin
