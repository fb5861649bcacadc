"""The classical filter: clean, steady, the same in windows, within a budget, and without ONNX
Runtime."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.errors import DeviceError, PassOptionError
from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.models import CLASSIC
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.runtime.device import cuda_fault
from tests.passes.denoise_frames import flat, noisy

ROOM = Path(__file__).parents[2] / "samples" / "room"


def shown(colour: np.ndarray) -> np.ndarray:
    return np.sqrt(colour / (1 + colour))


def run(frames: list[Frame], device: Device | None = None, **options: object) -> list[np.ndarray]:
    upscaler = DenoiseUpscale(**{"model": CLASSIC, "scale": 2, **options})
    chain = Pipeline([upscaler], device or Device("cpu", threads=2), exposure=0.0)
    return [chain(frame)[Role.COLOUR].copy() for frame in frames]


def with_strength(frame: Frame, mask: np.ndarray) -> Frame:
    return replace(frame, planes={**frame.planes, Role.STRENGTH: mask.astype(np.float32)})


def test_it_is_far_better_than_the_input_and_the_history_helps() -> None:
    frames = list(postfx.read_sequence(ROOM / "noisy.####.exr"))[:5]
    wanted = shown(list(postfx.read_sequence(ROOM / "reference.####.exr"))[4][Role.COLOUR])
    alone = [replace(frame, reset=True) for frame in frames[4:]]
    plain, first, last = (10 * np.log10(1 / np.mean((shown(found[-1]) - wanted) ** 2)) for found in
                          (run(frames[4:], strength=0), run(alone), run(frames)))
    assert first > plain + 8 and last > first + 0.5, (plain, first, last)


def test_a_picture_of_one_colour_stays_as_it_is() -> None:
    for size in ((24, 40), (1, 1), (17, 3)):
        for found in run([flat(number, 0.7, *size, jitter=(0.3, -0.2)) for number in (1, 2, 3)],
                         scale=1.5):
            np.testing.assert_allclose(found, 0.7, rtol=1e-5)


def test_what_is_no_number_stays_where_it_is() -> None:
    frames = [noisy(number) for number in (1, 2, 3)]
    for role in (Role.COLOUR, Role.NORMAL, Role.DEPTH, Role.MOTION):
        frames[0].planes[role][5, 7] = np.nan
        frames[1].planes[role][20, 9] = np.inf
    clean = [noisy(number) for number in (1, 2, 3)]
    for found, wanted in zip(run(frames), run(clean), strict=True):
        assert np.isfinite(found).all() and found.min() >= 0
        assert found.max() < 1.5 * wanted.max()


def test_a_window_is_as_the_whole_frame() -> None:
    """Around a mask, and in tiles of a memory budget; also where the history was."""
    height, width = 160, 256
    mask = np.zeros((height, width, 1))
    mask[80:90, 100:120] = 1
    frames = [noisy(number, height, width) for number in (1, 2, 3)]
    whole = run(frames)[-1][164:176, 204:236]
    found = run([with_strength(frame, mask) for frame in frames])[-1][164:176, 204:236]
    np.testing.assert_allclose(shown(found), shown(whole), atol=2e-3)


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
def test_a_gpu_gives_the_same() -> None:
    """With a history, broken pixels and another size; a network goes on from what it leaves, within
    a budget."""
    frames = [noisy(number) for number in (1, 2, 3)]
    frames[0].planes[Role.COLOUR][5, 7] = np.nan
    frames[1].planes[Role.DEPTH][20, 9] = np.inf
    for scale in (1, 1.5, 2):
        for found, wanted in zip(run(frames, Device("cuda"), scale=scale), run(frames, scale=scale),
                                 strict=True):
            np.testing.assert_allclose(shown(found), shown(wanted), atol=1e-3)
    upscaler = DenoiseUpscale(budget=0.01)
    chain = Pipeline([upscaler], Device("cuda"), exposure=0.0)
    for number in range(1, 5):
        found = chain(flat(number, 0.7))[Role.COLOUR]
    assert upscaler.choice == CLASSIC
    np.testing.assert_allclose(found, 0.7, rtol=1e-2)


def test_tiles_within_a_memory_budget_are_as_the_whole_frame() -> None:
    frames = [noisy(number, 540, 960) for number in (1, 2)]
    found = run(frames, Device("cpu", threads=2, memory="640M"), scale=1.5)
    whole = run(frames, scale=1.5)
    np.testing.assert_allclose(shown(found[-1]), shown(whole[-1]), atol=2e-3)


def test_it_runs_where_no_network_fits_the_budget_and_the_history_goes_on() -> None:
    upscaler = DenoiseUpscale(budget=0.01)
    chain, chosen = Pipeline([upscaler], Device("cpu", threads=2), exposure=0.0), []
    for number in range(1, 7):
        chain(flat(number, 0.7))
        chosen.append(upscaler.choice)
    assert chosen[:3] == ["s"] * 3 and chosen[-1] == CLASSIC
    history = upscaler.history()
    assert history["next_state"][..., 3].min() > 3 and f"network {CLASSIC}" in history


def test_it_needs_the_compiled_kernels_of_a_cpu() -> None:
    """Elsewhere it is an error of one line, and no rung of a budget."""
    device = Device("cpu", threads=2, compiled_kernels=False)
    with pytest.raises(DeviceError,
                       match="no kernels for this device, 'cpu': give the device cpu with"):
        run([noisy(1)], device)
    upscaler = DenoiseUpscale(budget=0.01)
    chain = Pipeline([upscaler], device, exposure=0.0)
    for number in range(1, 5):
        chain(flat(number, 0.7))
    assert upscaler.choice == "s"


def test_parts_need_a_network() -> None:
    with pytest.raises(PassOptionError, match="filters no parts: give a network"):
        DenoiseUpscale(model=CLASSIC, parts=("key",))


WITHOUT_ONNX_RUNTIME = """
import json, sys
sys.modules["onnxruntime"] = None
from postfx.cli.main import main
for words in json.loads(sys.argv[1]):
    print("begun", flush=True)
    print("ended with", main(words), flush=True)
"""


def test_it_needs_no_onnx_runtime(tmp_path: Path) -> None:
    """The command line runs without it, and says what is missing where a network is asked for.

    All runs in one process: only the first one needs a start of Python.
    """
    run = ["run", str(ROOM / "noisy.0001.exr"), "--frames", "1", "--no-tonemap", "--run-up", "0"]
    ways = (("--model", CLASSIC), (), ("--budget", "10000"), ("--model", "s.fp32"))
    commands = [[*run, *options, "-o", str(tmp_path / f"{number}.####.exr")]
                for number, options in enumerate(ways)]
    done = subprocess.run([sys.executable, "-c", WITHOUT_ONNX_RUNTIME, json.dumps(commands)],
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    made, *fallen = done.stdout.split("begun\n")[1:]
    assert "ended with 0" in made and "onnxruntime" not in made, done.stdout
    assert (tmp_path / "0.0001.exr").stat().st_size > 10000
    # the filter stands in for what is shipped
    assert len(fallen) == len(ways) - 1
    for number, told in enumerate(fallen, 1):
        assert "ended with 0" in told and told.count("onnxruntime is missing") == 1, told
        (one,), (other,) = (list(postfx.read_sequence(tmp_path / f"{name}.####.exr"))
                            for name in (0, number))
        np.testing.assert_array_equal(one[Role.COLOUR], other[Role.COLOUR])


def test_without_onnx_runtime_looks_that_are_tables_stay_and_the_rest_is_named() -> None:
    """In one process: the same picture by a table, a warning of the filter, and an error of a
    look's network."""
    code = f"""
import sys, warnings
import numpy as np
import postfx
from postfx import Pipeline, Role
from postfx.errors import ModelError
from postfx.passes.registry import create
frame = next(iter(postfx.read_sequence({str(ROOM / 'noisy.####.exr')!r})))
for look in ("aces2", "agx", "pbr_neutral"):
    shown = Pipeline([create("tonemap", look=look)], exposure=0.0)(frame)
    print(look, shown[Role.COLOUR].astype(float).sum())
if len(sys.argv) > 1:
    try:
        Pipeline([create("tonemap", look="auto")])(frame)
    except ModelError as error:
        assert "are tables" in str(error), error
    with warnings.catch_warnings(record=True) as told:
        create("denoise_upscale")
    assert "onnxruntime is missing" in str(told[0].message)
"""
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    hidden = f"import sys; sys.modules['onnxruntime'] = None\n{code}"
    missing = subprocess.run([sys.executable, "-c", hidden, "missing"], capture_output=True,
                             text=True)
    assert there.returncode == missing.returncode == 0, there.stderr + missing.stderr
    assert there.stdout == missing.stdout and there.stdout.count("\n") == 3
