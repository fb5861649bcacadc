"""Constants of the CUDA kernels are those of Python, and defined nowhere else."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from postfx.kernels import KERNEL_SOURCES, SHARED, constants_of, print_constants, read_source
from postfx.kernels import denoise as layout
from postfx.kernels.denoise import history, output

FAMILIES = sorted(KERNEL_SOURCES.rglob("*.cu"))


def constants(path: Path) -> dict[str, int | float]:
    return constants_of(path, read_source(path))


def test_constants_are_those_of_the_module_beside_the_file_and_of_the_layout() -> None:
    found = constants(SHARED / "denoise/history.cu")
    assert (found["ROUGHEST"], found["MAX_COLOUR"]) == (history.ROUGHEST, layout.MAX_COLOUR)
    low, high = output.STRUCTURE
    found = constants(SHARED / "denoise/output.cu")
    assert (found["STRUCTURE_LOW"], found["STRUCTURE_HIGH"], found["TILE"]) == (low, high,
                                                                                output.TILE)


@pytest.mark.parametrize("path", FAMILIES, ids=lambda path: path.name)
def test_printed_constants_have_the_values_of_python(path: Path) -> None:
    known = constants(path)
    with np.printoptions(precision=3, legacy="1.13"):  # a program's own
        printed = print_constants(known)
    found = re.findall(r"const (int|float|double) (\w+) = (\S+?)f?;", printed)
    assert [name for _, name, _ in found] == list(known)
    for kind, name, text in found:
        exact = {"int": int, "float": np.float32, "double": np.float64}[kind]
        assert exact(text) == exact(known[name]) and (kind == "int") == isinstance(known[name], int)


@pytest.mark.parametrize("path", FAMILIES, ids=lambda path: path.name)
def test_no_source_defines_them_again(path: Path) -> None:
    lines = re.findall(r"^(?:\[\[maybe_unused\]\] )?(?:enum|const \w+) .*", read_source(path), re.M)
    defined = [name for line in lines for name in re.findall(
        r"\b[A-Z][A-Z_\d]+\b" + (r"(?= =)" if line.startswith(("const", "[")) else ""), line
    )]
    assert len(defined) == len(set(defined)) and set(constants(path)) <= set(defined)


def headers_of(source: Path) -> Iterator[Path]:
    """Headers that a source includes, and those that they do."""
    for name in re.findall(r'^#include "(.+)"', source.read_text("utf-8"), re.M):
        header = (source.parent / name).resolve()
        yield header
        yield from headers_of(header)


@pytest.mark.parametrize("path", FAMILIES, ids=lambda path: path.name)
def test_headers_have_the_same_constants_on_a_gpu(path: Path) -> None:
    """Python's stand there, those of the module beside the CUDA source before those of the
    layout."""
    known, headers = constants(path), {*headers_of(SHARED / "common.cuh"), *headers_of(path)}
    texts = {header.name: header.read_text("utf-8") for header in headers}
    named = "".join(text for name, text in texts.items() if name != "denoise.h")
    for header, text in texts.items():
        for name, value in re.findall(r"^constexpr \w+ ([A-Z][A-Z\d_]+) = (-?[\d.e+-]+)f?;", text,
                                      re.M):
            if name in known and re.search(rf"\b{name}\b", named):
                assert np.float32(value) == np.float32(known[name]), f"{header}: {name}"


def test_a_header_is_in_a_source_once_and_without_what_is_a_cpu_s_alone() -> None:
    """Also where two headers include it."""
    source = read_source(SHARED / "denoise/classic.cu")
    assert source.count("struct Accumulated {") == source.count("struct Tint {") == 1
    assert "WIDE" not in source and "#include" not in source and "#pragma once" not in source
