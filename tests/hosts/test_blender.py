"""The extension for Blender: built by make, installed into bpy, on frames that Cycles renders
there.

It needs the package bpy, in this interpreter or in the one that POSTFX_BPY_PYTHON names.
"""

import importlib.util
import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

import postfx

ROOT = Path(__file__).parents[2]
PYTHON = os.environ.get("POSTFX_BPY_PYTHON") or (sys.executable if find_spec("bpy") else None)


def test_the_manifest_is_of_this_version():
    manifest = tomllib.loads((ROOT / "hosts/blender_postfx/blender_manifest.toml").read_text())
    assert manifest["version"] == postfx.__version__ and manifest["blender_version_min"] == "4.2.0"


def picture(path: Path) -> np.ndarray:
    file = oiio.ImageInput.open(str(path))
    names = list(file.spec().channelnames)
    colour = [next(i for i, name in enumerate(names) if name.endswith(f"Combined.{c}") or name == c)
              for c in "RGB"]
    return file.read_image("float")[..., colour]


needs_bpy = pytest.mark.skipif(PYTHON is None,
                               reason="needs the package bpy (POSTFX_BPY_PYTHON names a Python "
                               "that has it)")


@pytest.fixture(scope="session")
def extension() -> Path:
    subprocess.run(["make", "blender", f"PYTHON={sys.executable}"], cwd=ROOT, check=True,
                   capture_output=True)
    return ROOT / "dist/postfx-blender.zip"


def in_blender(script: str, extension: Path, folder: Path) -> dict:
    """What a script that runs in bpy prints on its last line."""
    command = folder / "postfx"
    command.write_text(f'#!/bin/sh\nexec env PYTHONPATH={ROOT} {sys.executable} -m postfx "$@"\n')
    command.chmod(0o755)
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "blender")}
    environment.pop("PYTHONPATH", None)
    done = subprocess.run([PYTHON, str(Path(__file__).with_name(script)), str(extension),
                           str(folder), str(command)],
                          env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def layers(path: Path) -> dict[str, np.ndarray]:
    """Colours of a file's parts and layers, by name."""
    file, found, part = oiio.ImageInput.open(str(path)), {}, 0
    while file.seek_subimage(part, 0):
        names = list(file.spec().channelnames)
        pixels = file.read_image(part, 0, 0, file.spec().nchannels, "float")
        for name in names:
            if name.endswith(".R") and f"{name[:-1]}B" in names:
                found[name[:-2]] = pixels[..., [names.index(f"{name[:-1]}{letter}")
                                                for letter in "RGB"]]
        part += 1
    return found


@needs_bpy
def test_the_validator_of_extensions_takes_it(extension):
    where = subprocess.run([PYTHON, "-c",
                            "import bpy; print(bpy.utils.system_resource('SCRIPTS'))"],
                           check=True, capture_output=True, text=True).stdout.splitlines()[-1]
    (validator,) = Path(where).rglob("bl_pkg/cli/blender_ext.py")
    done = subprocess.run([PYTHON, str(validator), "validate", str(extension)], capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@needs_bpy
def test_an_artists_first_hour(extension, tmp_path):
    found = in_blender("blender_story.py", extension, tmp_path)
    assert found["set up"] == found["check"] == found["denoise"] == "FINISHED" and found["seeds"]
    assert found["findings"] == found["said"] == ""
    assert {"Combined", "Combined_key", "Combined_fill", "Depth", "Vector"} <= {*found["passes"]}
    noisy, clean = (layers(tmp_path / "shot" / f"torus_{mark}0003.exr")
                    for mark in ("", "denoised_"))
    assert noisy.keys() == clean.keys()
    first, second = (layers(tmp_path / "shot" / f"torus_000{number}.exr")["ViewLayer.Combined"]
                     for number in (1, 2))
    assert (first[-12:] != second[-12:]).mean() > 0.5  # the floor rests, seeds differ
    for name in ("Combined", "Combined_key"):
        shown, own = picture(tmp_path / f"{name}.exr"), clean[f"ViewLayer.{name}"]
        np.testing.assert_array_equal(shown, own)
        before = noisy[f"ViewLayer.{name}"]
        assert np.abs(np.diff(own, axis=1)).mean() < 0.7 * np.abs(np.diff(before, axis=1)).mean()
    np.testing.assert_allclose(clean["ViewLayer.Combined_key"] + clean["ViewLayer.Combined_fill"],
                               clean["ViewLayer.Combined"], rtol=0.01, atol=2e-3)


@needs_bpy
def test_two_frames_in_blender(extension, tmp_path):
    found = in_blender("blender_session.py", extension, tmp_path)
    assert found["wrong engine"].startswith("postfx reads passes of Cycles")
    assert found["set up"] == found["denoise"] == found["frame"] == "FINISHED"
    assert (found["picture"] == "FINISHED" and found["shown"]
            and found["place"] == [str(tmp_path / "postfx")])
    assert found["not rendered"].startswith("frame 1 is not rendered: there is no ")
    assert found["no command"].startswith("there is no command '/nowhere/postfx': install it")
    assert found["broken"].startswith("error") and "box_0002.exr" in found["broken"]
    assert found["options"] == {"NONE": ["--model", "s"], "preview": ["--preset", "preview"],
                                "final": ["--preset", "final"],
                                "animation": ["--model", "s", "--preset", "animation"]}
    assert found["image"] == ["box_denoised_0001.exr", "SEQUENCE"]
    names = [f"box_{mark}000{number}.exr" for mark in ("", "denoised_") for number in (1, 2)]
    assert [name for name in found["files"] if name.endswith(".exr")] == sorted(names)
    assert found["modal"] == [["PASS_THROUGH", "RUNNING_MODAL", "FINISHED"],
                              [0.0, "postfx: 0 of ? frames. Esc to stop. starting", 1.0],
                              ["cancel"]]
    assert found["stopped"] == [True, False, 0] and found["disabled"]
    noisy, clean = (picture(tmp_path / "shot" / f"box_{mark}0001.exr")
                    for mark in ("", "denoised_"))
    assert clean.shape == (64, 96, 3)
    # where a lit side is even, noise falls
    assert np.abs(np.diff(clean, axis=1)).mean() < 0.5 * np.abs(np.diff(noisy, axis=1)).mean()


@pytest.fixture(scope="session")
def panels():
    """The script that draws Blender's panels for the pages."""
    spec = importlib.util.spec_from_file_location("blender_panels",
                                                  ROOT / "samples/blender_panels.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@needs_bpy
def test_the_page_names_what_the_button_sets_and_its_block_does_the_same(extension, panels,
                                                                         tmp_path, monkeypatch):
    monkeypatch.setenv("POSTFX_BPY_PYTHON", PYTHON)
    page = (ROOT / "docs/start/blender.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "block.py").write_text(block)
    found = panels.in_blender(extension, tmp_path / "block.py")
    assert found["block"] == found["after"] != found["before"]
    table = page[page.index("| panel |"):page.index("Before Blender 5.2")]
    changed = [(title, line) for title, lines in found["after"].items() for line in lines
               if line not in found["before"][title]]
    assert len(changed) == 11
    for title, line in changed:
        (row,) = (row for row in re.split(r"\n(?=\| \w)", table)
                  if title.removesuffix(" > Output") in row)
        words = {"Motion Blur": "off", "Denoise": "off", "Seed": "clock beside Seed",
                 "Color Depth": "32 bits", "File Format": "EXR", "Media Type": "Multi-Layer EXR"}
        label = line[0][2] or title.rpartition(" > ")[2]
        assert words.get(label, label) in row, label


@needs_bpy
def test_the_panel_of_the_pages_is_the_extensions(extension, panels, monkeypatch):
    monkeypatch.setenv("POSTFX_BPY_PYTHON", PYTHON)
    page = (ROOT / "docs/howto/hosts.md").read_text(encoding="utf-8")
    (rows,) = panels.in_blender(extension)["panel"].values()
    assert [label for line in rows
            for _, _, label, _ in line if f"| **{label}** |" not in page] == []
