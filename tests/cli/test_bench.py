"""`postfx bench` from the command line."""

import csv
import json

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.version import pip_install

for module in ("flip_evaluator", "skimage", "matplotlib", "pyoidn"):
    pytest.importorskip(module, reason="needs the extra 'bench'")


@pytest.fixture
def scene(write_exr):
    """Writes noisy frames in/noisy.#### of 48x32 and references in/reference.#### of `scale` times
    the size."""

    def write(*numbers, scale=2.0, references=None, reference_prefix="in/reference"):
        rng = np.random.default_rng(7)
        y, x = np.mgrid[0:32, 0:48] / 32
        for number in numbers:
            light = 0.5 + 0.4 * np.sin(6 * x) * np.cos(5 * y)
            planes = {name: light * rng.gamma(2, 0.5, light.shape) for name in "RGB"}
            planes |= {f"albedo.{name}": light for name in "RGB"}
            planes |= {"depth.Z": np.full((32, 48), 3.0), "motion.X": 0 * x, "motion.Y": 0 * x}
            planes |= {"normal.X": 0 * x, "normal.Y": 0 * x, "normal.Z": 0 * x + 1}
            write_exr(f"in/noisy.{number:04d}.exr", planes)
        height, width = round(32 * scale), round(48 * scale)
        y, x = (np.mgrid[0:height, 0:width] + 0.5) / height
        light = 0.5 + 0.4 * np.sin(6 * x) * np.cos(5 * y)
        for number in numbers if references is None else references:
            write_exr(f"{reference_prefix}.{number:04d}.exr", dict.fromkeys("RGB", light))

    return write


INPUTS = ("in/noisy.####.exr", "--reference", "in/reference.####.exr", "-o", "out", "--device",
          "cpu", "--runs", "1")


def test_everything_that_is_written(postfx, scene, tmp_path):
    scene(1, 2, 3)
    done = postfx("bench", *INPUTS, "--methods", "m,oidn-fast,accumulation,bicubic")
    assert done.code == 0, done.err
    assert ("48x32 to 96x64, 3 frames, cpu" in done.out and "m fp32 against the best of the "
            "others" in done.out)
    assert "not measured: m fp16: fp16 is for cuda, not for cpu" in done.out
    assert [line.split(":")[0] for line in done.err.splitlines()][-4:] == [
        "1/4 m", "2/4 oidn-fast", "3/4 accumulation", "4/4 bicubic"]
    facts = json.loads((tmp_path / "out/bench.json").read_text())
    rows = {row["name"]: row for row in facts["methods"]}
    assert (facts["scale"], facts["output_size"]) == (2.0, [96, 64])
    for row in rows.values():
        assert (row["time"]["wall_ms"] > 0 and row["time"]["cpu_s"] > 0
                and row["time"]["gpu_ms"] is None)
        assert (row["time"]["peak_mb"] > 50 and len(row["frames"]) == 3
                and row["scores"]["not_finite"] == 0)
    assert rows["accumulation"]["scores"]["psnr_late"] > rows["bicubic"]["scores"]["psnr_late"]
    assert rows["accumulation"]["scores"]["flicker"] < rows["bicubic"]["scores"]["flicker"]
    assert rows["oidn-fast"]["scores"]["psnr"] > rows["bicubic"]["scores"]["psnr"]
    with (tmp_path / "out/bench.csv").open() as file:
        assert [line["name"] for line in csv.DictReader(file)] == list(rows)
    for name in ("pareto_psnr", "pareto_flicker", "crops"):
        assert np.ptp(oiio.ImageBuf(str(tmp_path / f"out/{name}.png")).get_pixels(oiio.UINT8)) > 100
    wrote = done.out.splitlines()[-1].split(": ")[1].split(", ")
    pictures = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert {"bench.csv", "bench.json", "frames/"} | pictures == set(wrote)
    assert len(list((tmp_path / "out/frames/m").glob("frame.000[123].exr"))) == 3


def test_json_and_a_scale_that_is_not_whole(postfx, scene):
    scene(1, 2, scale=1.5)
    done = postfx("bench", *INPUTS, "--methods", "bicubic", "--json", "--frames", "2")
    assert done.code == 0, done.err
    assert (done.json["scale"], done.json["output_size"],
            done.json["sequence"]["frames"]) == (1.5, [72, 48], [2])
    assert done.json["methods"][0]["scores"]["flicker"] is None


def test_one_frame_and_one_reference_need_no_common_number(postfx, scene):
    scene(4, scale=1.0, references=[9])
    done = postfx("bench", *INPUTS, "--methods", "bicubic", "--json")
    assert done.code == 0 and done.json["scale"] == 1.0, done.err


@pytest.mark.soak
def test_ablations_tell_what_a_plane_is_worth(postfx, scene):
    scene(1, 2)
    names = ["m", "m-without-depth", "m-without-all"]
    done = postfx("bench", *INPUTS, "--ablations", "--methods", ",".join(names), "--json")
    assert done.code == 0, done.err
    rows = {row["name"]: row for row in done.json["methods"]}
    assert list(rows) == ["m", "m-without-depth", "m-without-all"]
    assert set(rows["m-without-all"]["without"]) == {"diffuse_albedo", "normal", "depth", "motion"}
    assert rows["m-without-all"]["scores"]["psnr"] != rows["m"]["scores"]["psnr"]
    assert [entry["of"] for entry in done.json["ablations"]] == ["m", "m"]
    assert postfx("bench", *INPUTS, "--methods", "m-without-depth").code == 2


def test_guides_of_another_size_than_the_references(postfx, scene, write_exr):
    scene(1)
    write_exr("in/guides.0001.exr", {f"albedo.{name}": np.ones((48, 72)) for name in "RGB"})
    done = postfx("bench", *INPUTS, "--guides", "in/guides.####.exr")
    assert done.code == 2
    assert ("in/guides.0001.exr: guides are 72x48, references 96x64: render both at one "
            "size" in done.err)


def test_guides_that_no_network_reads_are_told(postfx, scene, write_exr):
    scene(1)
    write_exr("in/guides.0001.exr", {f"albedo.{name}": np.ones((64, 96)) for name in "RGB"})
    done = postfx("bench", *INPUTS, "--guides", "in/guides.####.exr", "--methods", "m,bicubic",
                  "--json")
    assert done.code == 0, done.err
    guided = "m-guides" in [row["name"] for row in done.json["methods"]]
    told = "there is no model denoise_upscale.m.guides" in [item["why"]
                                                            for item in done.json["left_out"]]
    assert done.json["guides"] == ["diffuse_albedo"] and not guided and told != _has_guided_model()


def _has_guided_model():
    from postfx.runtime import Library

    return "denoise_upscale.m.guides" in Library().names()


@pytest.mark.parametrize(
    ("numbers", "facts", "arguments", "message"),
    [((1, 2), {"references": [1]}, (),
      "in/reference.0002.exr: frame 2 has no reference: render it, or choose frames"),
     ((1,), {"scale": 4.0}, (),
      "references are 192x128, frames 48x32: references must be 1 to 3 times as large"),
     ((1,), {"scale": 0.5}, (),
      "references must be 1 to 3 times as large, by the same factor both ways"),
     ((1,), {}, ("--methods", "oidn-super"),
      "--methods oidn-super: there is no 'oidn-super' here: "),
     ((1,), {}, ("--models", "xs"), "--models xs: there is no 'xs' here")],
)
def test_errors_name_the_mend(postfx, scene, tmp_path, numbers, facts, arguments, message):
    scene(*numbers, **facts)
    done = postfx("bench", *INPUTS, *arguments)
    assert done.code == 2 and message in done.err and done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_library_that_is_not_installed(monkeypatch, capsys):
    from postfx.cli.main import main
    from postfx.tools import bench

    find = bench.find_spec
    monkeypatch.setattr(bench, "find_spec",
                        lambda name: None if name == "flip_evaluator" else find(name))
    assert main(["bench", *INPUTS]) == 2
    message = ("error: flip-evaluator is not installed, and it measures or draws: "
               f"{pip_install('bench')}\n")
    assert capsys.readouterr().err == message


def test_help_shows_examples(capsys):
    from postfx.cli.main import main

    with pytest.raises(SystemExit) as ended:
        main(["bench", "--help"])
    assert ended.value.code == 0
    assert "examples:\n  postfx bench shot/noisy.####.exr --reference" in capsys.readouterr().out
