"""Every script in samples/ runs as its first lines say."""

import contextlib
import io
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

import postfx
from postfx.cli.main import main
from postfx.cuts import CutDetector
from postfx.doctor.inspection import Inspection
from tests.kernels import host_cuda

SAMPLES = Path(__file__).parent.parent / "samples"
WRITERS = {"denoise_upscale.py": 8, "tone_map.py": 2, "pipeline.py": 8}


def run(script: str, *arguments: str) -> str:
    """What a script prints. It runs in this process: a start of Python takes longer than most of
    them."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.chdir(SAMPLES.parent)
        patch.setattr(sys, "argv", [str(SAMPLES / script), *arguments])
        patch.syspath_prepend(SAMPLES)
        runpy.run_path(str(SAMPLES / script), run_name="__main__")
    return printed.getvalue()


@pytest.mark.parametrize("script", WRITERS)
def test_script_writes_its_frames(script, tmp_path):
    run(script, str(tmp_path))
    assert (len([path for path in tmp_path.iterdir() if path.stat().st_size > 10000])
            == WRITERS[script])


def test_the_demo_says_what_takes_how_long_and_shows_a_page_with_a_video(tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "PIL", None)  # it is not among what `make demo` installs
        said = run("demo.py", str(tmp_path))
    assert re.findall(r"(?m)^(\d of 4)  ", said) == ["2 of 4", "3 of 4", "4 of 4"]
    assert len(re.findall(r"(?m)^ +\d+\.\d s$", said)) == 3
    commands = [shlex.split(line)[1:]
                for line in said.splitlines() if line.startswith("  postfx run ")]
    for words, suffix in zip(commands, (".exr", ".png"), strict=True):
        words[words.index("-o") + 1] = str(tmp_path / f"command/####{suffix}")
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(SAMPLES.parent)
            usual = () if "--no-denoise" in words else ("--model", "xl")  # tests have a quick one
            assert main([*words, "--frames", "1", "--quiet", *usual]) == 0
        of_demo = tmp_path / f"{'clean' if suffix == '.exr' else 'picture'}.0001{suffix}"
        ours, theirs = (oiio.ImageBuf(str(path)).get_pixels()
                        for path in (tmp_path / f"command/0001{suffix}", of_demo))
        assert np.array_equal(ours[..., :3], theirs[..., :3])
    page = (tmp_path / "index.html").read_text("utf-8")
    assert all((tmp_path / name).stat().st_size > 20000
               for name in re.findall(r'src="([^"]+)"', page))
    with Image.open(tmp_path / "video.png") as video:
        assert video.n_frames == 14 and video.size == (2 * 640 + 4, 360)
        shown = []
        for number in (0, 7, 13):
            video.seek(number)
            shown.append(np.asarray(video.convert("RGB"), np.float32)[:, 644:])
    picture = oiio.ImageBuf(str(tmp_path / "picture.0001.png")).get_pixels(oiio.UINT8)[..., :3]
    # the video's first frame is the picture, but for its dither
    assert np.abs(shown[0][::2, ::2] - picture).max() <= 1
    # it goes and comes back
    assert np.abs(shown[1] - shown[0]).mean() > 2 * np.abs(shown[2] - shown[0]).mean() > 0
    clean, noisy = (oiio.ImageBuf(str(tmp_path / "before_after.png")).get_pixels()[:320, half]
                    for half in (slice(0, 316), slice(324, 640)))
    assert (np.abs(np.diff(noisy[::2], axis=0)).mean() > 3 * np.abs(np.diff(clean[::2], axis=0))
            .mean())


def test_an_animation_of_pictures_of_two_sizes_is_refused(tmp_path):
    made = runpy.run_path(str(SAMPLES / "pictures.py"))
    for name, side in (("a.png", 8), ("b.png", 9)):
        Image.new("RGB", (side, side)).save(tmp_path / name)
    with pytest.raises(ValueError, match=r"b\.png: is not of the size"):
        made["write_animation"](tmp_path / "c.png", [tmp_path / "a.png", tmp_path / "b.png"], 8)


@pytest.mark.soak
def test_the_showcase_is_drawn_and_measured(tmp_path):
    """By frames of the room in the place of the product shot."""
    pytest.importorskip("flip_evaluator")
    pytest.importorskip("pyoidn")
    for number in (7, 8):
        shutil.copy(SAMPLES / f"room/noisy.{number:04d}.exr", tmp_path)
    large = next(iter(postfx.read_sequence(SAMPLES
                                           / "room/reference.0008.exr")))[postfx.Role.COLOUR]
    small = large.reshape(180, 2, 320, 2, 3).mean((1, 3))
    postfx.write_frame(tmp_path / "reference.0008.exr", postfx.Frame({postfx.Role.COLOUR: small}))
    said = run("showcase.py", str(tmp_path), str(tmp_path / "out"), "--places", "60,40", "--side",
               "60")
    rows = re.findall(r"(?m)^(.{28}) PSNR (\S+)", said)
    found = {name.strip(): float(figure) for name, figure in rows}
    assert found["as rendered"] + 5 < min(found["Open Image Denoise"], found["postfx, network xl"])
    with Image.open(tmp_path
                    / "out/showcase.jpg") as picture, Image.open(tmp_path
                                                                 / "out/showcase.webp") as video:
        assert picture.size == (4 * 180 + 12, 180 + 4 + 24 + 4 + 180) and video.n_frames == 2


@pytest.mark.soak
def test_planes_stand_on_one_picture(tmp_path):
    run("planes.py", str(tmp_path / "planes.png"))
    spec = oiio.ImageInput.open(str(tmp_path / "planes.png")).spec()
    assert (spec.width, spec.height) == (4 * 320 + 3 * 4, 2 * 180 + 4)


def test_looks_differ_and_dither_keeps_the_ramp(tmp_path):
    run("display.py", str(tmp_path))
    paths = (tmp_path / "views.jpg", tmp_path / "dither.png")
    views, ramps = (np.asarray(oiio.ImageBuf(str(path)).get_pixels()) for path in paths)
    looks = [views[y:y + 180, x:x + 320] for y in (0, 180) for x in (0, 320, 640)]
    assert min(np.abs(one - two).mean() for k, one in enumerate(looks) for two in looks[:k]) > 0.01
    rounded, dithered = ramps[:110, :, 0], ramps[-110:, :, 0]
    assert len(np.unique(rounded)) == len(np.unique(dithered)) == 9
    ramp = 128 / 255 + 25 * (np.linspace(0, 8, 900) - 4) / 255
    kept = [np.abs(np.convolve(codes.mean(0) - ramp, np.ones(32) / 32, "valid")).max()
            for codes in (rounded, dithered)]
    assert kept[1] < 0.003 and kept[0] > 0.02


def test_both_directions_are_better_than_one(tmp_path):
    rows = [line.split() for line in run("both_ways.py", str(tmp_path / "a.png"), "--model", "s")
            .splitlines()[1:9]]
    assert [int(row[0]) for row in rows] == list(range(1, 9))
    assert all(float(both) > float(forwards) for _, forwards, _, both in rows[:7])
    assert all(float(run_up) > float(forwards) for _, forwards, run_up, _ in rows[:3])
    assert (tmp_path / "a.png").stat().st_size > 100000


def test_frames_between_frames_are_better_than_blending_and_warping(tmp_path):
    pytest.importorskip("flip_evaluator")
    lines = run("between_frames.py", "--most", "1", "--picture",
                str(tmp_path / "a.png")).splitlines()[1:]
    dB, flip = ({line[14:32].strip(): float(line[32:].split()[at]) for line in lines}
                for at in (0, 2))
    assert dB["postfx"] > max(dB["warp"] + 1, dB["blend"] + 1.5)
    assert flip["postfx"] < 0.9 * min(flip["warp"], flip["blend"])
    assert (tmp_path / "a.png").stat().st_size > 100000


def test_a_tone_mapper_outside_is_measured(tmp_path):
    rows = [line.split() for line in run("external_tone_mapper.py", str(tmp_path)).splitlines()[1:]]
    assert [row[0] for row in rows] == ["right", "x2", "x0.5", "drifting"]
    made, found = (np.array([[float(row[at]), float(row[at + 2])] for row in rows])
                   for at in (1, 4))
    np.testing.assert_allclose(found, made, atol=0.05)
    assert [" ".join(row[7:]) for row in rows] == ["right", "too bright", "too dark", "drifting"]


def run_alone(script: str, *arguments: str) -> str:
    """What a script prints that runs in a process of its own, as people start it."""
    command = [sys.executable, str(SAMPLES / script), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True,
                          cwd=SAMPLES.parent).stdout


def test_reading_names_the_planes():
    assert run_alone("read_sequence.py").count("planes colour, motion") == 3


def test_all_looks_are_timed():
    assert run("look_speed.py", "--width", "96", "--height", "64", "--runs",
               "1").count("all cores") == 7


@pytest.mark.skipif(find_spec("pyoidn") is None, reason="pyoidn is not installed")
def test_speed_is_compared_with_oidn():
    printed = run("compare_speed.py", "--width", "96", "--height", "64", "--runs", "1")
    assert printed.count("x of OIDN high") == 6
    assert printed.count("'denoise_upscale': ") == 3  # and no frame repeats the one before it
    assert "'denoise_upscale': '0.00 ms'" not in printed


def test_the_time_of_the_whole_command():
    printed = run("command_speed.py", "--width", "96", "--height", "54", "--frames", "1", "--runs",
                  "1", "--ways", "1", "--model", "s")
    assert printed.count("; ratio ") == 1


def test_the_time_of_masked_frames(tmp_path):
    printed = run("masked_speed.py", "--width", "96", "--height", "64", "--runs", "1", "-o",
                  str(tmp_path / "a.png"))
    assert printed.count("% masked: denoised upscaler") == 6
    assert (tmp_path / "a.png").stat().st_size > 10000


@pytest.mark.soak
def test_the_time_of_a_frame_is_fitted_and_a_farm_simulated(tmp_path):
    printed = run("time_model.py", "--models", "s", "--runs", "1", "--sizes",
                  "96x64,192x128,384x256", "--full", "192x128", "--threads", "1", "--what",
                  "work,threads,farm", "-o", str(tmp_path / "a.png"))
    assert len(re.findall(r"the model is [+-][0-9.]+ % off", printed)) == 3 + 5 + 3 + 1
    hours = {(shot, size): float(value) for shot, size, value
             in re.findall(r"shots of (\d+), chunks of (\d+): .*; ([0-9.]+) h", printed)}
    # chunks smaller than the run-up before them
    assert hours["1000", "25"] > 2 * hours["1000", "200"]
    assert hours["100", "25"] > hours["100", "100"]
    assert (tmp_path / "a.png").stat().st_size > 10000


def test_the_memory_of_a_frame_is_measured_in_a_process_of_its_own():
    printed = run("time_model.py", "--models", "s", "--sizes", "96x64", "--budgets", "none,2G",
                  "--what", "memory")
    assert len(re.findall(r"s: 96x64, budget \w+: [1-9]\d+ MiB, 0 of them the planes; \d+ ms",
                          printed)) == 2


@pytest.mark.skipif(find_spec("flip_evaluator") is None,
                    reason="postfx-render[bench] is not installed")
@pytest.mark.soak
def test_misses_are_left_alone_as_long_as_that_is_better():
    """At every noise within 0.5 dB of the better of denoising them and leaving them; without noise
    they are left."""
    rows = [list(map(float, line.split()[:5]))
            for line in run("leave_alone.py", "1").splitlines()[1:]]
    assert all(auto > max(denoised, left) - 0.5 for _, denoised, left, auto, _ in rows)
    assert rows[0][4] > 1 and rows[0][3] > rows[0][1] + 3 and rows[-1][4] == 0


@pytest.mark.soak
def test_what_has_converged_is_left_alone_more_and_more_rarely():
    """On the smallest frame that windows fit in; what is left alone is noisier than what is
    denoised."""
    printed = run("converged.py", "--size", "96x64", "--passes", "32", "--runs", "1", "--model",
                  "s").splitlines()[1:]
    rows = [[float(word) for word in line.replace("%", "").split()] for line in printed]
    samples, shares = [row[1] for row in rows], [row[2] for row in rows]
    assert samples == sorted(samples) and shares == sorted(shares, reverse=True) and shares[0] > 20
    assert rows[0][3] < rows[0][4] and rows[0][5] < rows[0][6]


@pytest.mark.soak
def test_what_windows_take_is_measured():
    assert "ms a window =" in run("window_cost.py", "--width", "480", "--height", "272", "--runs",
                                  "1", "--model", "s")


def test_the_classical_filter_is_between_the_input_and_a_network(tmp_path):
    told = run("classic.py", str(tmp_path / "a.png"))
    later = {name: float(found)
             for name, found in re.findall(r"(?m)^(\w+) +[\d.]+ +([\d.]+) ", told)}
    assert later["plain"] + 8 < later["classic"] < later["s"]
    assert (tmp_path / "a.png").stat().st_size > 100000


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="postfx-render[bench] is not installed")
def test_a_renderer_keeps_to_a_frame_time(tmp_path):
    told = run("render_size.py", str(tmp_path / "a.png"), "--size", "96x54", "--frames", "6",
               "--time", "10000")
    assert re.findall(r"(?m)^frame .* (\d+x\d+) ", told)[::5] == ["32x18", "96x54"]
    assert (tmp_path / "a.png").stat().st_size > 5000


@pytest.mark.soak
@pytest.mark.skipif(find_spec("matplotlib") is None, reason="postfx-render[bench] is not installed")
def test_networks_improve_ambient_occlusion(tmp_path):
    """The U-Net, which never saw such blocks, by the 4 dB that it gains on real scenes."""
    told = run("occlusion.py", str(tmp_path / "a.png"), "--views", "8", "--size", "80", "48",
               "--steps", "500")
    rows = np.array([[*map(float, row)]
                     for row in re.findall(r"(?m)^ +0\.\d+ +(\S+) dB +(\S+) dB +(\S+) dB$", told)])
    classical, network, unet = rows.mean(0)
    assert (rows.shape == (6, 3) and classical > 18 and network > classical + 0.2
            and unet > classical + 4)
    assert (tmp_path / "a.png").stat().st_size > 10000


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="postfx-render[bench] is not installed")
@pytest.mark.soak
def test_a_network_shades_frames_that_it_has_not_seen(tmp_path):
    told = run("neural_shading.py", str(tmp_path / "a.png"), "--steps", "150")
    rows = re.findall(r"(?m)^frame ([36]): shaded ([\d.]+) dB, relMSE ([\d.]+); the noisy render "
                      r"([\d.]+) dB, relMSE ([\d.]+)", told)
    assert [number for number, *_ in rows] == ["3", "6"]
    for shaded, error, noisy, noise in (map(float, values) for _, *values in rows):
        assert shaded > 22 > noisy + 6 and 5 * error < noise
    assert (tmp_path / "a.png").stat().st_size > 50000


@pytest.mark.skipif(find_spec("flip_evaluator") is None,
                    reason="postfx-render[bench] is not installed")
@pytest.mark.soak
def test_networks_of_the_room_shade_its_sequence(tmp_path):
    """History makes them calmer by a quarter, and nearer to the reference, whose noise would hide
    it."""
    pytest.importorskip("pyoidn")
    half = [str(SAMPLES / f"room/{name}.000[1-4].exr") for name in ("noisy", "reference")]
    told = run("scene_network.py", str(tmp_path / "a.png"), "--runs", "1", "--clean", "--noisy",
               half[0], "--reference", half[1])
    rows = re.findall(r"(?m)^(.{22}) +([\d.]+) dB  relMSE ([\d.]+)  flicker +([\d.]+) +[\d.]+ ms a "
                      r"frame", told)
    dB, relative, flicker = ({name.strip(): float(values[k]) for name, *values in rows}
                             for k in (0, 1, 2))
    assert max(relative.values()) < 0.03  # lamps have their light, and nothing is brighter
    assert dB["shading"] > 32.5 and dB["temporal"] > max(32.3, dB["temporal, no history"] + 0.5)
    assert flicker["temporal"] < 0.75 * flicker["temporal, no history"]
    assert (tmp_path / "a.png").stat().st_size > 50000


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="postfx-render[bench] is not installed")
def test_a_neural_material_is_better_than_coarser_blocks(tmp_path):
    pytest.importorskip("torch")
    told = run("neural_material.py", str(tmp_path / "a.png"), "--size", "64", "--steps", "200")
    rows = re.findall(r"(?m)^(\w+, \d+ bits) +([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+) +([\d.]+)$",
                      told)
    colour, normal, whole = ({name: float(values[k]) for name, *values in rows} for k in (1, 2, 4))
    assert len(rows) == 4 and colour["blocks, 16 bits"] > 27 and normal["blocks, 16 bits"] > 34
    assert whole["neural, 16 bits"] > whole["neural, 8 bits"] > whole["blocks, 7 bits"] - 1
    assert (tmp_path / "a.png").stat().st_size > 10000


def test_a_network_inside_of_a_kernel_gives_what_three_dispatches_give() -> None:
    told = run("mlp_in_kernel.py", "--width", "96", "--runs", "1")
    assert float(re.search(r"largest difference (\S+) of", told)[1]) < 1e-5 and "ratio" in told


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
def test_the_cuda_source_of_the_sample_shades_as_its_rows_do() -> None:
    names = runpy.run_path(str(SAMPLES / "mlp_in_kernel.py"))
    normal, albedo = names["ball"](18, 40)
    inputs = {"network": names["NETWORK"].facts(), "parameters": names["NETWORK"].initial(),
              "normal": normal, "albedo": albedo, "points": np.zeros((18, 40, 5), np.float32),
              "values": np.random.default_rng(0).normal(size=(18, 40, 3)).astype(np.float32)}
    for kernel in (names["ONE"], names["FEATURES"], names["SHADE"]):
        given = {name: inputs[name] for name in kernel.reads}
        shape = inputs[kernel.writes[0]].shape if kernel.writes[0] in inputs else normal.shape
        wanted, found = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        kernel.rows(0, 18, *given.values(), wanted)
        host_cuda.run(kernel, given | {kernel.writes[0]: found})
        np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_small_networks_are_timed_beside_torch() -> None:
    pytest.importorskip("torch")
    told = run("neural_speed.py", "--widths", "8", "--threads", "1", "--points", "100", "--runs",
               "1", "--eager")
    assert len(re.findall(r"(?m)^ +1 +8 (?:run|learn) .* [\d.]+x$", told)) == 2


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="postfx-render[bench] is not installed")
def test_a_sky_is_learnt_while_the_sun_moves(tmp_path) -> None:
    told = run("sky_probe.py", str(tmp_path / "sky.png"), "--frames", "60", "--width", "96")
    online, stopped = map(float, re.search(r"frames: (\S+) where it learns on, (\S+) where it",
                                           told).groups())
    assert online < 0.1 and online < stopped / 4
    assert (tmp_path / "sky.png").stat().st_size > 10000


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="postfx-render[bench] is not installed")
def test_networks_of_irradiance_are_better_than_few_samples(tmp_path) -> None:
    told = run("irradiance_network.py", str(tmp_path / "a.png"), "--samples", "1", "4", "--frames",
               "2", "32", "--offline", "200", "--reference", "4096", "--checked", "100", "--width",
               "96", "--runs", "1")
    errors = {name: float(error)
              for name, error in re.findall(r"(?m)^(\w.*?) +[\d.]+ +(\d\S*e[-+]\d+)$", told)}
    assert errors["online, frame 32"] < errors["online, frame 2"] / 4
    assert max(errors["online, frame 32"], errors["offline, ONNX"]) < errors["Monte Carlo, 4 "
                                                                             "samples"]
    assert 1000 < int(re.search(r"(\d+) of 5184 pixels have", told)[1]) < 4000
    assert (tmp_path / "a.png").stat().st_size > 10000


@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs ziglang")
def test_a_pixel_function_is_the_same_at_every_level() -> None:
    told = run("one_source.py", "--width", "40", "--height", "24", "--runs", "1")
    found = dict(re.findall(r"(?m)^ *(\w+) +[\d.]+ ms  difference (\S+)$", told))
    assert float(found.pop("baseline")) < 1e-6
    assert all(float(difference) == 0 for difference in found.values())


@pytest.mark.soak
def test_edges_of_overlays_neither_ring_nor_shine(tmp_path):
    """What holds them adds less than 0.5 % to the error; bilinear has more than 10 % more."""
    lines = run("overlay_edges.py", str(tmp_path / "room.png")).splitlines()[1:]
    rows = {(line[:10].strip(), line[11:37].strip()): line[37:].split() for line in lines}
    for overlay in ("disc", "letters", "particles"):
        error, outside, excess = map(float, rows[overlay, "and held to coverage"][:3])
        free, plain = (float(rows[overlay, way][0])
                       for way in ("cubic, each channel held", "bilinear"))
        assert outside < 1e-4 and excess < 1e-4 and error < 1.005 * free < plain / 1.1
    assert (tmp_path / "room.png").stat().st_size > 100000


@pytest.mark.soak
def test_sparks_leave_a_third_of_their_ghosts_at_most_with_a_mask(tmp_path):
    printed = run("ghosts.py", "--models", "s", "-o", str(tmp_path / "a.png")).splitlines()
    ghosts = {line[5:17].strip(): float(line[17:].split()[0]) for line in printed}
    assert max(ghosts["coverage"], ghosts["difference"]) < ghosts["no mask"] / 3
    assert (tmp_path / "a.png").stat().st_size > 100000


@pytest.mark.soak
def test_memory_is_measured_within_a_budget():
    """The peak of a process begins with that of the one that starts it, which must be small."""
    printed = run_alone("measure_memory.py", "--sizes", "2560x1440", "--memory", "none,640M",
                        "--model", "s")
    whole, part = (float(line.split(": ")[1].split()[0]) for line in printed.splitlines())
    assert part < 640 and part < 0.8 * whole, printed


def test_what_the_ray_caster_writes_is_right(tmp_path):
    """The history helps, and every mistake about motion and jitter costs more than 1 dB."""
    run("ray_caster.py", str(tmp_path), "--frames", "5", "--size", "128x72", "--reference", "5",
        "--reference-samples", "24")
    printed = run("integration_mistakes.py", str(tmp_path)).splitlines()
    scores = {line.split(" dB  ")[1]: float(line.split()[0]) for line in printed}
    costly = [name for name in scores if "motion" in name or "jitter" in name or "reset" in name]
    assert len(costly) == 8 and max(scores[name] for name in costly) < scores["none"] - 1, scores
    noisy = tmp_path / "noisy.####.exr"
    detector = CutDetector()
    assert not any(detector(frame) for frame in postfx.read_sequence(noisy))
    found = {finding.code for finding in Inspection(str(noisy), None, None).findings}
    assert found <= {"albedo-noisy"}  # by its texture, at this size


def cells(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")]
            for line in table.splitlines()[2:]]


def test_reflections_are_better_with_their_hit_distance():
    printed = run("reflections.py", "--size", "96x54", "--frames", "4", "--judged", "4",
                  "--roughness", "0.05", "--reference-samples", "16", "--models", "s")
    ((_, _, alone, surface, hit, rest),) = cells(printed)
    assert (float(hit) > float(surface) + 0.2 and float(surface) > float(alone)
            and abs(float(rest)) < 0.2)


@pytest.mark.skipif(find_spec("flip_evaluator") is None,
                    reason="postfx-render[bench] is not installed")
@pytest.mark.soak
def test_history_brings_detail_that_no_frame_holds():
    found = {name: list(map(float, re.findall(r"-?[0-9.]+", albedo)))
             for name, albedo, *_ in cells(run("detail.py", "--frames", "2", "--models", "s",
                                                  "--subsamples", "4"))}
    share, match = (lambda name: found[name][1]), (lambda name: found[name][2])
    assert share("all samples kept") > 0.5 > 0.25 > share("perfect + cubic")
    assert match("postfx s") > match("perfect + cubic") > match("postfx s, alone")


def test_pictures_of_tools_show_what_they_say(tmp_path):
    """The two that need no browser: boards a stop apart around the right one, and a shot of each
    kind."""
    made = runpy.run_path(str(SAMPLES / "site_pictures.py"))
    made["draw_boards"](tmp_path / "board.png")
    pixels = made["pixels_of"](tmp_path / "board.png")
    dark, right, bright = (pixels[:180, x:x + 320].mean() / 255 for x in (0, 328, 656))
    assert abs(right - 0.35) < 0.02 and dark < right - 0.08 and bright > right + 0.08
    found = made["debug"](made["shots"](), [postfx.ToneMap(look="aces2")], "metadata")
    assert [shot.verdict for shot in found.shots] == ["right", "drifting", "too dark"]


def test_passes_by_networks_of_scenes_are_timed():
    rows = run("scene_passes.py", "--runs", "1").splitlines()
    assert len(rows) == 7 and all(float(row.split()[-4]) > 0 for row in rows[1:])
    (points,) = (row for row in rows if row.startswith("scene_shading, points"))
    busy, rate = (float(points.split()[at]) for at in (-6, -4))
    assert abs(busy * rate / 1000 - 1) < 0.1


def test_every_script_is_run_here():
    named = {*WRITERS, "demo.py", "pictures.py", "showcase.py", "read_sequence.py",
             "compare_speed.py", "masked_speed.py", "leave_alone.py",
             "converged.py", "window_cost.py", "one_source.py", "overlay_edges.py", "ghosts.py",
             "measure_memory.py", "ray_caster.py", "integration_mistakes.py", "look_speed.py",
             "convolution_speed.py",
             "both_ways.py", "command_speed.py", "external_tone_mapper.py", "between_frames.py",
             "mlp_in_kernel.py", "neural_speed.py", "sky.py", "sky_probe.py",
             "irradiance_network.py", "planes.py", "classic.py", "render_size.py", "occlusion.py",
             "time_model.py", "neural_material.py", "neural_shading.py", "scene_network.py",
             "display.py", "reflections.py", "detail.py", "site_pictures.py", "scene_passes.py",
             "blender_panels.py"}
    assert {path.name for path in SAMPLES.glob("*.py")} == named


def test_convolutions_by_tiles_are_compared_with_onnx_runtimes():
    pytest.importorskip("onnx")
    said = run("convolution_speed.py", "--width", "48", "--height", "32", "--runs", "1")
    lines = re.findall(r"(?m)^(.+?) +[\d.]+ ms +[\d.]+ ms +[\d.]+  off by (\S+)$", said)
    assert [name for name, _ in lines[-2:]] == ["xl, 48x32", "l, 48x32"] and len(lines) == 12
    assert all(0 < float(error) < 1e-4 for _, error in lines)
