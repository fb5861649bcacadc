"""Tables and pictures of docs/lab/quality.md: written from results, left alone without, and
checked."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image", reason="needs the extra 'train'")

from postfx.tools.bench import report  # noqa: E402
from tests.conftest import REPOSITORY  # noqa: E402
from tests.training.measure.quality_results import bench, comparison, method  # noqa: E402
from training.measure.quality_report import document  # noqa: E402
from training.measure.quality_report.__main__ import MAKERS, main  # noqa: E402
from training.measure.quality_report.document import LIMIT, shrink_picture  # noqa: E402


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A folder of results: two sequences, one of them with its ablations beside it, and all the
    rest."""
    folder = tmp_path / "results"
    beside = {**bench(34.0), "ablations": []}
    curves = [{"scale": 1, "samples": n, "method": name, "psnr": 20.0, "gain": gain}
              for n, gain in ((1, 9.0), (4, -0.25), (16, 0.5)) for name in ("input", "m")]
    equivalent = {"scene": "room", "seed": 9000, "counts": [1, 64],
                  "results": {"m": {"equivalent_samples": {"seen": 40.04, "relmse": None},
                                    "images": 4}}}
    written = {"one/bench.json": bench(33.0),
               "two/bench.json": beside, "two-ablations/bench.json": bench(34.0),
               "validation/comparison.json": comparison(),
               "equivalent/equivalent_samples.json": equivalent,
               "convergence/convergence.json": {"view": {"scene": "room", "seed": 9000},
                                                "rows": curves},
               "models/denoise_upscale.m.json": {
                   "name": "denoise_upscale.m", "tag": "m", "parameters": 3038591,
                   "config": {"widths": [64, 128], "depth": 2},
                   "training": {"steps": 100, "batch": 16, "minutes": 22.01, "gpus": 2,
                                "clips": 840,
                                "validation_psnr": 28.649, "validation_flicker": 0.0185}},
               "models/denoise_upscale.m.int8.json": {"name": "denoise_upscale.m.int8",
                                                      "precision": "int8"}}
    card = written["models/denoise_upscale.m.json"]
    for tag in ("m.1x", "m.guides"):
        written[f"models/denoise_upscale.{tag}.json"] = {**card, "name": f"denoise_upscale.{tag}",
                                                         "tag": tag}
    for name, facts in written.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(json.dumps(facts))
    return folder


def written(tmp_path: Path, results: Path, *blocks: str, options: tuple[str, ...] = (),
            code: int = 0) -> list[str]:
    """Blocks of a document after the tool has run over it; what is around them has to be as it
    was."""
    doc = tmp_path / "doc.md"
    head = "# Title\n\nBy hand.\n\n"
    between = "\nMore by hand, without a newline"
    foot = "\nThe end"
    inner = "\nold\n<!-- end -->\n" + between.rstrip() + "\n\n"
    doc.write_text(head + "".join(f"<!-- table: {block} -->{inner}" for block in blocks) + foot)
    arguments = [str(results), "--doc", str(doc), "--images", str(tmp_path / "images"), "--models",
                 str(results / "models"), *options]
    assert main(arguments) == code
    text = doc.read_text()
    assert text.startswith(head) and text.endswith(foot) and text.count(between) == len(blocks)
    return [part.split("<!-- end -->")[0].split("-->\n", 1)[1]
            for part in text.split("<!-- table: ")[1:]]


def cells(block: str) -> list[list[str]]:
    """Rows of a table of markdown, all of one length."""
    rows = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in block.splitlines()]
    assert set(rows[1]) == {"---"} and len({len(row) for row in rows}) == 1
    return [rows[0], *rows[2:]]


def test_figures_of_all_methods(tmp_path, results):
    (block,) = written(tmp_path, results, "methods one")
    rows = {row[0]: row[1:] for row in cells(block)}
    assert list(rows) == ["method", "OIDN high", "OIDN high + accumulation", "bicubic", "postfx m",
                          "postfx m int8", "postfx m, no history"]
    assert rows["postfx m"] == ["**33.00**", "**0.8250**", "**0.0303**", "**0.0100**", "**8.00**"]
    assert rows["OIDN high"][0] == "30.00"


def test_ours_against_the_best_of_the_others_with_the_mean(tmp_path, results):
    (block,) = written(tmp_path, results, "gains two one")
    rows = cells(block)
    assert rows[0] == ["figure", "method", "two", "one", "mean"]
    assert rows[1] == ["PSNR, dB", "best of the others", *["31.00 (OIDN high + accumulation)"] * 2,
                       ""]
    assert rows[2] == ["", "postfx m", "+3.00", "+2.00", "+2.50"]
    assert rows[-1] == ["", "postfx m", "0.80x", "0.80x", "0.80x"]


def test_a_mean_tells_of_how_many(tmp_path, results):
    facts = bench(34.0)
    guided = {**facts["methods"][0], "name": "m-guides", "guides": True}
    facts["methods"].append(guided)
    facts["against_best_baseline"] = report.compare(report.choices(facts["methods"]))
    (results / "two/bench.json").write_text(json.dumps(facts))
    (block,) = written(tmp_path, results, "gains one two")
    assert cells(block)[3] == ["", "postfx m with guides", "-", "+3.00", "+3.00 (1 of 2)"]


def test_networks_with_a_run_up_have_rows_of_their_own_but_where_their_history_is_the_same(tmp_path,
                                                                                           results):
    facts = bench(33.0, method("m-run-up", 62, 33.25, 7, "ours", 32, model="m", run_up=True),
                  method("m-both-ways", 99, 34, 7, "ours", 33, model="m", both=True))
    (results / "one/bench.json").write_text(json.dumps(facts))
    gains, frames, history = (cells(block)[1:]
                              for block in written(tmp_path, results, "gains one", "frames one",
                                                   "history one"))
    assert gains[2] == ["", "postfx m, run-up", "+2.25", "+2.25"]
    assert frames == [["postfx m", "1 of 4, least -0.50 dB (frame 1)"],
                      ["postfx m, run-up", "0 of 4, least +2.00 dB (frame 1)"]]
    assert [row[0] for row in history] == ["postfx m"]


def test_single_frames_history_and_conditions(tmp_path, results):
    facts = json.loads((results / "one/bench.json").read_text())
    facts["methods"][2]["frames"][3]["psnr"] += 0.5
    (results / "one/bench.json").write_text(json.dumps(facts))
    frames, history, conditions = written(tmp_path, results, "frames one", "history one",
                                          "conditions one")
    assert cells(frames)[1:] == [["postfx m", "1 of 4, least -0.50 dB (frame 1)"]]
    assert cells(history)[1:] == [["postfx m", "+2.00 dB, least frame +1.50 dB, flicker 0.50x"]]
    assert cells(conditions)[1] == ["one", "32x18 to 64x36", "4", "yes", "cpu, 2 threads, some CPU",
                                    "3", "pyoidn 2.5"]


def test_fronts_and_times(tmp_path, results):
    psnr, times = written(tmp_path, results, "front psnr one two", "times one")
    rows = {row[0]: row[1:] for row in cells(psnr)}
    assert (rows["postfx m"] == ["**60 ms, 33.00**", "**60 ms, 34.00**"]
            and rows["bicubic"][0] == "**10 ms, 17.00**")
    assert rows["OIDN high"][0] == "200 ms, 30.00" and "postfx m, no history" not in rows
    assert cells(times)[1] == ["postfx m", "60", "59 to 62", "0.120", "300"]


def test_ablations_of_the_same_file_or_the_folder_beside(tmp_path, results):
    (block,) = written(tmp_path, results, "ablations m one two")
    assert cells(block)[1:] == [["depth", *["-0.40 dB, flicker 1.25x"] * 2],
                                ["all: colour only", *["-3.00 dB, flicker 2.50x"] * 2]]


def test_the_validation_set(tmp_path, results):
    scales, rays = (cells(block)[1:]
                    for block in written(tmp_path, results, "scales", "equal_rays"))
    assert [row[:4] for row in scales] == [["1x", "OIDN high", "27.50", "+0.00"],
                                           ["", "postfx m", "29.00", "+1.50"],
                                           ["2x", "OIDN high", "27.50", "+0.00"],
                                           ["", "postfx m", "28.00", "+0.50"]]
    assert scales[3][5:] == ["1.00", "0.75", "+0.50", "+0.50", "0 of 4"]
    assert [row[0] for row in rays] == ["full, 1 spp", "", "half, 4 spp", ""]
    assert rays[3][1:4] == ["postfx m", "28.00", "+0.50"]


def test_views_and_networks(tmp_path, results):
    names = ("equivalent equivalent", "convergence convergence", "networks")
    equivalent, convergence, networks = (cells(block)[1:]
                                         for block in written(tmp_path, results, *names))
    assert equivalent == [["room, seed 9000", "postfx m", "40.0", "over 64", "4"]]
    assert convergence == [["room, seed 9000", "1x", "postfx m", "-0.25 dB at 4", "+0.50 dB at 16"]]
    facts = ["64/128", "2", "3.04 M", "100 of 16 windows, 22 minutes, 2 GPUs", "840", "28.65 dB",
             "18.5"]
    assert networks == [[name, *facts]
                        for name in ("postfx m", "postfx m at 1x", "postfx m with guides")]


def test_the_shipped_networks_have_a_table(tmp_path, results, capsys):
    """Also those that give the picture; printed, for `training.measure.record`."""
    doc = tmp_path / "doc.md"
    doc.write_text("<!-- table: networks -->\nold\n<!-- end -->\n")
    models = REPOSITORY / "models"
    assert main([str(results), "--doc", str(doc), "--models", str(models), "--print"]) == 0
    told = capsys.readouterr().out
    tags = [json.loads(path.read_text())["tag"] for path in models.glob("denoise_upscale.*.json")]
    whole = [tag for tag in tags if not {"int8", "fp16"} & {*tag.split(".")}]
    assert len(cells(told.partition("\n\n")[2])) == 1 + len(whole) and "down 32/" in told
    assert doc.read_text() == "<!-- table: networks -->\nold\n<!-- end -->\n"


def test_what_is_missing_stays_and_is_named(tmp_path, results, capsys):
    names = ("methods three", "methods one", "picture one/crops.png Words", "ablations s one")
    blocks = written(tmp_path, results, *names)
    assert [block == "old\n" for block in blocks] == [True, False, True, True]
    told = capsys.readouterr().err.splitlines()
    assert (len(told) == 3 and "'methods three': there is "
            "no" in told[0] and told[0].endswith("three/bench.json"))
    assert "one has no ablations of s" in told[2]


def test_check_writes_nothing_and_tells_what_is_out_of_date(tmp_path, results, capsys):
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(results / "one/pareto_psnr.png")
    names = ("methods one", "picture one/pareto_psnr.png A plot")
    assert written(tmp_path, results, *names, options=("--check",), code=1) == ["old\n", "old\n"]
    assert (capsys.readouterr().out.count("out of date: ") == 3
            and not (tmp_path / "images").exists())
    written(tmp_path, results, *names)
    arguments = [str(results), "--doc", str(tmp_path / "doc.md"), "--images",
                 str(tmp_path / "images"), "--check"]
    assert main(arguments) == 0
    Image.fromarray(np.full((9, 9, 3), 90, np.uint8)).save(results / "one/pareto_psnr.png")
    assert main(arguments) == 1
    assert (capsys.readouterr().out.splitlines()[-1] == "out of date: "
            f"{tmp_path / 'images/one.pareto_psnr.png'}")


def test_lines_of_plots_keep_their_colours(tmp_path):
    drawn = np.full((300, 600, 3), 255, np.uint8)
    drawn[:, :] = np.linspace(0, 255, 600).astype(np.uint8)[None, :, None]
    lines = {20: (11, 98, 184), 40: (200, 80, 10), 60: (0, 102, 85)}
    for y, colour in lines.items():
        drawn[y, 50:90] = colour
    Image.fromarray(drawn).save(tmp_path / "plot.png")
    (tmp_path / "small.png").write_bytes(shrink_picture(tmp_path / "plot.png", "png"))
    with Image.open(tmp_path / "small.png") as picture:
        small = np.asarray(picture.convert("RGB")).astype(int)
    assert all(np.abs(small[y, 60] - colour).max() <= 10 for y, colour in lines.items())


def test_pictures_are_made_smaller(tmp_path, results, monkeypatch, capsys):
    noise = np.random.default_rng(0).integers(0, 255, (30, 1500, 3), np.uint8)
    for name in ("crops", "curves"):
        Image.fromarray(noise).save(results / f"{name}.png")
    names = ("picture crops.png Side by side", "picture curves.png Curves")
    crops, curves = written(tmp_path, results, *names)
    assert (crops, curves) == ("![Side by side](images/crops.jpg)\n",
                               "![Curves](images/curves.png)\n")
    for name, kind in (("crops.jpg", "JPEG"), ("curves.png", "PNG")):
        with Image.open(tmp_path / "images" / name) as picture:
            assert (picture.format, picture.size) == (kind, (1100, 22))
        assert ((tmp_path / "images" / name).stat().st_size < (results / "curves.png").stat()
                .st_size / 2)
    with Image.open(tmp_path / "images/curves.png") as picture:
        assert len(picture.convert("RGB").getcolors()) <= 256
    monkeypatch.setattr(document, "LIMIT", 1000)
    written(tmp_path, results, *names, code=2)
    assert "MB, more than 0.001: show fewer of them" in capsys.readouterr().err


@pytest.mark.parametrize(("text", "message"), [
    ("<!-- table: nothing one -->\n<!-- end -->\n",
     "doc.md:1: there is no table 'nothing one': choose among abl"),
    ("<!-- table: scales -->\n\n<!-- table: networks -->\n<!-- end -->\n",
     "doc.md:3: block of line 1 has no end"),
    ("text\n<!-- end -->\n", "doc.md:2: an end without a beginning"),
    ("<!-- table: scales -->\n", "doc.md:1: block has no end: write <!-- end --> after it"),
    ("<!-- table: methods -->\n<!-- end -->\n", "doc.md:1: 'methods' takes NAME"),
    ("<!-- table: gains -->\n<!-- end -->\n", "doc.md:1: 'gains' takes NAMES..."),
    ("<!-- table: scales x1 -->\n<!-- end -->\n", "doc.md:1: 'scales x1' takes nothing"),
    ("<!-- table: front ssim one -->\n<!-- end -->\n",
     "doc.md:1: front ssim: there are fronts of psnr and flicker"),
    ("<!-- table: methods broken -->\n<!-- end -->\n", "broken/bench.json: is not JSON"),
    ("<!-- table: methods old -->\n<!-- end -->\n",
     "'methods old': the results lack 'methods': measure again"),
])
def test_errors_name_the_line_and_write_nothing(tmp_path, results, capsys, text, message):
    for name, content in (("broken", "{"), ("old", "{}")):
        (results / name).mkdir()
        (results / name / "bench.json").write_text(content)
    doc = tmp_path / "doc.md"
    doc.write_text(text)
    assert main([str(results), "--doc", str(doc)]) == 2
    error = capsys.readouterr().err
    assert (error.startswith("error: ") and message in error and error.count("\n") == 1
            and doc.read_text() == text)


def test_the_document_has_known_markers_and_its_pictures():
    docs = Path(__file__).resolve().parents[3] / "docs"
    page = docs / "lab/quality.md"
    from training.measure.quality_report.document import Block, parse

    blocks = [part for part in parse(page.read_text(), page, {*MAKERS, "picture"})
              if isinstance(part, Block)]
    assert "picture" in {block.name for block in blocks} <= {*MAKERS, "picture"}
    shown = [block.text.split("](")[1].rstrip(")\n")
             for block in blocks if block.name == "picture" and block.text]
    files = {f"../images/quality/{path.name}": path.stat().st_size
             for path in (docs / "images/quality").iterdir()}
    assert shown and set(shown) == set(files) and sum(files.values()) <= LIMIT


@pytest.mark.parametrize(("value", "form", "text"),
                         [(-0.001, "+.2f", "+0.00"), (-1.236, "+.2f", "-1.24"),
                          (None, ".2f", "-"), (-0.04, ".1f", "0.0")])
def test_numbers_are_written_in_their_form(value, form, text):
    assert document.number(value, form) == text


@pytest.mark.parametrize(("name", "text"),
                         [("m-int8-guides-alone", "postfx m int8 with guides, no history"),
                          ("oidn-high-accumulated", "OIDN high + accumulation"), ("l", "postfx l")])
def test_methods_are_named_in_words(name, text):
    assert document.method_title(name) == text
