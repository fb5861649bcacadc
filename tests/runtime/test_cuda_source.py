"""Constants of the CUDA kernels are those of Python, and defined nowhere else."""

from __future__ import annotations

import re

import numpy as np
import pytest

from postfx.runtime.cuda import CONSTANTS, SOURCES, print_constants


def test_printed_constants_have_the_values_of_python():
    found = dict(re.findall(r"(\w+) = ([^,; ]+)", print_constants()))
    assert found.keys() == CONSTANTS.keys()
    for name, text in found.items():
        assert np.float32(text.removesuffix("f")) == np.float32(CONSTANTS[name])
        assert text.endswith("f") != isinstance(CONSTANTS[name], int)


@pytest.mark.parametrize("path", sorted((*SOURCES.rglob("*.cu"), *SOURCES.rglob("*.cuh"))), ids=lambda path: path.name)
def test_no_source_defines_them_again(path):
    defined = re.findall(r"^(?:\[\[maybe_unused\]\] )?(?:enum|const \w+) .*", path.read_text(), re.M)
    again = {name for line in defined for name in re.findall(r"\b([A-Z_\d]+)\b(?= [=,}]|[,;])", line)}
    assert not again & CONSTANTS.keys()
