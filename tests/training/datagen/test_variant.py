"""A libLLVM that would abort is refused, with one that works."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from training.datagen.variant import llvm_fault, use_variant


@pytest.mark.parametrize(("version", "told"), [((15, 0, 6), "libLLVM 15.0.6 aborts"),
                                               ((14,), "libLLVM 14 aborts"),
                                               (None, "no libLLVM is there")])
def test_old_ones_are_refused(version: tuple[int, ...] | None, told: str) -> None:
    fault = llvm_fault(version)
    assert (fault is not None and told in fault and "libLLVM "
            "19" in fault and "DRJIT_LIBLLVM_PATH=" in fault)


def test_newer_ones_are_taken() -> None:
    assert llvm_fault((16, 0, 0)) is llvm_fault((19, 1, 7)) is None


def test_it_is_refused_before_anything_is_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    mitsuba = pytest.importorskip("mitsuba")
    before, drjit = mitsuba.variant(), pytest.importorskip("drjit")
    monkeypatch.setattr(drjit.detail, "llvm_version", lambda: (15, 0, 6))
    with pytest.raises(SystemExit, match=r"15\.0\.6 aborts: install libLLVM 19"):
        use_variant("llvm_ad_rgb")
    if before:  # what other tests rely on
        mitsuba.set_variant(before)


def test_one_that_is_not_there_is_told_without_a_traceback() -> None:
    """After what Dr.Jit itself writes."""
    pytest.importorskip("mitsuba")
    lines = "from training.datagen.variant import use_variant; use_variant('llvm_ad_rgb')"
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True,
                          env=os.environ | {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"})
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith("error: no libLLVM is there: install libLLVM 19")
