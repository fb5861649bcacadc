"""The pass that mixes in what later frames make of a frame."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.frame import Frame, Part, Role
from postfx.passes.composite import BothWays
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.plan import make_plan
from postfx.runtime import Device


def frame(weight: float | np.ndarray, later: float = 3.0, colour: float = 1.0) -> Frame:
    """A frame of one colour, and of another one with this weight."""
    weights = np.broadcast_to(np.float32(weight), (6, 8, 1))
    plane = np.concatenate([np.float32(later) * weights.repeat(3, 2), weights], 2)
    return Frame({Role.COLOUR: np.full((6, 8, 3), colour, np.float32), Role.LATER: plane})


@pytest.fixture(scope="module", params=[True, False], ids=["compiled", "portable"])
def passes(request) -> Pipeline:
    return Pipeline([BothWays()], Device("cpu", threads=1, compiled_kernels=request.param),
                    exposure=0.0)


@pytest.mark.parametrize(("weight", "expected"), [(0, 1), (1, 3), (0.25, 1.5)])
def test_it_mixes_by_weight(passes, weight, expected):
    result = passes(frame(weight))
    assert Role.LATER not in result
    np.testing.assert_allclose(result[Role.COLOUR], expected, rtol=1e-6)


def test_weights_count_pixel_by_pixel(passes):
    weights = np.linspace(0, 1, 48, dtype=np.float32).reshape(6, 8, 1)
    np.testing.assert_allclose(passes(frame(weights))[Role.COLOUR], (1 + 2 * weights).repeat(3, 2),
                               rtol=1e-6)


def test_parts_get_their_share_of_the_mixed_picture(passes):
    both = Pipeline([BothWays(parts=["key", "fill", Part("z", "depth")])], passes.device,
                    exposure=0.0)
    given = frame(np.linspace(0, 1, 48, dtype=np.float32).reshape(6, 8, 1))
    given.parts = {"key": 0.75 * given[Role.COLOUR], "fill": 0.25 * given[Role.COLOUR],
                   "z": given[Role.COLOUR] * 9}
    result = both(given)
    np.testing.assert_allclose(result.parts["key"], 0.75 * result[Role.COLOUR], rtol=1e-6)
    np.testing.assert_allclose(result.parts["fill"], 0.25 * result[Role.COLOUR], rtol=1e-6)
    np.testing.assert_array_equal(result.parts["z"], given.parts["z"])


def test_parts_with_light_below_0_add_up_to_the_mixed_picture(passes):
    """A part brighter than the picture was cut to it."""
    shares = {"key": 1.5, "dark": -0.75, "fill": 0.25}
    both = Pipeline([BothWays(parts=list(shares))], passes.device, exposure=0.0)
    given = frame(np.linspace(0, 1, 48, dtype=np.float32).reshape(6, 8, 1))
    given.parts = {name: share * given[Role.COLOUR] for name, share in shares.items()}
    result = both(given)
    np.testing.assert_allclose(sum(result.parts.values()), result[Role.COLOUR], rtol=1e-5)
    assert result.parts["dark"].max() < 0 < result.parts["fill"].min()


def test_it_says_why_it_does_nothing():
    spec = Frame({Role.COLOUR: np.ones((6, 8, 3), np.float32)}).spec
    (skip,) = [item for item in make_plan([BothWays()], spec).skips if item.what == "both_ways"]
    assert skip.why == "later frames were not processed"


def test_the_upscaler_hands_the_plane_on_as_it_is():
    rng = np.random.default_rng(2)
    later = rng.random((12, 16, 4), np.float32)
    small = Frame({Role.COLOUR: rng.random((6, 8, 3), np.float32)}, guides={Role.LATER: later},
                  jitter=(0.3, -0.2))
    result = Pipeline([DenoiseUpscale(strength=0)], Device("cpu", threads=1), exposure=0.0)(small)
    np.testing.assert_array_equal(result[Role.LATER], later)
