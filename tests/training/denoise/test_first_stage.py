"""Clips for the network that enlarges what another one has denoised."""

from pathlib import Path

import pytest
import torch

from training.denoise.checkpoint import save
from training.denoise.clips import CHANNELS, DEPTH, MOTION, Clip
from training.denoise.first_stage import FirstStage, shrink
from training.denoise.model import DenoiseUpscale, TrunkConfig
from training.denoise.picture import PictureConfig, PictureNetwork

SIDE = 32


def make_clip(scale: int = 1) -> Clip:
    random = torch.Generator().manual_seed(1)
    planes = torch.rand(2, 3, CHANNELS, SIDE, SIDE, generator=random).half()
    reference = torch.full((3, 3, scale * SIDE, scale * SIDE), 0.5).half()
    return Clip("clip", planes, torch.full((2, 3, 2), 0.25), [True, True],
                torch.tensor([0.0, 1.0, 1.0]), reference, None, 1.0, None, [False, False],
                [False, False], [False, False], [4, 8])


def test_a_shrunken_clip_keeps_its_reference_and_gains_samples() -> None:
    clip = make_clip()
    small = shrink(clip)
    assert small.planes.shape == (2, 3, CHANNELS, SIDE // 2, SIDE // 2)
    assert small.reference is clip.reference
    assert small.samples == [16, 32]
    torch.testing.assert_close(small.jitter, clip.jitter / 2)
    colour = clip.planes[:, :, :3, :2, :2].float().mean((-1, -2))
    torch.testing.assert_close(small.planes[:, :, :3, 0, 0].float(), colour, atol=1e-3, rtol=1e-3)


def test_depth_and_motion_of_a_shrunken_clip_are_those_of_one_pixel() -> None:
    clip = make_clip()
    small = shrink(clip)
    torch.testing.assert_close(small.planes[:, :, DEPTH], clip.planes[:, :, DEPTH, 1::2, 1::2])
    torch.testing.assert_close(small.planes[:, :, MOTION:],
                               clip.planes[:, :, MOTION:, 1::2, 1::2] / 2)


def test_a_clip_that_is_smaller_than_its_reference_stays() -> None:
    clip = make_clip(scale=2)
    assert shrink(clip) is clip


def picture_checkpoint(path: Path) -> Path:
    torch.manual_seed(2)
    config = PictureConfig(down=(8, 8, 8, 8, 8), up=(8, 8, 8, 8), last=8, beside=(8, 8, 8))
    network = PictureNetwork(config)
    save({"config": config.as_dict(), "notes": {},
          "weights": {f"trunk.{name}": values for name, values in network.state_dict().items()}},
         path)
    return path


def test_colour_becomes_a_mixture_with_what_the_network_makes(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = make_clip(scale=2)
    first = FirstStage(picture_checkpoint(tmp_path / "picture.pt"), torch.device("cpu"))
    monkeypatch.setattr("training.denoise.first_stage.SHARES", (1.0, 1.0))
    denoised = first(clip).planes
    monkeypatch.setattr("training.denoise.first_stage.SHARES", (0.25, 0.25))
    mixed = first(clip).planes
    assert torch.equal(mixed[:, :, 3:], clip.planes[:, :, 3:])
    noisy = clip.planes[:, :, :3].float()
    assert (denoised[:, :, :3] - noisy).abs().mean() > 0.01
    torch.testing.assert_close(mixed[:, :, :3].float(),
                               0.75 * noisy + 0.25 * denoised[:, :, :3].float(),
                               atol=2e-3, rtol=2e-3)


def test_a_network_that_predicts_filters_is_refused(tmp_path: Path) -> None:
    model = DenoiseUpscale(TrunkConfig(widths=(8, 8)))
    path = tmp_path / "filters.pt"
    save({"config": model.config.as_dict(), "weights": model.state_dict(), "notes": {}}, path)
    with pytest.raises(ValueError, match="does not give the picture itself"):
        FirstStage(path, torch.device("cpu"))
