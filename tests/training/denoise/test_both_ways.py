"""Training on clips that are run backwards, too: motion turned round, the blend of both directions,
and steps."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from postfx.frame import Frame, Role  # noqa: E402
from postfx.temporal.reverse_motion import LOST, motion_to_next  # noqa: E402
from tests.training.denoise.test_train import (  # noqa: E402
    inner,
    moving_clip,
    settings,
    steps_lower_the_loss,
    write_clips,
)
from tests.training.small_denoiser import small_model  # noqa: E402
from training import ops  # noqa: E402
from training.denoise import loss as losses  # noqa: E402
from training.denoise import train  # noqa: E402
from training.denoise.augment import Augment  # noqa: E402
from training.denoise.clips import CHANNELS, MOTION, inverse_motion, load  # noqa: E402
from training.denoise.dataset import Batch, Stack, collate, to_batch  # noqa: E402
from training.denoise.gradient import copy_batch, tensors  # noqa: E402
from training.denoise.loss import ClipLoss  # noqa: E402
from training.denoise.model import Step  # noqa: E402


def turned_clip() -> Stack:
    """The picture that turns and slides, with its inverse motion."""
    clip = moving_clip(2)
    motion = clip.planes[0, :, MOTION:CHANNELS].movedim(1, -1).numpy()
    planes = {"v0_motion": motion, "v0_depth": np.ones(motion.shape[:3], np.float32)}
    inverse = (torch.from_numpy(inverse_motion(planes, "v0")).movedim(-1, 1).half()
               .to(clip.planes.dtype))
    return replace(clip, planes=torch.cat((clip.planes, inverse[None]), 2), motions=("inverse",))


def test_what_points_out_of_the_picture_has_no_history() -> None:
    motion = torch.full((1, 2, 16, 16), float(LOST)).half().float()
    assert not ops.inside(ops.dilate_motion(motion, torch.ones(1, 1, 16, 16))).any()


@pytest.mark.parametrize("seed", range(8))
def test_augmentations_keep_inverse_motion_true(seed: int) -> None:
    random.seed(seed)
    torch.manual_seed(seed)
    for batch in (to_batch(turned_clip()), Augment(drop=0.0)(turned_clip())):
        moved = losses.reproject_reference(batch.references[1], batch.inverse[0])
        error = inner(moved - batch.references[0]).abs().mean() / batch.references.mean()
        assert (error < 0.03 < inner(batch.references[1] - batch.references[0]).abs()
                .mean() / batch.references.mean())


def test_without_motion_there_is_none_either_way() -> None:
    random.seed(0)
    batch = Augment(drop=100.0)(turned_clip())
    assert not any(motion.any() for motion in batch.inverse)


def test_inverse_motion_is_made_when_a_clip_is_loaded(tmp_path: Path) -> None:
    write_clips(tmp_path, 1)
    clip = load(tmp_path / "clip0000.npz", torch.device("cpu"), motions=("inverse",))
    assert clip.planes.shape == (1, 2, CHANNELS + 2, 48, 60)
    with np.load(tmp_path / "clip0000.npz") as file:
        frames = [Frame({Role.MOTION: motion, Role.DEPTH: depth[..., None]})
                  for motion, depth in zip(file["v0_motion"], file["v0_depth"], strict=True)]
    wanted = torch.from_numpy(motion_to_next(*frames)).movedim(-1, 0)
    assert (torch.equal(clip.planes[0, 0, CHANNELS:], wanted.half())
            and not clip.planes[0, 1, CHANNELS:].any())
    batch = to_batch(collate([clip], [0], 32))
    assert batch.inverse[0].shape == batch.frames[0].motion.shape == (1, 2, 32, 32)


class Told(torch.nn.Module):
    """Instead of a network: the frame's motion as a grey picture."""

    def step(self, inputs, state):
        return Step(inputs.motion[:, :1].expand(-1, 3, -1, -1), state, None, None)


def told_clip(cuts: list[int]) -> Batch:
    """Motion is 1 forwards and 2 backwards."""
    clip = moving_clip(1)
    planes = torch.cat((clip.planes, clip.planes[:, :, :2]), 2)[:, :1].repeat(1, len(cuts), 1, 1, 1)
    planes[:, :, MOTION:CHANNELS], planes[:, :, CHANNELS:] = 1, 2
    repeated = {name: getattr(clip, name)[:, :1].repeat(1, len(cuts),
                                                        *[1] * (getattr(clip, name).ndim - 2))
                for name in ("jitter", "reference", "surfaces", "guides")}
    keep = 1 - torch.tensor([cuts], dtype=torch.float32)
    return to_batch(replace(clip, planes=planes, motions=("inverse",), keep=keep, **repeated))


def test_a_frame_is_blended_by_what_each_direction_has_seen_of_it(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    rated = []
    scores = losses.Truth.scores
    monkeypatch.setattr(losses.Truth, "scores",
                        lambda *args: rated.append(args[1]) or scores(*args))
    loss, *_ = ClipLoss(Told(), flicker=1.0, reset=0.0)(told_clip([1, 0, 0, 1, 0]))
    ahead, back, both = ([float(picture.mean()) for picture in outputs] for outputs in rated)
    assert ahead == [1.0] * 5 and back == [2.0] * 5
    assert both == pytest.approx([2 - k / 4 for k in (1, 2, 3)] + [2 - k / 3 for k in (1, 2)])
    parts = [float(scores(losses.Truth(told_clip([1, 0, 0, 1, 0])), outputs, 1.0)[0])
             for outputs in rated]
    assert float(loss) == pytest.approx(parts[0] / 4 + parts[1] / 4 + parts[2] / 2, rel=1e-4)


def test_steps_both_ways_lower_the_loss() -> None:
    model, clip = small_model(), turned_clip()
    batch = to_batch(replace(clip, planes=clip.planes[..., :32, :32],
                             reference=clip.reference[..., :64, :64]))
    steps_lower_the_loss(model, batch)


def test_copying_a_batch_copies_its_inverse_motion() -> None:
    def drawn() -> Batch:
        random.seed(0)  # all turned alike: of one shape
        return Augment()(turned_clip())

    one, other = drawn(), drawn()
    assert [x.shape for x in tensors(one)] == [x.shape for x in tensors(other)]
    other.inverse[0][:] = 7
    copy_batch(other, one)
    assert (one.inverse[0] == 7).all()


@pytest.mark.parametrize(("share", "count"), [(0.0, 0), (0.25, 25), (0.5, 50), (1.0, 100)])
def test_steps_both_ways_are_spread_evenly(share: float, count: int) -> None:
    chosen = [train.runs_both_ways(step, share) for step in range(100)]
    assert sum(chosen) == count
    assert abs(sum(chosen[:10]) - 10 * share) < 1


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_run_both_ways_validates_the_blend(share: float, tmp_path: Path) -> None:
    write_clips(tmp_path, 3)
    train.train(settings(tmp_path, tmp_path, "--steps", 4, "--both-ways", share))
    notes = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["notes"]
    assert notes["steps"] == 4 and notes["both_ways"] == share
    assert np.isfinite(notes["both_psnr"]) and notes["both_psnr"] != notes["validation_psnr"]
