"""Cells of light and bands along silhouettes, as they are compared with Open Image Denoise."""

from pathlib import Path

import numpy as np
import pytest

from postfx.io.writer import write_channels
from training.measure.light_and_edges import (
    CELL_PX,
    POSTFX,
    Sums,
    cell_means,
    light_change,
    main,
    silhouettes,
)

SIZE = 2 * CELL_PX, 3 * CELL_PX


def test_cells_are_whole_squares():
    light = np.ones((CELL_PX + 5, 2 * CELL_PX + 7, 3))
    light[:CELL_PX, CELL_PX:2 * CELL_PX] = 3
    np.testing.assert_allclose(cell_means(light), [[1, 3]])


def test_light_that_moves_within_a_cell_is_kept_and_light_that_fades_is_lost():
    wanted = np.full((*SIZE, 3), 0.1)
    wanted[10:12, 10:12] = 50
    moved = np.roll(wanted, (3, 2), axis=(0, 1))
    assert light_change(moved, wanted).max() < 1e-9
    faded = np.minimum(wanted, 25)
    change = light_change(faded, wanted)
    assert (change > 1e-9).sum() == 1 and 0.3 < change.max() < 0.5


def test_dark_cells_do_not_count():
    wanted = np.full((*SIZE, 3), 0.1)
    wanted[:CELL_PX, :CELL_PX] = 0
    assert len(light_change(wanted + 0.01, wanted)) == 5


def test_silhouettes_are_bands_of_two_pixels_on_either_side_of_a_step_of_depth():
    depth = np.full((9, 12), 4.0)
    depth[:, 6:] = 5.0
    np.testing.assert_array_equal(silhouettes(depth)[4].nonzero()[0], [4, 5, 6, 7])
    slope = np.linspace(4, 5, 12) * np.ones((9, 1))
    assert not silhouettes(slope).any()


def test_errors_away_from_silhouettes_do_not_count_as_those_of_edges():
    edge = silhouettes(np.where(np.arange(12) < 6, 4.0, 5.0) * np.ones((9, 1)))
    wanted = np.full((9, 12, 3), 0.2)
    far, near = wanted.copy(), wanted.copy()
    far[:, 0], near[:, 6] = 0.4, 0.4
    sums = Sums({}, {})
    sums.add("far", far, wanted, edge)
    sums.add(POSTFX, near, wanted, edge)
    assert sums.edges["far"] == [0] and sums.edges[POSTFX][0] > 0


def test_the_command_prints_shots_and_means(tmp_path: Path, capsys):
    pytest.importorskip("pyoidn")
    random = np.random.default_rng(0)
    folder = tmp_path / "kinds" / "wall"
    folder.mkdir(parents=True)
    for name, samples in (("noisy.4", 4), ("reference", 1024)):
        light = 0.3 * random.gamma(samples, 1 / samples, (*SIZE, 3))
        planes = {channel: light[..., axis] for axis, channel in enumerate("RGB")}
        planes["Z"] = np.where(np.arange(SIZE[1]) < CELL_PX, 4.0, 5.0) * np.ones((SIZE[0], 1))
        write_channels(folder / f"{name}.0001.exr", planes, {"postfx:spp": samples})
    main([str(tmp_path / "kinds"), "--model", "s"])
    rows = capsys.readouterr().out.splitlines()[2:]
    assert [line.split()[0] for line in rows] == ["wall", "all", "all"]
    noisy, ours = (float(rows[0].split()[index]) for index in (2, 4))
    assert 0 < ours < 10 and 0 < noisy < 10 and "no silhouettes" not in rows[0]
