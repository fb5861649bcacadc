"""Teaching a look of one's own, from nothing to a model that the run-time takes."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("PyOpenColorIO")

from postfx.frame import Frame, Role  # noqa: E402
from postfx.passes.tonemap import ToneMap  # noqa: E402
from postfx.pipeline import Pipeline  # noqa: E402
from postfx.runtime import Device  # noqa: E402
from training.tonemap.looks import ACES2, Local, Look, exact_target, exact_view  # noqa: E402  # noqa: E402
from training.tonemap.model import CUBE, HDRNet, default_shaper, look_up, shape  # noqa: E402
from training.tonemap.pairs import fit_cube, interpolation  # noqa: E402
from training.tonemap.pictures import expose, find_pictures  # noqa: E402
from training.tonemap.train import Recipe, parse, recipe_of  # noqa: E402

LEAST = 35.0  # dB that a look of a table must be learnt to from 8 pairs


def graded(light: np.ndarray) -> np.ndarray:
    """A grading on top of ACES 2: warm highlights, green shadows, more colour; a function of colour
    alone."""
    display = exact_view(ACES2, light).astype(np.float64)
    grey = display @ np.array([0.2126, 0.7152, 0.0722])
    rich = np.clip(grey[..., None] + (display - grey[..., None]) * 1.3, 0, 1)
    return np.clip(rich ** np.array([0.9, 1.0, 1.12]) * [1.0, 0.97, 0.9] + [0.0, 0.012, 0.004], 0,
                   1).astype(np.float32)


def picture(seed: int, height: int = 96, width: int = 144) -> np.ndarray:
    """Coloured patches under light of many stops."""
    random = np.random.default_rng(seed)
    light = np.exp2(random.normal(-2, 2.0, (6, 9, 1))) * random.uniform(0.1, 1.0, (6, 9, 3)) ** 1.5
    smooth = np.exp2(np.linspace(-1, 1, width))[:, None]
    return (light.repeat(height // 6, 0).repeat(width // 9, 1) * smooth).astype(np.float32)


def write(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    assert oiio.ImageBuf(np.ascontiguousarray(image)).write(str(path))


def write_pairs(folder: Path, pictures: dict[str, np.ndarray]) -> list[str]:
    for name, light in pictures.items():
        write(folder / "hdr" / f"{name}.exr", light)
        write(folder / "sdr" / f"{name}.png", np.round(graded(light) * 255).astype(np.uint8))
    return [str(folder / "hdr"), str(folder / "sdr")]


def teach(monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    """The command, without a start of Python and its libraries; a network is trained for a step or
    two only."""
    from training.tonemap import train

    short = ["--minutes", "0.01", "--batch", "1", "--scale", "0.1"]
    monkeypatch.setattr(sys, "argv", ["train_tonemap", *words, *short])
    train.main()


def psnr_of(model: Path, light: np.ndarray, wanted: np.ndarray) -> float:
    """Of what the run-time makes with a model."""
    pipeline = Pipeline([ToneMap(look=str(model))], Device("cpu"), exposure=0.0)
    found = pipeline(Frame({Role.COLOUR: light}))[Role.COLOUR]
    return float(-10 * np.log10(np.square(found - wanted).mean()))


def test_weights_of_a_fit_are_those_of_the_look_up() -> None:
    random = np.random.default_rng(2)
    colours, cube = random.random((500, 3)), random.random((7, 7, 7, 3))
    found = interpolation(colours, 7) @ cube.reshape(-1, 3)
    image = torch.from_numpy(colours.T.reshape(1, 3, 500, 1).astype(np.float32))
    wanted = look_up(image, torch.from_numpy(cube.astype(np.float32)))[0, :, :, 0].T
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_a_fit_keeps_the_start_where_nothing_is_asked() -> None:
    """Colours of the lower half go to half as much; the upper half has no data and goes on
    evenly."""
    random = np.random.default_rng(3)
    start = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 3, indexing="ij"), -1).astype(np.float32)
    colours = random.random((4000, 3)) * 0.5
    cube = fit_cube(colours, colours * 0.5, start)
    np.testing.assert_allclose(interpolation(colours, 9) @ cube.reshape(-1, 3), colours * 0.5,
                               atol=0.01)
    np.testing.assert_allclose(cube[8, 8, 8], 0.5, atol=0.1)


def test_a_look_is_learnt_from_pairs_to_a_model_that_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a solver that stops early: 53 dB take half of the time of 59 dB."""
    from training.tonemap import pairs

    folders = write_pairs(tmp_path, {f"p{i}": picture(i) for i in range(9)})
    monkeypatch.setattr(pairs, "TOLERANCE", 5e-3)
    teach(monkeypatch, "mine", "--pairs", *folders, "--hold-out", "p8", "-o",
               str(tmp_path / "run"))
    said = capsys.readouterr().out
    assert "colour alone explains the pairs" in said and "p8: " in said
    model = tmp_path / "run" / "tonemap.mine.onnx"
    card = json.loads(model.with_suffix(".json").read_text())
    assert card["look"] == {"pairs": [f"p{i}" for i in range(8)]} and card["parameters"] == 0
    assert psnr_of(model, picture(8), graded(picture(8))) >= LEAST
    assert card["quality"]["held_out_psnr"]["p8"] >= LEAST


def test_a_look_of_a_config_is_baked_and_measured_on_charts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = ["--ocio", ACES2.config, "--display", ACES2.display, "--view", ACES2.view]
    teach(monkeypatch, "film", *view, "-o", str(tmp_path))
    model, light = tmp_path / "tonemap.film.onnx", picture(1)
    assert psnr_of(model, light, exact_view(ACES2, light)) > 45
    assert min(json.loads(model.with_suffix(".json")
                          .read_text())["quality"]["held_out_psnr"].values()) > 45


def test_training_that_spoils_the_start_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the cube cannot be fitted better, and training ends with a grid of nothing."""
    from training.tonemap import pairs as module
    from training.tonemap import train

    def spoil(net: HDRNet, *rest: object) -> dict[str, object]:
        weights = {name: value * 0 for name, value in net.state_dict().items()}
        return {"weights": weights, "psnr": {"1": 5.0}, "history": ["spoilt"]}

    monkeypatch.setattr(module, "fit", lambda net, pairs, start: (start, 30.0))
    monkeypatch.setattr(train, "train_grid", spoil)
    monkeypatch.setattr(train, "nearest_cube", lambda pairs: train.shipped_cubes()["local"])
    look = Look(ACES2, gain=0.75, local=Local(1.0, 0.95, 0.7))
    made = [(picture(i), exact_target(picture(i), look)) for i in range(2)]
    pairs = module.Pairs({"0": made[0]}, {"1": made[1]})
    found = train.teach_pairs(pairs, "local", Recipe(1.0), torch.device("cpu"), print)
    assert found["history"] == [] and found["weights"]["guide.matrix"].any()


@pytest.mark.parametrize(("words", "on_gpu", "rate"), [
    ([], False, 2e-4), ([], True, 1.5e-3), (["--start", "none"], False, 1.5e-3),
    (["--rate", "0.01"], False, 0.01)])
def test_fine_tuning_on_a_cpu_takes_small_steps(
    words: list[str], on_gpu: bool, rate: float
) -> None:
    assert recipe_of(parse(["mine", "--target", "local", *words]), on_gpu).rate == rate


@pytest.mark.slow
@pytest.mark.soak
def test_a_local_look_is_trained_and_exported(tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    for i in range(2):
        write(tmp_path / "hdr" / f"{i}.exr", picture(i))
    words = ["--target", "local", "--pictures", str(tmp_path / "hdr/*.exr"), "--hold-out", "1",
             "--start", "none"]
    teach(monkeypatch, "small", *words, "-o", str(tmp_path / "run"))
    card = json.loads((tmp_path / "run" / "tonemap.small.json").read_text())
    assert card["parameters"] == 488_352 and card["training"]["runs"][0]["steps"] > 0
    assert (tmp_path / "run" / "log.jsonl").read_text().count("\n") >= 1


def test_an_exposure_is_learnt_and_exported(tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    """From one picture; light that is four times as bright comes out the same."""
    from training.tonemap import examples

    write(tmp_path / "hdr" / "0.exr", picture(0))
    monkeypatch.setattr(examples, "SHAPES", ((96, 144),))
    pictures = str(tmp_path / "hdr/*.exr")
    words = ["--target", "auto", "--pictures", pictures, "--views", "60", "-o",
             str(tmp_path / "run")]
    teach(monkeypatch, "mine", *words)
    model, light = tmp_path / "run" / "tonemap.mine.onnx", picture(1)
    card = json.loads(model.with_suffix(".json").read_text())
    assert card["outputs"]["stops"]["shape"] == [1, 1] and card["keep"] == 0.98
    pipeline = Pipeline([ToneMap(look=str(model), keep=0.0)], Device("cpu"), exposure=0.0)
    dim, bright = (pipeline(Frame({Role.COLOUR: light * np.float32(gain)}))[Role.COLOUR].copy()
                   for gain in (1, 4))
    assert dim.std() > 0.05
    np.testing.assert_allclose(bright, dim, atol=0.01)


def test_pairs_that_do_not_fit_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_pairs(tmp_path, {"a": picture(0), "b": picture(1)})
    write(tmp_path / "sdr" / "b.png", np.zeros((10, 10, 3), np.uint8))
    folders = [str(tmp_path / "hdr"), str(tmp_path / "sdr")]
    with pytest.raises(SystemExit, match="both must show the same pixels"):
        teach(monkeypatch, "x", "--pairs", *folders, "-o", str(tmp_path / "run"))


def test_eight_pairs_of_photographs_are_enough(shared_dir: Path,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    """On pictures that were not among the eight; the solver stops early here, too."""
    from training.tonemap import pairs as module
    from training.tonemap.pairs import Pairs, fit
    from training.tonemap.train import nearest_cube

    monkeypatch.setattr(module, "TOLERANCE", 5e-3)

    found = find_pictures([f"{shared_dir}/hdr/*.exr"], [f"{shared_dir}/environments/*.hdr"], 320)
    found = {name: expose(light) for name, light in found.items()}
    held = {"Bonita", "pedestrian_overpass_1k"}
    train = {name: (found[name], graded(found[name])) for name in sorted(found.keys() - held)[:8]}
    assert len(train) == 8
    pairs = Pairs(train, {})
    cube, _ = fit(None, pairs, nearest_cube(pairs))
    assert cube.shape == (CUBE, CUBE, CUBE, 3)
    for name in held:
        shaped = shape(torch.from_numpy(found[name]).permute(2, 0, 1)[None], *default_shaper())
        error = look_up(shaped, cube)[0].permute(1, 2, 0).numpy() - graded(found[name])
        assert -10 * np.log10(np.square(error).mean()) >= LEAST, name
