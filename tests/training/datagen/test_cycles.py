"""Clips that Cycles renders: what is made of its files. Blender itself runs where `bpy` is
installed."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from training.datagen.clip_file import load_clip, save_clip
from training.datagen.cycles.clips import Blender, CyclesOptions, make_clip, shrink
from training.datagen.cycles.exchange import clip_generator, read_pass, scene_generator


def render(scale: int) -> dict[str, np.ndarray]:
    """Two frames of 4x6 render pixels at a scale, each pixel with a value of its own."""
    h, w = 4 * scale, 6 * scale
    values = np.arange(2 * h * w, dtype=np.float32).reshape(2, h, w)
    return {"colour": np.repeat(values[..., None], 3, -1), "depth": values,
            "motion": np.full((2, h, w, 2), 6.0, np.float32)}


@pytest.mark.parametrize("scale", [1, 2, 3])
def test_a_shrunk_render_keeps_light_and_takes_depth_of_one_sample(scale):
    fine, small = render(scale), shrink(render(scale), scale)
    assert small["colour"].shape == (2, 4, 6, 3) and small["depth"].shape == (2, 4, 6)
    np.testing.assert_allclose(small["colour"].mean(), fine["colour"].mean(), rtol=1e-6)
    assert np.isin(small["depth"], fine["depth"]).all()  # no mean of two surfaces
    np.testing.assert_allclose(small["motion"], 6.0 / scale)  # in pixels of the smaller picture


def test_kinds_and_attempts_get_bodies_of_their_own():
    """Kinds that are built on the same studio must not show the same bodies, yet a clip is the same
    every time."""
    def first(*name: object) -> float:
        return float(scene_generator(*name).random())

    kinds = ("product", "glass", "text", "fur", "dof", "motion_blur")
    drawn = [first(7, 3, kind) for kind in kinds] + [first(7, 3, "product", 1),
                                                     first(7, 4, "product"), first(8, 3, "product"),
                                                     float(clip_generator(7, 3).random())]
    assert len(set(drawn)) == len(drawn)
    assert first(7, 3, "glass", 2) == first(7, 3, "glass", 2)
    # the same in Blender's Python: no hash that varies
    assert drawn[0] == pytest.approx(0.53761, abs=1e-5)


def test_a_pass_is_found_by_name_in_a_file_of_many_parts(tmp_path):
    names = ("Combined", "Denoising Albedo")
    specs = []
    for name in names:
        spec = oiio.ImageSpec(3, 2, 4, oiio.FLOAT)
        spec.channelnames = [f"ViewLayer.{name}.{c}" for c in "RGBA"]
        spec.attribute("oiio:subimagename", f"ViewLayer.{name}")
        specs.append(spec)
    path, pixels = tmp_path / "a.exr", np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), specs) and file.write_image(pixels)
    assert file.open(str(path), specs[1], "AppendSubimage") and file.write_image(-pixels)
    file.close()
    np.testing.assert_array_equal(read_pass(path, "Combined"), pixels)
    np.testing.assert_array_equal(read_pass(path, "Denoising Albedo", 3), -pixels[..., :3])
    with pytest.raises(KeyError, match="no pass Normal"):
        read_pass(path, "Normal")


def test_a_clip_keeps_the_other_half_of_its_reference(tmp_path):
    """A noisy render made of one half of the reference's samples is compared with the other
    half."""
    planes = {"colour": (2, 4, 4, 3), "diffuse_albedo": (2, 4, 4, 3),
              "specular_albedo": (2, 4, 4, 3), "normal": (2, 4, 4, 3), "roughness": (2, 4, 4),
              "depth": (2, 4, 4), "motion": (2, 4, 4, 2)}
    variant = {name: np.ones(shape, np.float32) for name, shape in planes.items()}
    variant |= {"jitter": np.zeros((2, 2)), "spp": 64, "style": "box"}
    facts = {"scale": 1.0, "seed": 0, "scene": "test", "meta": {},
             "half": np.full((2, 4, 4, 3), 2.0)}
    save_clip(tmp_path / "clip.00001.npz", np.full((2, 4, 4, 3), 3.0),
              [variant, variant | {"half": True}], facts)
    clip = load_clip(tmp_path / "clip.00001.npz")
    assert not clip["v0_half"] and clip["v1_half"] and (clip["half"] == 2).all()

    torch = pytest.importorskip("torch")
    from training.denoise.clips import load
    from training.denoise.dataset import collate

    loaded = load(tmp_path / "clip.00001.npz", torch.device("cpu"))
    stack = collate([loaded, loaded], [0, 1])
    assert (stack.reference[0] == 3).all() and (stack.reference[1] == 2).all()


def test_a_reference_with_negative_samples_has_an_exposure():
    """Volumes are sampled with weights of both signs, and few samples may sum to less than
    nothing."""
    pytest.importorskip("torch")
    from training.denoise.clips import grey_factor

    colour = np.full((8, 8, 3), 0.18)
    colour[0, 0] = -2.0
    assert 0.5 < grey_factor(colour) < 2.0


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("bpy") is None,
                    reason="Blender's module bpy is not installed")
def test_blender_renders_a_clip():
    options = CyclesOptions(16, 16, 2, most_spp=2, half_samples=4, kind="product")
    reference, variants, facts = make_clip(Blender(Path(sys.executable), None), options, seed=9000,
                                           index=0)
    assert np.isfinite(reference).all() and reference.mean() > 0
    assert facts["scene"] == "cycles.product" and facts["half"].shape == reference.shape
    assert {v["colour"].shape for v in variants} == {(2, 16, 16, 3)}
