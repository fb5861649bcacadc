"""Noise that a pixel filter spreads over several pixels."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("pyoidn")

from postfx import Frame, Role  # noqa: E402
from postfx.io.writer import write_channels  # noqa: E402
from training.measure.pixel_filter import METHOD_COLUMNS, Case, main, spread  # noqa: E402

SIZE = 96, 128


def test_a_filter_keeps_light_and_makes_noise_of_neighbours_alike():
    random = np.random.default_rng(1)
    assert spread(np.full((8, 9, 3), 0.25, np.float32), 0.5) == pytest.approx(0.25, rel=1e-6)
    noise = random.standard_normal((256, 256, 1)).astype(np.float32)
    found = spread(noise, 0.5)[..., 0]
    assert abs((noise[:, 1:] * noise[:, :-1]).mean()) < 0.02
    alike = (found[:, 1:] * found[:, :-1]).mean() / found.var()
    assert alike == pytest.approx((2 * 0.1065 * 0.787) / (0.787**2 + 2 * 0.1065**2), abs=0.03)


def test_the_command_prints_a_row_for_each_shot(tmp_path: Path, capsys):
    """Undoing the filter first is better than to denoise what it spread, and nearly as good as
    frames that no filter spread."""
    kind = tmp_path / "wall"
    kind.mkdir()
    random = np.random.default_rng(2)
    for number in (1, 2):
        for name, samples in (("noisy.4", 4), ("reference", 100_000)):
            light = 0.3 * random.gamma(samples, 1 / samples, (*SIZE, 3))
            planes = {channel: light[..., axis] for axis, channel in enumerate("RGB")}
            write_channels(kind / f"{name}.{number:04d}.exr", planes, {"postfx:spp": samples})
    main([str(tmp_path), "--samples", "4"])
    head, row, mean = capsys.readouterr().out.splitlines()
    assert tuple(head.split()) == METHOD_COLUMNS
    assert row.split()[:3] == ["wall", "4", "0.5"] and row.split()[3:] == mean.split()[2:]
    found = dict(zip(METHOD_COLUMNS, map(float, row.split()[3:]), strict=True))
    assert found["xl_undone"] > found["xl"] + 3 and found["xl"] > found["input"]
    assert found["oidn_undone"] > found["oidn"] + 3
    assert found["before"] < found["xl_undone"] + 2


def test_mitsuba_s_own_box_has_a_row_for_each_number_of_samples(tmp_path: Path, capsys,
                                                                monkeypatch):
    noise = np.random.default_rng(4).gamma(1, 0.3, (*SIZE, 3)).astype(np.float32)
    box = Case("box 4", [Frame({Role.COLOUR: noise})], [], [np.full_like(noise, 0.3)])
    monkeypatch.setattr("training.measure.pixel_filter.mitsuba_cases", lambda: [box])
    monkeypatch.setattr("training.measure.pixel_filter.shots", lambda *given: [object()])
    monkeypatch.setattr("training.measure.pixel_filter.spread_case", lambda shot, stddev: box)
    main([str(tmp_path), "--mitsuba"])
    _, _, _, row = capsys.readouterr().out.splitlines()
    assert row.split()[:2] == ["box", "4"] and row.split()[-1] == "-"


def test_a_folder_without_kinds_is_told(tmp_path: Path, capsys):
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert "render_scenes.py makes them" in capsys.readouterr().err
