"""Mitsuba for tests: they are skipped where it is missing, or finds no LLVM that its variant
llvm_ad_rgb can use."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest


def require_llvm() -> Any:
    """The module mitsuba, with an LLVM for it and for the processes that a test starts."""
    mitsuba = pytest.importorskip("mitsuba", reason="mitsuba is not installed (extra 'train')")
    found = [*Path("/usr/lib").glob("*/libLLVM*19*"),
             *Path("/usr/lib/llvm-19/lib").glob("libLLVM*.so*")]
    if found:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(found[0]))
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        pytest.skip("no libLLVM newer than 15 for Mitsuba's llvm_ad_rgb", allow_module_level=True)
    return mitsuba


def require_mitsuba() -> Any:
    """The same, with the variant llvm_ad_rgb."""
    mitsuba = require_llvm()
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba
