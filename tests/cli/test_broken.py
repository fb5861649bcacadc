"""What is said about pixels that are not finite: by `postfx run`, and by `postfx bench --stress`,
which makes them."""

import json

import numpy as np


def test_pixels_that_are_not_finite_are_reported(postfx, write_exr, tmp_path):
    for number in (1, 2, 3):
        planes = {name: np.full((32, 48), 0.5) for name in "RGB"}
        planes |= {"depth.Z": np.full((32, 48), np.inf), "normal.X": np.zeros((32, 48)),
                   "normal.Y": np.zeros((32, 48)), "normal.Z": np.ones((32, 48))}
        if number > 1:
            planes["G"][5, 7], planes["B"][number, 9] = np.nan, np.inf
            planes["normal.X"][0, number - 1] = np.nan
        write_exr(f"in/shot.{number:04d}.exr", planes)
    done = postfx("run", "in/shot.####.exr", "-o", "out/####.exr", "--model", "s", "--json",
                  "--log", "log.jsonl")
    assert done.code == 0
    assert done.json["broken"] == {"colour": {"pixels": 4, "frames": 2},
                                   "normal": {"pixels": 2, "frames": 2}}
    repaired = "repaired from the pixels around where those are known"
    assert f"broken   colour: 4 pixels not finite in 2 frames, {repaired}" in done.err
    assert "broken   normal: 2 pixels not finite in 2 frames\n" in done.err
    events = map(json.loads, (tmp_path / "log.jsonl").read_text().splitlines())
    assert [event["broken"] for event in events if event["event"] == "frame"] == [
        {}, {"colour": 2, "normal": 1}, {"colour": 2, "normal": 1}]


def test_hard_inputs_are_checked(postfx, shot):
    shot(1, 2)
    stress = ("bench", "in/shot.####.exr", "--stress", "--models", "s.fp32")
    done = postfx(*stress)
    assert (done.code == 0
            and done.out.startswith("s.fp32: 34 of 34 hard inputs give light in range"))
    assert postfx(*stress, "--json").json["well"] is True
    wrong = postfx("bench", "in/shot.####.exr")
    assert (wrong.code, wrong.err.strip()) == (
        2, "error: bench needs --reference and -o, or --stress: see postfx bench --help")
