"""The validation set: compact files, one clip rendered at toy size, expanded and measured; and what
is told of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from postfx.frame import Role
from postfx.io.sequence import read_sequence
from tests.training.llvm import require_llvm
from training.datagen.clip_file import HALF_MAX
from training.measure.validation import __main__, clips, compare
from training.measure.validation.clips import FULL, HALF, SCENES, STYLES, renders

SIZE = (66, 48)


@pytest.mark.parametrize(("bits", "error"), [(5, 2.0**-6), (7, 2.0**-8)])
def test_colours_keep_their_leading_bits(bits: int, error: float) -> None:
    light = np.exp(np.random.default_rng(0).normal(-1, 3, (2, 8, 9, 3))).astype(np.float32)
    light[0, 0, 0], light[0, 0, 1] = 0, 2 * HALF_MAX
    back = clips.unpack_colour(clips.pack_colour(light, bits), bits)
    light = np.minimum(light, HALF_MAX)
    # half float rounds first
    assert np.all(np.abs(back - light) <= (error + 2.0**-11) * light + 2e-6)
    assert np.isfinite(back).all() and not back[0, 0, 0].any()


def test_planes_keep_their_steps() -> None:
    rng = np.random.default_rng(1)
    shapes = {"normal": 3, "diffuse_albedo": 3, "roughness": 1, "motion": 2}
    for name, channels in shapes.items():
        low, high = (-100, 100) if name == "motion" else (-1, 1) if name == "normal" else (0, 1)
        values = rng.uniform(low, high, (2, 5, 7, channels))
        step = clips.PACKING[name]
        back = clips.unpack_plane(name, clips.pack_plane(name, values, step), step)
        assert back.shape == values.shape and np.abs(back - values).max() <= 0.51 * step, name
    depth = np.exp(rng.uniform(-5, 15, (2, 5, 7)))
    depth[0, 0, :3] = 1e10
    back = clips.unpack_plane("depth", clips.pack_plane("depth", depth, 1 / 512), 1 / 512)[..., 0]
    assert np.allclose(back, depth, rtol=1e-3) and (back[0, 0, :3] == 1e10).all()


def test_a_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    reference = np.random.default_rng(2).random((2, 4, 6, 3))
    planes = {"colour": reference[:, :2, :3], "depth": np.full((2, 2, 3), 1e10)}
    clips.save(tmp_path / "clip.00000.npz", reference, {"x2": planes}, {"seed": 9000})
    assert [path.name for path in tmp_path.iterdir()] == ["clip.00000.npz"]
    colour, back, facts = clips.load(tmp_path / "clip.00000.npz")
    assert np.allclose(colour, reference, rtol=6e-3) and facts == {"seed": 9000}
    assert (np.allclose(back["x2"]["colour"], planes["colour"], rtol=2e-2)
            and back["x2"]["depth"].max() == 1e10)


def test_clips_differ_and_spend_equal_light_paths() -> None:
    sets = [renders(index) for index in range(len(SCENES))]
    assert ({r.name for r in sets[0]} == {"x1", "x1.5", "x2", "x3"}
            and FULL.spp * HALF.scale**2 == HALF.spp)
    for style in range(len(STYLES)):
        assert {sets[k][1].spp for k in range(style, len(SCENES), len(STYLES))} == {1, 2, 4, 8}
    assert [render.size((432, 240)) for render in sets[0]] == [(432, 240), (288, 160), (216, 120),
                                                               (144, 80)]


def test_sizes_that_a_scale_does_not_divide_are_refused(capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit):
        __main__.main(["render", "--out=x", "--clips=1", "--width=640"])
    assert "'640' is not a multiple of 6, which 1.5x, 2x and 3x need" in capsys.readouterr().err


def row(scene: str, render: str, method: str, family: str, psnr: float,
        flicker: float | None = 10.0) -> dict:
    figures = {"psnr_late": psnr, "ssim_late": 0.5, "flip_late": 0.1, "flicker_late": flicker}
    return {"scene": scene, "render": render, "scale": 1.0, "method": method, "family": family,
            "wall_ms": 1.0,
            "psnr_frames": [psnr - 1, psnr], "reference_noise": [1e-5, 1e-5], **figures}


def test_gains_are_over_the_best_of_oidn(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    rows = [row("a", "x1", "m", "ours", 31), row("b", "x1", "m", "ours", 28, 5.0),
            row("a", "x2", "m", "ours", 29),
            row("a", "x1", "oidn-high", "oidn", 30), row("b", "x1", "oidn-high", "oidn", 26),
            row("a", "x1", "oidn-fast", "oidn", 20), row("b", "x1", "oidn-fast", "oidn", 27),
            row("a", "x1", "bicubic", "plain", 10, None),
            row("b", "x1", "bicubic", "plain", 10, None)]
    compare.report(tmp_path, rows)
    facts = json.loads((tmp_path / "comparison.json").read_text())
    found = {entry["method"]: entry for entry in facts["scales"]["x1"]}
    assert (found["m"]["gain"] == pytest.approx(29.5 - 28)
            and found["oidn-fast"]["gain"] == pytest.approx(23.5 - 28))
    assert (found["m"]["least_gain"] == pytest.approx(1)
            and found["m"]["flicker_ratio"] == pytest.approx(0.75))
    assert (found["m"]["worst_frame"] == pytest.approx(1)
            and found["oidn-fast"]["worst_frame"] == pytest.approx(-10))
    assert found["bicubic"]["flicker_late"] is None and facts["scales"]["x2"][0]["gain"] is None
    assert [entry["method"]
            for entry in facts["equal_rays"]][:2] == ["m (half, 4 spp)", "m (full, 1 spp)"]
    assert facts["equal_rays"][0]["gain"] == pytest.approx(29 - 28)
    assert "noise, 50.0 dB, is taken out" in capsys.readouterr().out
    assert len((tmp_path / "comparison.csv").read_text().splitlines()) == 1 + len(rows)


def test_the_reference_s_noise_is_taken_out_of_psnr() -> None:
    rng = np.random.default_rng(3)
    truth = rng.random((90, 100, 3))
    halves = truth + rng.normal(0, 0.02, (2, *truth.shape))
    noise = np.square(halves[0] - halves[1]).mean() / 4
    picture = truth + rng.normal(0, 0.02, truth.shape)
    found = [-10 * np.log10(np.square(picture - other).mean()) for other in (halves.mean(0), truth)]
    assert (found[0] < found[1] - 1
            and compare.without_noise(found[0], noise) == pytest.approx(found[1], abs=0.1))
    assert compare.without_noise(30.0, 1.0) == pytest.approx(40)


def test_a_folder_without_clips_is_told(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="holds no clip: run 'render"):
        __main__.main(["sheet", str(tmp_path), str(tmp_path / "sheet.png")])


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clips of two frames, by the command that renders on all GPUs of a machine."""
    require_llvm()
    folder = tmp_path_factory.mktemp("clips")
    sizes = [f"--width={SIZE[0]}", f"--height={SIZE[1]}", "--frames=2", "--reference-error=0.06",
             "--most-spp=256"]
    command = ["render", f"--out={folder}", "--clips=2", "--variant=llvm_ad_rgb",
               "--processes-per-gpu=1", *sizes]
    assert __main__.main(command) == 0
    return folder


@pytest.mark.slow
def test_a_clip_becomes_sequences(rendered: Path, tmp_path: Path) -> None:
    assert __main__.main(["expand", str(rendered), str(tmp_path)]) == 0
    for folder, kind, style in zip(sorted(tmp_path.iterdir(), key=lambda path: path.suffix), SCENES,
                                   STYLES, strict=False):
        assert folder.name.split(".")[0] == kind[0]
        frames = {name: read_sequence(folder / f"{name}.####.exr").read(1)
                  for name in ("x1", "x1.5", "x2", "x3")}
        second = read_sequence(folder / "x2.####.exr").read(2)
        reference = read_sequence(folder / "reference.####.exr").read(2)
        guides = read_sequence(folder / "guides.####.exr", planes=[Role.NORMAL, Role.DEPTH]).read(2)
        assert [frame.spec.width for frame in frames.values()] == [66, 44, 33, 22]
        paths = [frames[name].samples * frames[name].spec.width * frames[name].spec.height
                 for name in ("x1", "x2")]
        assert paths[0] == paths[1] == SIZE[0] * SIZE[1]
        assert reference[Role.COLOUR].shape == guides[Role.NORMAL].shape == (48, 66, 3)
        assert (frames["x1"].reset and not second.reset
                and frames["x1"].exposure == reference.exposure)
        assert any(second.jitter) == any(guides.jitter) == (style == "realtime")
        assert second[Role.COLOUR].mean() == pytest.approx(reference[Role.COLOUR].mean(), rel=0.5)


@pytest.mark.slow
def test_clips_are_drawn_and_compared(
    rendered: Path, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the pictures of each measurement, which tests of the bench look at."""
    for drawing in ("pareto", "draw_crops", "draw_worst"):
        monkeypatch.setattr(f"postfx.tools.bench.pictures.{drawing}", lambda *_: None)
    for module in ("flip_evaluator", "skimage", "matplotlib"):
        pytest.importorskip(module, reason="needs the extra 'bench'")
    __main__.main(["sheet", str(rendered), str(tmp_path / "sheet.png")])
    assert (tmp_path / "sheet.png").stat().st_size > 10000
    command = ["compare", str(rendered), "-o", str(tmp_path), "--methods=bicubic",
               "--renders=x1,x3", "--device=cpu"]
    __main__.main(command)
    facts = json.loads((tmp_path / "comparison.json").read_text())
    assert {(one["scene"].split(".")[1], one["render"]) for one in facts["rows"]} == {
        (seed, name) for seed in ("9000", "9001") for name in ("x1", "x3")}
    first = capsys.readouterr().out
    __main__.main([*command, "--keep"])
    assert capsys.readouterr().out == first and "3x, 2 clips" in first
