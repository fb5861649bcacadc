"""The examples in docs/passes.md, docs/runtime.md, docs/integration.md and docs/masks.md do what their text says."""

import importlib
import re
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from postfx import integrate, read_sequence
from postfx.passes import registry
from postfx.runtime import Device, Library

DOCS = Path(__file__).resolve().parent.parent / "docs"


def blocks(name: str, language: str) -> list[str]:
    """Code blocks of a document, in order."""
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / name).read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def vignette(tmp_path, monkeypatch):
    """The example pass, installed as the document says; the rest of the document's code."""
    module, *rest = blocks("passes.md", "python")
    (tmp_path / "vignette.py").write_text(module)
    (point,) = re.findall(r'^(\w+) = "(.+)"$', blocks("passes.md", "toml")[0], re.MULTILINE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "_installed", lambda: {point[0]: EntryPoint(*point, registry.GROUP)})
    importlib.invalidate_caches()
    yield rest
    sys.modules.pop("vignette", None)


def test_the_example_pass_runs(vignette, capsys):
    names = {}
    exec(vignette[0], names)
    assert names["result"]["colour"][0, 0, 0] < 0.51 and "pass 1  vignette: reads colour" in capsys.readouterr().out
    assert list(names["pipeline"].timings) == ["vignette"]


def test_the_examples_own_tests_pass(vignette, tmp_path):
    pytest.importorskip("torch")
    _, portable, tests = vignette
    names = {}
    exec(portable, names)
    names["export"](str(tmp_path / "vignette.onnx"))
    exec(tests, names)
    names["test_corners_lose_the_amount_and_the_centre_nothing"](Device("cpu"))
    names["test_the_portable_kernel_agrees"](Library(tmp_path))


def test_the_runtime_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    first, again, transient, capture = blocks("runtime.md", "python")
    exec(first, names)
    assert np.isfinite(names["grid"].array).all() and names["grid"].array.any()
    exec(again, names)
    assert names["commands"].label == "frame 4"
    assert [label for label, _ in names["commands"].timings] == ["prepare", "coefficients"]
    exec(transient, names)
    assert names["commands"].label == "frame 5" and "0.0 % over the bound" in capsys.readouterr().out
    exec(capture, names)
    assert "prepare" in (tmp_path / "look/capture.json").read_text() and (tmp_path / "look/capture.html").is_file()


def test_the_frame_of_the_integration_page_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(blocks("integration.md", "python")[0], names)
    (frame,) = read_sequence("out/noisy.####.exr")
    focal = names["width"] / 2 / np.tan(np.radians(30))
    moved = np.float32([focal * 0.1 / 5, 0])
    np.testing.assert_allclose(frame["motion"], np.broadcast_to(moved, frame["motion"].shape), atol=1e-3)


def test_the_masks_of_the_page_are_made(write_exr, tmp_path, monkeypatch):
    """On a frame of misses and a Cryptomatte without a manifest, in which the logo is nowhere."""
    monkeypatch.chdir(tmp_path)
    names = ("R", "G", "B", *(f"CryptoObject00.{letter}" for letter in "RGBA"))
    planes = {name: np.full((30, 40), 0.5) for name in names} | {"depth.Z": np.full((30, 40), 1e10)}
    write_exr("shot/noisy.0001.exr", planes, **{"cryptomatte/0123456/name": "CryptoObject"})
    names = {}
    exec(blocks("masks.md", "python")[0], names)
    assert names["frame"]["strength"].shape == (30, 40, 1) and not names["frame"]["strength"].any()


def test_the_reactive_mask_of_the_page_is_used(write_exr, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    planes = {name: np.full((30, 40), 0.5) for name in ("R", "G", "B", "motion.X", "motion.Y")}
    for number in (1, 2):
        write_exr(f"shot/noisy.{number:04d}.exr", planes)
    names = {}
    exec(blocks("masks.md", "python")[-1], names)
    assert names["clean"]["colour"].shape == (60, 80, 3)


def test_the_integration_page_names_every_helper():
    page = (DOCS / "integration.md").read_text(encoding="utf-8")
    apart = {"IntegrationError", "frame_header", "halton", "pixel_positions", "positions_from_depth", "project",
             "view_rays", "depth_to_device", "ray_from_depth", "normals_to_camera", "fresnel_dielectric",
             "fresnel_schlick", "roughness_from_exponent", "roughness_from_smoothness"}
    assert [name for name in integrate.__all__ if name not in page and name not in apart] == []


def test_the_display_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "samples").symlink_to(DOCS.parent / "samples")
    (code,) = blocks("display.md", "python")
    exec(code, {})
    assert len(list((tmp_path / "out").glob("hdr.*.png"))) == 2
