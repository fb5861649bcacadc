"""Chooses Mitsuba's variant, and refuses a libLLVM that would abort the process in the middle of a
render."""

from __future__ import annotations

OLDEST_LLVM = 16
"""Dr.Jit finds older ones, too, whose code generator ends the process: 'Cannot select: fmaximum' in
15.0.6."""


def use_variant(name: str) -> None:
    """Use this variant. What is imported from Mitsuba from here on has its types. Raises SystemExit
    with the fix."""
    import mitsuba as mi

    try:
        mi.set_variant(name)
    except ImportError as error:  # Dr.Jit found no libLLVM
        raise SystemExit(f"error: {llvm_fault(None)}" if name.startswith("llvm")
                         else f"error: Mitsuba's variant {name}: {error}") from error
    if name.startswith("llvm"):
        import drjit

        fault = llvm_fault(drjit.detail.llvm_version())
        if fault:
            raise SystemExit(f"error: {fault}")


def llvm_fault(version: tuple[int, ...] | None) -> str | None:
    """Why a version of libLLVM cannot be used, and what can; None if it can."""
    if version is not None and version[0] >= OLDEST_LLVM:
        return None
    found = ("no libLLVM is there" if version is None
             else f"libLLVM {'.'.join(map(str, version))} aborts")
    return (f"{found}: install libLLVM 19 and name its file, e.g. "
            "DRJIT_LIBLLVM_PATH=/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1; at least 16 is needed")
