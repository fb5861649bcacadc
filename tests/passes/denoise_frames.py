"""Frames to run the upscaler on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from postfx.frame import GUIDE_ROLES, Frame, Role
from postfx.passes.denoise.assembly import FrameNetworks
from postfx.passes.denoise.history import History, Turn
from postfx.passes.denoise.window import FrameWork
from postfx.runtime import CommandBuffer, Tensor

PLANES = (Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.DIFFUSE_ALBEDO,
          Role.SPECULAR_ALBEDO, Role.ROUGHNESS)


def noisy(number: int, height: int = 37, width: int = 50, planes: tuple[Role, ...] = PLANES,
          **kept: Any) -> Frame:
    """Random planes with the ranges of real ones; another `number` gives other ones."""
    random = np.random.default_rng([number, height, width])
    unit = {role: random.random((height, width, _CHANNELS.get(role, 3)), np.float32)
            for role in PLANES + (Role.ALPHA,)}
    values = unit | {
        Role.COLOUR: 30 * unit[Role.COLOUR] ** 4,
        Role.DEPTH: 1 + 5 * unit[Role.DEPTH],
        Role.MOTION: 8 * (unit[Role.MOTION] - 0.5),
        Role.NORMAL: 2 * unit[Role.NORMAL] - 1,
        Role.SPECULAR_ALBEDO: 0.3 * unit[Role.SPECULAR_ALBEDO],
    }
    kept = {"jitter": tuple(random.uniform(-0.5, 0.5, 2)), **kept}
    return Frame({role: values[role].astype(np.float32) for role in planes}, number=number, **kept)


def guided(frame: Frame, height: int, width: int, roles: tuple[Role, ...] = GUIDE_ROLES,
           **kept: Any) -> Frame:
    """The same frame with random guides of this size."""
    guides = noisy(100 + frame.number, height, width, roles).planes
    return replace(frame, guides=guides, guide_source="guides.exr", **kept)


def flat(number: int, value: float, height: int = 24, width: int = 40, **kept: Any) -> Frame:
    """A picture of one colour at rest: whatever a network predicts, normalised filters leave it as
    it is."""
    constant = {Role.COLOUR: value, Role.DEPTH: 3.0, Role.MOTION: 0.0, Role.NORMAL: 0.5,
                Role.DIFFUSE_ALBEDO: 0.5, Role.SPECULAR_ALBEDO: 0.04, Role.ROUGHNESS: 0.5}
    planes = {role: np.full((height, width, _CHANNELS.get(role, 3)), v, np.float32)
              for role, v in constant.items()}
    return Frame(planes, number=number, **kept)


_CHANNELS = {Role.DEPTH: 1, Role.ROUGHNESS: 1, Role.ALPHA: 1, Role.MOTION: 2}


def watch_histories(monkeypatch: pytest.MonkeyPatch) -> list[list[Any]]:
    """A list that gets a row for each frame from now on: its network, and the state that the last
    frame left, before the history turns to that network and after."""
    kept: list[list[Any]] = []
    encode, turn = FrameNetworks.encode, History.turn

    def begin(frames: FrameNetworks, commands: CommandBuffer, planes: Any, work: FrameWork,
              *rest: Any) -> Tensor:
        kept.append([work.model, frames._history.next["next_state"].download()])
        return encode(frames, commands, planes, work, *rest)

    def go_on(history: History, *given: Any) -> Turn:
        kept[-1].append(history.next["next_state"].download())
        return turn(history, *given)

    monkeypatch.setattr(FrameNetworks, "encode", begin)
    monkeypatch.setattr(History, "turn", go_on)
    return kept
