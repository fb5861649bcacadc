"""The predicted error is fitted to what is measured, and nothing else of a network changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxruntime")

from training.datagen.clip_file import save_clip  # noqa: E402
from training.denoise.calibrate import (  # noqa: E402
    Layer,
    Pixels,
    fit,
    held_back,
    main,
    observe,
    ratios,
    squared_error,
)
from training.denoise.checkpoint import PREFIX, read, save  # noqa: E402
from training.denoise.dataset import load  # noqa: E402
from training.denoise.picture import PictureConfig, PictureNetwork  # noqa: E402

SMALL = PictureConfig(down=(8, 8, 8, 8, 8), up=(8, 8, 8, 8), last=8)
SIZE = 40, 56
FRAMES = 2
CHANNELS = 6


def drawn(seed: int = 0, clips: int = 10, each: int = 4000) -> tuple[Pixels, Layer]:
    """Pixels whose squared errors scatter around what a layer says, and that layer."""
    generator = torch.Generator().manual_seed(seed)
    inputs = torch.rand(clips * each, CHANNELS, generator=generator)
    true = Layer(torch.tensor([2.0, -1.0, 0.5, 0.0, 1.0, -0.5]), torch.tensor([-6.0]))
    scatter = torch.randn(len(inputs), generator=generator).square()
    return Pixels(inputs, true(inputs).exp() * scatter, torch.arange(clips).repeat_interleave(each)
                  ), true


def test_a_wrong_slope_and_scale_are_found() -> None:
    pixels, true = drawn()
    wrong = Layer(0.5 * true.weight, true.bias + 1)
    assert min(ratios(wrong, pixels)) < 0.6
    found = ratios(fit(pixels, wrong), pixels)
    assert len(found) == 10 and all(0.9 < ratio < 1.1 for ratio in found)
    assert all(0.85 < ratio < 1.15 for ratio in held_back(pixels, wrong))


def test_without_many_pixels_the_layer_stays_as_it_was_trained() -> None:
    """An input that says nothing keeps its weight."""
    pixels, true = drawn()
    silent = Pixels(pixels.inputs.clone(), pixels.squared, pixels.clips)
    silent.inputs[:, 3] = 0.5
    begin = Layer(torch.full((CHANNELS,), 0.25), true.bias)
    assert fit(silent, begin).weight[3] == pytest.approx(0.25, abs=1e-3)


def write_clip(path: Path, noise: float = 0.02) -> None:
    """A wall in even light with a noisy render, one of half of the reference, and references whose
    halves have noise."""
    random = np.random.default_rng(7)
    shape = (FRAMES, *SIZE)
    true = np.full((*shape, 3), 0.2)
    halves = [true + random.normal(0, noise, true.shape) for _ in range(2)]
    planes = {"diffuse_albedo": np.full((*shape, 3), 0.5), "specular_albedo": np.zeros((*shape, 3)),
              "normal": np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3)),
              "roughness": np.ones(shape), "depth": np.full(shape, 3.0),
              "motion": np.zeros((*shape, 2)), "jitter": np.zeros((FRAMES, 2)), "style": "box"}
    noisy = {**planes, "colour": true * random.gamma(4, 0.25, true.shape), "spp": 4}
    half = {**planes, "colour": halves[0], "spp": 64, "half": True}
    facts = {"scale": 1.0, "seed": 0, "scene": "test", "meta": {}, "half": halves[1]}
    save_clip(path, (halves[0] + halves[1]) / 2, [noisy, half], facts)


def test_the_noise_of_references_is_no_error(tmp_path: Path) -> None:
    write_clip(tmp_path / "clip.npz")
    clip = load(tmp_path / "clip.npz", torch.device("cpu"), blank_volumes=False)
    from training.denoise.loss import display

    truth = display(torch.full((3, *SIZE), 0.2) * clip.exposure)
    noise = float((display(clip.half[0].float() * clip.exposure) - truth).square().mean())
    for variant in range(2):
        found = float(squared_error(truth, clip, variant, 0).mean())
        assert abs(found) < 0.1 * noise


def checkpoint(path: Path) -> Path:
    """A network with weights at random."""
    torch.manual_seed(3)
    weights = {PREFIX + name: weight
               for name, weight in PictureNetwork(SMALL).state_dict().items()}
    save({"config": SMALL.as_dict(), "weights": weights, "notes": {"steps": 1}}, path)
    return path


def test_the_command_changes_the_prediction_alone(tmp_path: Path,
                                                  capsys: pytest.CaptureFixture[str]) -> None:
    clips = tmp_path / "clips" / "kind"
    clips.mkdir(parents=True)
    write_clip(clips / "clip.00000.npz")
    before = read(checkpoint(tmp_path / "before.pt"))
    main([str(tmp_path / "before.pt"), "--clips", str(tmp_path / "clips"), "-o",
          str(tmp_path / "after.pt")])
    assert "1 clips" in capsys.readouterr().out
    after = read(tmp_path / "after.pt")
    changed = {name for name, weight in after["weights"].items()
               if not torch.equal(weight, before["weights"][name])}
    assert changed == {f"{PREFIX}error.weight", f"{PREFIX}error.bias"}
    assert "calibrate" in after["notes"]["error"] and after["notes"]["steps"] == 1
    pixels = observe(after, [clips / "clip.00000.npz"])
    layer = Layer(after["weights"][f"{PREFIX}error.weight"].flatten(),
                  after["weights"][f"{PREFIX}error.bias"])
    expected = layer(pixels.inputs).exp().mean()
    assert float(pixels.squared.mean() / expected) == pytest.approx(1, abs=0.15)


def test_a_folder_without_clips_is_told(tmp_path: Path,
                                        capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([str(checkpoint(tmp_path / "one.pt")), "--clips", str(tmp_path), "-o",
              str(tmp_path / "two.pt")])
    assert "training.datagen.render makes them" in capsys.readouterr().err
