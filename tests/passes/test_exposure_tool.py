"""The checkerboard: where it is drawn, how bright it is, and how the environment asks for it."""

from __future__ import annotations

import numpy as np
import pytest

from postfx import BothWays, DenoiseUpscale, Frame, FrameSpec, Pipeline, Role, ToneMap
from postfx.errors import ExposureError
from postfx.passes.exposure_tool import CELLS, TOOL_VARIABLE, ExposureTool, board_area, cells
from postfx.runtime import Device

SIZE = (54, 96)


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def frame(**values: object) -> Frame:
    return Frame({Role.COLOUR: np.random.default_rng(3).random((*SIZE, 3), np.float32)}, **values)


def names(passes: list) -> list[str]:
    return [item.name for item in Pipeline(passes, Device("cpu")).passes]


@pytest.mark.parametrize("ev", (-5.0, 0.0, 3.5))
def test_exposed_it_is_two_greys_around_mid_grey(ev: float, device: Device) -> None:
    shown = 2.0**ev * Pipeline([ExposureTool()], device, ev)(frame())[Role.COLOUR]
    dark, light = np.unique(shown.round(6))
    assert np.sqrt(dark * light) == pytest.approx(0.18, rel=1e-4)
    assert light / dark == pytest.approx(np.sqrt(2), rel=1e-4)
    assert (shown[..., 0] > 0.18).mean() == pytest.approx(0.5, abs=0.02)


def test_cells_are_square_and_alternate(device: Device) -> None:
    shown = Pipeline([ExposureTool()], device, 0.0)(frame())[Role.COLOUR][..., 0] > 0.18
    side = SIZE[0] // CELLS
    assert (shown[0, :side].sum() == 0 and shown[0, side : 2 * side].all()
            and shown[side : 2 * side, 0].all())
    rows, columns = cells(*SIZE)
    assert np.array_equal(shown, rows[:, None] != columns[None, :])


def test_the_picture_below_does_not_shine_through(device: Device) -> None:
    other = Frame({Role.COLOUR: np.full((*SIZE, 3), np.nan, np.float32)})
    one, two = (Pipeline([ExposureTool()], device, 1.0)(item)[Role.COLOUR]
                for item in (frame(), other))
    assert np.array_equal(one, two)


def test_it_covers_what_is_transparent(device: Device) -> None:
    planes = {**frame().planes, Role.ALPHA: np.zeros((*SIZE, 1), np.float32)}
    assert (Pipeline([ExposureTool()], device, 0.0)(Frame(planes))[Role.ALPHA] == 1).all()


@pytest.mark.parametrize("part", [False, True])
def test_an_overlay_is_removed(part: bool, device: Device) -> None:
    covered = frame()
    covered.planes[Role.OVERLAY] = np.ones((*SIZE, 4), np.float32)
    pipeline = Pipeline([ExposureTool(part=part)], device, 0.0)
    assert set(pipeline(covered).planes) == set(pipeline.explain().output.roles) == {Role.COLOUR}


def test_it_is_divided_by_a_reference_where_one_is_given(device: Device) -> None:
    pipeline = Pipeline([ExposureTool(reference={7: 4.0})], device, 0.0)
    assert pipeline(frame(number=7))[Role.COLOUR].mean() == pytest.approx(0.18 / 4, rel=0.03)


def test_a_display_picture_is_left_alone() -> None:
    tool = ExposureTool()
    assert tool.skip(FrameSpec(8, 8, (Role.COLOUR,))) is None
    assert "exposed already" in (tool.skip(FrameSpec(8, 8, (Role.COLOUR,), "srgb")) or "")


@pytest.mark.parametrize("value", ("0", "", None, "false", "OFF", "no"))
def test_nothing_is_drawn_unless_the_environment_asks(value: str | None,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(TOOL_VARIABLE, raising=False)
    if value is not None:
        monkeypatch.setenv(TOOL_VARIABLE, value)
    assert names([DenoiseUpscale(), ToneMap()]) == ["denoise_upscale", "tonemap"]


def test_the_environment_draws_it_where_the_upscaler_writes(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOOL_VARIABLE, "1")
    assert names([DenoiseUpscale(), BothWays(), ToneMap()]) == ["denoise_upscale", "exposure_tool",
                                                                "tonemap"]
    assert names([ToneMap()]) == ["exposure_tool", "tonemap"]
    assert names([DenoiseUpscale()]) == ["denoise_upscale", "exposure_tool"]
    assert names([ExposureTool(), ToneMap()]) == ["exposure_tool", "tonemap"]


def test_the_plan_tells_that_a_checkerboard_covers_the_picture(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOOL_VARIABLE, "1")
    plan = Pipeline([ToneMap()], Device("cpu")).explain(frame().spec)
    assert any(TOOL_VARIABLE in remark for remark in plan.remarks)


def test_under_a_whole_board_nothing_is_denoised(monkeypatch: pytest.MonkeyPatch,
                                                 device: Device) -> None:
    monkeypatch.setenv(TOOL_VARIABLE, "yes")
    covered = Pipeline([DenoiseUpscale(scale=1.5, model="l", budget=9)], device, 1.0)
    shown = covered(frame())[Role.COLOUR]
    assert shown.shape == (81, 144, 3) and len(np.unique(shown)) == 2
    assert covered.passes[0].options["strength"] == 0 and not device.models


def test_a_part_leaves_the_rest_of_the_picture(monkeypatch: pytest.MonkeyPatch,
                                               device: Device) -> None:
    monkeypatch.setenv(TOOL_VARIABLE, "part")
    given = frame()
    given.planes[Role.ALPHA] = np.zeros((*SIZE, 1), np.float32)
    made = Pipeline([BothWays()], device, 2.0)
    assert [item.name for item in made.passes] == ["both_ways", "exposure_tool"]
    shown = made(given)
    area = board_area(*SIZE, True)
    assert shown[Role.COLOUR][area].shape == (18, 32, 3)
    np.testing.assert_allclose(np.unique(shown[Role.COLOUR][area]),
                               0.18 * 2.0 ** np.array([-2.25, -1.75]), rtol=1e-5)
    assert (shown[Role.ALPHA][area] == 1).all() and shown[Role.ALPHA].mean() == pytest.approx(1 / 9)
    rest = np.ones(SIZE, bool)
    rest[area] = False
    assert np.array_equal(shown[Role.COLOUR][rest], given[Role.COLOUR][rest])
    assert any("a checkerboard covers a part of the picture" in text
               for text in made.explain().remarks)


def test_an_unknown_form_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOOL_VARIABLE, "corner")
    with pytest.raises(ExposureError, match="use 1, part"):
        names([ToneMap()])
