"""Finding passes by name: entry points of the group `postfx.passes`, and the modules of this folder.

The modules are looked at too so that a checkout works without being installed. A module's name is its pass's name;
modules that are no passes begin with an underscore.
"""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from postfx.errors import RegistryError
from postfx.passes.base import Pass

GROUP = "postfx.passes"
_NO_PASSES = ("base", "registry")


def names() -> tuple[str, ...]:
    """Names of all passes, sorted; none of them is imported."""
    return tuple(sorted({*_installed(), *_modules()}))


def load(name: str) -> type[Pass]:
    """The class of a pass. Raises RegistryError when the name is unknown or what it points to is no pass."""
    installed = _installed().get(name)
    try:
        if installed is not None:
            found = installed.load()
        elif name in _modules():
            found = _class_in(f"{__package__}.{name}", name)
        else:
            raise RegistryError(f"no pass '{name}': there are {', '.join(names())}")
    except RegistryError:
        raise
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


@cache
def _modules() -> tuple[str, ...]:
    found = [module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)])]
    return tuple(name for name in found if not name.startswith("_") and name not in _NO_PASSES)


def _class_in(module: str, name: str) -> type | None:
    classes = [item for item in vars(import_module(module)).values() if isinstance(item, type)]
    return next((item for item in classes if issubclass(item, Pass) and getattr(item, "name", None) == name), None)
