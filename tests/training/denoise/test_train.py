"""The upscaler's training: augmentation of clips, steps and checkpoints."""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.training.small_denoiser import SMALL, small_model  # noqa: E402
from training.datagen.clip_file import save_clip  # noqa: E402
from training.denoise import loss as losses  # noqa: E402
from training.denoise import train  # noqa: E402
from training.denoise.augment import Augment  # noqa: E402
from training.denoise.clips import CHANNELS, MOTION, load  # noqa: E402
from training.denoise.dataset import Batch, ClipPool, Stack, to_batch  # noqa: E402
from training.denoise.gradient import FlatGradient, GradientStep, copy_batch  # noqa: E402
from training.denoise.model import TrunkConfig, empty_state  # noqa: E402

MOVE, TURN = torch.tensor([2.3, -1.1]), 0.03  # render pixels and radians a frame
H, W = 48, 60


def pattern(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """A smooth picture, defined everywhere in render pixels; (3, ...)."""
    waves = [torch.sin(0.21 * x + 0.13 * y + c) + torch.sin(0.17 * x - 0.19 * y + 2 * c)
             for c in (0.0, 1.0, 2.0)]
    return torch.stack(waves) * 0.2 + 0.5


def rotated_back(x: torch.Tensor, y: torch.Tensor,
                 frames: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Where the point at (x, y) in frame ``frames`` was in frame 0."""
    for _ in range(frames):
        dx, dy = x - W / 2, y - H / 2
        x, y = x + MOVE[0] - TURN * dy, y + MOVE[1] + TURN * dx
    return x, y


def grid(h: int, w: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres of h x w pixels over the whole picture, in render pixels."""
    y, x = torch.meshgrid((torch.arange(h) + 0.5) * H / h, (torch.arange(w) + 0.5) * W / w,
                          indexing="ij")
    return x, y


def moving_clip(scale: int, frames: int = 2) -> Stack:
    """A picture that turns and slides; colour holds point samples."""
    jitter = torch.tensor([[0.3, -0.4], [-0.2, 0.35]])[:frames]
    x, y = grid(H, W)
    planes, reference = torch.rand(frames, CHANNELS, H, W), []
    for t in range(frames):
        planes[t, :3] = pattern(*rotated_back(x + jitter[t, 0], y + jitter[t, 1], t))
        before = rotated_back(x, y, 1)
        planes[t, MOTION], planes[t, MOTION + 1] = before[0] - x, before[1] - y
        reference.append(pattern(*rotated_back(*grid(scale * H, scale * W), t)))
    guides = torch.rand(1, frames, 11, scale * H, scale * W)
    return Stack(planes[None], jitter[None], torch.tensor([False]), torch.ones(1, frames),
                 *[torch.stack(reference)[None]] * 2, planes[None].clone(), guides,
                 torch.ones(1, 1, 1, 1), torch.ones(1, dtype=torch.bool))


@pytest.mark.parametrize("seed", range(8))
def test_augmentations_keep_motion_and_jitter_true(seed: int) -> None:
    clip = moving_clip(2)
    random.seed(seed)
    torch.manual_seed(seed)
    for batch in (to_batch(clip), Augment(drop=0.0)(clip)):
        moved = losses.reproject_reference(batch.references[0], batch.frames[1].motion)
        assert inner(moved - batch.references[1]).abs().mean() < 0.02 * batch.references.mean()
        assert torch.equal(batch.halves, batch.references)  # they are the same in this clip
        assert (inner(at_samples(batch, 1) - batch.frames[1].colour).abs()
                .mean() < 0.02 * batch.references.mean())


def at_samples(batch: Batch, t: int) -> torch.Tensor:
    """The reference where frame ``t`` has its samples."""
    inputs = batch.frames[t]
    h, w = inputs.colour.shape[-2:]
    y, x = torch.meshgrid(torch.arange(h) + 0.5, torch.arange(w) + 0.5, indexing="ij")
    place = torch.stack(((x + inputs.jitter[0, 0]) / w, (y + inputs.jitter[0, 1]) / h),
                        -1)[None] * 2 - 1
    return torch.nn.functional.grid_sample(batch.references[t], place, align_corners=False)


def inner(image: torch.Tensor) -> torch.Tensor:
    return image[..., 12:-12, 12:-12]


def test_a_wrong_jitter_would_be_noticed() -> None:
    batch = to_batch(moving_clip(2))
    mirrored = replace(batch, frames=[replace(f, jitter=-f.jitter) for f in batch.frames])
    wrong = inner(at_samples(mirrored, 1) - batch.frames[1].colour).abs().mean()
    assert wrong > 0.05 * batch.references.mean()


@pytest.mark.parametrize("seed", range(6))
def test_guides_go_through_what_the_planes_go_through(seed: int) -> None:
    clip = moving_clip(1)
    random.seed(seed)
    for frame in Augment(drop=2.0, clean=0.0)(replace(clip, guides=clip.planes[:, :, 3:14])).frames:
        for field in fields(frame.guides):
            assert torch.equal(getattr(frame.guides, field.name), getattr(frame, field.name))


def test_only_renders_with_spread_samples_are_cleaned() -> None:
    clip = moving_clip(1)
    clip = replace(clip, planes=torch.rand_like(clip.planes))
    for spread in (True, False):
        random.seed(0)
        torch.manual_seed(0)
        batch = Augment(drop=0.0, clean=1.0,
                        stops=0.0)(replace(clip, spread=torch.tensor([spread])))
        noisy = (clip.planes[:, 0, :3] - clip.reference[:, 0]).abs().mean()
        error = (batch.frames[0].colour - batch.references[0]).abs().mean()
        assert error < 0.95 * noisy if spread else torch.isclose(error, noisy)


def test_without_motion_every_frame_stands_alone() -> None:
    random.seed(0)
    batch = Augment(drop=100.0)(moving_clip(2))
    assert not batch.keep.any()
    assert (batch.frames[1].roughness == 0.5).all()
    assert (batch.frames[1].guides.roughness == 0.5).all()


def test_a_cut_in_a_clip_drops_the_history(tmp_path: Path) -> None:
    write_clips(tmp_path, 1)
    path = tmp_path / "clip0000.npz"
    with np.load(path) as file:
        np.savez(path, **{**file, "reset": np.array([1, 0], np.uint8)})
    clip = load(path, torch.device("cpu"))
    assert clip.keep.tolist() == [0.0, 1.0]


def test_steps_lower_the_loss() -> None:
    model, clip = small_model(), moving_clip(2)
    batch = to_batch(replace(clip, planes=clip.planes[..., :32, :32],
                             reference=clip.reference[..., :64, :64]))
    steps_lower_the_loss(model, batch)


def steps_lower_the_loss(model: torch.nn.Module, batch: Batch) -> None:
    step = GradientStep(train.ClipLoss(model, flicker=1.0, reset=0.0),
                        FlatGradient(list(model.parameters())))
    optimiser = torch.optim.AdamW(model.parameters(), lr=3e-3)
    values = []
    for _ in range(8):
        values.append(float(step(batch)[0]))
        assert step.flat.finish(1.0, several=False) > 0
        optimiser.step()
    assert np.mean(values[-2:]) < 0.97 * values[0]


def test_learning_rate_rises_slowly_and_falls_with_the_clock() -> None:
    rises = [train.rate_at(0.0, step, 1.0) for step in range(0, 600, 50)]
    assert rises == sorted(rises) and rises[0] < 0.01 and rises[1] < 0.11 and rises[-1] == 1
    falls = [train.rate_at(0.1 * tenth, 10**6, 1.0) for tenth in range(11)]
    assert falls == sorted(falls, reverse=True) and falls[0] == 1 and 0 < falls[-1] < 0.01


def test_clips_of_little_noise_count_as_much_as_noisy_ones() -> None:
    """The same relative mistake costs the same, until errors would count more than eight times."""
    torch.manual_seed(1)
    reference, noise = torch.rand(1, 3, 32, 32), torch.randn(1, 3, 32, 32)
    faint, strong, least = (float(_even_loss(reference, noise * level))
                            for level in (0.05, 0.2, 1e-4))
    assert faint == pytest.approx(strong, rel=0.02)
    assert least < 0.1 * faint


def _even_loss(reference: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    """The loss, without its part that is not scaled, of a result that leaves a tenth of the
    noise."""
    scale = losses.even_scale(reference + noise, reference, 8.0)
    output = reference + noise / 10
    return (losses.frame_loss(output, reference, scale)
            - losses.SEEN * losses.difference(output, reference))


def test_a_noisy_reference_moves_no_minimum() -> None:
    """Over many references of much noise, the loss for such references leads to the codes of their
    mean light, where the loss for clean ones leads below it."""
    generator = torch.Generator().manual_seed(4)
    noise = torch.distributions.Gamma(8.0, 8.0)
    torch.manual_seed(4)
    light = 0.2 + torch.rand(1, 3, 1, 1, generator=generator)
    halves = light * noise.sample((2, 1, 1, 96, 96))
    references = halves.mean(0)
    wanted = losses.shown_by_halves(references, halves[0])
    ones = torch.ones(1, 1, 1, 1)

    def pull(loss: Callable[[torch.Tensor], torch.Tensor], share: float) -> float:
        """Change of a loss as a flat picture becomes brighter than this share of the light."""
        factor = torch.tensor(share, requires_grad=True)
        loss((light * factor).expand(1, 3, 96, 96)).backward()
        return float(factor.grad)

    def noisy(output: torch.Tensor) -> torch.Tensor:
        return losses.noisy_frame_loss(losses.display(output), wanted, ones)

    def clean(output: torch.Tensor) -> torch.Tensor:
        return losses.frame_loss(losses.display(output), losses.display(references), ones)

    assert pull(noisy, 0.99) < 0 < pull(noisy, 1.01)
    assert pull(clean, 0.99) > 0


def test_clips_of_noisy_references_count_less() -> None:
    light, generator = torch.rand(2, 3, 32, 32), torch.Generator().manual_seed(1)
    noise = 0.3 * torch.rand(1, 3, 32, 32, generator=generator)
    half = light + torch.cat((torch.zeros_like(noise), noise))
    quiet, noisy = losses.certainty(light, half).flatten().tolist()
    assert quiet == 1 and 0 < noisy < 0.7


def test_a_reference_without_noise_shows_what_it_is() -> None:
    light = torch.rand(1, 3, 8, 8) * 4
    torch.testing.assert_close(losses.shown_by_halves(light, light), losses.display(light))


def test_a_clip_with_noisy_references_is_scored_against_them() -> None:
    """The network's own picture as the reference leaves no loss of pictures and of change."""
    torch.manual_seed(0)
    model = small_model()
    batch = replace(to_batch(moving_clip(2)), surfaces=None)
    loss = train.ClipLoss(model, flicker=1.0, reset=0.0, light=(0.0, 1.0), is_noisy=True)
    state, outputs = empty_state(batch.frames[0], *batch.references.shape[-2:]), []
    with torch.autocast("cpu", torch.bfloat16):
        for inputs, kept in zip(batch.frames, batch.keep, strict=True):
            step = model.step(inputs, state.drop(kept))
            state = step.state
            outputs.append(step.output.detach())
    own, other = (loss(one)[0].detach()
                  for one in (replace(batch, references=torch.stack(outputs),
                                      halves=torch.stack(outputs)), batch))
    assert own < 1e-6 < 1e-3 < other


def test_clips_whose_reference_is_noisy_do_not_judge_the_predicted_error() -> None:
    pictures = [torch.rand(2, 3, 16, 16)]
    references = torch.rand(1, 2, 3, 16, 16)
    batch = replace(to_batch(moving_clip(2)), references=references, halves=references,
                    keep=torch.ones(1, 2, 1, 1, 1),
                    quiet=torch.tensor([True, False])[:, None, None, None])
    batch = replace(batch, frames=[replace(batch.frames[0], colour=torch.rand(2, 3, 16, 16),
                                           motion=torch.zeros(2, 2, 16, 16))])
    predicted = torch.zeros(2, 1, 16, 16, requires_grad=True)
    losses.Truth(batch, is_noisy=True).error_score(pictures, [predicted]).backward()
    assert predicted.grad[0].any() and not predicted.grad[1].any()


def test_noisy_references_and_colour_moved_towards_them_exclude_each_other(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        settings(tmp_path, tmp_path / "run", "--noisy-references", "--clean", 0.1)
    assert "--noisy-references needs --clean 0" in capsys.readouterr().err


def test_validation_counts_what_is_seen_however_clips_count(tmp_path: Path) -> None:
    write_clips(tmp_path, 2)
    pool = ClipPool({tmp_path: 1.0}, torch.device("cpu"))
    pool.refresh()
    model = small_model()
    ways = [train.ClipLoss(model, flicker=1.0, reset=0.1, even=even) for even in (8.0, 0.0)]
    even, plain = (train.validate(way, model.state_dict(), pool) for way in ways)
    assert even == plain and [way.even for way in ways] == [8.0, 0.0]


def test_the_scale_of_errors_is_found_at_the_inputs_size() -> None:
    reference = torch.rand(2, 3, 8, 12).repeat_interleave(3, 2).repeat_interleave(3, 3)
    colour = reference[..., ::3, ::3] + torch.tensor([0.1, 0.4])[:, None, None, None]
    assert losses.even_scale(colour, reference, 8.0).flatten().tolist() == pytest.approx([2, 1])


def test_a_non_finite_gradient_becomes_no_step() -> None:
    parameter = torch.nn.Parameter(torch.ones(3))
    flat = FlatGradient([parameter])
    flat.buffer[:] = torch.tensor([1.0, float("nan"), 2.0])
    flat.finish(1.0, several=False)
    assert torch.equal(parameter.grad, torch.zeros(3))
    assert int(flat.nonfinite) == 1


def test_copying_a_batch_copies_all_of_it() -> None:
    one, other = to_batch(moving_clip(2)), to_batch(moving_clip(2))
    assert not torch.equal(one.frames[1].guides.depth, other.frames[1].guides.depth)
    copy_batch(one, other)
    for a, b in zip(one.frames, other.frames, strict=True):
        planes = [f.name for f in fields(a) if f.name not in ("gain", "guides")]
        assert all(torch.equal(getattr(a, name), getattr(b, name)) for name in planes)
        assert torch.equal(a.guides.depth, b.guides.depth)
    assert torch.equal(one.references, other.references)


def write_clips(folder: Path, count: int) -> None:
    """Clips as the data factory writes them, of a picture that turns."""
    clip = moving_clip(2)
    planes, jitter, reference = (x[0].numpy() for x in (clip.planes, clip.jitter, clip.reference))
    names = {"colour": slice(0, 3), "diffuse_albedo": slice(3, 6), "specular_albedo": slice(6, 9),
             "normal": slice(9, 12), "roughness": 12, "depth": 13,
             "motion": slice(MOTION, CHANNELS)}
    variant = {name: np.moveaxis(planes[:, at], 1, -1)
               if isinstance(at, slice) else planes[:, at] + 0.5 for name, at in names.items()}
    facts = {"scale": 2.0, "seed": 0, "scene": "test", "meta": {}}
    for number in range(count):
        save_clip(folder / f"clip{number:04d}.npz", np.moveaxis(reference, 1, -1),
                  [{**variant, "jitter": jitter, "spp": 1, "style": "realtime"}], facts)


def settings(clips: Path, out: Path, *words: object) -> argparse.Namespace:
    """Arguments of a small training; words that follow change them."""
    small = ["--clips", clips, "--out", out, "--batch", 2, "--rate", 1e-3, "--widths",
             *SMALL.widths, "--depth", SMALL.depth, "--flicker", 1, "--reset", 0.1, "--wait", 2,
             "--crop", 48, "--clean", 0, *words]
    out.mkdir(exist_ok=True)
    torch.manual_seed(0)
    return train.parse([str(word) for word in small])


def test_a_clip_that_is_still_being_written_waits(tmp_path: Path) -> None:
    write_clips(tmp_path, 2)
    partial = tmp_path / ".clip0002.npz.17.partial.npz"
    partial.write_bytes((tmp_path / "clip0001.npz").read_bytes()[:1000])
    pool = ClipPool({tmp_path: 1.0}, torch.device("cpu"))
    pool.refresh()
    assert {path.name for path in pool.seen} == {"clip0000.npz", "clip0001.npz"}


def test_a_checkpoint_holds_the_averaged_weights_and_can_be_started_from(tmp_path: Path) -> None:
    write_clips(tmp_path, 3)
    begun = train.train(settings(tmp_path, tmp_path / "begun", "--steps", 0)).state_dict()
    train.train(settings(tmp_path, tmp_path / "run", "--steps", 5, "--log",
                         tmp_path / "runs.jsonl"))
    checkpoint = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert checkpoint["notes"]["steps"] == checkpoint["step"] == 5
    assert np.isfinite(checkpoint["notes"]["validation_psnr"])
    assert TrunkConfig.from_dict(checkpoint["config"]) == SMALL
    assert any(not torch.equal(checkpoint["weights"][key], begun[key]) for key in begun)
    again = train.train(settings(tmp_path, tmp_path / "again", "--steps", 0, "--start",
                                 tmp_path / "run" / "checkpoint.pt"))
    for key, value in again.state_dict().items():
        torch.testing.assert_close(value, checkpoint["weights"][key])
    row, = map(json.loads, (tmp_path / "runs.jsonl").read_text().splitlines())
    assert (row["run"] == "run" and row["steps"] == checkpoint["step"]
            and row["options"]["batch"] == 2)
    assert (row["validation_psnr"] == checkpoint["notes"]["validation_psnr"]
            and "seed" not in row["options"])


def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    write_clips(tmp_path, 3)
    whole, half = tmp_path / "whole", tmp_path / "half"
    random.seed(0)
    train.train(settings(tmp_path, whole, "--steps", 4))
    random.seed(0)
    train.train(settings(tmp_path, half, "--steps", 4, "--log", tmp_path / "runs.jsonl"), pause=2)
    assert not (tmp_path / "runs.jsonl").exists()  # it is not over
    random.seed(7)
    train.train(train.parse(["--clips", str(tmp_path), "--out", str(half), "--resume",
                             str(half / "checkpoint.pt")]))
    one, other = (torch.load(folder / "checkpoint.pt", weights_only=True)
                  for folder in (whole, half))
    assert one["step"] == other["step"] == 4 and one["rate"] == other["rate"]
    assert one["seed"] == 0 and one["commit"] and one["arguments"]["batch"] == 2
    for part in ("weights", "live"):
        assert all(torch.equal(one[part][name], other[part][name]) for name in one[part])
    assert all(torch.equal(a, b) for index, state in one["optimiser"]["state"].items()
               for a, b in zip(state.values(), other["optimiser"]["state"][index].values(),
                               strict=True))


def test_a_batch_with_a_state_continues_its_history() -> None:
    """Two halves of a clip, the second with the state after the first, give what the whole clip
    gives."""
    torch.manual_seed(0)
    model = small_model()
    half = replace(to_batch(moving_clip(2)), keep=torch.ones(2, 1, 1, 1, 1), surfaces=None)
    whole = replace(half, frames=half.frames * 2, references=half.references.repeat(2, 1, 1, 1, 1),
                    keep=half.keep.repeat(2, 1, 1, 1, 1))
    loss = train.ClipLoss(model, flicker=0.0, reset=0.0)
    end, alone = loss(whole)[3], loss(half)[3]
    continued = loss(replace(half, state=alone))[3]
    assert torch.equal(continued.output, end.output) and torch.equal(continued.count, end.count)
    assert not torch.equal(alone.output, end.output)


def test_carried_histories_grow_longer_than_a_clip(tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    write_clips(tmp_path, 3)
    begun, run = [], train.GradientStep.__call__

    def watched(step: GradientStep, batch: Batch) -> list:
        begun.append(float(batch.state.fresh.mean()))
        return run(step, batch)

    monkeypatch.setattr(train.GradientStep, "__call__", watched)
    monkeypatch.setattr(train, "PLAYING", 1)
    words = ("--steps", 4, "--carry", 1)
    train.train(settings(tmp_path, tmp_path / "run", *words))
    assert begun == [0, 1, 1, 1]
    with pytest.raises(SystemExit):
        settings(tmp_path, tmp_path / "run", *words, "--both-ways", 0.5)


@pytest.mark.soak
def test_a_machine_that_only_trains_needs_no_library_for_pictures() -> None:
    """Such machines have PyTorch, kornia, NumPy and ONNX, but nothing else that postfx itself
    needs."""
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    needed = {re.match("[A-Za-z0-9_-]+", word)[0] for word in project["dependencies"]} - {"numpy"}
    absent = (*sorted(needed), "colour", "mitsuba")
    assert {"platformdirs", "OpenImageIO", "onnxruntime"} <= set(absent)
    program = (f"import sys; sys.modules.update(dict.fromkeys({absent})); import "
               "training.denoise.train")
    # makes motion for --carry
    program += "; from postfx.temporal.reverse_motion import invert_motion as run"
    program += ("; import numpy as np; run(np.zeros((4, 4, 2), np.float32), *np.ones((2, 4, 4, 1), "
                "np.float32))")
    subprocess.run([sys.executable, "-c", program], check=True)


class Filling:
    """Stands for a pool whose folder holds so many clips at each look."""

    def __init__(self, *counts: int) -> None:
        self.counts, self.looks = counts, 0

    def refresh(self) -> int:
        self.looks += 1
        return self.counts[min(self.looks, len(self.counts)) - 1]


def test_a_folder_without_clips_is_named(tmp_path: Path,
                                         capsys: pytest.CaptureFixture[str]) -> None:
    full, empty = tmp_path / "full", tmp_path / "empty"
    for folder in (full, empty):
        folder.mkdir()
    write_clips(full, 1)
    pool = train.ClipPool({full: 1.0, empty: 4.0}, torch.device("cpu"))
    pool.refresh()
    train.tell_empty_folders(pool)
    said = capsys.readouterr().out
    assert f"no clip of {empty} is there yet" in said and str(full) not in said


def test_the_wait_fits_the_number_of_clips(monkeypatch, capsys):
    monkeypatch.setattr(train, "PAUSE", 0.01)
    monkeypatch.setattr(train, "PATIENCE", 0.05)
    train.wait_for_clips(few := Filling(0, 0, 3), None, "clips")
    assert few.looks > 5 and "no more clips come: training on 3" in capsys.readouterr().out
    train.wait_for_clips(growing := Filling(1, 4, 9, 20), None, "clips")
    assert growing.looks == 3 and "no more" not in capsys.readouterr().out
    train.wait_for_clips(asked := Filling(2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 5), 5, "clips")
    assert asked.looks == 11
