"""References of few samples become those of many, and a clip's other content stays."""

import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("pyoidn")

from training.datagen import clean_references, formula  # noqa: E402
from training.datagen.clip_file import load_clip, save_clip  # noqa: E402
from training.denoise.clips import load  # noqa: E402
from training.denoise.dataset import compared, has_quiet_target  # noqa: E402

FRAMES = 3
SIDE = 64
NOISE = 4.0  # shape of the gamma distribution that stands in for few samples


def error(picture: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared error after x / (1 + x)."""
    seen, wanted = (x.astype(np.float32) / (1 + x.astype(np.float32)) for x in (picture, truth))
    return float(np.square(seen - wanted).mean())


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, np.ndarray]:
    """A folder of one clip with a noisy reference in halves, and of one without halves; a folder
    for the cleaned clips; the first one's true reference."""
    raw, cleaned = tmp_path_factory.mktemp("raw"), tmp_path_factory.mktemp("cleaned")
    torch.manual_seed(3)
    drawn = formula.draw_clips(2, FRAMES, SIDE, 1.0, torch.device("cpu"))
    rng = np.random.default_rng(5)
    for number, (reference, variants, facts) in enumerate(drawn):
        halves = [reference * rng.gamma(NOISE, 1 / NOISE, reference.shape) for _ in range(2)]
        facts |= {"seed": number}
        if number == 0:
            truth = reference
            variants = [*variants, variants[0] | {"colour": halves[0], "half": True, "spp": 32}]
            facts |= {"half": halves[1]}
            reference = (halves[0] + halves[1]) / 2
        save_clip(raw / f"clip.{number:05d}.npz", reference, variants, facts)
    return raw, cleaned, truth


def test_both_halves_stay_as_rendered_where_noise_is_kept(folders: tuple[Path, Path, np.ndarray],
                                                           tmp_path: Path) -> None:
    raw, kept = tmp_path / "raw", tmp_path / "kept"
    shutil.copytree(folders[0], raw)
    before = load_clip(raw / "clip.00000.npz")
    assert clean_references.main([str(raw), str(kept), "--keep-noise"]) == 0
    after = load_clip(kept / "clip.00000.npz")
    assert all(np.array_equal(before[name], after[name]) for name in ("reference", "half"))
    clip = load(kept / "clip.00000.npz", torch.device("cpu"))
    assert clip.halved[compared(clip)[-1]]  # compared with the other half
    # not where a target needs both halves
    assert not any(clip.halved[v] for v in compared(clip, both_halves=True))
    assert not has_quiet_target(clip, clip.halved.index(True))


def test_references_lose_their_noise_and_files_move(folders: tuple[Path, Path, np.ndarray],
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    raw, folder, truth = folders
    before = {path.name: load_clip(path) for path in raw.glob("*.npz")}
    assert clean_references.main([str(raw), str(folder), "--threads", "1"]) == 0
    assert capsys.readouterr().out.strip().endswith("2 clips, 1 of them cleaned")
    assert not list(raw.iterdir())
    after = {path.name: load_clip(path) for path in folder.iterdir()}
    noisy, clean = before["clip.00000.npz"], after["clip.00000.npz"]
    assert error(clean["reference"], truth) < 0.5 * error(noisy["reference"], truth)
    assert "half" not in clean
    same = set(noisy) - {"reference", "half", "meta"}
    assert all(np.array_equal(noisy[name], clean[name]) for name in same)
    plain = before["clip.00001.npz"]
    moved = after["clip.00001.npz"]
    assert all(np.array_equal(plain[name], moved[name]) for name in plain if name != "meta")


def test_a_render_whose_reference_is_gone_is_not_trained_on(folders: tuple[Path, Path,
                                                                           np.ndarray]) -> None:
    """It holds half of the reference's own samples, and stays for its planes."""
    _, folder, _ = folders
    cleaned = load(folder / "clip.00000.npz", torch.device("cpu"))
    half = cleaned.halved.index(True)
    assert half not in compared(cleaned)
    assert len(compared(cleaned)) == len(cleaned.planes) - 1


@pytest.mark.parametrize(("name", "frame"), (("reference", 0), ("reference", 2), ("v0_colour", 1)))
def test_a_clip_with_a_black_picture_is_left_out(tmp_path: Path, name: str, frame: int,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    """A renderer that fails may save black pictures."""
    raw, folder = tmp_path / "raw", tmp_path / "cleaned"
    raw.mkdir()
    torch.manual_seed(4)
    (reference, variants, facts), = formula.draw_clips(1, FRAMES, SIDE, 1.0, torch.device("cpu"))
    clip = {"reference": reference, "v0_colour": variants[0]["colour"]}
    clip[name][frame] = 0
    save_clip(raw / "clip.00000.npz", reference, variants, facts | {"seed": 0})
    assert clean_references.main([str(raw), str(folder), "--threads", "1"]) == 0
    assert "left out: clip.00000.npz" in capsys.readouterr().out
    assert not list(raw.iterdir())
    assert not list(folder.iterdir())


def test_pictures_smaller_than_a_block_are_compared_too() -> None:
    light = np.random.default_rng(6).random((FRAMES, 20, 28, 3)).astype(np.float32) + 0.1
    assert clean_references.is_whole({"reference": light, "v0_colour": 0.9 * light})
    assert not clean_references.is_whole({"reference": light, "v0_colour": 0.1 * light})
