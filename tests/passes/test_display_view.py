"""The pass `view` against OpenColorIO and against the formulas themselves."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from postfx.colour import ACESCG, REC709, matrix_between, ocio_library
from postfx.colour.displays import parse_display
from postfx.colour.ocio import file_transform, view_transform
from postfx.colour.views import find_view, is_view
from postfx.errors import ColourError
from postfx.frame import Frame, Role
from postfx.passes.display import View
from postfx.pipeline import Pipeline
from postfx.runtime import Device

colour = pytest.importorskip("colour")
OCIO = pytest.importorskip("PyOpenColorIO")

CONFIG = "studio-config-v4.0.0_aces-v2.0_ocio-v2.5"
ACES = {
    "srgb": ("sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)"),
    "p3": ("Display P3 - Display", "ACES 2.0 - SDR 100 nits (P3 D65)"),
    "rec709": ("Rec.1886 Rec.709 - Display", "ACES 2.0 - SDR 100 nits (Rec.709)"),
    "pq": ("Rec.2100-PQ - Display", "ACES 2.0 - HDR 1000 nits (P3 D65)"),
    "pq,peak=4000": ("Rec.2100-PQ - Display", "ACES 2.0 - HDR 4000 nits (P3 D65)"),
    "hlg": ("Rec.2100-HLG - Display", "ACES 2.0 - HDR 1000 nits (P3 D65)"),
}


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def scene(side: int = 128) -> np.ndarray:
    """Soft light over 14 stops, on patches from grey to nearly pure colours."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[0:side, 0:side] / side
    light = 0.18 * np.exp2(14 * x - 8)
    pure = random.dirichlet((0.7, 0.7, 0.7), (8, 8)) * 3
    patches = ((y[:8, :1] * 0 + np.linspace(0, 1, 8)[:, None])[..., None] * pure
               + np.linspace(1, 0, 8)[:, None, None])
    return (light[..., None] * patches.repeat(side // 8, 0).repeat(side // 8, 1)).astype(np.float32)


def through(view: str, display: str, device: Device, light: np.ndarray, ev: float = 0.0,
            exact: bool = False) -> Frame:
    return Pipeline([View(view=view, display=display, exact=exact)], device,
                    exposure=ev)(Frame({Role.COLOUR: light}))


def by_ocio(light: np.ndarray, display: str) -> np.ndarray:
    """By OpenColorIO's own package and CPU processor, from its linear Rec.709."""
    config = OCIO.Config.CreateFromBuiltinConfig(CONFIG)
    processor = config.getProcessor("Linear Rec.709 (sRGB)", *ACES[display],
                                    OCIO.TRANSFORM_DIR_FORWARD)
    out = np.ascontiguousarray(light.reshape(-1, 1, 3), np.float32)
    processor.getDefaultCPUProcessor().applyRGB(out)
    return out.reshape(light.shape).clip(0, 1)


def itp(codes: np.ndarray, display: str) -> np.ndarray:
    target = parse_display(display)
    space = {"p3": "Display P3", "pq": "ITU-R BT.2020",
             "hlg": "ITU-R BT.2020"}.get(target.name, "sRGB")
    nits = target.decode(codes.astype(np.float64)) * (target.white or 100)
    return colour.RGB_to_ICtCp(np.maximum(colour.RGB_to_RGB(nits, space, "ITU-R BT.2020"), 0))


def assert_near(found: np.ndarray, wanted: np.ndarray, display: str, psnr: float, mean: float,
                most: float) -> None:
    difference = colour.difference.delta_E_ITP(itp(found, display), itp(wanted, display))
    assert -10 * np.log10(np.square(found.astype(np.float64) - wanted).mean()) > psnr
    assert difference.mean() < mean
    assert np.percentile(difference, 99) < most


@pytest.mark.parametrize("display", ACES)
def test_aces_views_are_those_of_opencolorio(display: str, device: Device) -> None:
    found = through("ocio:", display, device, scene() / 8, ev=3.0)
    assert found.encoding == str(parse_display(display))
    assert_near(found[Role.COLOUR], by_ocio(scene(), display), display, psnr=58, mean=0.4, most=2.5)


@pytest.mark.parametrize("display", ACES)
@pytest.mark.parametrize("ev", [0.0, 4.0])
def test_an_exact_view_is_opencolorio_itself_in_saturated_light_too(display: str, ev: float,
                                                                    device: Device) -> None:
    found = through("ocio:", display, device, scene() / 8, ev=3.0 + ev, exact=True)
    assert found.encoding == str(parse_display(display))
    assert (np.abs(found[Role.COLOUR] - by_ocio(scene() * np.float32(2**ev), display))
            .max() < 0.5 / 255)


def test_the_cube_is_off_where_the_exact_view_is_not(device: Device) -> None:
    bright = np.random.default_rng(10).random((24, 32, 3)) @ matrix_between(ACESCG, REC709).T * 16
    light = bright.astype(np.float32)
    fast, exact = (through("ocio:", "srgb", device, light, exact=exact)[Role.COLOUR]
                   for exact in (False, True))
    assert 2 / 255 < np.abs(fast - exact).max() < 16 / 255


def test_exact_is_what_a_pass_does_by_itself(device: Device) -> None:
    by_default = Pipeline([View(view="ocio:")], device, exposure=0.0)(Frame({Role.COLOUR: scene()}))
    wanted = through("ocio:", "srgb", device, scene(), exact=True)
    np.testing.assert_array_equal(by_default[Role.COLOUR], wanted[Role.COLOUR])


def test_without_the_package_openimageio_gives_the_same_colours(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    light = scene() @ matrix_between(REC709, ACESCG).T
    by_package = view_transform("", parse_display("srgb")).apply(light)
    monkeypatch.setattr(ocio_library, "is_installed", lambda: False)
    ocio_library.load.cache_clear()
    try:
        by_openimageio = view_transform("", parse_display("srgb")).apply(light)
        with pytest.raises(ColourError, match="none.ocio: not a readable OpenColorIO config"):
            ocio_library.load("none.ocio")
    finally:
        ocio_library.load.cache_clear()
    assert np.abs(by_package - by_openimageio).max() < 1e-4


def test_the_packages_newer_configs_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    newest = OCIO.BuiltinConfigRegistry().getBuiltinConfigs()
    name = next(name for name, *_ in newest if name.startswith("studio-config-v5"))
    monkeypatch.setenv("OCIO", f"ocio://{name}")
    assert view_transform("", parse_display("srgb")).title.startswith("ACES 2")


def test_neutral_and_reinhard_are_their_formulas(device: Device) -> None:
    for name, display in (("neutral", "srgb"), ("reinhard", "srgb"), ("reinhard", "p3"),
                          ("reinhard", "pq,peak=4000")):
        view = find_view(name, parse_display(display))
        wanted = view.apply(np.maximum(scene() @ matrix_between(REC709, view.primaries).T, 0))
        for runs_on in (device, Device("cpu", compiled_kernels=False)):
            found = through(name, display, runs_on, scene(), exact=True)[Role.COLOUR]
            np.testing.assert_allclose(found, wanted, atol=3e-5 if view.display.hdr else 1e-5)


def test_colours_outside_rec709_reach_a_wide_display(device: Device) -> None:
    """Negative light in Rec.709 that is red in P3."""
    red = (np.array([[[0.2, 0.0, 0.0]]])
           @ colour.matrix_RGB_to_RGB("Display P3", "sRGB", "Bradford").T)
    assert red.min() < 0
    found = through("ocio:un-tone", "p3", device, red.astype(np.float32))[Role.COLOUR][0, 0]
    np.testing.assert_allclose(found, [0.4845, 0, 0], atol=0.02)


def test_grey_stays_grey_and_brighter_stays_brighter(device: Device) -> None:
    ramp = np.ascontiguousarray(np.broadcast_to(
        0.18 * np.exp2(np.linspace(-10, 9, 2000))[None, :, None], (4, 2000, 3)
    ))
    for name, display in (("neutral", "srgb"), ("reinhard", "pq"), ("ocio:", "srgb"),
                          ("ocio:", "pq")):
        found = through(name, display, device, ramp.astype(np.float32))[Role.COLOUR][0]
        assert np.ptp(found, axis=1).max() < 1e-3
        assert np.diff(found[:, 1]).min() > -1e-6


@pytest.mark.parametrize("exact", [True, False])
def test_bad_pixels_are_black_or_white(device: Device, exact: bool) -> None:
    """In blocks that are too large to be repaired."""
    light = np.full((6, 24, 3), 0.18, np.float32)
    light[:, 6:12], light[:, 12:18], light[:, 18:] = np.nan, np.inf, -5
    for name in ("neutral", "reinhard", "ocio:"):
        found = through(name, "srgb", device, light, exact=exact)[Role.COLOUR][3]
        assert found[9].max() < 1e-3 and found[15].min() > 0.98 and found[21].max() < 1e-3


def test_a_look_up_table_is_read_as_opencolorio_reads_it(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "film.cube"
    axis = np.linspace(0, 1, 33)
    blue, green, red = np.meshgrid(axis, axis, axis, indexing="ij")
    film = np.stack([red, green * 0.9 + 0.05, blue * 0.8 + 0.1],
                    -1).reshape(-1, 3) ** [1.2, 1.0, 0.9]
    path.write_text("LUT_3D_SIZE "
                    "33\n" + "\n".join(" ".join(f"{v:.6f}" for v in row) for row in film))
    found = through(f"{path},input=ACEScct", "srgb", device, scene())
    config = OCIO.Config.CreateFromBuiltinConfig(CONFIG)
    into = OCIO.ColorSpaceTransform("Linear Rec.709 (sRGB)", "ACEScct")
    both = OCIO.GroupTransform([into, OCIO.FileTransform(str(path))])
    wanted = np.ascontiguousarray(scene().reshape(-1, 1, 3))
    config.getProcessor(both).getDefaultCPUProcessor().applyRGB(wanted)
    assert_near(found[Role.COLOUR], wanted.reshape(scene().shape).clip(0, 1), "srgb", psnr=55,
                mean=0.5, most=3)


def test_a_look_up_table_must_say_what_it_takes(tmp_path: Path) -> None:
    path = tmp_path / "film.cube"
    with pytest.raises(ColourError, match="no such look-up table"):
        View(view=str(path))
    path.write_text("LUT_3D_SIZE 2\n" + "0 0 0\n1 1 1\n" * 4)
    for text, message in (
        (f"{path}", "does not say which colours it takes: give e.g. .*film.cube,input=ACEScct"),
        (f"{path},input=LogX", "has no colour space 'LogX'"),
        (f"{path},in=ACEScct", "'in' is neither input nor output"),
        (f"{path},input=ACEScct,output=crt", "unknown display 'crt'"),
    ):
        with pytest.raises(ColourError, match=message):
            View(view=text)
    path.write_text("LUT_3D_SIZE 2\nno numbers")
    with pytest.raises(ColourError, match="film.cube"):
        View(view=f"{path},input=ACEScct")


@pytest.mark.parametrize(("before", "line", "message"), [
    ("", "nan 1 1", "numbers 'nan 1 1'"),
    ("", "1 -Inf 1", "numbers '1 -Inf 1'"),
    ("DOMAIN_MAX nan 1 1\n", "1 1 1", "numbers 'DOMAIN_MAX nan 1 1'"),
    ("\ufeff", "1 1 1", "byte order mark"),
])
def test_a_look_up_table_holds_finite_numbers(tmp_path: Path, before: str, line: str,
                                              message: str) -> None:
    """OpenColorIO takes them: pictures came out darker, or brighter, without a word."""
    path = tmp_path / "film.cube"
    path.write_text(f"{before}LUT_3D_SIZE 2\n" + "0 0 0\n" * 7 + line, encoding="utf-8")
    with pytest.raises(ColourError, match=message):
        View(view=f"{path},input=ACEScct")
    path.write_text("TITLE \"nan inf\"\n# inf 1 1\nLUT_3D_SIZE 2\n" + "0 0 0\n1 1 1\n" * 4)
    View(view=f"{path},input=ACEScct")


@pytest.mark.parametrize(("text", "display", "message"), [
    ("ocio:kodak", "srgb", "no view 'kodak': use one of: ACES 2.0 - SDR"),
    ("ocio:hdr 1000", "pq", r"several views are 'hdr 1000': use one of: .*P3 D65.*Rec.2020"),
    ("ocio:", "pq,peak=1500", "no view '' for 1500 nits: use one of"),
    ("ocio:", "rec2020", "no display for 'rec2020': name one by ocio:VIEW@DISPLAY: sRGB - Display"),
    ("ocio:@CRT", "srgb", "no display for 'CRT'"),
])
def test_views_that_are_not_there(text: str, display: str, message: str) -> None:
    with pytest.raises(ColourError, match=message):
        View(view=text, display=display)


def test_views_are_found_by_part_of_their_name_and_by_display() -> None:
    assert find_view("ocio:rec.2020 4000", parse_display("pq")).display.peak == 4000
    view = find_view("ocio:SDR@Display P3 - Display", parse_display("rec2020"))
    assert view.title.startswith("ACES 2.0 - SDR 100 nits (P3 D65)") and str(view.display) == "p3"
    assert is_view("ocio:x") and is_view("a.cube,input=b") and not is_view("aces2")


def test_the_users_config_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = OCIO.Config.CreateFromBuiltinConfig(CONFIG)
    config.addDisplayView("sRGB - Display", "Mine", "sRGB - Display", "")
    config.setActiveViews("")
    (tmp_path / "config.ocio").write_text(config.serialize())
    monkeypatch.setenv("OCIO", str(tmp_path / "config.ocio"))
    assert find_view("ocio:mine", parse_display("srgb")).title == "Mine, sRGB - Display"
    monkeypatch.setenv("OCIO", str(tmp_path / "none.ocio"))
    with pytest.raises(ColourError, match="none.ocio: not a readable OpenColorIO config"):
        find_view("ocio:", parse_display("srgb"))


BROKEN_TABLES = {
    "a.cube": b"\xff\xfe\x80LUT_3D_SIZE 2\n", "b.cube": b"LUT_3D_SIZE \xff\xfe\n",
    "a.spi3d": b"SPILUT \xff 1.0\n3 3\n",
    "a.csp": b"CSPLUTV100\n3D\n\nBEGIN METADATA\n\xff\nEND METADATA\n\xfe\n",
    "b.csp": b"\xffCSPLUTV100\n3D\n", "a.3dl": b"\xff\xfe 1 2 3\n",
    "a.clf": b"<ProcessList id='\xff\xfe'/>", "all.cube": bytes(range(256)),
}


@pytest.mark.parametrize("name", BROKEN_TABLES)
def test_a_broken_table_whose_bytes_are_no_text_is_refused_in_one_line(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(BROKEN_TABLES[name])
    with pytest.raises(ColourError, match=re.escape(name)) as caught:
        file_transform(f"{path},input=ACEScct").apply(np.zeros((1, 3)))
    assert "\n" not in str(caught.value)


def test_a_built_in_config_of_a_newer_library_says_how_to_get_that(monkeypatch):
    monkeypatch.setenv("OCIO", "ocio://studio-config-v9")
    monkeypatch.setattr("postfx.colour.ocio_library.is_installed", lambda: False)
    with pytest.raises(ColourError, match=r"This is OpenColorIO 2.*; a newer one comes by pip"):
        view_transform("", parse_display("srgb"))


def test_a_broken_config_whose_bytes_are_no_text_is_refused_in_one_line(tmp_path, monkeypatch):
    (tmp_path / "config.ocio").write_bytes(b"ocio_profile_version: \xff\xfe\n")
    monkeypatch.setenv("OCIO", str(tmp_path / "config.ocio"))
    with pytest.raises(ColourError,
                       match=r"config\.ocio: not a readable OpenColorIO config") as caught:
        view_transform("", parse_display("srgb"))
    assert "\n" not in str(caught.value)
