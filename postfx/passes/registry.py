"""Finding passes by name: entry points of the group `postfx.passes`, and those that come with postfx.

The latter are listed here too, so that a checkout works without being installed.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from postfx.errors import RegistryError
from postfx.passes.base import Pass

GROUP = "postfx.passes"
BUILT_IN = {
    "denoise_upscale": "postfx.passes.denoise:DenoiseUpscale",
    "both_ways": "postfx.passes.composite:BothWays",
    "overlay": "postfx.passes.composite:Overlay",
    "tonemap": "postfx.passes.tonemap:ToneMap",
    "display": "postfx.passes.display:Display",
    "view": "postfx.passes.display:View",
    "exposure_tool": "postfx.passes.exposure_tool:ExposureTool",
}
"""Entry points of the passes that come with postfx, as in pyproject.toml."""


def names() -> tuple[str, ...]:
    """Names of all passes, sorted; none of them is imported."""
    return tuple(sorted({*BUILT_IN, *_installed()}))


def load(name: str) -> type[Pass]:
    """The class of a pass. Raises RegistryError if the name is unknown or its target is not a pass."""
    point = _built_in(name) or _installed().get(name)
    if point is None:
        raise RegistryError(f"no pass '{name}': there are {', '.join(names())}")
    try:
        found = point.load()
    except Exception as error:  # other people's code
        raise RegistryError(f"pass '{name}' cannot be loaded: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Pass)):
        raise RegistryError(f"pass '{name}' points to {found!r}, which is no subclass of postfx.passes.base.Pass")
    return found


def create(name: str, **options: Any) -> Pass:
    """A pass by name. Raises RegistryError for an unknown name, PassOptionError for an unknown option."""
    return load(name)(**options)


@cache
def _installed() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def _built_in(name: str) -> EntryPoint | None:
    return EntryPoint(name, BUILT_IN[name], GROUP) if name in BUILT_IN else None
