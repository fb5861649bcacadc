"""The network that a run takes where nobody chose one."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import postfx
from postfx.io.sequence import Sequence
from postfx.io.writer import write_channels
from postfx.passes.denoise import default_network
from postfx.passes.denoise.default_network import (
    ENLARGING_PIXEL_BYTES,
    GPU_PIXEL_BYTES,
    PIXEL_BYTES,
    PLAIN_PIXEL_BYTES,
    lacks_memory,
    usual_network,
)
from postfx.passes.denoise.models import mixture_model, short_tag
from tests.splatted import splatted

CHOOSES_NETWORK = True
ENLARGING = short_tag(mixture_model("xl"))
RUN = ("run", "in/shot.####.exr", "-o", "out/", "--overwrite", "--device", "cpu")


@pytest.mark.parametrize(("options", "network"), (
    ((), "xl"), (("--scale", "1"), "xl"), (("--denoise-only",), "xl"),
    (("--scale", "2"), "xl in two stages"), (("--size", "72x48"), "xl in two stages"),
    (("--budget", "5000"), "m"), (("--memory", "2G"), "m"), (("--model", "s"), "s"),
    (("--preset", "preview"), "s"),
))
def test_a_run_takes_the_best_network(postfx, shot, tmp_path, options, network):
    shot(1)
    done = postfx(*RUN, *options)
    assert done.code == 0
    found = (tmp_path / "out" / "postfx.manifest.json").read_text()
    tag = network.split()[0]
    assert f"denoise_upscale.{tag}" in found
    told = done.err.split("chose    denoise_upscale: ")[1].splitlines()[0]
    if "--budget" not in options:  # a budget begins with the fastest network
        assert told == f"{network} for 1 frame"
    assert f"; network {tag}" in postfx(*RUN, *options, "--explain").out


def test_where_samples_pay_is_told_for_the_same_network(postfx, shot):
    shot(1)
    words = ("samples", "in/shot.####.exr", "--samples", "4", "--device", "cpu", "--json")
    usual, best, small = (json.loads(postfx(*words, *model).out)["frames"]
                          for model in ((), ("--model", "xl"), ("--model", "s")))
    assert usual == best != small


def spread_noise(folder, *numbers, spread=True):
    """Frames of grey noise in a folder, after a gaussian pixel filter."""
    folder.mkdir()
    for number in numbers:
        light = np.random.default_rng(number).gamma(1, 1.0, (96, 128, 1)).repeat(3, 2)
        light = splatted(np.full((96, 128, 3), 0.5), 0.5, seed=number) if spread else light
        write_channels(folder / f"shot.{number:04d}.exr",
                       {name: light[..., axis] for axis, name in enumerate("RGB")}, {})


@pytest.mark.parametrize("spread", (True, False))
def test_a_run_undoes_the_pixel_filter_that_the_noise_tells(postfx, tmp_path, spread):
    """The best network stays, and the summary says what was done."""
    spread_noise(tmp_path / "in", 1, spread=spread)
    done = postfx(*RUN)
    assert done.code == 0 and "chose    denoise_upscale: xl for 1 frame" in done.err
    told = [line for line in done.err.splitlines() if line.startswith("undid")]
    assert len(told) == spread and "noise of pixels" not in done.err
    assert all("a pixel filter of 0.4" in line or "a pixel filter of 0.5" in line for line in told)
    runs = json.loads((tmp_path / "out/postfx.manifest.json").read_text())["runs"]
    (used,) = (made["passes"]["denoise_upscale"]["pixel_filter"] for made in runs.values())
    assert used == (pytest.approx(0.5, rel=0.1) if spread else "none")
    explained = postfx(*RUN, "--explain").out
    assert ("a pixel filter of 0.5" in explained or "a pixel filter of 0.4" in explained) == spread
    for words, is_told in ((("--model", "s"), spread),
                           (("--model", "s", "--pixel-filter", "none"), False)):
        assert ("as a gaussian pixel filter" in postfx(*RUN, *words).err) == is_told
    assert "pixel filter" not in postfx(*RUN, "--pixel-filter", "none", "--explain").out
    assert "a pixel filter of 0.45 px" in postfx(*RUN, "--pixel-filter", "0.45", "--explain").out


def test_chunks_undo_the_pixel_filter_of_the_first_frame(postfx, tmp_path):
    """Their pixels are those of one run, though each would find another width."""
    spread_noise(tmp_path / "in", 1, 2)
    words = ("--model", "l", "--device", "cpu", "--run-up", "0")
    done = postfx("chunks", "in/shot.####.exr", "--size", "1", "-o", "parts/a.####.exr", "--json",
                  "--", *words)
    for chunk in done.json["chunks"]:
        assert "--pixel-filter" in chunk["command"]
        assert postfx(*chunk["command"][1:]).code == 0
    assert postfx("run", "in/shot.####.exr", "-o", "one/a.####.exr", *words).code == 0
    assert postfx("run", "in/shot.####.exr", "-o", "two/", "--frames", "2", *words).code == 0
    widths = {made["passes"]["denoise_upscale"]["pixel_filter"]
              for folder in ("one", "two", "parts")
              for made in json.loads((tmp_path / folder / "postfx.manifest.json").read_text()
                                     )["runs"].values()}
    assert len(widths) == 1
    for path in sorted((tmp_path / "one").glob("*.exr")):
        one, other = (Sequence(found) for found in (path, tmp_path / "parts" / path.name))
        assert (one.read(one.numbers[0])["colour"] == other.read(one.numbers[0])["colour"]).all()


@pytest.mark.parametrize(("options", "said"), (
    (("--scale", "2"), "network xl at the render's size first, then "
     f"{ENLARGING} enlarges; l alone where frames have jitter"),
    (("--model", "m.fp32"), "network m.fp32"),
    (("--budget", "5000"), "network m, or a faster one to keep the budget"),
    (("--model", "classic"), "the classical filter, no network"),
))
def test_a_plan_says_which_network_runs(postfx, shot, options, said):
    """That of a stand-in, where the one that was asked for cannot run."""
    shot(1)
    (line,) = [line for line in postfx(*RUN, *options, "--explain").out.splitlines()
               if ": reads " in line and "denoise_upscale" in line]
    assert line.endswith(f"; {said}")


@pytest.mark.parametrize("bound", (("--budget", "5000"), ("--memory", "2G")))
def test_a_bound_says_that_it_takes_a_smaller_network(postfx, shot, bound):
    shot(1)
    told = f"skips   the best network: {bound[0]} takes m unless --model names another"
    assert told in postfx(*RUN, *bound, "--explain").out
    assert "the best network" not in postfx(*RUN, *bound, "--model", "s", "--explain").out


def test_a_network_in_no_folder_is_told_by_its_file(postfx, shot):
    shot(1)
    done = postfx(*RUN, "--model", "nets/mine.onnx")
    assert done.code == 2
    assert "error: model 'nets/mine.onnx': no such file: check the path and its rights" in done.err


def test_frames_that_are_too_large_for_it_take_the_usual_one(postfx, shot, tmp_path, monkeypatch):
    shot(1)
    monkeypatch.setattr(default_network, "usable_memory", lambda: 1 << 20)
    done = postfx(*RUN)
    assert done.code == 0
    line = next(line for line in done.err.splitlines() if "the best network" in line)
    assert line.startswith("skipped  the best network: frames of ")
    assert "m runs; --model xl with --memory works in tiles" in line
    found = (tmp_path / "out" / "postfx.manifest.json").read_text()
    assert "denoise_upscale.m" in found


def on_a_gpu(free: int | None) -> SimpleNamespace:
    """A device that is a GPU with so many bytes free; None for one whose kernels are not ours."""
    gpu = None if free is None else SimpleNamespace(free_bytes=lambda: free)
    return SimpleNamespace(memory=SimpleNamespace(host_visible=False), gpu=gpu)


@pytest.mark.parametrize("scale", (1, 2))
def test_a_gpu_takes_it_where_its_free_memory_is_enough(scale):
    size = 1920, 1080
    each = GPU_PIXEL_BYTES + (scale - 1) * ENLARGING_PIXEL_BYTES
    enough = each * size[0] * size[1]
    assert usual_network(size, scale, on_a_gpu(enough)) == "xl"
    assert usual_network(size, scale, on_a_gpu(enough - 1)) == "m"
    assert usual_network(size, scale, on_a_gpu(None)) == "m"
    assert lacks_memory(size, scale, on_a_gpu(1 << 30)).startswith(
        f"frames of 1920x1080 take {enough >> 30} GB, this GPU has 1 GB free: m runs; ")


@pytest.mark.parametrize(("operators", "each"), [
    ("a file", PIXEL_BYTES), (None, PLAIN_PIXEL_BYTES)])
def test_a_cpu_takes_it_where_its_memory_is_enough(operators, each, monkeypatch):
    """Without our convolutions it needs more."""
    size, device = (1920, 1080), postfx.Device("cpu")
    monkeypatch.setattr(default_network, "operators_library", lambda: operators)
    for there, network in ((each * 1920 * 1080, "xl"), (each * 1920 * 1080 - 1, "m")):
        monkeypatch.setattr(default_network, "usable_memory", lambda there=there: there)
        assert usual_network(size, 1, device) == network


def test_larger_frames_with_guides_take_the_network_that_reads_them():
    size, device = (64, 48), on_a_gpu(1 << 40)
    assert [usual_network(size, scale, device, True) for scale in (1, 2)] == ["xl", "m"]


def test_a_still_takes_the_same():
    color = np.random.default_rng(1).random((24, 32, 3), np.float32)
    chosen = [postfx.denoise(color, model=model) for model in (None, "xl", "m")]
    np.testing.assert_array_equal(chosen[0], chosen[1])
    assert np.abs(chosen[0] - chosen[2]).max() > 1e-3
    enlarged = [postfx.denoise(color, model=model, scale=2) for model in (None, "xl")]
    np.testing.assert_array_equal(*enlarged)


def test_watch_makes_previews_with_the_quick_network(postfx, shot, tmp_path):
    shot(1)
    made = {}
    for name, options in (("plain", ()), ("m", ("--model", "m")), ("xl", ("--model", "xl"))):
        done = postfx("watch", "in/shot.####.exr", "-o", f"{name}/shot.####.exr", "--until", "1",
                      "--", "--device", "cpu", *options)
        assert done.code == 0
        made[name] = (tmp_path / name / "shot.0001.exr").read_bytes()
    assert made["plain"] == made["m"] != made["xl"]
