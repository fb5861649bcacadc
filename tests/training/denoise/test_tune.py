"""`postfx tune`: a network for one shot learns from some frames, and is written only if it
gains."""

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import postfx  # noqa: E402
from postfx.cli.main import main  # noqa: E402
from postfx.frame import Role  # noqa: E402
from postfx.io.writer import write_channels  # noqa: E402
from training.denoise import tune  # noqa: E402


def write_shot(folder: Path, name: str, sigma: float, seed: int, count: int = 2) -> str:
    """Still frames of a checkerboard, with noise."""
    rows, columns = np.mgrid[:48, :64]
    board = 0.2 + 0.5 * ((rows // 6 + columns // 6) % 2)
    random = np.random.default_rng(seed)
    for number in range(1, count + 1):
        light = np.abs(board[..., None] + random.normal(0, sigma, (48, 64, 3)))
        planes = {letter: light[..., axis] for axis, letter in enumerate("RGB")}
        planes |= {"motion.X": 0 * board, "motion.Y": 0 * board, "depth.Z": 1 + 0 * board}
        write_channels(folder / f"{name}.{number:04}.exr", planes, {"postfx:spp": 4})
    return f"{folder}/{name}.####.exr"


def run_tune(monkeypatch, capsys, *words: str) -> tuple[int, dict]:
    monkeypatch.setattr("sys.argv", ["tune", *words, "--json"])
    code = tune.main()
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("target",
                         [pytest.param("--references", marks=pytest.mark.soak), "--halves"])
def test_a_gain_is_written_as_a_network_that_runs(tmp_path: Path, monkeypatch, capsys, target: str):
    shot = write_shot(tmp_path, "noisy", 0.3, 1)
    other = write_shot(tmp_path, "other", 0.3 if target == "--halves" else 0.0, 2)
    path = tmp_path / "nets/shot.onnx"
    monkeypatch.setattr(tune, "LEAST", -np.inf)
    code, facts = run_tune(monkeypatch, capsys, shot, target, other, "-o", str(path), "--steps",
                           "6")
    assert code == 0 and facts["written"] == str(path) and facts["steps"] == 6
    assert facts["examples"] == (4 if target == "--halves" else 2) and facts["target"] == target[2:]
    card = json.loads(path.with_suffix(".json").read_text())
    assert card["name"] == "shot" and card["training"]["gain_db"] == facts["gain_db"]
    frame = postfx.read_sequence(shot).read(1)
    tuned, plain = (postfx.Pipeline([postfx.DenoiseUpscale(model=model)])(frame)[Role.COLOUR]
                    for model in (str(path), "s.fp32"))
    assert (np.isfinite(tuned).all() and tuned.shape == plain.shape
            and not np.array_equal(tuned, plain))
    np.testing.assert_allclose(tuned, plain, atol=0.2)


def test_more_steps_gain_on_what_was_held_back(tmp_path: Path, monkeypatch, capsys):
    shot, clean = write_shot(tmp_path, "noisy", 0.5, 1, 5), write_shot(tmp_path, "clean", 0.0, 2, 5)
    monkeypatch.setattr(tune, "RATE", 3e-4)
    words = (shot, "--references", clean, "-o", str(tmp_path / "shot.onnx"), "--steps", "25")
    code, facts = run_tune(monkeypatch, capsys, *words)
    assert code == 0 and facts["gain_db"] > 0.3 and facts["held_back"] == 1


def test_a_loss_is_not_written(tmp_path: Path, monkeypatch, capsys):
    shot, clean = write_shot(tmp_path, "noisy", 0.3, 1), write_shot(tmp_path, "clean", 0.0, 2)
    monkeypatch.setattr(tune, "RATE", 0.0)
    words = (shot, "--references", clean, "-o", str(tmp_path / "shot.onnx"), "--steps", "1")
    code, facts = run_tune(monkeypatch, capsys, *words)
    assert code == 1 and facts["written"] == "" and abs(facts["gain_db"]) < 1e-3
    assert not (tmp_path / "shot.onnx").exists()


def test_what_was_held_back_is_not_trained_on():
    one = tune.Example(None, None, torch.zeros(1, 3, 48, 64), torch.ones(1, 1, 48, 64), True, "")
    by_column, by_frame = tune.Split([one]), tune.Split([one] * 9)
    assert (by_column.columns(one, held=False) == slice(0, 48)
            and by_column.columns(one, held=True) == slice(48, 64))
    assert (len(by_frame.held) == 2 and len(by_frame.seen) == 7
            and by_frame.columns(one, held=True) == slice(0, 64))


def test_references_of_tiles_count_where_they_have_samples(tmp_path: Path):
    counts = np.zeros((48, 64, 1), np.float32)
    counts[16:24, 8:16], counts[32:40, 40:48], counts[0, 0] = 64, 64, 16
    colour = np.full((48, 64, 3), 0.2, np.float32)
    colour[20, 12] = np.nan
    known = tune.known_pixels(postfx.Frame({Role.COLOUR: colour, Role.SAMPLE_COUNT: counts}))
    assert known.sum() == 127 and known[16:24, 8:16].sum() == 63
    inputs = tune.inputs_of(postfx.Frame({Role.COLOUR: np.full((48, 64, 3), 0.2, np.float32)}), 1.0)
    target = torch.full((1, 3, 48, 64), 0.2)
    split = tune.Split([tune.Example(inputs, inputs, target, torch.from_numpy(known)[None, None],
                                     True, "")])
    *_, drawn, _ = split.draw(tune.random.Random(1))
    assert drawn.shape[0] == 4 * tune.BATCH and (drawn.sum((1, 2, 3)) > 0).all()
    result = torch.where(drawn > 0, 0.2, 0.9).expand(-1, 3, -1, -1)  # right where it counts
    targets = torch.full_like(result, 0.2)
    for is_noisy in (False, True):
        right = tune.error(targets, targets, drawn, is_noisy)
        torch.testing.assert_close(tune.error(result, targets, drawn, is_noisy), right)
        assert tune.error(result + 0.5, targets, drawn, is_noisy) > right + 0.2


def test_the_command_says_what_is_wrong(tmp_path: Path, monkeypatch, capsys):
    shot = write_shot(tmp_path, "noisy", 0.3, 1)
    out = ["-o", str(tmp_path / "shot.onnx")]
    for words, message in (([shot, *out], "nothing to learn from"),
                           ([shot, "--references", shot], "nowhere to write")):
        assert main(["tune", *words]) == 2
        assert message in capsys.readouterr().err
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["tune", shot, "--references", shot, *out]) == 2
    error = capsys.readouterr().err
    assert "tune needs PyTorch" in error and error.count("\n") == 1
