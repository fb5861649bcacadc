"""The model of a look: where it is, the shaper that its card gives, and whether the kernels can take what it holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from postfx.runtime import Library, ModelError

KEEP, FOLLOW = 0.6, 0.6  # where a look's card says nothing
_MOST = 1e6  # so that no sum of a few products overflows
_SHAPER = "toe and scale above 0, and a matrix of 9 numbers"


class Shaper(NamedTuple):
    """What a look's model was trained behind; see ``postfx.kernels.colour``."""

    toe: float
    scale: float
    matrix: np.ndarray


def find_model(tag: str) -> tuple[Library, str]:
    """The library and the name in it of a look by tag, or of a model file."""
    if tag.endswith(".onnx"):
        return Library(Path(tag).parent), Path(tag).stem
    return Library(), f"tonemap.{tag}"


def shaper(library: Library, model: str) -> Shaper:
    """The shaper of a model, from its card. ModelError when there is none, or none that can be."""
    given: Any = library.card(model).get("shaper")
    try:
        found = Shaper(float(given["toe"]), float(given["scale"]), np.array(given["matrix"], np.float32))
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ModelError(f"card of model '{model}' gives no shaper ({_SHAPER}): export the model again") from None
    if found.matrix.shape != (9,) or not (np.isfinite(found.matrix).all() and 0 < found.toe < np.inf
                                          and 0 < found.scale < np.inf):
        raise ModelError(f"card of model '{model}' gives a shaper that cannot be: it needs {_SHAPER}")
    return found


def keep_of(library: Library, model: str) -> float:
    """Part of the last frame's grid that a look keeps, from its card. ModelError when it is not from 0 to below 1."""
    given = library.card(model).get("keep", KEEP)
    if not _is_number(given) or not 0 <= given < 1:
        raise ModelError(f"card of model '{model}' keeps {given!r} of the last grid, not 0 to below 1")
    return float(given)


def follow_of(library: Library, model: str) -> float:
    """Part of the way that the grid goes in a frame when light changes, from a look's card. ModelError when it is not
    from 0 to 1."""
    given = library.card(model).get("follow", FOLLOW)
    if not _is_number(given) or not 0 <= given <= 1:
        raise ModelError(f"card of model '{model}' follows {given!r} of a change of light, not 0 to 1")
    return float(given)


def _is_number(given: object) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool)


def check_constants(model: str, constants: Mapping[str, np.ndarray], has_grid: bool) -> None:
    """ModelError when a look's constants are not those that the kernels take: they look up without checking bounds."""
    wanted = {"cube", "guide"} if has_grid else {"cube"}
    if set(constants) != wanted:
        raise ModelError(f"model '{model}' is no look: its card marks {', '.join(sorted(constants)) or 'no output'} as "
                         f"constant, not {', '.join(sorted(wanted))}")
    shape = constants["cube"].shape
    if len(shape) != 4 or min(shape) < 2:
        raise ModelError(f"model '{model}' is no look: its cube is {shape}, not (n, n, n, 3) with n of 2 and more")
    if not all((np.abs(values) <= _MOST).all() for values in constants.values()):
        raise ModelError(f"model '{model}' is no look: it holds numbers beyond {_MOST:g}, or that are none")
