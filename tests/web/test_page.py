"""The page in the browser: its models compute what postfx does, and Chromium shows it."""

from __future__ import annotations

import http.server
import importlib.util
import json
import shutil
import subprocess
import threading
from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.exposure import measure
from postfx.frame import Frame, Role
from postfx.passes.denoise.planes import shows_volume

ROOT = Path(__file__).resolve().parents[2]
PAGE, SAMPLE = ROOT / "build/page", ROOT / "samples/room/noisy.0006.exr"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SECONDS, GPU_SECONDS = 60, 600
DROP = """
document.getElementById("options").elements.network.value = "NETWORK";
const file = await (await fetch("/given.exr")).arrayBuffer(), data = new DataTransfer();
data.items.add(new File([file], "given.exr"));
dispatchEvent(new DragEvent("drop", { dataTransfer: data }));
const status = document.getElementById("status"), after = document.getElementById("after");
const working = () => !/ in .* s$/.test(status.textContent) && status.className !== "error";
while (working()) await new Promise((resolve) => setTimeout(resolve, 50));
tell({ status: status.textContent, planes: document.getElementById("planes").innerText,
       picture: [after.width, after.height], png: after.toDataURL("image/png").split(",")[1],
       loaded: performance.getEntriesByType("resource").map((one) => one.name) });
"""
READ = """
const { readFrame } = await import("/page.js");
const { meter, showsVolume } = await import("/frame.js");
const found = {};
for (const name of NAMES) {
  try {
    const frame = readFrame(await (await fetch(`/${name}`)).arrayBuffer());
    const coded = (plane) => btoa(
      Array.from(new Uint8Array(plane.buffer), (b) => String.fromCharCode(b)).join(""));
    const { colour, depth } = frame.planes;
    found[name] = { ...frame, stops: meter(colour, frame.width, frame.height),
                    volume: depth && showsVolume(depth, frame.width, frame.height),
                    planes: Object.fromEntries(
                      Object.entries(frame.planes).map(([key, one]) => [key, coded(one)])) };
  } catch (error) {
    found[name] = { error: error.message };
  }
}
tell(found);
"""


def load_export():
    spec = importlib.util.spec_from_file_location("export", ROOT / "web/export.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def frame_of(path: Path) -> Frame:
    (frame,) = postfx.read_sequence(path)
    return frame


def test_the_models_compute_what_the_pass_does(tmp_path):
    """One file for frames of any size, of odd sides too."""
    pytest.importorskip("onnx")
    ort = pytest.importorskip("onnxruntime")
    export = load_export()
    export.main(tmp_path)
    whole = frame_of(SAMPLE)
    part = replace(whole, planes={role: np.ascontiguousarray(plane[:51, :77])
                                  for role, plane in whole.planes.items()})
    for frame, scale, tag in ((part, 2, "s"), (part, 1, "s"), (whole, 2, "m"), (part, 1, "m")):
        wanted = postfx.Pipeline([postfx.DenoiseUpscale(scale=scale, model=f"{tag}.fp32")])(frame)
        exposure = np.float32(2 ** measure(frame[Role.COLOUR]))
        feeds = {name: frame[Role(name)] for name in export.PLANES}
        feeds["params"] = np.float32([exposure, *frame.jitter, 1])
        session = ort.InferenceSession(tmp_path / f"denoise.{tag}.{scale}x.onnx",
                                       providers=["CPUExecutionProvider"])
        (clean,) = session.run(None, feeds)
        np.testing.assert_allclose(np.log1p(clean), np.log1p(wanted[Role.COLOUR]), atol=3e-3)
        if frame is whole:
            continue
        shown = postfx.Pipeline([postfx.ToneMap()], exposure=float(np.log2(exposure)))(
            replace(frame, planes={Role.COLOUR: clean}))
        look = ort.InferenceSession(tmp_path / "look.aces2.onnx",
                                    providers=["CPUExecutionProvider"])
        (codes,) = look.run(None, {"colour": clean, "exposure": exposure[None]})
        np.testing.assert_allclose(codes, shown[Role.COLOUR], atol=2e-4)


class Server(http.server.SimpleHTTPRequestHandler):
    """The page as a plain static server gives it, with a script at its end, further files, and a
    place for answers."""

    def __init__(self, *rest, script: str, files: dict[str, Path],
                 told: Callable[[bytes], None]) -> None:
        self._script, self._files, self._told = script, files, told
        super().__init__(*rest, directory=str(PAGE))

    def do_GET(self) -> None:
        if self.path.split("?")[0] == "/":
            text = ((PAGE / "index.html").read_text("utf-8") + '<script '
                    f'type="module">{self._script}</script>')
            self._give(text.encode(), "text/html")
        elif self.path[1:] in self._files:
            self._give(self._files[self.path[1:]].read_bytes(), "application/octet-stream")
        else:
            super().do_GET()

    def do_POST(self) -> None:
        self._told(self.rfile.read(int(self.headers["Content-Length"])))
        self._give(b"", "text/plain")

    def _give(self, body: bytes, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


def in_chromium(script: str, files: dict[str, Path], folder: Path, gpu: bool = False) -> dict:
    """What a script tells that runs on the page; with `gpu` by WebGPU, on a GPU that the CPU
    imitates."""
    if CHROMIUM is None or not PAGE.is_dir():
        pytest.skip("needs chromium, and the page: make page")
    heard, done = [], threading.Event()

    def told(body: bytes) -> None:
        heard.append(json.loads(body))
        done.set()

    begin = ('const tell = (found) => fetch("/told", { method: "POST", body: JSON.stringify(found) '
             '});')
    script = (f"{begin} try {{ {script} }} catch (error) {{ tell({{ error: String(error.stack) "
              "}); }")
    handler = partial(Server, script=script, files=files, told=told)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as one:
        threading.Thread(target=one.serve_forever, daemon=True).start()
        flags = (["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"] if gpu
                 else ["--disable-gpu"])
        command = [CHROMIUM, "--headless", "--no-sandbox", *flags,
                   f"--user-data-dir={folder / 'chromium'}", "--remote-debugging-port=0",
                   f"http://127.0.0.1:{one.server_address[1]}/{'?on=webgpu' if gpu else ''}"]
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            assert done.wait(GPU_SECONDS if gpu else SECONDS), "the page told nothing"
        finally:
            browser.terminate()
            browser.wait()
            one.shutdown()
    return heard[0]


@pytest.mark.parametrize("network", ["s", pytest.param("m", marks=pytest.mark.soak)])
def test_a_dropped_file_is_denoised_and_shown(network, tmp_path):
    told = in_chromium(DROP.replace("NETWORK", network), {"given.exr": SAMPLE}, tmp_path)
    assert "320x180 to 320x180" in told["status"] and told["picture"] == [320, 180], told
    assert "motion.X, motion.Y" in told["planes"] and "not there" not in told["planes"]
    # nothing comes from elsewhere
    assert all(name.startswith("http://127.0.0.1:") for name in told["loaded"])
    assert_it_is_the_passes_picture(told["png"], network, tmp_path)


@pytest.mark.soak
def test_webgpu_shows_the_same(tmp_path):
    told = in_chromium(DROP.replace("NETWORK", "s"), {"given.exr": SAMPLE}, tmp_path, gpu=True)
    runtimes = {name.rsplit("/", 1)[1] for name in told["loaded"] if name.endswith(".min.mjs")}
    assert runtimes == {"ort.webgpu.min.mjs"}, told["status"]  # it did not fall back to the CPU
    assert_it_is_the_passes_picture(told["png"], "s", tmp_path)


def assert_it_is_the_passes_picture(png: str, network: str, folder: Path) -> None:
    """The page's picture is the one that the passes make, but for the rounding to 8 bits and of the
    last bits."""
    image = pytest.importorskip("PIL.Image")
    (folder / "picture.png").write_bytes(b64decode(png))
    passes = [postfx.DenoiseUpscale(model=f"{network}.fp32"), postfx.ToneMap()]
    wanted = postfx.Pipeline(passes)(frame_of(SAMPLE))
    shown = np.asarray(image.open(folder / "picture.png").convert("RGB")) / np.float32(255)
    error = np.abs(shown - wanted[Role.COLOUR])
    assert error.max() < 4 / 255 and error.mean() < 0.5 / 255


def test_files_of_all_kinds_are_read_as_by_postfx(tmp_path):
    """Compressions, parts, types and orders of channels; what cannot be read says so in one
    line."""
    oiio = pytest.importorskip("OpenImageIO")
    kinds = {}
    small = oiio.ImageBufAlgo.cut(oiio.ImageBuf(str(SAMPLE)), oiio.ROI(0, 70, 0, 45))
    plain = ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "dwaa", "htj2k32", "lj2k", "zstd")
    for compression, kind in (*((name, "") for name in plain), ("piz", "float"), ("piz", "half"),
                              ("zip", "float")):
        path = kinds[f"{compression}{kind}.exr"] = tmp_path / f"{compression}{kind}.exr"
        small.specmod().attribute("compression", compression)
        small.copy().write(str(path), kind)
    fog = small.copy()
    pixels, depth = fog.get_pixels(), fog.spec().channelindex("depth.Z")
    pixels[np.random.default_rng(0).random(pixels.shape[:2]) < 0.5, depth] = 1e10
    fog.set_pixels(oiio.ROI(), pixels)
    kinds["fog.exr"] = tmp_path / "fog.exr"
    fog.write(str(kinds["fog.exr"]), "float")
    parts = kinds["parts.exr"] = tmp_path / "parts.exr"
    write_parts(frame_of(kinds["zip.exr"]), parts)
    cut = kinds["cut.exr"] = tmp_path / "cut.exr"
    cut.write_bytes(SAMPLE.read_bytes()[:300])
    text = kinds["text.exr"] = tmp_path / "text.exr"
    text.write_text("no picture")
    told = in_chromium(READ.replace("NAMES", json.dumps([*kinds])), kinds, tmp_path)
    refused = {"text.exr": "not an OpenEXR file", "cut.exr": "cut short",
               "piz.exr": "half and float channels", "dwaa.exr": "DWAA cannot be read here: save "
               "the file as ZIP", "htj2k32.exr": "HTJ2K cannot be read",
               "lj2k.exr": "LJ2K cannot be read", "zstd.exr": "ZSTD cannot be read"}
    assert [name for name, why in refused.items() if why not in told[name]["error"]] == []
    for name in (name for name in kinds if name not in refused):
        wanted, found = frame_of(kinds[name]), told[name]
        assert (found.get("error"), found["width"], found["height"]) == (None, 70, 45), name
        assert abs(found["stops"] - measure(wanted[Role.COLOUR])) < 1e-3
        assert found["volume"] == shows_volume(wanted[Role.DEPTH]) == (name == "fog.exr")
        for role in ("colour", "diffuse_albedo", "specular_albedo", "normal", "roughness", "depth",
                     "motion"):
            plane = np.frombuffer(b64decode(found["planes"][role]), np.float32).reshape(45, 70, -1)
            np.testing.assert_array_equal(plane, wanted[Role(role)], err_msg=f"{name}, {role}")


def test_files_of_blender_are_read_as_by_postfx(tmp_path, shared_dir):
    """A part a pass, and all passes in one part."""
    kinds = {path.name: path for path in (shared_dir / "sequences/garage").glob("*.0001.exr")
             if "ref" not in path.name}
    assert len(kinds) == 2
    for name, found in in_chromium(READ.replace("NAMES", json.dumps([*kinds])), kinds,
                                   tmp_path).items():
        wanted = frame_of(kinds[name])
        assert len(found["planes"]) == 6
        for role, coded in found["planes"].items():
            plane = np.frombuffer(b64decode(coded), np.float32).reshape(wanted[Role(role)].shape)
            np.testing.assert_array_equal(plane, wanted[Role(role)], err_msg=f"{name}, {role}")


def write_parts(frame: Frame, path: Path) -> None:
    """Planes as parts of a file, one a plane, as Blender 5 writes them."""
    openexr = pytest.importorskip("OpenEXR")
    layers = {"rgba": ("colour", "RGB"), "albedo": ("diffuse_albedo", "RGB"),
              "depth": ("depth", "Z"),
              "specular_albedo": ("specular_albedo", "RGB"), "normal": ("normal", "XYZ"),
              "roughness": ("roughness", "Y"), "motion": ("motion", "XY")}
    parts = []
    for layer, (role, letters) in layers.items():
        planes = {letter if layer == "rgba"
                  else f"{layer}.{letter}": np.ascontiguousarray(frame[Role(role)][..., i])
                  for i, letter in enumerate(letters)}
        parts.append(openexr.Part({"compression": openexr.ZIP_COMPRESSION}, planes, name=layer))
    openexr.File(parts).write(str(path))
