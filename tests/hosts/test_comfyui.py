"""Nodes for ComfyUI, as its executor calls them: by the names that INPUT_TYPES declares, with its tensors."""

import inspect
import math
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx import DenoiseUpscale, Pipeline, PostfxError, Role, ToneMap

torch = pytest.importorskip("torch")
ROOT = Path(__file__).parents[2]
ROOM = str(ROOT / "samples/room/noisy.####.exr")
WIDGETS = {"STRING": str, "FLOAT": float, "INT": int}


@pytest.fixture(scope="module")
def nodes():
    """The package, found as ComfyUI finds it: by the path of its folder."""
    path = ROOT / "hosts/comfyui_postfx/__init__.py"
    spec = spec_from_file_location("custom_nodes.comfyui_postfx", path)
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def call(nodes, name, **given):
    """A node's result as ComfyUI takes it; widgets that are not given have their defaults."""
    node = nodes.NODE_CLASS_MAPPINGS[name]
    for key, (kind, *options) in node.INPUT_TYPES()["required"].items():
        default = kind[0] if isinstance(kind, list) else None
        given.setdefault(key, (options or [{}])[0].get("default", default))
    result = getattr(node(), node.FUNCTION)(**given)
    return result["result"][0] if isinstance(result, dict) else result[0]


def test_nodes_declare_what_comfyui_asks_for(nodes):
    assert nodes.NODE_CLASS_MAPPINGS.keys() == nodes.NODE_DISPLAY_NAME_MAPPINGS.keys()
    for node in nodes.NODE_CLASS_MAPPINGS.values():
        inputs = node.INPUT_TYPES()
        assert set(inputs) <= {"required", "optional"} and node.CATEGORY == "postfx" and node.DESCRIPTION
        assert isinstance(node.RETURN_TYPES, tuple) and set(node.RETURN_TYPES) <= {"STRING", "IMAGE", nodes.FRAMES}
        declared = [name for part in inputs.values() for name in part]
        assert declared == list(inspect.signature(getattr(node, node.FUNCTION)).parameters)[1:]
        for kind, *options in (entry for part in inputs.values() for entry in part.values()):
            assert isinstance(kind, list) or kind in {*WIDGETS, "IMAGE", nodes.FRAMES}
            if not isinstance(kind, list) and kind in WIDGETS:
                assert isinstance(options[0]["default"], WIDGETS[kind])
    assert math.isnan(nodes.NODE_CLASS_MAPPINGS["PostfxLoadSequence"].IS_CHANGED(pattern="", frames=""))


def test_from_files_to_files(nodes, tmp_path):
    shot = call(nodes, "PostfxLoadSequence", pattern=ROOM, frames="1-2")
    clean = call(nodes, "PostfxDenoise", frames=shot, model="s")
    files = call(nodes, "PostfxSaveFrames", frames=clean, output=str(tmp_path / "clean.####.exr"))
    assert files == str(tmp_path / "clean.####.exr") and len(list(tmp_path.iterdir())) == 2
    pictures = call(nodes, "PostfxFramesToImages", frames=call(nodes, "PostfxLook", frames=clean))
    assert pictures.shape == (2, 360, 640, 3) and pictures.dtype is torch.float32
    pipeline = Pipeline([DenoiseUpscale(scale=2, model="s"), ToneMap(tag="aces2")])
    for picture, frame in zip(pictures, postfx.read_sequence(ROOM, frames="1-2"), strict=True):
        assert np.array_equal(picture.numpy(), pipeline(frame)[Role.COLOUR])


def test_from_images_to_images(nodes):
    images = torch.rand(2, 24, 32, 3, generator=torch.Generator().manual_seed(0))
    shot = call(nodes, "PostfxImagesToFrames", images=images)
    again = call(nodes, "PostfxFramesToImages", frames=shot)
    assert torch.allclose(again, images, atol=1e-5)
    guided = call(nodes, "PostfxImagesToFrames", images=images, encoding="linear", albedo=images, normals=images)
    frame = next(iter(call(nodes, "PostfxDenoise", frames=guided, scale=1.0, model="s")))
    assert frame[Role.COLOUR].shape == (24, 32, 3) and not np.array_equal(frame[Role.COLOUR], images[0].numpy())


def test_wrong_use_is_told_before_frames_are_made(nodes, tmp_path):
    shot = call(nodes, "PostfxLoadSequence", pattern=ROOM)
    with pytest.raises(PostfxError, match="has no place for the number of 8 frames: write ####"):
        call(nodes, "PostfxSaveFrames", frames=shot, output=str(tmp_path / "clean.exr"))
    with pytest.raises(PostfxError, match="scale"):
        call(nodes, "PostfxDenoise", frames=shot, scale=7.0)
    images = torch.zeros(2, 4, 4, 3)
    with pytest.raises(PostfxError, match="there are 2 images and 1 of albedo"):
        call(nodes, "PostfxImagesToFrames", images=images, albedo=images[:1])
    with pytest.raises(PostfxError, match="nowhere"):
        call(nodes, "PostfxLoadSequence", pattern=str(tmp_path / "nowhere.####.exr"))
