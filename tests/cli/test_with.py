"""`postfx run --with`: another denoiser beside the project's own."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import oidn
from postfx.version import pip_install

RUN = ("run", "in/shot.####.exr", "--model", "s", "--scale", "1")
needs_oidn = pytest.mark.skipif(not oidn.is_installed(),
                                reason="Open Image Denoise is not installed")


def pixels(path: Path) -> np.ndarray:
    found: np.ndarray = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)[..., :3]
    return found


def header(path: Path) -> str:
    return str(oiio.ImageBuf(str(path)).spec().getattribute("postfx:settings"))


@needs_oidn
def test_open_image_denoise_runs_too_and_files_and_words_say_so(postfx: Callable,
                                                                noise: Path) -> None:
    done = postfx(*RUN, "--with", "oidn", "-o", "out/a.####.exr", "--json")
    assert done.code == 0, done.err
    assert set(done.json["passes"]) == {"partner", "denoise_upscale", "mix_partner"}
    assert f"with oidn (pyoidn {oidn.version()})" in done.err
    facts = json.loads(header(noise / "out/a.0003.exr"))
    assert facts["settings"]["with"] == "oidn" and facts["passes"]["partner"]["of"] == "oidn"
    (run,) = json.loads((noise / "out/postfx.manifest.json").read_text())["runs"].values()
    assert run["versions"]["pyoidn"] == oidn.version()
    plain = postfx(*RUN, "-o", "plain/a.####.exr")
    assert plain.code == 0
    assert "pyoidn" not in plain.err and not np.array_equal(pixels(noise / "out/a.0004.exr"),
                                                            pixels(noise / "plain/a.0004.exr"))


@needs_oidn
def test_the_plan_names_the_partner(postfx: Callable, noise: Path) -> None:
    told = postfx(*RUN, "--with", "oidn,quality=fast", "--explain").out
    assert f"runs oidn (pyoidn {oidn.version()})" in told
    assert (told.index("partner: reads") < told.index("denoise_upscale: reads")
            < told.index("mix_partner: reads"))


@needs_oidn
def test_the_preset_for_final_frames_takes_it_where_it_is_installed(
    postfx: Callable, noise: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = (*RUN, "--preset", "final", "--explain")
    assert "runs oidn" in postfx(*given).out
    assert "runs oidn" not in postfx(*given, "--with", "none").out
    assert "runs oidn" not in postfx(*given[:-3], "--explain").out
    monkeypatch.setattr(oidn, "find_spec", lambda name: None)
    alone = postfx(*given)
    assert alone.code == 0 and "runs oidn" not in alone.out and "both_ways" in alone.out
    assert "skips   Open Image Denoise: it is not installed" in alone.out
    assert "Open Image Denoise" not in postfx(*given, "--with", "none").out


@needs_oidn
@pytest.mark.parametrize("size", [("--scale", "2"), ("--size", "96x64")], ids=str)
def test_the_preset_for_final_frames_leaves_it_out_where_they_are_enlarged(
    postfx: Callable, noise: Path, size: tuple[str, ...]
) -> None:
    given = (*RUN[:2], *size, "--preset", "final", "--explain")
    told = postfx(*given).out
    assert "runs oidn" not in told and "both_ways" in told
    assert "skips   Open Image Denoise: frames are enlarged" in told
    assert "network xl at the render's size first, then " in told
    assert "runs oidn" in postfx(*given, "--with", "oidn").out


@needs_oidn
@pytest.mark.parametrize("words", [("--with", "oidn"), ("--preset", "final")])
def test_it_runs_where_the_output_s_size_is_given(postfx: Callable, noise: Path,
                                                  words: tuple[str, ...]) -> None:
    run = (*RUN[:4], *words, "--frames", "1-2", "--run-up", "0")
    made = {}
    for name, size in (("by size", ("--size", "96x64")), ("by scale", ("--scale", "2"))):
        assert postfx(*run, *size, "-o", f"{name}/a.####.exr").code == 0
        made[name] = pixels(noise / f"{name}/a.0002.exr")
    assert made["by size"].shape == (64, 96, 3)
    np.testing.assert_array_equal(made["by size"], made["by scale"])


def test_what_is_not_installed_is_one_line(postfx: Callable, noise: Path,
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oidn, "find_spec", lambda name: None)
    done = postfx(*RUN, "--with", "oidn", "-o", "out/a.####.exr")
    assert done.code == 2
    assert done.err.strip().splitlines()[-1].endswith(f"is not installed: {pip_install('oidn')}")
    assert not (noise / "out").exists()


@needs_oidn
def test_frames_that_were_missing_come_out_as_in_an_unbroken_run(postfx: Callable,
                                                                 noise: Path) -> None:
    given = (*RUN, "--with", "oidn", "-o", "out/a.####.exr")
    assert postfx(*given, "--checkpoint", "0").code == 0
    whole = {number: pixels(noise / f"out/a.{number:04d}.exr") for number in (3, 6)}
    for number in whole:
        (noise / f"out/a.{number:04d}.exr").unlink()
    assert postfx(*given, "--skip-existing", "--json").json["frames"] == 2
    for number, before in whole.items():
        np.testing.assert_array_equal(pixels(noise / f"out/a.{number:04d}.exr"), before)


@needs_oidn
def test_frames_of_another_partner_are_told_from_its_own(postfx: Callable, noise: Path) -> None:
    given = ("--with", "oidn", "-o", "out/a.####.exr", "--skip-existing", "--json")
    assert postfx(*RUN, "--with", "oidn,quality=fast", "-o", "out/a.####.exr").code == 0
    (warning,) = [text for text in postfx(*RUN, *given).json["warnings"] if text.startswith("kept")]
    assert "made with other settings, models or versions: frames 1-6;" in warning


@needs_oidn
def test_strength_0_leaves_it_out(postfx: Callable, noise: Path) -> None:
    assert "partner" not in postfx(*RUN, "--with", "oidn", "--strength", "0", "--explain").out


@pytest.mark.parametrize(("words", "reason"), [
    (["--no-denoise"], "--no-denoise leaves out"), (["--budget", "9"], "--budget keeps to a time"),
    (["--memory", "4G"], "--memory keeps to a size")])
def test_what_it_does_not_go_with(postfx: Callable, noise: Path, words: list[str],
                                  reason: str) -> None:
    done = postfx("run", "in/shot.####.exr", "--with", "oidn", *words, "-o", "out/a.####.exr")
    assert done.code == 2 and reason in done.err
