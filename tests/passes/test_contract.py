"""The contract, held against every registered pass: a new pass is tested here without a line of test code."""

from __future__ import annotations

import pytest

from postfx.passes import registry
from postfx.runtime import Device, Library
from postfx.testing import Maker, PassContract
from tests import toys

TOYS = {"toy double": toys.Double, "toy sum": toys.Sum, "toy enlarge": toys.Enlarge, "toy guide": toys.AddGuide}


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Library:
    return toys.make_library(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def portable(tmp_path_factory) -> Device:
    """With the portable kernels of the toys, too."""
    return Device("cpu", compiled_kernels=False, kernels=toys.make_kernels(tmp_path_factory.mktemp("kernels")))


class TestEveryPass(PassContract):
    """The suite that packages with passes use, once for each of ours."""

    @pytest.fixture(params=[*registry.BUILT_IN, *TOYS])
    def make(self, request, library) -> Maker:
        """Makes the pass under test, with its default options."""
        if request.param == "toy double":
            return lambda **options: toys.Double(**{"library": library, **options})
        if request.param == "denoise_upscale":  # integers turn over with the last bit of what another kernel computes
            return lambda **options: registry.load(request.param)(**{"model": "m.fp32", **options})
        if request.param in ("oidn", "partner"):
            pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")
        return TOYS[request.param] if request.param in TOYS else registry.load(request.param)
