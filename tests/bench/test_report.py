"""What is told of the measurements: fronts, comparisons, CSV and pictures."""

import csv

import numpy as np
import OpenImageIO as oiio
import pytest
from matplotlib.text import Text

from postfx.frame import Frame, Role
from postfx.tools.bench import pictures, report

FIGURES = {"ssim_late": 0.9, "flip_late": 0.1, "relmse_late": 0.01, "worst_frame": 1,
           "worst_psnr": 1.0, "not_finite": 0}


@pytest.mark.parametrize(("dx", "side"), [(7, "left"), (-7, "right"), (0, "center")])
def test_a_label_stands_beside_its_dot(dx, side):
    label = Text()
    pictures._stand(label, dx, 5)
    assert (label.get_position(), label.get_horizontalalignment()) == ((dx, 5), side)


def row(name, time, psnr, flicker=10.0, family="plain", **facts):
    scores = {"psnr_late": psnr, "psnr": psnr, "flicker_late": flicker, "flicker": flicker,
              **FIGURES}
    times = {"wall_ms": time, "wall_ms_min": 0.9 * time, "wall_ms_max": 1.2 * time,
             "cpu_s": time / 500, "gpu_ms": None, "first_ms": 5 * time, "peak_mb": 300.0}
    plain = {"title": name, "model": "", "precision": "fp32", "guides": False, "alone": False,
             "run_up": False, "both": False, "without": ()}
    return {"name": name, "family": family, **plain, **facts, "time": times, "scores": scores,
            "frames": [{"frame": 1, "psnr": psnr}]}


ROWS = [row("m", 60, 32.6, 8, "ours"), row("m-alone", 61, 31.0, 19, "ours", alone=True),
        row("oidn-high", 200, 31.5, 16, "oidn"), row("oidn-fast", 55, 31.1, 17, "oidn"),
        row("bicubic", 10, 17, 130)]


LACKING = [ROWS[0], row("m-without-depth", 60, 32.1, 10, "ours", without=("depth",)), *ROWS[1:]]


def test_ablations_are_compared_with_the_same_network_and_offered_to_nobody(tmp_path):
    (entry,) = report.ablations(LACKING)
    assert (entry["name"], entry["of"]) == ("m-without-depth", "m")
    assert (entry["psnr_late"] == pytest.approx(-0.5)
            and entry["flicker_late"] == pytest.approx(1.25))
    assert report.choices(LACKING) == ROWS and report.ablations(ROWS) == []
    others = [row("m-run-up", 70, 33, 7, "ours", run_up=True),
              row("m-both-ways", 130, 34, 6, "ours", both=True)]
    assert report.ablations([*others, *LACKING]) == [entry]
    report.write_csv(tmp_path / "bench.csv", [row("x", 1, 1, without=("depth", "normal"))])
    assert "depth normal" in (tmp_path / "bench.csv").read_text()


def test_the_front_holds_what_nothing_beats_in_both():
    assert report.front(ROWS, "psnr_late") == ["bicubic", "oidn-fast", "m"]
    assert report.front(ROWS, "flicker_late") == ["bicubic", "oidn-fast", "m"]


def test_ours_against_the_best_of_the_others():
    ours, alone = report.compare(ROWS)
    assert ours["psnr_late"] == pytest.approx(1.1) and ours["flicker_late"] == pytest.approx(0.5)
    assert (ours["frames_below_oidn"], alone["frames_below_oidn"]) == (0, 1)
    assert report.compare(ROWS[:2]) == []


def test_csv_has_a_line_a_method_and_leaves_the_unknown_empty(tmp_path):
    report.write_csv(tmp_path / "bench.csv", ROWS)
    with (tmp_path / "bench.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [line["name"] for line in lines] == [entry["name"] for entry in ROWS]
    assert (lines[0]["wall_ms"], lines[0]["gpu_ms"], lines[0]["psnr_late"]) == ("60", "", "32.6")
    assert {"alone", "run_up", "both"} < set(lines[0])


def facts():
    return {"device": "cpu", "threads": 2, "runs": 3, "render_size": [32, 18],
            "output_size": [64, 36], "methods": ROWS, "sequence": {"frames": [1]},
            "against_best_baseline": report.compare(ROWS), "ablations": [],
            "left_out": [{"what": "m int8", "why": "there is no such model"}],
            "fronts": {figure: report.front(ROWS, figure)
                       for figure in ("psnr_late", "flicker_late")}}


def test_the_table_is_whole_outside_a_terminal(capsys):
    report.print_table(facts())
    text = capsys.readouterr().out
    assert all(entry["title"] in text for entry in ROWS)
    assert ("m against the best of the others: PSNR +1.10 dB, SSIM +0.0000, FLIP 1.00x, flicker "
            "0.50x" in text)
    facts_of_ablations = {**facts(), "methods": LACKING, "ablations": report.ablations(LACKING)}
    report.print_table(facts_of_ablations)
    assert ("m-without-depth against m: PSNR -0.50 dB, SSIM +0.0000, FLIP "
            "1.00x" in capsys.readouterr().out)
    assert "not measured: m int8: there is no such model" in text
    assert "…" not in text


@pytest.mark.parametrize("figure", ["psnr_late", "flicker_late"])
def test_labels_of_the_plot_stand_apart(tmp_path, figure, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra 'bench'")
    from postfx.tools.bench import pictures

    boxes, place = [], pictures._place
    monkeypatch.setattr(pictures, "_place",
                        lambda *arguments: boxes.append(place(*arguments)) or boxes[-1])
    pictures.pareto(facts(), figure, tmp_path / "plot.png")
    assert len(boxes) == len(ROWS)
    pairs = [(one, other) for index, one in enumerate(boxes) for other in boxes[:index]]
    assert not any(pictures._overlap(one, other) for one, other in pairs)
    picture = oiio.ImageBuf(str(tmp_path / "plot.png")).get_pixels(oiio.UINT8)
    assert picture.shape[:2] == (780, 1170) and np.ptp(picture) == 255


def test_crops_are_where_pictures_differ_and_do_not_overlap():
    pytest.importorskip("matplotlib", reason="needs the extra 'bench'")
    from postfx.tools.bench.pictures import pick

    difference = np.zeros((60, 100))
    difference[10:31, 70:91] = 1.0
    difference[35:56, 5:26] = 0.5
    places = pick(difference, 2)
    assert places == [(10, 70), (35, 5)]
    assert len(pick(np.ones((20, 20)), 9)) <= 9


def test_failures_are_where_ours_is_behind_the_better_of_the_others():
    pytest.importorskip("matplotlib", reason="needs the extra 'bench'")
    from postfx.tools.bench.pictures import pick_deficits

    ours, one, other = np.zeros((60, 100)), np.full((60, 100), 0.1), np.full((60, 100), 9.0)
    ours[10:31, 70:91] = 0.3
    ours[35:56, 5:26] = 0.8
    ours[0:21, 0:21], one[0:21, 0:21] = 5.0, 6.0  # bad, but better than both
    assert pick_deficits(ours, [one, other], 2) == [(35, 5), (10, 70)]
    assert pick_deficits(ours, [ours + 0.01], 3) == []


class Sequence:
    """Stands in for the frames of a sequence: two frames of 40x60, results by name, the reference
    flat grey."""

    size, numbers = (40, 60), (3, 4)

    def __init__(self, results):
        self.noisy, self._results = self, results

    def reference(self, number):
        return Frame({Role.COLOUR: np.ones((40, 60, 3), np.float32)}, exposure=0.0, number=number)

    motion = reference

    def result(self, name, number):
        return Frame({Role.COLOUR: self._results[name][number]}, number=number)


def test_failures_are_drawn_of_the_worst_frame_only_where_there_are_any(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra 'bench'")
    from postfx.tools.bench import pictures

    flat = np.ones((40, 60, 3), np.float32)
    spot = flat.copy()
    spot[20:34, 40:54] = 3
    rows = [{**row("l", 60, 30, family="ours"), "output": "l",
             "frames": [{"psnr": 30.0}, {"psnr": 24.0}]},
            {**row("oidn-high", 60, 28, family="oidn"), "output": "oidn",
             "frames": [{"psnr": 25.0}, {"psnr": 26.0}]},
            row("l-both-ways", 120, 31, family="ours", both=True)]  # sees frames that OIDN does not
    seen, draw = [], pictures._draw
    monkeypatch.setattr(pictures, "_draw",
                        lambda *arguments: seen.append(arguments[1:4]) or draw(*arguments))
    material = Sequence({"l": {3: flat, 4: spot}, "oidn": {3: spot, 4: flat * 1.01}})
    pictures.draw_worst(material, rows, tmp_path / "worst.png")
    (places, frame, why), = seen
    assert places[0] == (20, 40) and (frame, why) == ("frame 4", "where l is behind OIDN most")
    assert np.ptp(oiio.ImageBuf(str(tmp_path / "worst.png")).get_pixels(oiio.UINT8)) > 100
    pictures.draw_worst(material, rows[:1], tmp_path / "worst.png")
    assert not (tmp_path / "worst.png").exists()
    pictures.draw_worst(Sequence({"l": {3: flat, 4: flat}, "oidn": {3: spot, 4: spot}}), rows,
                        tmp_path / "worst.png")
    assert len(seen) == 1 and not (tmp_path / "worst.png").exists()
