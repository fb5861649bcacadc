"""`postfx loop`: rounds of rendering where it pays, with renderers that are faked, Blender and
Mitsuba."""

import json
import os
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.main import main
from postfx.frame import Role
from postfx.io.exr.merge import merge_renders
from postfx.io.frame_reader import FrameFiles
from postfx.io.sequence import read_sequence
from postfx.tools.adaptive.estimate import read_error

ROOT = Path(__file__).resolve().parents[2]
HOSTS = ROOT / "hosts/loop"

FAKE = """
import json, sys
from pathlib import Path
import numpy as np
from postfx.io.writer import write_channels

jobs = json.loads(Path(sys.argv[1]).read_text())["jobs"]
size = 96, 64
for job in jobs:
    box = job["region"] or {"x": 0, "y": 0, "width": size[0], "height": size[1]}
    sigma = np.full(size[::-1], 0.01)
    sigma[:, 48:] = 0.5
    rows = slice(box["y"], box["y"] + box["height"])
    columns = slice(box["x"], box["x"] + box["width"])
    noise = np.random.default_rng(job["seed"]).normal(0, 1, (*size[::-1], 3)) * sigma[..., None]
    light = np.abs(0.4 + noise / np.sqrt(job["samples"]))[rows, columns]
    planes = {name: light[..., axis] for axis, name in enumerate("RGB")}
    header = {"postfx:spp": job["samples"]}
    write_channels(job["output"], planes, header, (box["x"], box["y"]), size)
"""


@pytest.fixture
def fake(tmp_path: Path, monkeypatch) -> str:
    """The command of a renderer whose right half is noisy."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    (tmp_path / "fake.py").write_text(FAKE)
    return shlex.join([sys.executable, str(tmp_path / "fake.py"), "{jobs}"])


def loop(tmp_path: Path, render: str, *words: str, model: str = "s") -> int:
    return main(["loop", "--render", render, "-o", f"{tmp_path}/clean/####.exr", *words, "--",
                 "--model", model])


@pytest.mark.parametrize("text", ["", "[" * 100_000, "[3]", "{}x", '[{"plan": {}}]', '"text"'])
def test_a_damaged_log_of_rounds_is_one_line(tmp_path: Path, fake: str, capsys, text: str):
    log = tmp_path / "clean" / "loop" / "loop.json"
    log.parent.mkdir(parents=True)
    log.write_text(text)
    assert loop(tmp_path, fake) == 2
    assert re.fullmatch(rf"error: {log}: is damaged \(.*\): delete it to begin the loop anew\n",
                        capsys.readouterr().err)


def test_only_noisy_tiles_are_rendered_again_and_merged(tmp_path: Path, fake: str, capsys):
    words = ("--samples", "4", "--rounds", "2", "--quality", "46dB", "--json")
    assert loop(tmp_path, fake, "--frames", "1-2", *words) == 0
    printed = capsys.readouterr()
    facts = json.loads(printed.out)
    assert printed.err.count("round ") == len(facts["rounds"]) >= 2
    means = [one["samples"] for one in facts["rounds"]]
    assert means[0] == 4 and means == sorted(means)
    work = tmp_path / "clean/loop"
    jobs = json.loads((work / "round1.json").read_text())["jobs"]
    assert jobs and all(job["region"]["x"] >= 32 for job in jobs)
    first = json.loads((work / "round0.json").read_text())["jobs"]
    assert len({job["seed"] for job in first} & {job["seed"] for job in jobs}) == 0
    for number in (1, 2):
        counts = read_sequence(work
                               / f"merged/{number:04}.exr").read(number)[Role.SAMPLE_COUNT][:, :, 0]
        assert counts[:, :32].max() == 4 and counts[:, 64:].min() > 4
        assert (tmp_path / f"clean/{number:04}.exr").exists()


def test_a_budget_is_kept_over_all_rounds(tmp_path: Path, fake: str, capsys):
    words = ("--samples", "4", "--quality", "60dB", "--json")
    assert loop(tmp_path, fake, *words, "--rounds", "1", "--budget", "4") == 0
    rounds = json.loads(capsys.readouterr().out)["rounds"]
    assert 4 < rounds[-1]["samples"] <= 8 and len(rounds) == 2
    # goes on with a larger budget
    assert loop(tmp_path, fake, *words, "--rounds", "3", "--budget", "10") == 0
    rounds = json.loads(capsys.readouterr().out)["rounds"]
    assert 8 < rounds[-1]["samples"] <= 14 and len(rounds) >= 3
    seeds = {job["seed"] for path in tmp_path.glob("clean/loop/round*.json")
             for job in json.loads(path.read_text())["jobs"]}
    assert len(seeds) == 2 * len(rounds)


def test_halves_are_of_one_sequence(tmp_path: Path, fake: str):
    """Both go on where the other one ends, round by round, with seeds of their own for renderers
    that cannot. Cycles' headers count the samples that were left out before the first one."""
    script = Path(shlex.split(fake)[1])
    script.write_text(FAKE.replace('{"postfx:spp": job["samples"]}',
                                   '{"postfx:spp": job["first_sample"] + job["samples"]}'))
    words = ("--samples", "9", "--quality", "60dB", "--tile", "16", "--rounds", "2", "--budget",
             "27")
    assert loop(tmp_path, fake, *words) == 0
    work, drawn, counts = tmp_path / "clean/loop", 0, np.zeros((64, 96))
    for number in range(3):
        jobs = json.loads((work / f"round{number}.json").read_text())["jobs"]
        assert {job["first_seed"] for job in jobs} == {1}
        assert len({job["seed"] for job in jobs}) == 2
        first, second = ([job for job in jobs if job["half"] == half]
                         for half in ("half1", "half2"))
        for one, other in zip(first, second, strict=True):
            assert one["region"] == other["region"] and one["first_sample"] == drawn
            assert other["first_sample"] == drawn + one["samples"]
            box = one["region"] or {"x": 0, "y": 0, "width": 96, "height": 64}
            counts[box["y"] : box["y"] + box["height"],
                   box["x"] : box["x"] + box["width"]] += one["samples"] + other["samples"]
        drawn += max(one["samples"] + other["samples"]
                     for one, other in zip(first, second, strict=True))
    merged = read_sequence(work / "merged/0001.exr").read(1)[Role.SAMPLE_COUNT][:, :, 0]
    np.testing.assert_array_equal(merged, counts)


def test_a_network_that_predicts_its_error_needs_no_halves(tmp_path: Path, fake: str, capsys):
    """One sequence of samples: each round goes on where the last one ended."""
    words = ("--samples", "4", "--quality", "60dB", "--tile", "16", "--json")
    more = ("--rounds", "1", "--budget", "4", "--error", "network")
    assert loop(tmp_path, fake, *words, *more, model="l") == 0
    rounds = json.loads(capsys.readouterr().out)["rounds"]
    assert len(rounds) == 2 and 4 < rounds[1]["samples"] <= 8
    work = tmp_path / "clean/loop"
    first, second = (json.loads((work / f"round{number}.json").read_text())["jobs"]
                     for number in range(2))
    assert [(job["samples"], job["first_sample"]) for job in first] == [(4, 0)]
    assert {job["first_sample"] for job in second} == {4}
    assert {job["first_seed"] for job in second} == {first[0]["seed"]}
    counts = np.full((64, 96), 4.0)
    for job in second:
        box = job["region"]
        counts[box["y"] : box["y"] + box["height"],
               box["x"] : box["x"] + box["width"]] += job["samples"]
    merged = read_sequence(work / "merged/0001.exr").read(1)[Role.SAMPLE_COUNT][:, :, 0]
    np.testing.assert_array_equal(merged, counts)
    assert not (work / "half2").exists()
    assert loop(tmp_path, fake, *words, model="l") == 2
    assert "was begun with --error network" in capsys.readouterr().err


@pytest.mark.parametrize("given", [["--aov", "key,fill"], ["--aov=fill,error,key"]])
@pytest.mark.parametrize("network", ["xl", "l"])
def test_light_groups_need_no_halves_either(tmp_path: Path, fake: str, given, network):
    """The network predicts its error beside them, and they still add up to the picture."""
    Path(shlex.split(fake)[1]).write_text(FAKE.replace("    header =", """\
    for name, share in (("key", 0.7), ("fill", 0.3)):
        planes |= {f"{name}.{channel}": share * light[..., axis]
                   for axis, channel in enumerate("RGB")}
    header ="""))
    words = ["loop", "--render", fake, "-o", f"{tmp_path}/clean/####.exr", "--samples", "4",
             "--quality", "60dB", "--rounds", "1", "--budget", "4", "--tile", "16",
             "--error", "network"]
    assert main([*words, "--", *given, "--model", network]) == 0
    assert not (tmp_path / "clean/loop/half2").exists()
    sequence = read_sequence(tmp_path / "clean/0001.exr", aov="key,fill")
    found = sequence.read(1)
    both = found.parts["key"] + found.parts["fill"]
    np.testing.assert_allclose(both, found[Role.COLOUR], atol=2e-3)
    assert read_error(tmp_path / "clean/0001.exr").max() > 0


def test_a_network_without_a_prediction_is_refused_where_it_must_have_one(
        tmp_path: Path, fake: str, capsys):
    assert loop(tmp_path, fake, "--error", "network") == 2
    assert "give --error halves, or another --model" in capsys.readouterr().err


def test_a_loop_that_was_stopped_goes_on(tmp_path: Path, fake: str, capsys):
    words = ("--samples", "4", "--quality", "46dB", "--json")
    assert loop(tmp_path, fake, *words, "--rounds", "1") == 0
    first = json.loads(capsys.readouterr().out)["rounds"]
    begun = (tmp_path / "clean/loop/round0/0001.exr").exists()
    assert loop(tmp_path, fake, *words, "--rounds", "2") == 0
    second = json.loads(capsys.readouterr().out)["rounds"]
    assert second[: len(first)] == first and not begun


def test_a_renderer_that_crashes_goes_on_with_what_is_left(tmp_path: Path, fake: str, capsys):
    script = Path(shlex.split(fake)[1])
    script.write_text(FAKE + "    if len(jobs) > 1:\n        raise SystemExit(139)\n")
    assert loop(tmp_path, fake, "--frames", "1-2", "--samples", "4", "--quality", "10dB",
                "--json") == 0
    assert json.loads(capsys.readouterr().out)["done"] == "all tiles have the quality"
    # the last of four
    assert len(json.loads((tmp_path / "clean/loop/round0.json").read_text())["jobs"]) == 1


def test_what_goes_wrong_is_said_in_one_line(tmp_path: Path, fake: str, capsys):
    for render, message in (("my_render", "give a command with {jobs}"),
                            ("no_such_program {jobs}", "no_such_program cannot be started"),
                            (f"{shlex.quote(sys.executable)} -c 'raise SystemExit(3)' {{jobs}}",
                             "ended with 3"),
                            (f"{shlex.quote(sys.executable)} -c pass {{jobs}}",
                             "the renderer did not write it")):
        assert loop(tmp_path, render) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
    assert main(["loop", "--render", fake, "-o", str(tmp_path / "one.exr")]) == 2
    assert "give EXR files with a frame number" in capsys.readouterr().err


BLENDER = os.environ.get("POSTFX_BPY_PYTHON", "/tmp/bpyenv/bin/python")
SHOT = """
import bpy
bpy.ops.wm.read_factory_settings(use_empty=False)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 100, 70
for light in bpy.data.lights:
    light.shadow_soft_size = 3
bpy.ops.mesh.primitive_plane_add(size=30, location=(0, 0, -1))
bpy.ops.wm.save_as_mainfile(filepath="{path}")
"""


@pytest.mark.skipif(not Path(BLENDER).exists(),
                    reason="no Blender as a module: POSTFX_BPY_PYTHON names its Python")
def test_blender_renders_regions_that_merge_to_its_own_picture(tmp_path: Path, capsys):
    blend = tmp_path / "shot.blend"
    subprocess.run([BLENDER, "-c", SHOT.format(path=blend)], check=True, capture_output=True)
    render = f"{BLENDER} {HOSTS / 'render_blender.py'} {blend} {{jobs}}"
    words = ("--samples", "4", "--tile", "16", "--rounds", "1", "--quality", "60dB", "--budget",
             "4", "--json")
    assert loop(tmp_path, render, *words) == 0
    rounds = json.loads(capsys.readouterr().out)["rounds"]
    assert len(rounds) == 2 and 4 < rounds[1]["samples"] <= 8
    work = tmp_path / "clean/loop"
    jobs = json.loads((work / "round1.json").read_text())["jobs"]
    counts = np.full((70, 100), 4.0)
    for job in jobs:
        box = job["region"]
        counts[box["y"] : box["y"] + box["height"],
               box["x"] : box["x"] + box["width"]] += job["samples"]
    frame = read_sequence(work / "merged/0001.exr").read(1)
    nominal = frame.samples if frame[Role.SAMPLE_COUNT].max() <= 1 else 1
    np.testing.assert_allclose(frame[Role.SAMPLE_COUNT][:, :, 0] * nominal, counts, rtol=1e-3)
    assert frame[Role.DEPTH].max() <= 1e10  # Blender writes 1e11 outside of a border


BOX = """
import mitsuba as mi

def build(frame):
    scene = mi.cornell_box()
    scene["sensor"]["film"]["width"], scene["sensor"]["film"]["height"] = 48, 40
    return scene
"""


@pytest.mark.skipif(find_spec("mitsuba") is None, reason="Mitsuba is not installed")
def test_mitsuba_renders_crop_windows_that_lie_where_they_belong(tmp_path: Path, capsys):
    (tmp_path / "box.py").write_text(BOX)
    render = (f"{shlex.quote(sys.executable)} {HOSTS / 'render_mitsuba.py'} {tmp_path / 'box.py'} "
              "{jobs}")
    words = ("--samples", "8", "--tile", "16", "--rounds", "1", "--quality", "60dB", "--budget",
             "24", "--json")
    assert loop(tmp_path, render, *words) == 0
    assert len(json.loads(capsys.readouterr().out)["rounds"]) == 2
    work = tmp_path / "clean/loop"
    merged = read_sequence(work / "merged/0001.exr").read(1)
    jobs = json.loads((work / "round1.json").read_text())["jobs"]
    counts = np.full((40, 48), 8.0)
    for job in jobs:
        box = job["region"]
        rows = slice(box["y"], box["y"] + box["height"])
        columns = slice(box["x"], box["x"] + box["width"])
        counts[rows, columns] += job["samples"]
        with FrameFiles({"": Path(job["output"])}) as files:
            tile = files.read(1)
        # nearly without noise, so that a wrong place shows
        for role in (Role.DIFFUSE_ALBEDO, Role.NORMAL):
            assert np.median(np.abs(tile[role][rows, columns] - merged[role][rows, columns])) < 0.02
    np.testing.assert_array_equal(merged[Role.SAMPLE_COUNT][:, :, 0], counts)
    again = merge_renders([work / "merged/0001.exr", *(Path(job["output"]) for job in jobs)],
                          tmp_path / "again.exr")
    assert again.samples > merged.samples
