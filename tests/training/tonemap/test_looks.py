"""Looks that the tone mapper learns, and the colour pipelines behind them."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("PyOpenColorIO")

from postfx.colour.displays import srgb_encode  # noqa: E402
from postfx.colour.views import neutral  # noqa: E402
from training.tonemap.looks import (  # noqa: E402  # noqa: E402
    ACES2,
    LOOKS,
    NEUTRAL,
    Lut,
    Ocio,
    bake,
    describe,
    exact_target,
    exact_view,
    find_look,
    key,
    log_luminance,
    look_from,
    target,
)
from training.tonemap.pictures import Pictures, collect, lesson, load, save  # noqa: E402


def colours(count: int = 1000) -> np.ndarray:
    random = np.random.default_rng(5)
    stops = random.uniform(-7, 6, (1, count, 1)) + random.normal(0, 0.7, (1, count, 3))
    return np.exp2(stops).astype(np.float32)


def test_aces_view_is_the_configs_own() -> None:
    """ACES 2.0 SDR puts scene mid grey 0.18 at 10 cd/m2 of 100, which is 0.349 of the sRGB
    signal."""
    grey = exact_view(ACES2, np.full((1, 1, 3), 0.18, np.float32))
    np.testing.assert_allclose(grey, 0.3492, atol=1e-3)


def test_neutral_view_is_the_specifications() -> None:
    """Blender's table of it is read between corners."""
    if "BLENDER_OCIO" not in __import__("os").environ:
        pytest.skip("needs BLENDER_OCIO: Blender's OpenColorIO config")
    rgb = colours()
    error = np.abs(exact_view(NEUTRAL, rgb) - srgb_encode(neutral(rgb.astype(np.float64))))
    assert error.mean() < 1 / 255


def test_baked_cube_stands_for_the_view() -> None:
    rgb = colours()
    look, cube = LOOKS["aces2"], torch.from_numpy(bake(ACES2))
    found = target(torch.from_numpy(rgb).permute(2, 0, 1)[None], look,
                   cube)[0].permute(1, 2, 0).numpy()
    error = np.abs(found - exact_target(rgb, look))
    assert error.mean() < 0.5 / 255
    assert np.quantile(error, 0.99) < 2 / 255


def test_key_keeps_dark_scenes_dark_and_bright_ones_bright_whatever_their_scale() -> None:
    random = torch.Generator().manual_seed(1)
    noise = torch.randn(1, 1, 64, 64, generator=random).expand(1, 3, 64, 64)
    lamp = torch.zeros_like(noise)
    lamp[..., :12, :12] = 8.0  # stops
    night, day, snow = noise * 0.5 + lamp, noise, noise * 0.5 - lamp
    mean = [float(log_luminance(key(torch.exp2(x))).mean()) for x in (night, day, snow)]
    assert mean[0] < mean[1] - 0.5 and mean[2] > mean[1] + 0.5
    assert abs(mean[1] - np.log2(0.18)) < 0.3
    torch.testing.assert_close(key(torch.exp2(night) * 16), key(torch.exp2(night)), rtol=1e-3,
                               atol=1e-6)


def test_looks_come_by_name_or_from_a_file(tmp_path) -> None:
    assert find_look("aces2") is LOOKS["aces2"]
    path = tmp_path / "mine.toml"
    view = "".join(f'{name} = "{value}"\n' for name, value in vars(ACES2).items())
    path.write_text(f"gain = 1.0\n[local]\nsigma = 1.0\nbeta = 0.8\n[view]\n{view}")
    look = find_look(str(path))
    assert (look.gain, look.local.beta, look.local.alpha, look.view) == (1.0, 0.8, 1.0, ACES2)
    path.write_text("gain = 1.0\n")
    with pytest.raises(SystemExit, match=r"mine\.toml: 'view': give a table \[view\]"):
        find_look(str(path))
    with pytest.raises(SystemExit, match="no look 'sepia'"):
        find_look("sepia")


def test_cards_hold_all_of_a_look() -> None:
    for look in LOOKS.values():
        assert look_from(describe(look)) == look


def test_a_table_is_a_view(tmp_path) -> None:
    """Of a table that swaps red and blue, in ACEScct."""
    axis = np.linspace(0, 1, 5)
    rows = "".join(f"{b:.6f} {g:.6f} {r:.6f}\n" for b in axis for g in axis for r in axis)
    path = tmp_path / "swap.cube"
    path.write_text(f"LUT_3D_SIZE 5\n{rows}")
    found = exact_view(Lut(f"{path},input=ACEScct"),
                       np.float32([[0.18, 0.18, 0.18], [0.4, 0.2, 0.1]]))
    np.testing.assert_allclose(found[0], 0.4135, atol=2e-3)
    assert found[1, 0] < found[1, 1] < found[1, 2]


def test_unknown_displays_are_named() -> None:
    with pytest.raises(SystemExit, match="sepia"):
        exact_view(Ocio(ACES2.config, "sepia", "sepia"), np.ones((1, 3), np.float32))


def test_a_set_gives_back_its_pictures_and_lessons(tmp_path, write_exr) -> None:
    random = np.random.default_rng(0)
    for name in ("one", "two", "held"):
        planes = (np.exp2(random.normal(0, 2, (3, 12, 16))).repeat(4, 1).repeat(4, 2)
                  .astype(np.float32))
        write_exr(f"{name}.exr", dict(zip("RGB", planes, strict=True)))
    pictures = collect([str(tmp_path / "*.exr")], hold_out=["held"])
    assert set(pictures.train) == {"one", "two"} and set(pictures.held) == {"held"}
    made = lesson(LOOKS["local"], pictures)
    save(str(tmp_path / "set.npz"), pictures, {"local": made})
    again, task = load(str(tmp_path / "set.npz"), "local")
    assert isinstance(again, Pictures) and task.look == LOOKS["local"]
    np.testing.assert_array_equal(again.train["one"], pictures.train["one"])
    torch.testing.assert_close(task.cube, made.cube)
    np.testing.assert_allclose(task.wanted["held"], made.wanted["held"], atol=1e-5)
    with pytest.raises(SystemExit, match="no look 'sepia': it has local"):
        load(str(tmp_path / "set.npz"), "sepia")
