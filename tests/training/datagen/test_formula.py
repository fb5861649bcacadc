"""Clips by formula: read as any other clip; noise without bias; vectors that lead back; without
noise, the truth."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from training.datagen import formula  # noqa: E402
from training.datagen.clip_file import load_clip  # noqa: E402
from training.denoise.dataset import ClipPool, collate, to_batch  # noqa: E402
from training.denoise.loss import display, explained_by_motion, reproject_reference  # noqa: E402

CPU, SIDE = torch.device("cpu"), 32


def test_clips_are_read_by_the_pool(tmp_path: Path) -> None:
    formula.write_clips(tmp_path, 2, seed=1, device=CPU, frames=3, side=SIDE)
    clip = load_clip(tmp_path / "clip.00001.npz")
    assert clip["variants"] == formula.VARIANTS + 1 and clip["meta"] == {"kind": "formula"}
    pool = ClipPool({tmp_path: 1.0}, CPU, guides=True, held_out=10)
    pool.refresh()
    (clips,) = pool.training.values()
    batch = to_batch(collate(clips, [0] * len(clips)))
    assert all(torch.isfinite(plane).all() for one in batch.frames
               for plane in (one.colour, one.depth, one.normal))
    assert batch.frames[0].guides.depth.shape[-1] == batch.references.shape[-1]


def test_the_same_seed_makes_the_same_clips(tmp_path: Path) -> None:
    for name in ("a", "b"):
        formula.write_clips(tmp_path / name, 1, seed=5, device=CPU, frames=2, side=SIDE)
    one, other = (load_clip(tmp_path / name / "clip.00000.npz") for name in ("a", "b"))
    assert all(np.array_equal(one[key], other[key], equal_nan=True)
               for key in one if isinstance(one[key], np.ndarray))


def planes_of(scene: formula.Scene, drawn: formula.Sampling, t: int = 0) -> torch.Tensor:
    no = torch.zeros(len(scene.air), dtype=torch.bool)
    return formula.noisy_planes(scene, t, SIDE, drawn, torch.zeros(len(no), 2), no, no)


def test_noise_adds_no_light_and_its_absence_is_the_truth() -> None:
    torch.manual_seed(0)
    scene, count = formula.draw_scenes(8, SIDE, CPU), 8
    truth = formula.mean_of(formula.clean_light(
        scene, formula.look(scene, formula.grid(SIDE, SIDE, 1, 3, CPU), 0)
    ), SIDE, SIDE)
    drawn = formula.draw_sampling(count, CPU)
    quiet = dataclasses.replace(drawn, quiet=torch.ones_like(drawn.quiet))
    torch.testing.assert_close(planes_of(scene, quiet)[:, :3], truth, rtol=0.05, atol=1e-3)
    noisy = dataclasses.replace(drawn, quiet=~quiet.quiet,
                                samples=torch.full_like(drawn.samples, 16.0))
    light = torch.stack([planes_of(scene, noisy)[:, :3] for _ in range(12)]).mean((0, 3, 4))
    torch.testing.assert_close(light, truth.mean((2, 3)), rtol=0.12, atol=0.01)


def test_vectors_lead_to_where_things_were() -> None:
    torch.manual_seed(2)
    scene = formula.draw_scenes(6, SIDE, CPU)
    scene.speed = torch.randint(-3, 4, scene.speed.shape).float()  # whole pixels
    before, now = (formula.mean_of(formula.clean_light(scene, formula.look(
        scene, formula.grid(SIDE, SIDE, 1, 3, CPU), t)), SIDE, SIDE) for t in (0, 1))
    quiet = dataclasses.replace(formula.draw_sampling(6, CPU),
                                quiet=torch.ones(6, 1, 1, 1, dtype=torch.bool))
    motion = planes_of(scene, quiet, 1)[:, 14:]
    shown = [display(picture) for picture in (before, now)]
    same = explained_by_motion(shown[1], reproject_reference(shown[0], motion))
    still = explained_by_motion(shown[1], shown[0])
    assert same.mean() > 0.85 and same.mean() > still.mean() + 0.1
