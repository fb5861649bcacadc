"""Finding passes by name, and making them of words such as 'vignette,amount=0.5'.

Passes are entry points of the group `postfx.passes`. Those that come with postfx are listed here
instead, so that a checkout works without being installed; no other package can take their names.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from inspect import Parameter
from typing import Any, NamedTuple

from postfx.errors import OptionError, PassOptionError, PostfxError, RegistryError, offer
from postfx.files import parse_json
from postfx.passes import Pass
from postfx.version import __version__

ENTRY_POINT_GROUP = "postfx.passes"
BUILT_IN = {
    "denoise_upscale": "postfx.passes.denoise:DenoiseUpscale",
    "both_ways": "postfx.passes.composite:BothWays",
    "oidn": "postfx.passes.oidn:Oidn",
    "partner": "postfx.passes.partner:Partner",
    "mix_partner": "postfx.passes.partner:MixPartner",
    "overlay": "postfx.passes.composite:Overlay",
    "tonemap": "postfx.passes.tonemap:ToneMap",
    "display": "postfx.passes.display:Display",
    "view": "postfx.passes.display:View",
    "exposure_tool": "postfx.passes.exposure_tool:ExposureTool",
    "occlusion": "postfx.passes.scene:Occlusion",
    "irradiance": "postfx.passes.scene:Irradiance",
    "scene_shading": "postfx.passes.scene:SceneShading",
}
"""What an entry point would say of the passes that come with postfx."""

# What says where a pass stands; no pass may have options of these names.
PLACE_BEFORE = "before"
PLACE_AFTER = "after"

_COMMA = re.compile(r",(?=\w+=)")


def names() -> tuple[str, ...]:
    """Names of all passes, sorted; none of them is imported."""
    return tuple(sorted({*BUILT_IN, *_installed()}))


def load(name: str) -> type[Pass]:
    """The class of a pass. Raises RegistryError if the name is unknown or its target is not a pass
    of that name."""
    points = ([EntryPoint(name, BUILT_IN[name], ENTRY_POINT_GROUP)] if name in BUILT_IN
              else _installed().get(name, ()))
    if not points:
        raise RegistryError(f"no pass '{name}'{offer(name, names(), 'there are')}")
    if len(points) > 1:
        raise RegistryError(f"pass '{name}' comes with "
                            f"{' and with '.join(map(package_of, points))}: uninstall all but one "
                            "of them")
    try:
        found = points[0].load()
    except Exception as error:  # other people's code
        raise RegistryError(f"pass '{name}' cannot be loaded: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Pass)):
        raise RegistryError(f"pass '{name}' points to {found!r}, which is not a subclass of "
                            "postfx.passes.Pass")
    if getattr(found, "name", None) != name:
        raise RegistryError(f"pass '{name}' points to a class whose name "
                            f"is '{getattr(found, 'name', '')}': set name = \"{name}\" in "
                            f"{found.__qualname__}")
    if taken := {PLACE_BEFORE, PLACE_AFTER} & set(found.defaults):
        raise RegistryError(f"pass '{name}' has an option '{taken.pop()}', which says where a pass "
                            "stands: rename it")
    return found


def create(name: str, **options: Any) -> Pass:
    """A pass by name. Raises RegistryError for an unknown name, PassOptionError for an unknown
    option."""
    kind = load(name)
    try:
        return kind(**options)
    except PostfxError:
        raise
    except Exception as error:  # other people's code
        raise PassOptionError(f"pass '{name}' cannot be made: {error}") from error


def package_of(point: EntryPoint) -> str:
    """Name and version of the package that an entry point comes with."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "a package without a name"


def plug_ins() -> dict[str, str]:
    """Name -> package and version, of the passes that do not come with postfx."""
    return {name: ", ".join(map(package_of, points))
            for name, points in _installed().items() if name not in BUILT_IN}


def describe_passes() -> str:
    """All passes, a paragraph each: name, package, options with their defaults, and the first line
    of the docstring."""
    return "\n".join(line for name in names() for line in _description(name))


def _description(name: str) -> list[str]:
    hidden = [point for point in _installed().get(name, ()) if name in BUILT_IN]
    origin = plug_ins().get(name, f"postfx {__version__}")
    try:
        kind = load(name)
    except RegistryError as error:
        return [f"{name}  ({origin})", f"    {error}"]
    options = ", ".join(key if value is Parameter.empty else f"{key}={_spell(value)}"
                        for key, value in kind.defaults.items())
    summary = " ".join((kind.__doc__ or "").strip().partition("\n\n")[0].split())
    lines = [f"{name}  ({origin})", f"    {summary}", f"    options: {options or 'none'}"]
    return lines + [f"    a pass of this name in {package_of(point)} is not used: rename it"
                    for point in hidden]


def _spell(value: Any) -> str:
    return ("none" if value is None else str(value).lower() if isinstance(value, bool)
            else str(value))


class PassRequest(NamedTuple):
    """A pass as words ask for it: its name, its options as texts, and which pass it stands before
    or after."""

    name: str
    options: dict[str, str]
    before: str | None = None
    after: str | None = None

    @property
    def neighbour(self) -> str | None:
        """Name of the pass that it stands before or after; None where its place is free."""
        return self.before or self.after


def parse_pass(text: str, flag: str = "--pass") -> PassRequest:
    """The pass that 'NAME[,option=value]...[,before=PASS|after=PASS]' asks for. Raises OptionError,
    which names the flag, for anything else."""
    name, *words = _COMMA.split(text.strip())
    if not re.fullmatch(r"[\w.-]+", name):
        raise OptionError(f"{flag} {text}: give a name and options, e.g. "
                          "vignette,amount=0.5,before=tonemap")
    options: dict[str, str] = {}
    for word in words:
        key, _, value = word.partition("=")
        if key in options:
            raise OptionError(f"{flag} {text}: '{key}' is given twice")
        options[key] = value
    before, after = options.pop(PLACE_BEFORE, None), options.pop(PLACE_AFTER, None)
    if before and after:
        raise OptionError(f"{flag} {text}: a pass stands before or after another one, not both")
    return PassRequest(name, options, before, after)


def make_asked(asked: PassRequest) -> Pass:
    """The pass, its options read as values of the same kind as their defaults.

    Raises RegistryError for an unknown name, PassOptionError for an unknown option or a value of
    another kind.
    """
    defaults = load(asked.name).defaults
    options = {key: _value(asked.name, key, text, defaults.get(key))
               for key, text in asked.options.items()}
    return create(asked.name, **options)


_BOOLEANS = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False,
             "off": False, "0": False}


def _value(name: str, key: str, text: str, default: Any) -> Any:
    try:
        if isinstance(default, bool):
            return _BOOLEANS[text.lower()]
        if isinstance(default, int | float):
            return type(default)(text)
    except (KeyError, ValueError):
        kind = {bool: "true or false", int: "a whole number"}.get(type(default), "a number")
        raise PassOptionError(f"pass '{name}': {key}={text} is not {kind}") from None
    if isinstance(default, str):
        return text
    try:
        return None if text == "none" else parse_json(text)
    except ValueError:
        return text


def insert_passes(chain: Sequence[Pass], asked: Sequence[PassRequest], default: int) -> list[Pass]:
    """A chain with passes that were asked for. Those without a place stand before position
    `default` of it, or first if they read planes of the render.

    Passes of one place stand in the order in which they were asked for, and may name each other.
    Raises OptionError for a place that is not in the chain.
    """
    made = [(request, make_asked(request)) for request in asked]
    free = [instance for request, instance in made if not request.neighbour]
    result = [*(one for one in free if one.reads_render), *chain[:default],
              *(one for one in free if not one.reads_render), *chain[default:]]
    waiting = [(request, instance) for request, instance in made if request.neighbour]
    behind: Counter[Pass] = Counter()  # how many stand behind a pass already
    while waiting:
        placeable = [pair for pair in waiting if _find(result, pair[0].neighbour) is not None]
        if not placeable:
            raise _no_neighbour(waiting[0][0], result)
        request, instance = placeable[0]
        waiting.remove(placeable[0])
        place = _find(result, request.neighbour) or 0
        if request.after:
            neighbour = result[place]
            behind[neighbour] += 1
            place += behind[neighbour]
        result.insert(place, instance)
    return result


def _find(chain: Sequence[Pass], name: str | None) -> int | None:
    """Where the first pass of a name stands; None if there is none."""
    return next((place for place, instance in enumerate(chain) if instance.name == name), None)


def _no_neighbour(request: PassRequest, chain: Sequence[Pass]) -> OptionError:
    """The error for a pass that is to stand beside one that is not in the chain."""
    names = [instance.name for instance in chain]
    there = offer(str(request.neighbour), names or ["none"], "there are")
    return OptionError(f"--pass {request.name}: no pass '{request.neighbour}' runs here{there}")


@cache
def _installed() -> dict[str, tuple[EntryPoint, ...]]:
    """Name -> entry points of other packages than postfx."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if BUILT_IN.get(point.name) != point.value:
            found[point.name] = (*found.get(point.name, ()), point)
    return found
