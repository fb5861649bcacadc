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
from training.denoise import loss as losses  # noqa: E402
from training.denoise import shot_examples, tune  # noqa: E402
from training.denoise.model import Inputs, Step  # noqa: E402


def write_shot(folder: Path, name: str, sigma: float, seed: int, count: int = 2,
               light_of_all: float = 1.0) -> str:
    """Still frames of a checkerboard, with noise."""
    rows, columns = np.mgrid[:48, :64]
    board = 0.2 + 0.5 * ((rows // 6 + columns // 6) % 2)
    random = np.random.default_rng(seed)
    for number in range(1, count + 1):
        light = np.abs(board[..., None] + random.normal(0, sigma, (48, 64, 3))) * light_of_all
        planes = {letter: light[..., axis] for axis, letter in enumerate("RGB")}
        planes |= {"motion.X": 0 * board, "motion.Y": 0 * board, "depth.Z": 1 + 0 * board}
        write_channels(folder / f"{name}.{number:04}.exr", planes, {"postfx:spp": 4})
    return f"{folder}/{name}.####.exr"


def run_tune(monkeypatch, capsys, *words: str) -> tuple[int, dict]:
    monkeypatch.setattr("sys.argv", ["tune", *words, "--device", "cpu", "--json"])
    code = tune.main()
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(("target", "model"), [
    pytest.param("--references", "s", marks=pytest.mark.soak), ("--halves", "s"),
    pytest.param("--references", "xl", marks=pytest.mark.soak)])
def test_a_gain_is_written_as_a_network_that_runs(tmp_path: Path, monkeypatch, capsys, target: str,
                                                  model: str):
    shot = write_shot(tmp_path, "noisy", 0.3, 1)
    other = write_shot(tmp_path, "other", 0.3 if target == "--halves" else 0.0, 2)
    path = tmp_path / "nets/shot.onnx"
    monkeypatch.setattr(tune, "LEAST_SURE", -np.inf)
    monkeypatch.setattr(shot_examples, "HELD_WINDOWS", {"cpu": 2})
    code, facts = run_tune(monkeypatch, capsys, shot, target, other, "-o", str(path), "--steps",
                           "2", "--model", model)
    assert code == 0 and facts["written"] == str(path) and facts["steps"] == 2
    assert facts["examples"] == (4 if target == "--halves" else 2) and facts["target"] == target[2:]
    card = json.loads(path.with_suffix(".json").read_text())
    assert card["name"] == "shot" and card["training"]["gain_db"] == facts["gain_db"]
    frame = postfx.read_sequence(shot).read(1)
    tuned, plain = (postfx.Pipeline([postfx.DenoiseUpscale(model=one, scale=1)])(frame)[Role.COLOUR]
                    for one in (str(path), {"s": "s.fp32"}.get(model, model)))
    assert (np.isfinite(tuned).all() and tuned.shape == plain.shape
            and not np.array_equal(tuned, plain))
    assert np.abs(tuned - plain).mean() < 0.1


@pytest.mark.soak
def test_more_steps_gain_on_what_was_held_back(tmp_path: Path, monkeypatch, capsys):
    shot, clean = write_shot(tmp_path, "noisy", 0.5, 1, 5), write_shot(tmp_path, "clean", 0.0, 2, 5)
    monkeypatch.setattr(tune, "RATE", 3e-4)
    words = (shot, "--references", clean, "-o", str(tmp_path / "shot.onnx"), "--steps", "15",
             "--model", "s")
    code, facts = run_tune(monkeypatch, capsys, *words)
    assert code == 0 and facts["gain_db"] > 0.3 and facts["held_back"] == 1


def test_a_second_render_with_the_same_noise_teaches_nothing(tmp_path: Path, monkeypatch, capsys):
    shot = write_shot(tmp_path, "noisy", 0.3, 1)
    words = (shot, "--halves", shot, "-o", str(tmp_path / "shot.onnx"), "--model", "s")
    monkeypatch.setattr("sys.argv", ["tune", *words, "--steps", "1", "--device", "cpu"])
    assert tune.main() == 2 and "is the same render as" in capsys.readouterr().err
    assert not (tmp_path / "shot.onnx").exists()


def test_a_render_of_another_shot_teaches_nothing(tmp_path: Path, monkeypatch, capsys):
    shot = write_shot(tmp_path, "noisy", 0.1, 1)
    other = write_shot(tmp_path, "other", 0.1, 2, light_of_all=3.0)
    monkeypatch.setattr("sys.argv", ["tune", shot, "--references", other, "-o",
                                     str(tmp_path / "shot.onnx"), "--model", "s", "--steps", "1",
                                     "--device", "cpu"])
    assert tune.main() == 2 and "shows another picture than its frame of" in capsys.readouterr().err


def test_references_of_a_few_tiles_are_of_the_same_shot(tmp_path: Path, monkeypatch, capsys):
    """What is black without samples shows no other picture."""
    shot, clean = write_shot(tmp_path, "noisy", 0.1, 1), write_shot(tmp_path, "clean", 0.0, 2)
    for frame in list(postfx.read_sequence(clean)):
        counts = np.zeros((48, 64))
        counts[16:32] = 256
        light = frame[Role.COLOUR] * (counts[..., None] > 0)
        planes = {letter: light[..., axis] for axis, letter in enumerate("RGB")}
        write_channels(Path(frame.source), planes | {"sample_count.Y": counts})
    monkeypatch.setattr(shot_examples, "HELD_WINDOWS", {"cpu": 1})
    code, _ = run_tune(monkeypatch, capsys, shot, "--references", clean, "-o",
                       str(tmp_path / "shot.onnx"), "--model", "s", "--steps", "1")
    assert code in (0, 1)


def test_a_loss_is_not_written(tmp_path: Path, monkeypatch, capsys):
    shot, clean = write_shot(tmp_path, "noisy", 0.3, 1), write_shot(tmp_path, "clean", 0.0, 2)
    monkeypatch.setattr(tune, "RATE", 0.0)
    words = (shot, "--references", clean, "-o", str(tmp_path / "shot.onnx"), "--steps", "1",
             "--model", "s")
    code, facts = run_tune(monkeypatch, capsys, *words)
    assert code == 1 and facts["written"] == "" and abs(facts["gain_db"]) < 1e-3
    assert not (tmp_path / "shot.onnx").exists()


def example(number: int, known: torch.Tensor) -> shot_examples.Example:
    """A grey frame whose target is itself."""
    frame = postfx.Frame({Role.COLOUR: np.full((48, 64, 3), 0.2, np.float32)})
    inputs = shot_examples.inputs_of(frame, False, torch.device("cpu"))
    count = shot_examples.FRAMES_BEFORE + 1
    return shot_examples.Example(number, [inputs] * count, [False] + [True] * (count - 1), 1.0,
                        torch.full((1, 3, 48, 64), 0.2), known)


def test_what_was_held_back_is_not_trained_on():
    known = torch.ones(1, 1, 48, 64)
    by_column = shot_examples.Split([example(1, known)])
    assert by_column.seen[0].known[..., :48].all() and not by_column.seen[0].known[..., 48:].any()
    assert by_column.held[0].known[..., 48:].all() and not by_column.held[0].known[..., :48].any()
    # both renders of a frame are held back together
    by_frame = shot_examples.Split([example(number, known) for number in (*range(9), *range(9))])
    held, seen = ({one.number for one in part} for part in (by_frame.held, by_frame.seen))
    assert held == {2, 6} and seen == set(range(9)) - held
    assert all(one.known.all() for one in by_frame.held)


def test_pixels_of_one_column_are_too_few_to_hold_some_back():
    known = torch.zeros(1, 1, 48, 64)
    known[..., 5] = 1
    with pytest.raises(postfx.PostfxError, match="too few columns"):
        shot_examples.Split([example(1, known)])


def test_of_long_shots_as_many_frames_are_read_as_memory_holds():
    numbers = [*range(1, 301)]
    assert shot_examples.choose_targets(numbers, 320 * 180) == numbers
    chosen = shot_examples.choose_targets(numbers, 1920 * 1080)
    assert 4 < len(chosen) < 20 and chosen[0] == 1 and chosen[-1] == 300
    assert len(shot_examples.choose_targets(numbers, 15360 * 8640)) == shot_examples.KEPT
    assert shot_examples.choose_targets([7, 9], 15360 * 8640) == [7, 9]


def test_references_of_tiles_count_where_they_have_samples():
    counts = np.zeros((48, 64, 1), np.float32)
    counts[16:24, 8:16], counts[32:40, 40:48], counts[0, 0] = 64, 64, 16
    colour = np.full((48, 64, 3), 0.2, np.float32)
    colour[20, 12] = np.nan
    target = postfx.Frame({Role.COLOUR: colour, Role.SAMPLE_COUNT: counts})
    known = shot_examples.known_pixels(target)
    assert known.sum() == 127 and known[16:24, 8:16].sum() == 63
    split = shot_examples.Split([example(1, torch.from_numpy(known)[None, None])])
    drawn = split.draw(shot_examples.random.Random(1)).known
    assert drawn.shape[0] == 4 * shot_examples.BATCH and (drawn.sum((1, 2, 3)) > 0).all()
    result = torch.where(drawn > 0, 0.2, 0.9).expand(-1, 3, -1, -1)  # right where it counts
    targets = torch.full_like(result, 0.2)
    for is_noisy in (False, True):
        losses = [tune.loss_of(Step(light, None, light, None), targets, drawn, is_noisy)
                  for light in (targets, result, result + 0.5)]
        torch.testing.assert_close(losses[1], losses[0])
        assert losses[2] > losses[0] + 0.01


def read_halves(shot: str, other: str) -> list[shot_examples.Example]:
    words = [shot, "--halves", other, "-o", "x.onnx", "--model", "s"]
    parser = tune.Parser(prog="tune")
    tune.TUNE.add_to(parser)
    return shot_examples.read_examples(parser.parse_args(words), False, torch.device("cpu"))


def write_even(folder: Path, name: str, light: float) -> str:
    """Two frames of even light."""
    for number in (1, 2):
        write_channels(folder / f"{name}.{number:04}.exr",
                       {letter: np.full((48, 64), light) for letter in "RGB"})
    return f"{folder}/{name}.####.exr"


def test_each_pixel_is_of_one_render_and_its_target_of_the_other(tmp_path: Path, monkeypatch):
    """What is held back stays as it is."""
    # even light tells which render a pixel is of
    monkeypatch.setattr(shot_examples, "is_other_picture", lambda *_: False)
    found = read_halves(write_even(tmp_path, "a", 0.25), write_even(tmp_path, "b", 0.75))
    split = shot_examples.Split(found)
    windows = split.draw(shot_examples.random.Random(1))
    colour, target = windows.frames[-1].colour, windows.target
    brighter = colour > target
    assert 0.4 < brighter.float().mean() < 0.6
    ratio = torch.where(brighter, colour / target, target / colour)
    torch.testing.assert_close(ratio, torch.full_like(ratio, 3.0))
    for held in split.held_windows():
        assert len(held.frames[-1].colour.unique()) == len(held.target.unique()) == 1


def test_swapped_pixels_lose_nothing():
    torch.manual_seed(2)
    sizes = {"colour": 3} | {name: 1 for name in shot_examples.ABSENT}

    def planes() -> dict[str, torch.Tensor]:
        return {name: torch.rand(2, count, 8, 9) for name, count in sizes.items()}

    def render() -> list[Inputs]:
        return [Inputs(**planes(), jitter=torch.zeros(2, 2)) for _ in range(2)]

    own, other = render(), render()
    frames, target = shot_examples.swap_pixels(own, other)
    torch.testing.assert_close(frames[-1].colour + target, own[-1].colour + other[-1].colour)
    kept = [(mixed.colour == mine.colour).all(1) for mixed, mine in zip(frames, own, strict=True)]
    for mixed, mine, mask in zip(frames, own, kept, strict=True):
        assert torch.equal((mixed.depth == mine.depth)[:, 0], mask)
        assert 0.3 < mask.float().mean() < 0.7
    assert not torch.equal(*kept)


def test_frames_that_the_other_render_lacks_are_not_swapped(tmp_path: Path):
    shot = write_shot(tmp_path, "a", 0.3, 1, count=3)
    other = write_shot(tmp_path, "b", 0.3, 2, count=3)
    Path(other.replace("####", "0002")).unlink()
    found = read_halves(shot, other)
    assert {(one.number, bool(one.twins)) for one in found} == {(1, True), (3, False)}


def test_the_default_network_learns_all_but_how_much_of_the_history_counts():
    model, _ = tune.load_model("xl")
    one = example(1, torch.ones(1, 1, 48, 64))
    split = shot_examples.Split([one])
    step = tune.run(model, split.draw(shot_examples.random.Random(1)))
    assert step.output.shape[1:] == (3, 48, 48) and step.error is not None
    fixed = {name.split(".")[1] for name, weight in model.named_parameters()
             if not weight.requires_grad}
    assert fixed == set(tune.FROZEN)


def test_noise_of_targets_moves_no_minimum():
    """The error of what is seen, whose slope is that of the display curve, is least at the mean."""
    light = torch.linspace(0.01, 4, 150, dtype=torch.float64).reshape(1, 3, 5, 10).requires_grad_()
    (slope,) = torch.autograd.grad(tune.display(light).sum(), light)
    torch.testing.assert_close(losses.display_slope(light), slope)
    noisy = light.detach() * torch.tensor([0.2, 1.8])[:, None, None, None]
    (gradient,) = torch.autograd.grad(
        losses.seen_error(light, noisy, light.detach()).square().sum(), light)
    assert gradient.abs().max() < 1e-6


def test_a_gain_against_another_render_is_measured_without_its_noise(monkeypatch):
    """As large as against the truth, though the noise is far larger than what is gained."""
    generator = torch.Generator().manual_seed(1)
    monkeypatch.setattr(shot_examples, "HELD_WINDOWS", {"cpu": 40})
    # networks that are 0.06 and 0.03 too bright
    monkeypatch.setattr(tune, "run", lambda bias, windows: Step(
        windows.frames[-1].diffuse_albedo + bias, None, None, None))
    shown = torch.full((1, 3, 48, 64), 0.3)
    noisy = [(shown + torch.randn(shown.shape, generator=generator) * 0.08).clamp(min=0)
             for _ in range(2)]
    frame = Inputs(noisy[0], *[shown] * 2, shown, shown[:, :1], shown[:, :1], shown[:, :2],
                   torch.zeros(1, 2), denoising_albedo=shown, denoising_normal=shown)
    one = shot_examples.Example(1, [frame] * 3, [False, True, True], 1.0, noisy[1],
                       torch.ones(1, 1, 48, 64))
    score = tune.Measure(shot_examples.Split([one]), 0.06, is_noisy=True)(0.03)
    assert score.gain_db == pytest.approx(20 * np.log10(2), abs=1.5) and score.sure > 5


def test_the_command_says_what_is_wrong(tmp_path: Path, monkeypatch, capsys):
    shot = write_shot(tmp_path, "noisy", 0.3, 1)
    out = ["-o", str(tmp_path / "shot.onnx")]
    for words, message in (([shot, *out], "nothing to learn from"),
                           ([shot, "--references", shot], "nowhere to write"),
                           ([shot, "--references", shot, "-o", "net"], "net: is no network's")):
        assert main(["tune", *words]) == 2
        assert message in capsys.readouterr().err
    monkeypatch.setattr(shot_examples, "find_stddev", lambda colour, planes: 0.5)
    monkeypatch.setattr("sys.argv", ["tune", shot, "--references", shot, *out])
    assert tune.main() == 2
    error = capsys.readouterr().err
    assert "pixel filter" in error and "--model m" in error and error.count("\n") == 1
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["tune", shot, "--references", shot, *out]) == 2
    error = capsys.readouterr().err
    assert "tune needs PyTorch" in error and error.count("\n") == 1
