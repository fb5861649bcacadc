"""The stand-in for Mitsuba's OptiX denoiser, on what Mitsuba renders."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from postfx import PostfxError

mi = pytest.importorskip("mitsuba")
SIZE = 32


@pytest.fixture(scope="module")
def denoiser_type():
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    sys.path.insert(0, str(Path(__file__).parents[2] / "hosts"))
    try:
        from postfx_mitsuba import Denoiser

        yield Denoiser
    finally:
        sys.path.pop(0)
        if before is not None:
            mi.set_variant(before)


@pytest.fixture(scope="module")
def room(denoiser_type):
    """Cornell's box: a bitmap of four samples with albedo and normals, and the colour of 64."""
    scene = mi.cornell_box() | {"integrator": {"type": "aov", "aovs": "albedo:albedo,nn:sh_normal",
                                               "image": {"type": "path", "max_depth": 4}}}
    scene["sensor"]["film"] |= {"width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    scene = mi.load_dict(scene)
    layers = np.array(mi.render(scene, spp=4))
    bitmap = scene.sensors()[0].film().bitmap()
    return bitmap, layers, np.array(mi.render(scene, spp=64))[..., :3]


def parameters(signature: str) -> list[str]:
    """Names of what a function takes, as its documentation by nanobind lists them."""
    inside = re.search(r"\((.*)\) ->", signature)[1]
    return [re.match(r"\s*(\w+)", part)[1] for part in re.split(r",(?![^\[]*\])", inside)][1:]


def test_the_interface_is_mitsubas(denoiser_type):
    import inspect

    real = mi.OptixDenoiser
    made = parameters(real.__init__.__doc__.strip().splitlines()[0])
    ours = inspect.signature(denoiser_type).parameters.values()
    assert made == [parameter.name
                    for parameter in ours if parameter.kind is not parameter.KEYWORD_ONLY]
    tensors, bitmap = (parameters(line) for line in real.__call__.__doc__.strip().splitlines()[:2])
    assert tensors == list(inspect.signature(denoiser_type._of_tensors).parameters)[1:]
    assert bitmap == list(inspect.signature(denoiser_type._of_bitmap).parameters)[1:]


def error(picture, reference):
    return float(np.mean((picture / (1 + picture) - reference / (1 + reference)) ** 2))


def test_tensors_and_bitmaps(denoiser_type, room):
    bitmap, layers, reference = room
    noisy, albedo, normals = layers[..., :3], layers[..., 3:6], layers[..., 6:9]
    make = {"input_size": mi.ScalarVector2u(SIZE, SIZE), "albedo": True, "normals": True,
            "model": "s", "device": "cpu"}
    found = denoiser_type(**make)(mi.TensorXf(noisy), mi.TensorXf(albedo), mi.TensorXf(normals))
    assert isinstance(found, mi.TensorXf) and np.array(found).shape == (SIZE, SIZE, 3)
    assert error(np.array(found), reference) < 0.5 * error(noisy, reference)
    again = denoiser_type(**make)(bitmap, "albedo", "nn", to_sensor=mi.ScalarTransform4f())
    assert isinstance(again, mi.Bitmap) and again.component_format() == mi.Struct.Type.Float32
    assert np.allclose(np.array(again), np.array(found), rtol=1e-5)


def test_a_sequence_with_flow_and_alpha(denoiser_type):
    rng = np.random.default_rng(0)
    # moves 4 pixels to the right a frame
    wide = np.repeat(np.repeat(rng.random((8, 24, 3), np.float32), 4, 0), 4, 1)
    flow = mi.TensorXf(np.tile(np.float32([4, 0]), (SIZE, SIZE, 1)))
    frames = [np.dstack([wide[:, 60 - 4 * i:60 - 4 * i + SIZE] * rng.gamma(1, 1, (SIZE, SIZE, 1))
                         .astype("f4"), np.full((SIZE, SIZE), 0.25 * i, np.float32)])
              for i in range(4)]
    clean = [wide[:, 60 - 4 * i:60 - 4 * i + SIZE] for i in range(4)]
    errors = {}
    for sign in (1, -1):
        denoiser = denoiser_type([SIZE, SIZE], temporal=True, model="s", device="cpu")
        previous, errors[sign] = mi.TensorXf(frames[0]), []
        for frame, right in zip(frames, clean, strict=True):
            previous = denoiser(mi.TensorXf(frame), flow=sign * flow, previous_denoised=previous)
            assert np.array_equal(np.array(previous)[..., 3], frame[..., 3])
            errors[sign].append(error(np.array(previous)[..., :3], right))
    assert errors[1][3] < 0.8 * errors[1][0] and errors[1][3] < 0.8 * errors[-1][3]
    fresh = denoiser(mi.TensorXf(frames[0]), flow=flow, previous_denoised=mi.TensorXf(frames[0]))
    alone = denoiser_type([SIZE, SIZE], temporal=True, model="s", device="cpu")(
        mi.TensorXf(frames[0]), flow=flow, previous_denoised=mi.TensorXf(frames[0]))
    assert np.array_equal(np.array(fresh), np.array(alone))


def test_wrong_arguments_are_named(denoiser_type, room):
    bitmap, layers, _ = room
    noisy = mi.TensorXf(layers[..., :3])
    with pytest.raises(PostfxError, match="'albedo' is missing: give it"):
        denoiser_type([SIZE, SIZE], albedo=True, model="s", device="cpu")(noisy)
    denoiser = denoiser_type([SIZE, SIZE], model="s", device="cpu")
    with pytest.raises(PostfxError, match="'normals' is not expected: make the denoiser with it"):
        denoiser(noisy, normals=noisy)
    with pytest.raises(PostfxError,
                       match="'noisy' is 16x32 pixels, the denoiser was made for 32x32"):
        denoiser(mi.TensorXf(layers[:, :16, :3]))
    with pytest.raises(PostfxError, match="the bitmap has no layer 'depth': it has "):
        denoiser(bitmap, "depth")
    with pytest.raises(PostfxError, match="input_size 0x4"):
        denoiser_type([0, 4])
