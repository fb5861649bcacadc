"""Measured over predicted error by tenths, and the curve that brings it near 1."""

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from postfx.io.writer import write_channels  # noqa: E402
from postfx.kernels.denoise import FEATURES, MIRRORED  # noqa: E402
from training.denoise.checkpoint import PREFIX, read, save  # noqa: E402
from training.denoise.picture import PictureConfig, PictureNetwork  # noqa: E402
from training.measure.predicted_error import (  # noqa: E402
    BIAS,
    WEIGHT,
    Curve,
    Errors,
    calibrate,
    left_out,
    main,
    ratios,
)

SIZE = 48, 64
NOISE = 0.002  # of a reference, in codes


def frames(seed: int, slope: float = 1.0, bias: float = 0.0) -> list[Errors]:
    """Frames whose logarithm of the error is slope times the predicted one, plus bias. What is
    measured has the products of two references' noise, whose mean is 0."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(2):
        predicted = np.exp(random.uniform(-12, -4, SIZE)).astype(np.float32)
        true = np.exp(slope * np.log(predicted) + bias)
        scatter = random.normal(0, 1, SIZE) ** 2
        noise = random.normal(0, NOISE, SIZE) * random.normal(0, NOISE, SIZE)
        found.append(Errors(predicted, (true * scatter + noise).astype(np.float32)))
    return found


def test_right_predictions_have_the_ratio_of_one_without_the_noise_of_references():
    assert np.abs(ratios(frames(0)) - 1).max() < 0.25
    assert ratios(frames(0, bias=np.log(2))) == pytest.approx(2 * ratios(frames(0)), rel=0.02)


def test_a_curve_of_the_other_kinds_is_right_where_all_err_alike():
    kinds = {(name, samples): frames(seed, slope=1.2, bias=1.0)
             for seed, (name, samples) in enumerate([("fog", 4), ("fog", 16), ("glass", 4)])}
    wrong = ratios([one for found in kinds.values() for one in found])
    assert np.abs(np.log(wrong)).max() > 0.5
    right = ratios([one for found in left_out(kinds).values() for one in found])
    assert np.abs(right - 1).max() < 0.25


def test_the_curve_of_one_kind_says_nothing_of_that_kind():
    """A kind alone off by two stays off by two under the curve of the others."""
    kinds = {("fog", 4): frames(0), ("glass", 4): frames(1), ("water", 4): frames(2, bias=1.0)}
    found = ratios(left_out(kinds)["water", 4])
    assert np.median(found) == pytest.approx(np.e, rel=0.2)


def test_a_checkpoint_predicts_by_the_curve_and_keeps_all_else(tmp_path: Path):
    weights = {WEIGHT: torch.full((1, 4, 1, 1), 0.5), BIAS: torch.tensor([-6.0]),
               "trunk.other": torch.ones(3)}
    path = tmp_path / "one.pt"
    save({"config": {}, "weights": weights, "notes": {"steps": 3}}, path)
    made = calibrate(read(path), Curve(1.2, 0.5), 13)
    inputs = torch.tensor([1.0, 0.0, 2.0, 0.5])

    def predicted(held: dict) -> float:
        return float(held[WEIGHT].flatten() @ inputs + held[BIAS])

    assert predicted(made["weights"]) == pytest.approx(1.2 * predicted(weights) + 0.5)
    assert torch.equal(made["weights"]["trunk.other"], weights["trunk.other"])
    assert "times 1.200 plus 0.500, fitted to 13 kinds" in made["notes"]["predicted_error"]
    assert made["notes"]["steps"] == 3


def test_a_network_that_guards_its_history_predicts_by_the_curve_behind_the_guard():
    """Its pictures stay the same to the bit."""
    config = PictureConfig(guarded=True)
    network = PictureNetwork(config)
    weights = {f"{PREFIX}{name}": value for name, value in network.state_dict().items()}
    once = calibrate({"config": config.as_dict(), "weights": weights, "notes": {}},
                     Curve(1.2, 0.5), 13)
    made = calibrate(once, Curve(0.9, -0.1), 13)
    assert all(torch.equal(made["weights"][name], value) for name, value in weights.items())
    changed = PictureNetwork(PictureConfig.from_dict(made["config"]))
    changed.load_state_dict(network.state_dict())
    features, mirrored = torch.rand(1, FEATURES, 32, 32), torch.rand(1, MIRRORED, 32, 32)
    with torch.no_grad():
        picture, controls, error, _ = network(features, mirrored)
        same, alike, curved, _ = changed(features, mirrored)
    assert torch.equal(picture, same) and torch.equal(controls, alike)
    wanted = 0.9 * (1.2 * error + 0.5) - 0.1
    torch.testing.assert_close(curved, wanted)


def write_kind(folder: Path, seed: int) -> None:
    """Two frames of a wall in even light, with 4 samples and with many."""
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    for number in (1, 2):
        for name, samples in (("noisy.4", 4), ("reference", 1024), ("second", 1024)):
            light = 0.3 * random.gamma(samples, 1 / samples, (*SIZE, 3))
            planes = {channel: light[..., axis] for axis, channel in enumerate("RGB")}
            write_channels(folder / f"{name}.{number:04d}.exr", planes, {"postfx:spp": samples})


def test_the_command_prints_all_kinds_and_writes_a_checkpoint(tmp_path: Path, capsys):
    for seed, kind in enumerate(("fog", "wall")):
        write_kind(tmp_path / "kinds" / kind, seed)
    one = tmp_path / "one.pt"
    save({"config": {}, "weights": {WEIGHT: torch.ones(1, 4, 1, 1), BIAS: torch.zeros(1)},
          "notes": {}}, one)
    main([str(tmp_path / "kinds"), "--model", "l", "--calibrate", str(one), "-o",
          str(tmp_path / "two.pt")])
    printed = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in printed[:2]] == [["fog", "4"], ["wall", "4"]]
    slope = float(printed[-1].split("slope ")[1].split(",")[0])
    found = read(tmp_path / "two.pt")["weights"][WEIGHT]
    assert float(found[0, 0, 0, 0]) == pytest.approx(slope, abs=1e-3)


def test_a_folder_without_kinds_is_told(tmp_path: Path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert "render_scenes.py makes them" in capsys.readouterr().err
