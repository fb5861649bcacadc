"""Tone mappers of other programs: each is right by its own chart, and each mistake in its boards is
measured.

The curves are written here as their authors published them, whether postfx knows a like one or not.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import Frame, Pipeline, Role
from postfx.passes.display import View
from postfx.passes.exposure_tool import ExposureTool
from postfx.runtime import Device
from postfx.tools.exposure.debugger import debug, debug_graded
from postfx.tools.exposure.response import GradedBoards, read_response, write_chart
from tests.exposure.scenes import scene

NEEDED = 2.0
STOPS = {"right": (0.0,) * 4, "too bright": (1.0,) * 4, "too dark": (-1.0,) * 4,
         "drifting": (0.0, 0.2, 0.4, 0.6)}
Curve = Callable[[np.ndarray], np.ndarray]


def srgb(light: np.ndarray) -> np.ndarray:
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def hill(light: np.ndarray) -> np.ndarray:
    """S. Hill's fit of ACES, as in his BakingLab."""
    into = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566],
                     [0.02840, 0.13383, 0.83777]])
    out = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605],
                    [-0.00327, -0.07276, 1.07602]])
    v = light @ into.T
    return (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081) @ out.T


def narkowicz(x: np.ndarray) -> np.ndarray:
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)


def hable(x: np.ndarray, bias: float) -> np.ndarray:
    def part(x: np.ndarray | float) -> np.ndarray | float:
        return ((x * (0.15 * x + 0.10 * 0.50) + 0.20 * 0.02) / (x * (0.15 * x + 0.50) + 0.20 * 0.30)
                - 0.02 / 0.30)

    return part(bias * x) / part(11.2)


def uchimura(x: np.ndarray) -> np.ndarray:
    """H. Uchimura, "HDR theory and practice", 2017, with its defaults."""
    most, contrast, start, length, black = 1.0, 1.0, 0.22, 0.4, 1.33
    line = (most - start) * length / contrast
    end = start + contrast * line
    slope = contrast * most / (most - end)
    toe = start * (np.maximum(x, 0) / start) ** black
    shoulder = most - (most - end) * np.exp(-slope * (x - start - line) / most)
    t = np.clip(x / start, 0, 1)
    is_toe, is_shoulder = 1 - t * t * (3 - 2 * t), x >= start + line
    middle = start + contrast * (x - start)
    return toe * is_toe + np.where(is_shoulder, shoulder, middle) * (1 - is_toe)


def lottes(x: np.ndarray) -> np.ndarray:
    """T. Lottes, "Advanced Techniques and Optimization of HDR Color Pipelines", 2016."""
    a, d, most, grey_in, grey_out = 1.6, 0.977, 8.0, 0.18, 0.267
    below = (most ** (a * d) - grey_in ** (a * d)) * grey_out
    b = (-(grey_in**a) + most**a * grey_out) / below
    c = (most ** (a * d) * grey_in**a - most**a * grey_in ** (a * d) * grey_out) / below
    x = np.maximum(x, 0)
    return x**a / (x ** (a * d) * b + c)


def hejl(x: np.ndarray) -> np.ndarray:
    """J. Hejl and R. Burgess-Dawson, 2010; its encoding is inside."""
    x = np.maximum(x - 0.004, 0)
    return x * (6.2 * x + 0.5) / (x * (6.2 * x + 1.7) + 0.06)


def unreal_3(x: np.ndarray) -> np.ndarray:
    """The curve of Unreal 3; its encoding is inside."""
    return x / (x + 0.155) * 1.019


def agx(light: np.ndarray) -> np.ndarray:
    """T. Sobotka's AgX by B. Wrensch's polynomial; its encoding is inside."""
    into = np.array([[0.842479062253094, 0.0784335999999992, 0.0792237451477643],
                     [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
                     [0.0423756549057051, 0.0784336, 0.879142973793104]])
    out = np.array([[1.19687900512017, -0.0980208811401368, -0.0990297440797205],
                    [-0.0528968517574562, 1.15190312990417, -0.0989611768448433],
                    [-0.0529716355144438, -0.0980434501171241, 1.15107367264116]])
    stops = np.log2(np.maximum(light @ into.T, 1e-10))
    x = (np.clip(stops, -12.47393, 4.026069) + 12.47393) / (12.47393 + 4.026069)
    return np.polyval([15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232], x) @ out.T


CURVES: dict[str, Curve] = {
    "Hill": lambda x: srgb(hill(x)),
    "Hill by three.js": lambda x: srgb(hill(x / 0.6)),
    "Narkowicz": lambda x: srgb(narkowicz(x)),
    "Narkowicz x 0.6": lambda x: srgb(narkowicz(0.6 * x)),
    "Hable with bias": lambda x: srgb(hable(x, 2)),
    "Hable": lambda x: srgb(hable(x, 1)),
    "extended Reinhard": lambda x: srgb(x * (1 + x / 16) / (1 + x)),
    "Uchimura": lambda x: srgb(uchimura(x)),
    "Lottes": lambda x: srgb(lottes(x)),
    "Hejl": hejl,
    "Unreal 3": unreal_3,
    "AgX": agx,
    "gamma": lambda x: np.clip(x, 0, 1) ** (1 / 2.2),
    "sRGB": srgb,
    "Reinhard": lambda x: srgb(x / (1 + x)),
}


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def board(device: Device) -> np.ndarray:
    """A checkerboard at mid grey, exposed."""
    blank = Frame({Role.COLOUR: np.zeros((108, 192, 3), np.float32)}, number=1)
    return Pipeline([ExposureTool()], device, NEEDED)(blank)[Role.COLOUR] * 2**NEEDED


def show(curve: Curve, light: np.ndarray, path: Path) -> Path:
    codes = np.clip(curve(light.astype(np.float64)), 0, 1).astype(np.float32)
    path.parent.mkdir(exist_ok=True)
    assert oiio.ImageBuf(np.ascontiguousarray(codes)).write(str(path), oiio.UINT8)
    return path


@pytest.mark.parametrize("name", CURVES)
def test_a_measured_chart_is_the_truth(name: str, board: np.ndarray, tmp_path: Path) -> None:
    curve = CURVES[name]
    light = oiio.ImageBuf(str(write_chart(tmp_path / "chart.exr"))).get_pixels(oiio.FLOAT)[..., :3]
    judged = read_response(show(curve, light, tmp_path / "chart.png"))
    for number, (verdict, stops) in enumerate(STOPS.items()):
        for frame, error in enumerate(stops, 1):
            show(curve, board * 2**error, tmp_path / f"boards{number}/a.{frame:04d}.png")
        boards = GradedBoards(str(tmp_path / f"boards{number}/a.####.png"))
        report = debug_graded(scene([NEEDED] * len(stops)), boards.level, judged, NEEDED, NEEDED)
        assert [reading.mismatch_ev
                for reading in report.readings] == pytest.approx(stops, abs=0.05), verdict
        assert report.verdict == verdict


class Outside(View):
    """A curve as a pass, which multiplies by more than it is told."""

    defaults = MappingProxyType({**View.defaults, "gain": 1.0})

    def encode(self, commands, frame) -> None:
        told = frame.exposure_factor
        frame.exposure_factor = frame.exposure_factor * self.options["gain"]
        super().encode(commands, frame)
        frame.exposure_factor = told


@pytest.mark.parametrize("gain", [0.5, pytest.param(2.0, marks=pytest.mark.soak)])
def test_a_gain_over_the_look_that_is_meant_is_a_mistake_and_without_one_a_remark(
    gain: float, device: Device
) -> None:
    meant, made = [View(view="reinhard")], [Outside(view="reinhard", gain=gain)]
    report = debug(scene([1.5] * 2), meant, "smooth", chain=made, device=device)
    assert report.verdict == ("too bright" if gain > 1 else "too dark") and report.remark is None
    assert report.shots[0].mismatch_ev == pytest.approx(np.log2(gain), abs=0.05)
    alone = debug(scene([1.5] * 2), made, "smooth", device=device)
    assert alone.verdict == "right" and alone.shots[0].mismatch_ev == pytest.approx(0, abs=0.05)
    assert ("like that of Reinhard, sRGB, 1.00 EV "
            f"{'brighter' if gain > 1 else 'darker'}" in (alone.remark or ""))
