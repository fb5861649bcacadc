"""Code blocks of the documents do what their text says."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from postfx import integrate, read_sequence
from postfx.passes import registry
from tests.kernels import host_cuda

DOCS = Path(__file__).resolve().parent.parent / "docs"


def blocks(name: str, language: str) -> list[str]:
    """Code blocks of a document, in order."""
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / name).read_text(encoding="utf-8"),
                      re.DOTALL)


@pytest.fixture(scope="module")
def vignette(tmp_path_factory) -> Path:
    """The example package of passes.md with its files under the names that the document gives
    them."""
    folder = tmp_path_factory.mktemp("vignette")
    text = (DOCS / "howto/passes.md").read_text(encoding="utf-8")
    for paragraph, code in re.findall(r"\n\n([^\n].*?)\n\n```\w+\n(.*?)```", text, re.DOTALL):
        names = re.findall(r"`([\w/]+\.(?:py|toml|cu|h))`", paragraph.rpartition("\n\n")[2])
        if names:
            path = folder / names[-1]
            path.parent.mkdir(exist_ok=True)
            path.write_text(code)
    (folder / "samples").symlink_to(DOCS.parent / "samples")
    return folder


def test_the_example_package_is_made_installed_and_run_as_written(vignette):
    """Every shell block of the document in turn; what pip installs goes to a folder of its own."""
    pytest.importorskip("torch")
    pytest.importorskip("hatchling")
    site, tools = vignette / "site", vignette / "tools"
    tools.mkdir()
    # some environments come without it
    (tools / "pip").write_text('#!/bin/sh\nexec python -m pip "$@"\n')
    (tools / "pip").chmod(0o755)
    paths = [str(tools), str(Path(sys.executable).parent), os.environ["PATH"]]
    environment = {**os.environ, "PATH": os.pathsep.join(paths), "PYTHONPATH": str(site),
                   "PIP_TARGET": str(site), "PIP_NO_BUILD_ISOLATION": "0", "PIP_NO_INDEX": "1",
                   "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run(["sh", "-e"], input="".join(blocks("howto/passes.md", "sh")),
                          env=environment, cwd=vignette, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ("vignette  (postfx-vignette 1.0)\n    Darkens the corners of the picture.\n"
        "    options: amount=0.3\n" in done.stdout)
    order = [done.stdout.index(f"pass {number}  {name}")
             for number, name in ((1, "denoise_upscale"), (2, "vignette"))]
    assert order == sorted(order)
    assert len(list((vignette / "out").glob("dark.*.exr"))) == 2
    facts = json.loads((vignette / "out/postfx.manifest.json").read_text())["runs"].popitem()[1]
    assert (facts["settings"]["pass"] == "['vignette,amount=0.5']"
            and facts["passes"]["vignette"] == {"amount": 0.5})
    assert facts["versions"]["pass vignette"] == "postfx-vignette 1.0"
    assert re.search(r"(\d+) passed", done.stdout) and "failed" not in done.stdout


@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs ziglang")
def test_a_header_alone_is_enough_on_a_cpu(vignette, tmp_path):
    """Without CUDA and ONNX, the contract suite skips only what compares other forms."""
    package, facts = tmp_path / "postfx_vignette", tmp_path / "postfx_vignette-1.0.dist-info"
    package.mkdir()
    facts.mkdir()
    for name in ("__init__.py", "vignette.h"):
        shutil.copy(vignette / "postfx_vignette" / name, package)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: postfx-vignette\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[postfx.passes]\nvignette = "
                                            "postfx_vignette:Vignette\n")
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["postfx.testing"]\n')
    shutil.copy(vignette / "test_vignette.py", tmp_path)
    paths = os.pathsep.join([str(tmp_path), str(DOCS.parent)])
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-rs",
                           "test_vignette.py"],
                          env=os.environ | {"PYTHONPATH": paths}, cwd=tmp_path, capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (skipped,) = re.findall(r"SKIPPED \[(\d)\] .*kernel 'vignette' has no form that runs on",
                            done.stdout)
    assert skipped == "1"


FIVE_FILES = """
import numpy as np
from postfx import Frame, Pipeline, Role
from postfx.kernels import find_source, read_source
from postfx.passes import registry
from postfx.passes.vignette import VIGNETTE
frame = Frame({Role.COLOUR: np.ones((101, 101, 3), np.float32)})
made = Pipeline([registry.create("vignette", amount=0.5)])(frame)[Role.COLOUR]
is_there = "void vignette" in read_source(find_source(VIGNETTE))
print(float(made[50, 50, 0]), float(made[0, 0, 0]), is_there)
"""


@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs ziglang")
def test_a_pass_that_comes_with_postfx_takes_five_files(vignette, tmp_path):
    """The example's pass, kernel and CUDA source, and a line of the registry; the fifth is its
    test."""
    package = tmp_path / "postfx"
    shutil.copytree(DOCS.parent / "postfx", package,
                    ignore=shutil.ignore_patterns("_native", "__pycache__"))
    text = (vignette / "postfx_vignette/__init__.py").read_text()
    own = 'Rows("vignette", Path(__file__).with_name("vignette.h"))'
    assert own in text
    (package / "passes/vignette.py").write_text(text.replace(own, 'Rows("vignette")'))
    shutil.copy(vignette / "postfx_vignette/vignette.h", package / "kernels/vignette.cpp")
    shutil.copy(vignette / "postfx_vignette/vignette.cu", package / "kernels")
    registered = (package / "passes/registry.py").read_text().replace(
        "BUILT_IN = {", 'BUILT_IN = {"vignette": "postfx.passes.vignette:Vignette",')
    (package / "passes/registry.py").write_text(registered)
    done = subprocess.run([sys.executable, "-c", FIVE_FILES],
                          env=os.environ | {"PYTHONPATH": str(tmp_path)},
                          cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    centre, corner, has_source = done.stdout.split()
    assert (float(centre) == 1.0 and float(corner) == pytest.approx(0.51, abs=0.005)
            and has_source == "True")


def test_the_example_pass_runs_in_python(vignette, monkeypatch, capsys):
    monkeypatch.syspath_prepend(vignette)
    point = EntryPoint("vignette", "postfx_vignette:Vignette", registry.ENTRY_POINT_GROUP)
    monkeypatch.setattr(registry, "_installed", lambda: {"vignette": (point,)})
    (code,) = (block
               for block in blocks("howto/passes.md", "python") if "pipeline.explain" in block)
    names = {}
    exec(code, names)
    assert (names["result"]["colour"][0, 0, 0] < 0.51 and "pass 1  vignette: reads "
            "colour" in capsys.readouterr().out)
    assert list(names["pipeline"].timings) == ["vignette"]


def test_the_examples_cuda_source_computes_what_its_rows_do(vignette, monkeypatch):
    if host_cuda.COMPILER is None:
        pytest.skip("there is no g++")
    monkeypatch.syspath_prepend(vignette)
    kernel = importlib.import_module("postfx_vignette").VIGNETTE
    colour, amount = np.random.default_rng(0).random((9, 14, 3), np.float32), np.float32([0.4])
    arrays = {"colour": colour, "amount": amount, "output": np.zeros_like(colour)}
    host_cuda.run(kernel, arrays)
    output = np.zeros_like(colour)
    kernel.rows(0, 9, colour, amount, output)
    np.testing.assert_allclose(arrays["output"], output, rtol=1e-5)


def test_the_runtime_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    first, again, inside, transient, capture = blocks("concepts/runtime.md", "python")
    exec(first, names)
    assert np.isfinite(names["grid"].array).all() and names["grid"].array.any()
    exec(again, names)
    assert names["commands"].label == "frame 4"
    assert [label for label, _ in names["commands"].timings] == ["prepare", "coefficients"]
    exec(inside, names)
    assert (names["commands"].label == "frame 5"
            and names["heap"].size == (names["network"].intermediates_size or 0))
    exec(transient, names)
    assert (names["commands"].label == "frame 6" and "0.0 % over the "
            "bound" in capsys.readouterr().out)
    exec(capture, names)
    assert ("prepare" in (tmp_path / "look/capture.json").read_text()
            and (tmp_path / "look/capture.html").is_file())


def test_the_frame_of_the_integration_page_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(blocks("howto/integration.md", "python")[0], names)
    (frame,) = read_sequence("out/noisy.####.exr")
    focal = names["width"] / 2 / np.tan(np.radians(30))
    moved = np.float32([focal * 0.1 / 5, 0])
    np.testing.assert_allclose(frame["motion"], np.broadcast_to(moved, frame["motion"].shape),
                               atol=1e-3)


def test_the_masks_of_the_page_are_made(write_exr, tmp_path, monkeypatch):
    """On a frame of misses and a Cryptomatte without a manifest, in which the logo is nowhere."""
    monkeypatch.chdir(tmp_path)
    names = ("R", "G", "B", *(f"CryptoObject00.{letter}" for letter in "RGBA"))
    planes = {name: np.full((30, 40), 0.5) for name in names} | {"depth.Z": np.full((30, 40), 1e10)}
    write_exr("shot/noisy.0001.exr", planes, **{"cryptomatte/0123456/name": "CryptoObject"})
    names = {}
    exec(blocks("howto/masks.md", "python")[0], names)
    assert names["frame"]["strength"].shape == (30, 40, 1) and not names["frame"]["strength"].any()


def test_the_reactive_mask_of_the_page_is_used(write_exr, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    planes = {name: np.full((30, 40), 0.5) for name in ("R", "G", "B", "motion.X", "motion.Y")}
    for number in (1, 2):
        write_exr(f"shot/noisy.{number:04d}.exr", planes)
    names = {}
    exec(blocks("howto/masks.md", "python")[-1], names)
    assert names["clean"]["colour"].shape == (60, 80, 3)


def test_the_integration_page_names_every_helper():
    page = (DOCS / "howto/integration.md").read_text(encoding="utf-8")
    apart = {"IntegrationError", "frame_header", "halton", "pixel_positions",
             "positions_from_depth", "project", "view_rays", "depth_to_device", "ray_from_depth",
             "normals_to_camera", "fresnel_dielectric",
             "fresnel_schlick", "roughness_from_exponent", "roughness_from_smoothness"}
    assert [name for name in integrate.__all__ if name not in page and name not in apart] == []


def test_the_display_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "samples").symlink_to(DOCS.parent / "samples")
    (code,) = blocks("howto/display.md", "python")
    exec(code, {})
    assert len(list((tmp_path / "out").glob("hdr.*.png"))) == 2


def test_the_presenter_of_the_page_shows_all(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (code,) = (block
               for block in blocks("howto/interpolation.md", "python") if "Presenter" in block)
    exec(code, {})
    assert "every 8.33 ms" in capsys.readouterr().out and (tmp_path / "pacing.png").is_file()
