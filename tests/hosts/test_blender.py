"""The extension for Blender: built by make, installed into bpy, on two frames that Cycles renders there.

It needs the package bpy, in this interpreter or in the one that POSTFX_BPY_PYTHON names.
"""

import json
import os
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
    colour = [next(i for i, name in enumerate(names) if name.endswith(f"Combined.{c}") or name == c) for c in "RGB"]
    return file.read_image("float")[..., colour]


@pytest.mark.skipif(PYTHON is None, reason="needs the package bpy (POSTFX_BPY_PYTHON names a Python that has it)")
def test_two_frames_in_blender(tmp_path):
    subprocess.run(["make", "blender", f"PYTHON={sys.executable}"], cwd=ROOT, check=True, capture_output=True)
    command = tmp_path / "postfx"
    command.write_text(f'#!/bin/sh\nexec env PYTHONPATH={ROOT} {sys.executable} -m postfx "$@"\n')
    command.chmod(0o755)
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path / "blender")}
    done = subprocess.run([PYTHON, str(Path(__file__).with_name("blender_session.py")),
                           str(ROOT / "dist/postfx-blender.zip"), str(tmp_path), str(command)],
                          env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["wrong engine"].startswith("postfx reads passes of Cycles")
    assert found["set up"] == found["denoise"] == found["frame"] == "FINISHED"
    assert found["not rendered"].startswith("frame 1 is not rendered: there is no ")
    assert found["no command"].startswith("there is no command '/nowhere/postfx': install it")
    assert found["broken"].startswith("error") and "box_0002.exr" in found["broken"]
    assert found["image"] == ["box_denoised_0001.exr", "SEQUENCE"]
    names = [f"box_{mark}000{number}.exr" for mark in ("", "denoised_") for number in (1, 2)]
    assert [name for name in found["files"] if name.endswith(".exr")] == sorted(names)
    assert found["modal"] == [["PASS_THROUGH", "RUNNING_MODAL", "FINISHED"],
                              [0.0, "postfx: 0 of ? frames. Esc to stop", 1.0], ["cancel"]]
    assert found["stopped"] == [True, False, 0] and found["disabled"]
    noisy, clean = (picture(tmp_path / "shot" / f"box_{mark}0001.exr") for mark in ("", "denoised_"))
    assert clean.shape == (64, 96, 3)
    # where a lit side is even, noise falls
    assert np.abs(np.diff(clean, axis=1)).mean() < 0.5 * np.abs(np.diff(noisy, axis=1)).mean()
