"""What is drawn from clips beside plain windows: false motion, motion of a world at rest, planes of
fewer samples."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.training.denoise.test_train import moving_clip, write_clips  # noqa: E402
from training import ops  # noqa: E402
from training.datagen.scenes.motion import Camera, look_at  # noqa: E402
from training.denoise import loss as losses  # noqa: E402
from training.denoise.augment import Augment, ellipse, falsify_motion, spread_noise  # noqa: E402
from training.denoise.clips import (  # noqa: E402
    CHANNELS,
    DEPTH,
    GUIDES,
    MOTION,
    SURFACE,
    inverse_motion,
    load,
    static_motion,
)
from training.denoise.dataset import (  # noqa: E402
    Batch,
    ClipPool,
    Stack,
    collate,
    play_on,
    sparser,
    to_batch,
    true_planes,
)
from training.denoise.picture import guide_codes  # noqa: E402

SIZE = 40, 30
"""Width and height."""


def entries(count: int) -> Stack:
    """Clips of one motion everywhere, (1, -2), and another one for a world at rest, (5, 7)."""
    clip = moving_clip(1)
    planes = torch.cat((clip.planes, clip.planes[:, :, :2]), 2).repeat(count, 1, 1, 1, 1)
    for channel, value in zip(range(MOTION, MOTION + 4), (1.0, -2.0, 5.0, 7.0), strict=True):
        planes[:, :, channel] = value
    repeated = {name: getattr(clip, name).repeat(count, *[1] * (getattr(clip, name).ndim - 1))
                for name in ("jitter", "spread", "keep", "reference", "half", "surfaces",
                             "exposure", "quiet")}
    return replace(clip, planes=planes, guides=None, motions=("static",), **repeated)


def test_false_motion_is_one_of_four_kinds_and_the_loss_keeps_the_true_one() -> None:
    torch.manual_seed(0)
    batch = falsify_motion(to_batch(entries(200)), 0.75)
    motion = batch.frames[1].motion
    assert torch.equal(batch.frames[0].motion, motion)  # the same mistake all along the clip
    assert all((true[:, 0] == 1).all() and (true[:, 1] == -2).all() for true in batch.true_motion)
    untouched = ((motion[:, 0] == 1) & (motion[:, 1] == -2)).flatten(1)
    static = ((motion[:, 0] == 5) & (motion[:, 1] == 7)).flatten(1).all(1)
    still = (motion == 0).flatten(1).all(1)
    region = ((motion == 0).all(1).flatten(1) | untouched).all(1) & ~still & ~untouched.all(1)
    shares = [float(kind.float().mean()) for kind in (static, still, region)]
    assert shares == pytest.approx([0.75 / 4] * 3, abs=0.07)
    # What is left has its motion or, as motion is one everywhere, the equal mean around an ellipse.
    assert torch.equal(static | still | region, ~untouched.all(1))
    truth = losses.Truth(batch)
    assert truth.motion is batch.true_motion


def test_an_ellipse_takes_the_mean_motion_around_it() -> None:
    clip = entries(64)
    # left half, right half
    clip.planes[:, :, MOTION] = torch.where(torch.arange(60) < 30, 0.0, 4.0)
    torch.manual_seed(1)
    moving = to_batch(replace(clip, planes=clip.planes[:, :, :CHANNELS], motions=()))
    motion = falsify_motion(moving, 1.0).frames[1].motion
    between = ((motion[:, 0] > 0.01) & (motion[:, 0] < 3.99)).flatten(1).any(1)
    assert between.any()
    for x in motion[between, 0]:
        assert len(set(x.flatten().tolist())) <= 3  # one value in all of the ellipse
    inside = ellipse(torch.tensor([[0.5, 0.25]]), torch.tensor([[0.1, 0.25]]), 40, 100)[0, 0]
    assert inside[10, 50] and inside[1, 50] and not inside[21, 50] and not inside[10, 61]


def test_spread_noise_keeps_light_and_joins_neighbours() -> None:
    torch.manual_seed(0)
    clip = entries(64)
    noise = torch.rand_like(clip.planes[:, :, :3])
    planes = torch.cat((noise, clip.planes[:, :, 3:]), 2)
    render_size = replace(clip, planes=planes, reference=noise, half=noise)
    spread = spread_noise(render_size, 0.5)
    found = spread.planes[:, :, :3]
    assert torch.equal(found, spread.reference)  # of the same filter
    assert torch.equal(found, spread.half)
    assert torch.equal(spread.planes[:, :, DEPTH], planes[:, :, DEPTH])
    changed = (found != noise).flatten(1).any(1)
    assert 0.3 < float(changed.float().mean()) < 0.7
    assert found.mean((1, 2, 3, 4)) == pytest.approx(noise.mean((1, 2, 3, 4)), abs=1e-3)
    beside = found[..., 1:] - found[..., 1:].mean()
    joint = (beside * (found[..., :-1] - found[..., :-1].mean())).mean((1, 2, 3, 4))
    joint /= beside.square().mean((1, 2, 3, 4))
    assert joint[~changed].abs().max() < 0.02
    # of both signs: some of a filter is left, or too much of it was undone
    assert joint[changed].max() > 0.08 and joint[changed].min() < -0.03


def test_spread_noise_leaves_other_sizes_of_reference() -> None:
    clip = entries(8)
    smaller = replace(clip, planes=clip.planes[..., ::2, ::2])
    assert spread_noise(smaller, 1.0) is smaller
    assert spread_noise(clip, 1.0) is not clip


def test_without_the_option_nothing_is_drawn() -> None:
    def drawn(**options: float) -> tuple[Batch, float]:
        random.seed(0)
        torch.manual_seed(0)
        return Augment(**options)(moving_clip(2)), float(torch.rand(()))

    (plain, after), (again, after_again) = drawn(), drawn(false_motion=0.0)
    assert after == after_again and plain.true_motion is None
    assert torch.equal(plain.frames[1].motion, again.frames[1].motion)


def camera_clip() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """A clip file's arrays: a wall seen by a camera that moves and turns, and the wall's motion (T,
    h, w, 2)."""
    w, h = SIZE
    cameras = [Camera(look_at(np.array([0.3 * t, 0.1 * t, -4.0]), np.array([0.2 * t, 0.0, 0.0]),
                              0.05 * t), 50 + 2 * t)
               for t in range(3)]
    depth, motion = np.zeros((3, h, w), np.float32), np.zeros((3, h, w, 2), np.float32)
    y, x = np.meshgrid(np.arange(h) + 0.5, np.arange(w) + 0.5, indexing="ij")
    for t, camera in enumerate(cameras):
        focal = w / (2 * np.tan(np.radians(camera.fov) / 2))
        rays = np.stack([(w / 2 - x) / focal, (h / 2 - y) / focal, np.ones((h, w))],
                        -1) @ camera.to_world[:3, :3].T
        depth[t] = (1.0 - camera.to_world[2, 3]) / rays[..., 2]  # the wall is at z = 1
        points = camera.to_world[:3, 3] + depth[t][..., None] * rays
        if t:
            motion[t] = cameras[t - 1].project(points.reshape(-1, 3), w,
                                               h).reshape(h, w, 2) - np.stack([x, y], -1)
    meta = {"to_world": [camera.to_world.tolist() for camera in cameras],
            "fov": [camera.fov for camera in cameras]}
    return {"v0_depth": depth, "v0_motion": motion, "meta": np.str_(json.dumps(meta)),
            "reset": np.array([1, 0, 0], np.uint8)}, motion.copy()


def test_a_world_at_rest_moves_as_the_camera_makes_it() -> None:
    data, wall = camera_clip()
    data["v0_motion"][:, 10:20, 10:20] += (6.0, -3.0)  # a thing on the wall that moves
    found = static_motion(data, "v0")
    np.testing.assert_allclose(found[1:], wall[1:], atol=1e-3)
    assert np.abs(wall[1:]).max() > 1
    np.testing.assert_array_equal(found[0], data["v0_motion"][0])
    cut = data | {"reset": np.array([1, 0, 1], np.uint8)}
    np.testing.assert_array_equal(static_motion(cut, "v0")[2], data["v0_motion"][2])
    without = data | {"meta": np.str_("{}")}
    np.testing.assert_array_equal(static_motion(without, "v0"), data["v0_motion"])


def test_planes_come_from_the_sparser_render_and_light_from_the_denser(tmp_path: Path) -> None:
    write_clips(tmp_path, 1)
    path = tmp_path / "clip0000.npz"
    with np.load(path) as file:
        whole = dict(file)
    denser = {name.replace("v0_", "v1_"): values
              for name, values in whole.items() if name.startswith("v0_")}
    denser |= {f"v1_{name}": denser[f"v1_{name}"] + np.float16(0.25)
               for name in ("colour", "normal", "roughness")}
    offline = {"v0_style": np.str_("box"), "v1_style": np.str_("box"), "v1_spp": np.int32(32)}
    np.savez(path, **{**whole, **denser, **offline})
    clip = load(path, torch.device("cpu"))
    assert clip.samples == [1, 32] and sparser(clip, 1) == 0 and sparser(clip, 0) == 0
    # samples at one place fit no other render
    assert sparser(replace(clip, spread=[False, True]), 1) == 1
    dense, mixed = collate([clip], [1]).planes, collate([clip], [1], None, [0]).planes
    sparse = collate([clip], [0]).planes
    assert all(torch.equal(mixed[:, :, part], sparse[:, :, part]) for part in SURFACE)
    light = [channel for channel in range(CHANNELS)
             if not any(part.start <= channel < part.stop for part in SURFACE)]
    assert torch.equal(mixed[:, :, light], dense[:, :, light])
    pool = ClipPool({tmp_path: 1.0}, torch.device("cpu"), held_out=10**6)
    pool.seen.clear()
    pool.training = {tuple(clip.reference.shape): [clip]}
    drawn = pool.draw(16, 16, 0, sparse=1.0)
    assert drawn.planes.shape == (16, 2, CHANNELS, 16, 16)


def test_clips_of_a_folder_are_drawn_as_often_as_its_weight_says(tmp_path: Path) -> None:
    for name, value in (("many", 0.25), ("few", 0.75)):
        (tmp_path / name).mkdir()
        write_clips(tmp_path / name, 2)
        for path in (tmp_path / name).glob("*.npz"):
            clip = dict(np.load(path))
            np.savez(path, **clip | {"reference": np.full_like(clip["reference"], value)})
    pool = ClipPool({tmp_path / "many": 3.0, tmp_path / "few": 1.0}, torch.device("cpu"),
                    held_out=10**6)
    pool.refresh()
    random.seed(1)
    drawn = pool.draw(4000, 16, 0).reference[:, 0, 0, 0, 0]
    assert float((drawn == 0.25).float().mean()) == pytest.approx(0.75, abs=0.03)


def test_clips_without_guides_are_left_out_where_guides_are_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_clips(tmp_path, 2)
    path = tmp_path / "clip0001.npz"
    clip = dict(np.load(path))
    size = clip["reference"].shape[:3]
    np.savez(path, **clip,
             **{f"guide_{name}": np.zeros((*size, count) if count > 1 else size, np.float16)
                for name, count in GUIDES})
    pool = ClipPool({tmp_path: 1.0}, torch.device("cpu"), guides=True, held_out=10**6)
    assert pool.refresh() == 1
    bare = tmp_path / "clip0000.npz"
    assert (capsys.readouterr().out == f"left out: {bare}: no planes at output size, which "
            "--guides needs\n")


def test_later_turns_play_the_same_windows_the_other_way(tmp_path: Path) -> None:
    write_clips(tmp_path, 2)
    path = tmp_path / "clip0000.npz"
    pool = ClipPool({tmp_path: 1.0}, torch.device("cpu"), held_out=10**6,
                    motions=("inverse", "static"))
    pool.refresh()
    turns = []
    for turn in range(3):
        random.seed(5)
        turns.append(pool.draw(2, 16, 0, turn=turn))
    first, back, again = turns
    assert (torch.equal(back.reference, first.reference.flip(1))
            and torch.equal(again.reference, first.reference))
    assert torch.equal(back.jitter, first.jitter.flip(1))
    torch.testing.assert_close(back.surfaces, first.surfaces.flip(1), rtol=0, atol=0,
                               equal_nan=True)
    assert torch.equal(back.planes[:, :, :MOTION], first.planes[:, :, :MOTION].flip(1))
    inverse = torch.from_numpy(inverse_motion(np.load(path), "v0")).abs()
    assert float(back.planes[:, 1, MOTION].abs().amax()) <= float(inverse.amax()) + 1e-3
    assert torch.equal(back.planes[:, :, MOTION:MOTION + 2],
                       first.planes[:, :, MOTION + 2:MOTION + 4].flip(1))
    # it rests at the turn
    assert (not back.planes[:, 0, MOTION:].any() and back.planes[:, 1, MOTION].any())
    assert (not again.planes[:, 0, MOTION:].any()
            and torch.equal(again.planes[:, 1], first.planes[:, 1]))
    assert back.keep.all() and again.keep.all()


def test_a_cut_is_kept_when_played_backwards() -> None:
    clip = entries(1)
    cut = replace(clip, planes=clip.planes[:, [0, 1, 1]], keep=torch.tensor([[0.0, 0.0, 1.0]]),
                  motions=("inverse",))
    assert play_on(cut, backwards=True).keep.tolist() == [[1.0, 1.0, 0.0]]
    assert play_on(cut, backwards=False).keep.tolist() == [[1.0, 0.0, 1.0]]


def test_true_albedos_are_those_of_an_exact_render_or_of_many_samples(tmp_path: Path) -> None:
    write_clips(tmp_path, 1)
    clip = load(tmp_path / "clip0000.npz", torch.device("cpu"))
    renders = replace(clip, samples=[4, 32, 1024], spread=[True, True, True], exact=[False] * 3)
    assert [true_planes(renders, v) for v in range(3)] == [2, 2, 2]
    assert true_planes(replace(renders, exact=[False, True, False]), 0) == 1
    # all samples lie at one place
    assert true_planes(replace(renders, spread=[False, True, True]), 0) == 0
    few = replace(renders, samples=[16, 64, 8])
    assert [true_planes(few, v) for v in range(3)] == [1, None, 1]
    assert true_planes(replace(few, samples=[32, 64, 8]), 0) is None


def test_true_reflectance_follows_the_planes_through_augmentation() -> None:
    torch.manual_seed(3)
    random.seed(3)
    for drop in (0.0, 100.0):
        batch = Augment(drop=drop)(moving_clip(2))
        seen = [ops.demodulation(frame.diffuse_albedo, frame.specular_albedo)
                for frame in batch.frames]
        known = drop == 0  # a clip that lost its albedo has nothing to trust
        found = torch.stack(batch.reflectance())
        assert torch.equal(found, torch.stack(seen)) if known else found.isnan().all()


def test_cleaned_planes_are_compared_with_true_ones_through_augmentation() -> None:
    """The clip's planes have no noise, so that they are their own truth."""
    torch.manual_seed(4)
    random.seed(4)
    for drop in (0.0, 1.0, 100.0):
        batch = Augment(drop=drop)(moving_clip(4))
        for frame, surface in zip(batch.frames, batch.surfaces, strict=True):
            own = guide_codes(frame.diffuse_albedo + frame.specular_albedo, frame.denoising_albedo,
                              frame.normal)
            assert losses.guides_loss(own, surface) == 0
            if drop == 0:
                assert losses.guides_loss(own + 0.1, surface) > 0


def test_the_loss_of_reflectance_asks_for_trust_in_right_planes_and_for_doubt_in_noise() -> None:
    frame = to_batch(moving_clip(2)).frames[0]
    own = ops.demodulation(frame.diffuse_albedo, frame.specular_albedo)
    flat = torch.full_like(own, float(own.mean()))
    full, none = (torch.full_like(frame.depth, value) for value in (1.0, -1.0))
    assert losses.reflectance_loss(frame, full, own) == 0 < losses.reflectance_loss(frame, none,
                                                                                    own)
    assert losses.reflectance_loss(frame, none, flat) < losses.reflectance_loss(frame, full, flat)
    assert losses.reflectance_loss(frame, none, torch.full_like(own, torch.nan)) == 0


def test_a_clip_is_read_again_where_python_s_parser_stumbles(tmp_path, monkeypatch, capsys):
    """As that of Python 3.11 does in threads; a clip that never can be read is named."""
    from training.denoise import dataset

    calls = []

    def stumble(path, *_):
        calls.append(path)
        if len(calls) < 3 or path.name == "clip.00002.npz":
            raise SystemError("AST constructor recursion depth mismatch")
        return "clip"

    monkeypatch.setattr(dataset, "load", stumble)
    pool = dataset.ClipPool({tmp_path: 1.0}, torch.device("cpu"))
    assert pool._load(tmp_path / "clip.00001.npz") == "clip"
    assert pool._load(tmp_path / "clip.00002.npz") is None
    assert "left out: " in capsys.readouterr().out
