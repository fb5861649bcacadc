"""Written EXR frames come back through the reader with the same planes and headers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

import postfx
from postfx.frame import Role
from training.datagen.clip_file import (
    CHANNELS,
    GUIDES,
    exposure_of,
    frame_header,
    guide_planes,
    half_depth,
    main,
    save_clip,
    write_exr,
)


def planes(rng: np.random.Generator) -> dict[str, np.ndarray]:
    made = {name: rng.random((6, 10, len(c))).astype(np.float16).astype(np.float32)
            for name, c in CHANNELS.items()}
    made["depth"][0, 0] = 1e10
    return made


def test_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    to_world = np.eye(4)
    to_world[:3, 3] = 1, 2, 3
    written = [planes(rng), planes(rng)]
    for t, frame in enumerate(written):
        header = frame_header(to_world, 60.0, np.array([0.25, -0.5]), 4, 1.5, t == 0)
        write_exr(tmp_path / f"noisy.{t + 1:04d}.exr", frame, header)
    read = list(postfx.read_sequence(str(tmp_path / "noisy.%04d.exr")))
    assert [frame.reset for frame in read] == [True, False]
    for frame, expected in zip(read, written, strict=True):
        for name, values in expected.items():
            assert np.array_equal(frame.planes[Role(name)], values), name
        assert frame.jitter == pytest.approx((0.25, -0.5))
        assert (frame.samples, frame.exposure_factor, frame.fov_x) == (4, 1.5, 60.0)
    moved = np.array([1.0, 2, 3, 1]) @ np.asarray(read[0].world_to_camera)
    assert np.allclose(moved, [0, 0, 0, 1])


def test_guides_of_a_clip_are_written_at_output_size(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    half = {name: rng.random((2, 12, 20, len(CHANNELS[name]))).astype(np.float16)
            for name in GUIDES}
    depth = np.full((2, 12, 20), 1e10, np.float32)
    depth[:, 3:] = 4.0
    clip = {f"guide_{name}": values.squeeze(-1) if values.shape[-1] == 1 else values
            for name, values in half.items()}
    clip["guide_depth"] = half_depth(depth)
    write_exr(tmp_path / "guides.0001.exr", guide_planes(clip, 1),
              {"postfx:jitter": np.array([0.25, -0.5])})
    read = next(iter(postfx.read_sequence(str(tmp_path / "guides.%04d.exr"))))
    assert read.jitter == pytest.approx((0.25, -0.5))
    assert np.array_equal(read.planes[Role.DEPTH][..., 0], depth[1])
    for name in ("diffuse_albedo", "specular_albedo", "normal", "roughness"):
        assert np.array_equal(read.planes[Role(name)], half[name][1].astype(np.float32)), name


def test_exposure_brings_the_geometric_mean_to_the_key() -> None:
    assert exposure_of(np.full((2, 8, 8, 3), 0.36)) == pytest.approx(0.5, rel=1e-3)


def test_a_sheet_shows_one_row_a_clip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    frames = [planes(rng), planes(rng)]
    variant = {name: np.stack([frame[name] for frame in frames]) for name in CHANNELS}
    variant |= {"jitter": np.zeros((2, 2)), "spp": 1, "style": "box"}
    facts = {"scale": 1.0, "seed": 0, "scene": "test", "meta": {}}
    for number in range(3):
        save_clip(tmp_path / f"clip.{number:05d}.npz", variant["colour"], [variant], facts)
    monkeypatch.setattr("sys.argv", ["clip_file", "sheet", str(tmp_path), str(tmp_path / "a.png"),
                                     "--size", "16"])
    main()
    assert oiio.ImageBuf(str(tmp_path / "a.png")).spec().height == 3 * 16
