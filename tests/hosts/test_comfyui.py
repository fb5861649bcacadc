"""Nodes for ComfyUI: called by the names that INPUT_TYPES declares, and in ComfyUI itself where
POSTFX_COMFYUI names its folder (POSTFX_COMFYUI_PYTHON the Python that has what it requires; both
run on the CPU, on this machine alone)."""

import inspect
import json
import math
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import postfx
from postfx import DenoiseUpscale, Pipeline, PostfxError, Role, ToneMap

torch = pytest.importorskip("torch")
ROOT = Path(__file__).parents[2]
ROOM = str(ROOT / "samples/room/noisy.####.exr")
COMFYUI = os.environ.get("POSTFX_COMFYUI")
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
        assert (set(inputs) <= {"required", "optional"} and node.CATEGORY == "postfx"
                and node.DESCRIPTION)
        assert (isinstance(node.RETURN_TYPES, tuple)
                and set(node.RETURN_TYPES) <= {"STRING", "IMAGE", nodes.FRAMES})
        declared = [name for part in inputs.values() for name in part]
        assert declared == list(inspect.signature(getattr(node, node.FUNCTION)).parameters)[1:]
        for kind, *options in (entry for part in inputs.values() for entry in part.values()):
            assert isinstance(kind, list) or kind in {*WIDGETS, "IMAGE", nodes.FRAMES}
            if not isinstance(kind, list) and kind in WIDGETS:
                assert isinstance(options[0]["default"], WIDGETS[kind])


def test_frames_that_are_written_anew_are_read_again(nodes, tmp_path):
    is_changed = nodes.NODE_CLASS_MAPPINGS["PostfxLoadSequence"].IS_CHANGED
    for number in (1, 2):
        shutil.copy(ROOM.replace("####", f"000{number}"), tmp_path)
    found = is_changed(pattern=str(tmp_path), frames="")
    assert is_changed(pattern=str(tmp_path), frames="") == found
    os.utime(tmp_path / "noisy.0002.exr", (1, 1))
    assert is_changed(pattern=str(tmp_path), frames="") != found
    # what another node gives is not known yet
    assert math.isnan(is_changed(pattern=None, frames=""))


def test_from_files_to_files(nodes, tmp_path):
    shot = call(nodes, "PostfxLoadSequence", pattern=ROOM, frames="1-2")
    clean = call(nodes, "PostfxDenoise", frames=shot, scale=2.0, model="s")
    files = call(nodes, "PostfxSaveFrames", frames=clean, output=str(tmp_path / "clean.####.exr"))
    assert files == str(tmp_path / "clean.####.exr") and len(list(tmp_path.iterdir())) == 2
    pictures = call(nodes, "PostfxFramesToImages", frames=call(nodes, "PostfxLook", frames=clean))
    assert pictures.shape == (2, 360, 640, 3) and pictures.dtype is torch.float32
    pipeline = Pipeline([DenoiseUpscale(scale=2, model="s"), ToneMap(look="aces2")])
    for picture, frame in zip(pictures, postfx.read_sequence(ROOM, frames="1-2"), strict=True):
        assert np.array_equal(picture.numpy(), pipeline(frame)[Role.COLOUR])


def test_from_images_to_images(nodes):
    images = torch.rand(2, 24, 32, 3, generator=torch.Generator().manual_seed(0))
    shot = call(nodes, "PostfxImagesToFrames", images=images)
    again = call(nodes, "PostfxFramesToImages", frames=shot)
    assert torch.allclose(again, images, atol=1e-5)
    guided = call(nodes, "PostfxImagesToFrames", images=images, encoding="linear", albedo=images,
                  normals=images)
    frame = next(iter(call(nodes, "PostfxDenoise", frames=guided, scale=1.0, model="s")))
    assert (frame[Role.COLOUR].shape == (24, 32, 3)
            and not np.array_equal(frame[Role.COLOUR], images[0].numpy()))


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
    with pytest.raises(PostfxError, match="2 of 3 frames are missing: 9-10"):
        call(nodes, "PostfxLoadSequence", pattern=ROOM, frames="8-10")


class Server:
    """ComfyUI with our nodes, asked as its page asks it."""

    def __init__(self, folder: Path) -> None:
        (folder / "custom_nodes").mkdir()
        (folder / "custom_nodes/comfyui_postfx").symlink_to(ROOT / "hosts/comfyui_postfx")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address, self.log = f"http://127.0.0.1:{port}", folder / "log.txt"
        python = os.environ.get("POSTFX_COMFYUI_PYTHON") or sys.executable
        command = [python, "main.py", "--cpu", "--listen", "127.0.0.1", "--port", str(port),
                   "--disable-api-nodes", "--base-directory", str(folder)]
        with self.log.open("w") as log:
            self.process = subprocess.Popen(command, cwd=COMFYUI, stdout=log, stderr=log,
                                            env=os.environ | {"PYTHONPATH": str(ROOT)})

    def ask(self, path: str, body: dict | None = None) -> dict:
        request = urllib.request.Request(self.address + path,
                                         None if body is None else json.dumps(body).encode())
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return json.loads(answer.read() or "{}")
        except urllib.error.HTTPError as error:
            return json.loads(error.read())

    def wait_until(self, answers) -> None:
        end = time.monotonic() + 120
        while True:
            try:
                if answers():
                    return
            except urllib.error.URLError:  # it has not begun to listen
                pass
            assert (self.process.poll() is None
                    and time.monotonic() < end), self.log.read_text()[-3000:]
            time.sleep(0.1)

    def run(self, meanwhile=lambda: None, **nodes: dict) -> tuple[dict, dict]:
        """What happened (event -> its data) and what output nodes showed, of a graph: name -> a
        node's JSON."""
        prompt = self.ask("/prompt", {"prompt": nodes})["prompt_id"]
        meanwhile()
        self.wait_until(lambda: prompt in self.ask(f"/history/{prompt}"))
        done = self.ask(f"/history/{prompt}")[prompt]
        return dict(done["status"]["messages"]), done["outputs"]


def node(kind: str, **inputs) -> dict:
    return {"class_type": kind, "inputs": inputs}


@pytest.fixture
def server(tmp_path):
    server = Server(tmp_path)
    try:
        server.wait_until(lambda: server.ask("/system_stats"))
        yield server
    finally:
        server.process.kill()
        server.process.wait()


@pytest.mark.skipif(COMFYUI is None, reason="needs ComfyUI (POSTFX_COMFYUI names its folder)")
def test_in_comfyui_itself(server, tmp_path):
    comfy, folder = server, tmp_path
    (folder / "input/shot").mkdir(parents=True, exist_ok=True)
    for number in (1, 2):
        shutil.copy(ROOM.replace("####", f"000{number}"), folder / "input/shot")
    graph = {
        "load": node("PostfxLoadSequence", pattern="shot", frames=""),
        "denoise": node("PostfxDenoise", frames=["load", 0], scale=2.0, model="s", strength=1.0),
        "save": node("PostfxSaveFrames", frames=["denoise", 0], output="clean/clean.####.exr"),
        "look": node("PostfxLook", frames=["denoise", 0], look="aces2"),
        "images": node("PostfxFramesToImages", frames=["look", 0]),
        "shown": node("SaveImage", images=["images", 0], filename_prefix="room")}
    happened, shown = comfy.run(**graph)
    assert "execution_success" in happened, happened
    files = sorted((folder / "output/clean").iterdir())
    assert shown["save"]["text"] == [str(file) for file in files] and len(files) == 2
    pipeline = Pipeline([DenoiseUpscale(scale=2, model="s")])
    for file, frame in zip(files, postfx.read_sequence(ROOM, frames="1-2"), strict=True):
        (written,) = postfx.read_sequence(file)
        assert np.allclose(written[Role.COLOUR], pipeline(frame)[Role.COLOUR], rtol=1e-3)  # halves
    assert (len(shown["shown"]["images"]) == 2
            and (folder / "output/room_00002_.png").stat().st_size > 100_000)

    # ComfyUI's own pictures go through our nodes and back; what is unchanged is not computed again
    happened, _ = comfy.run(**graph)
    assert set(happened["execution_cached"]["nodes"]) == set(graph)
    os.utime(folder / "input/shot/noisy.0002.exr", (1, 1))
    happened, _ = comfy.run(**graph)
    assert happened["execution_cached"]["nodes"] == []
    happened, shown = comfy.run(
        load=node("LoadImage", image=str(folder / "output/room_00001_.png")),
        frames=node("PostfxImagesToFrames", images=["load", 0], encoding="srgb",
                    albedo=["load", 0]),
        denoise=node("PostfxDenoise", frames=["frames", 0], scale=1.0, model="s", strength=1.0),
        images=node("PostfxFramesToImages", frames=["denoise", 0]),
        half=node("ImageScaleBy", image=["images", 0], upscale_method="bilinear", scale_by=0.5),
        shown=node("PreviewImage", images=["half", 0]))
    assert "execution_success" in happened and len(shown["shown"]["images"]) == 1

    # mistakes are told as our own line, on our node; the button stops a long shot
    happened, _ = comfy.run(**graph
                            | {"load": node("PostfxLoadSequence", pattern="shot", frames="2-4")})
    error = happened["execution_error"]
    assert (error["node_id"] == "load" and "2 of 3 frames are missing: "
            "3-4" in error["exception_message"])
    long = {"many": node("EmptyImage", width=304, height=208, batch_size=300, color=255),
            "frames": node("PostfxImagesToFrames", images=["many", 0], encoding="srgb"),
            "denoise": node("PostfxDenoise", frames=["frames", 0], scale=2.0, model="s",
                            strength=1.0),
            "images": node("PostfxFramesToImages", frames=["denoise", 0]),
            "shown": node("PreviewImage", images=["images", 0])}

    def interrupt() -> None:
        comfy.wait_until(lambda: "ready for frames of 304x208" in comfy.log.read_text())
        comfy.ask("/interrupt", {})

    happened, _ = comfy.run(interrupt, **long)
    assert happened["execution_interrupted"]["node_id"] == "images"


@pytest.mark.parametrize("path", ["../out.####.exr", "/etc/out.####.exr", "~/out.####.exr",
                                  "a/../../out.####.exr"])
def test_no_path_leaves_comfyuis_folders(nodes, tmp_path, monkeypatch, path):
    """Workflows come from other people."""
    for kind in ("input", "output"):
        (tmp_path / kind).mkdir()
    folders = SimpleNamespace(get_input_directory=lambda: str(tmp_path / "input"),
                              get_output_directory=lambda: str(tmp_path / "output"))
    monkeypatch.setitem(sys.modules, "folder_paths", folders)
    shot = call(nodes, "PostfxImagesToFrames", images=torch.ones((1, 8, 8, 3)), encoding="linear")
    with pytest.raises(PostfxError, match="is outside of ComfyUI's output folder"):
        call(nodes, "PostfxSaveFrames", frames=shot, output=path)
    with pytest.raises(PostfxError, match="is outside of ComfyUI's input folder"):
        call(nodes, "PostfxLoadSequence", pattern=path)
    call(nodes, "PostfxSaveFrames", frames=shot, output="a/b.####.exr")
    call(nodes, "PostfxSaveFrames", frames=shot, output=str(tmp_path / "output/c.####.exr"))
    assert len(list((tmp_path / "output").rglob("*.exr"))) == 2
