"""The contract, held against every registered pass: a new pass is tested here without a line of
test code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postfx.errors import PassOptionError
from postfx.neural import Network
from postfx.passes import registry, scene
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.partner import MixPartner
from postfx.passes.tonemap import ToneMap
from postfx.runtime import Device, Library
from postfx.testing import Maker, PassContract
from tests import toys

ROOM = Path(__file__).parents[2] / "samples/room"
TOYS = {"toy double": toys.Double, "toy sum": toys.Sum, "toy enlarge": toys.Enlarge,
        "toy guide": toys.AddGuide}


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Library:
    return toys.make_library(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def portable(tmp_path_factory) -> Device:
    """With the portable kernels of the toys, too."""
    return Device("cpu", compiled_kernels=False,
                  kernels=toys.make_kernels(tmp_path_factory.mktemp("kernels")))


class TestEveryPass(PassContract):
    """The suite that packages with passes use, once for each of ours."""

    @pytest.fixture(params=[*registry.BUILT_IN, *TOYS])
    def make(self, request, library, tmp_path, monkeypatch) -> Maker:
        """Makes the pass under test, with its default options and the model that it cannot do
        without."""
        if request.param == "toy double":
            return lambda **options: toys.Double(**{"library": library, **options})
        # integers turn over with the last bit of what another kernel computes
        if request.param == "denoise_upscale":
            return lambda **options: registry.load(request.param)(**{"model": "m.fp32", **options})
        if request.param == "irradiance":
            network = Network(3, (4,), 3)
            network.save_onnx(tmp_path / "sky.onnx", network.initial(1))
            return lambda **options: scene.Irradiance(**{"model": str(tmp_path / "sky.onnx"),
                                                         **options})
        if request.param == "scene_shading":  # the suite's frames have no camera
            monkeypatch.setattr(scene, "camera_of",
                                lambda frame: np.linspace(-1, 1, scene.CAMERA_NUMBERS,
                                                          dtype=np.float32))
            return lambda **options: scene.SceneShading(**{"model": str(ROOM / "temporal.onnx"),
                                                           **options})
        if request.param in ("oidn", "partner"):
            pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")
        return TOYS[request.param] if request.param in TOYS else registry.load(request.param)


@pytest.mark.parametrize(("make", "option"), [
    (DenoiseUpscale, "strength"), (DenoiseUpscale, "budget"), (ToneMap, "keep"),
    (MixPartner, "strength"), (MixPartner, "scale"),
])
@pytest.mark.parametrize("given", [[2], "two", {}])
def test_what_is_no_number_is_refused_in_one_line(make, option: str, given: object) -> None:
    with pytest.raises(PassOptionError, match=rf"has {option} .*: give a number"):
        make(**{option: given})
