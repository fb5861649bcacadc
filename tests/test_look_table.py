"""Looks as look-up tables, read back by OpenColorIO's own package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postfx.colour import ocio
from postfx.colour.displays import parse_display
from postfx.colour.views import find_view
from postfx.errors import WriteError
from postfx.frame import Frame, Role
from postfx.passes.display import View
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.tools.look_table import (
    MOST_REPLACED_SHARE,
    LookTable,
    delta_e_itp,
    expose_colour,
    measure_difference,
    to_itp,
)

colour = pytest.importorskip("colour")
OCIO = pytest.importorskip("PyOpenColorIO")

SIZE = 17


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def picture() -> Frame:
    random = np.random.default_rng(6)
    light = 0.18 * np.exp2(random.normal(0, 2, (9, 16, 1))) * random.uniform(0.3, 1, (9, 16, 3))
    return Frame({Role.COLOUR: light.repeat(10, 0).repeat(10, 1).astype(np.float32)})


def by_ocio(path: Path, codes: np.ndarray) -> np.ndarray:
    transform = OCIO.FileTransform(str(path), interpolation=OCIO.INTERP_TETRAHEDRAL)
    out = np.ascontiguousarray(codes.reshape(-1, 1, 3), np.float32)
    OCIO.Config.CreateRaw().getProcessor(transform).getDefaultCPUProcessor().applyRGB(out)
    return out.reshape(codes.shape)


def test_a_global_look_is_its_table(device: Device, picture: Frame, tmp_path: Path) -> None:
    table = LookTable([View(view="neutral")], [picture], device, SIZE)
    table.write(tmp_path / "a.cube", ["a note"])
    codes = np.random.default_rng(0).integers(4, SIZE, (50, 3)) / (SIZE - 1)
    light = ocio.convert(codes, "ACEScct", "Linear Rec.709 (sRGB)")
    wanted = find_view("neutral", parse_display("srgb")).apply(np.maximum(light, 0))
    found = by_ocio(tmp_path / "a.cube", codes)
    bright = light.max(1) < 200  # where the view's own cube ends
    np.testing.assert_allclose(found[bright], wanted[bright], atol=0.02)
    assert np.abs(found - wanted)[bright].mean() < 2e-3


def test_tables_are_read_back_as_they_were_made(device: Device, picture: Frame,
                                                tmp_path: Path) -> None:
    table = LookTable([View(view="reinhard", display="pq")], [picture], device, SIZE)
    table.write(tmp_path / "new" / "a.cube", [])
    codes = np.stack(np.meshgrid(*[np.linspace(0, 1, SIZE)] * 3, indexing="ij"), -1)
    np.testing.assert_allclose(by_ocio(tmp_path / "new" / "a.cube", codes), table.cube, atol=1e-6)
    view = View(view=str(tmp_path / "new" / "a.cube"))
    assert view.output == "pq,peak=1000,white=203"


def test_a_networks_table_comes_near_it_and_says_how_near(device: Device, picture: Frame,
                                                          tmp_path: Path) -> None:
    table = LookTable([ToneMap()], [picture], device, SIZE)
    table.write(tmp_path / "a.cube", [])
    found = table.measure(tmp_path / "a.cube", [picture])
    wanted = Pipeline([ToneMap()], device, exposure=0.0)(picture)[Role.COLOUR]
    made = Pipeline([View(view=str(tmp_path / "a.cube"))], device,
                    exposure=0.0)(picture)[Role.COLOUR]
    assert found == measure_difference([made], [wanted], parse_display("srgb"))
    assert found.psnr > 25


def test_colours_among_the_pixels_hardly_change_what_the_network_does(device: Device,
                                                                      picture: Frame) -> None:
    large = picture[Role.COLOUR].repeat(8, 0).repeat(8, 1)
    strange = ocio.convert(np.random.default_rng(1).random((500, 3)), "ACEScct",
                           "Linear Rec.709 (sRGB)")
    places = (np.random.default_rng(0)
              .permutation(large[..., 0].size)[: int(MOST_REPLACED_SHARE * large[..., 0].size)])
    mixed = large.reshape(-1, 3).copy()
    mixed[places] = np.resize(strange, (len(places), 3))
    alone, beside = (Pipeline([ToneMap()], device,
                              exposure=0.0)(Frame({Role.COLOUR: colour}))[Role.COLOUR]
                     for colour in (large, mixed.reshape(large.shape)))
    assert np.delete(np.abs(beside - alone).reshape(-1, 3), places, 0).mean() < 0.01


def test_only_exposed_colour_is_used(picture: Frame) -> None:
    found = expose_colour(Frame({**picture.planes, Role.ALPHA: np.ones((90, 160, 1), np.float32)},
                                number=3), 2.0)
    assert list(found.planes) == [Role.COLOUR] and found.number == 3
    np.testing.assert_array_equal(found[Role.COLOUR], 2 * picture[Role.COLOUR])


def test_a_folder_that_cannot_be_made(device: Device, picture: Frame, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="a.cube: cannot be written"):
        LookTable([View()], [picture], device, 2).write(tmp_path / "file" / "a.cube", [])


@pytest.mark.parametrize("display", ["srgb", "p3", "pq"])
def test_delta_e_itp_is_that_of_colour_science(display: str) -> None:
    a, b = np.random.default_rng(0).random((2, 200, 3))
    target = parse_display(display)
    space = {"srgb": "sRGB", "p3": "Display P3", "pq": "ITU-R BT.2020"}[display]
    nits = [colour.RGB_to_RGB(target.decode(x) * (target.white or 100), space, "ITU-R BT.2020")
            for x in (a, b)]
    wanted = colour.difference.delta_E_ITP(*(colour.RGB_to_ICtCp(x) for x in nits))
    np.testing.assert_allclose(delta_e_itp(a, b, target), wanted, rtol=5e-3)
    np.testing.assert_allclose(to_itp(a, target)[:, 0], colour.RGB_to_ICtCp(nits[0])[:, 0],
                               atol=1e-4)
