"""The log of training runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from training.measure.runs import BEGIN, END, LOG, append_run, main, read_runs, record_kinds, table

RUN = {"run": "m.2", "start": "m.1", "options": {"widths": [16, 32], "even": True}, "clips": 9,
       "gpus": 2, "batch": 32,
       "steps": 100, "minutes": 1.5, "validation_psnr": 28.6049, "validation_flicker": float("nan")}


def test_a_row_is_written_scored_and_shown(tmp_path: Path,
                                           capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "folder" / "runs.jsonl"
    append_run(log, RUN)
    append_run(log, {"run": "s.1"})
    record_kinds(log, "m.2", {"fog": {"m": -0.9, "s": 0.25}})
    first, second = read_runs(log)
    assert first["validation_flicker"] is None and first["kinds"] == {"fog": {"m": -0.9, "s": 0.25}}
    assert second == {"run": "s.1"}
    lines = table([first, second]).splitlines()
    assert lines[2] == ("| m.2 | ? | m.1 | `--widths 16 32` `--even` | 9 | 2 x 16 | 100 | 1.5 | "
                        "28.60 | ? | fog m -0.90, s +0.25 |  |")
    assert lines[3].count("?") == 9
    with pytest.raises(ValueError, match=r"no run 'x': it has m.2, s.1"):
        record_kinds(log, "x", {})


def test_a_table_goes_between_the_markers_of_a_document(tmp_path: Path,
                                                        capsys: pytest.CaptureFixture[str]) -> None:
    log, page = tmp_path / "runs.jsonl", tmp_path / "a.md"
    append_run(log, RUN)
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    main(["table", "--log", str(log), "--write", str(page)])
    assert page.read_text() == f"before\n{BEGIN}\n{table(read_runs(log))}\n{END}\nafter\n"
    page.write_text("nothing")
    with pytest.raises(SystemExit):
        main(["table", "--log", str(log), "--write", str(page)])
    assert "no place for the table" in capsys.readouterr().err
    log.write_text('{"run": "a"}\n[1]\n')
    with pytest.raises(SystemExit):
        main(["table", "--log", str(log)])
    assert "line 2: not a run" in capsys.readouterr().err


def test_the_log_of_the_repository_is_the_table_of_the_page() -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "lab" / "training.md"
    runs = read_runs(LOG)
    assert (len({run["run"] for run in runs}) == len(runs)
            and {*runs[0]} >= {"start", "options", "kinds", "outcome"})
    assert table(runs) in page.read_text(), ("python -m training.measure.runs table --write "
                                             "docs/lab/training.md")
