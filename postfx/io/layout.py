"""Where a frame's planes are: the channels of its files, matched by a renderer profile."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from postfx.errors import GuideError, MissingPlaneError
from postfx.frame import OUTPUT_SIZE_ROLES, GuideSpec, Role
from postfx.io.channels import Channel, ChannelIndex, Names, are_together, before, has_siblings
from postfx.io.convert import Camera, DepthOption, missing_error, missing_number
from postfx.io.facts import Facts, read_facts
from postfx.io.profile import DetectRule, PlaneRule, Profile, load_profile, profile_names
from postfx.io.windows import PICTURE_ATTRIBUTE
from postfx.streams import make_printable


def _picture_rules(told: str) -> tuple[PlaneRule, ...]:
    """Rules for a picture that an earlier run wrote: under its own names, if these are not plain R,
    G, B."""
    names = told.split(",")
    red = next((name for name in names if name.rpartition(".")[2] in ALPHA_OF_RED), "")
    layer, _, letter = red.rpartition(".")
    if not layer or {"R", "G", "B"} <= {*names}:
        layer, letter = "", "R"
    letters = next(tuple(word) for word in _COLOURS if word[0] == letter)
    return (PlaneRule(Role.COLOUR, (layer,), (letters,)),
            PlaneRule(Role.ALPHA, (layer,), ((ALPHA_OF_RED[letter],),)))


_COLOURS = (("R", "G", "B"), ("r", "g", "b"), ("red", "green", "blue"), ("Red", "Green", "Blue"),
            ("RED", "GREEN", "BLUE"))
ALPHA_OF_RED = {"R": "A", "r": "a", "red": "alpha", "Red": "Alpha", "RED": "ALPHA"}


class Match(NamedTuple):
    """A plane that was found: the rule that fits and its channels."""

    rule: PlaneRule
    channels: tuple[Channel, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the plane, which are those of its area."""
        area = self.channels[0].part.area
        return area.width, area.height

    @property
    def names(self) -> str:
        """Channel names, the common part once: 'albedo.R,G,B'."""
        heads, tails = zip(*(channel.name.rpartition(".")[::2] for channel in self.channels),
                           strict=True)
        joined = ",".join(tails)
        same = len(set(heads)) == 1
        return ((f"{heads[0]}.{joined}" if heads[0] else joined) if same
                else ", ".join(c.name for c in self.channels))


@dataclass
class Layout:
    """The planes of a frame's files, as a profile finds them."""

    profile: Profile
    layer: str
    planes: dict[Role, Match]
    facts: Facts
    """What its header attributes say, by the names of its profile."""
    camera: Camera
    """Of these facts, and of what the user says."""
    attributes: Mapping[str, Any]
    paths: Mapping[str, Path]
    """Of the files, by their words."""
    warnings: list[str] = field(default_factory=list)
    unused: dict[Role, str] = field(default_factory=dict)
    """Why a plane that is there is not used, as long as no other one of its role is."""
    barred: set[tuple[Channel, ...]] = field(default_factory=set)
    """Channels that no later rule may take either, as they are in a space that cannot be left."""
    chosen_layer: str | None = None
    """The view layer that was chosen among several; None if there are not several."""

    def hints(self) -> dict[Role, str]:
        """Role -> where the user switches the plane on in the renderer, of those of which that is
        known."""
        rules = ((role, [rule.enable for rule in self.profile.rules(role) if rule.enable])
                 for role in Role)
        return {role: hints[0] for role, hints in rules if hints}


def make_layout(
    index: ChannelIndex,
    paths: Mapping[str, Path],
    attributes: Mapping[str, Any],
    profile: Profile | None = None,
    depth: DepthOption | None = None,
    without: Collection[Role] = (),
    layer: str | None = None,
) -> Layout:
    """Where the planes are, by a profile or else by the first that fits; `depth` replaces what the
    profile says of depth. `paths` are those of the files, by their words.

    Planes of the roles `without` are taken as absent. Of several view layers it is `layer`, or the
    one with the most planes.

    Raises ProfileError when the depth plane needs numbers of the camera that are not known.
    """
    profile = profile or _detect(index, attributes)
    if PICTURE_ATTRIBUTE in attributes:
        profile = replace(profile, planes=_picture_rules(str(attributes[PICTURE_ATTRIBUTE]))
                                          + profile.planes)
    layers = _distinct(index, _layers(index.names, profile), profile.marker)
    named = [name
             for name in layers if layer is not None and name.rstrip(".").lower() == layer.lower()]
    found = []
    for name in named or layers:
        facts = read_facts(profile, name, attributes)
        camera = depth.camera(facts.camera) if depth else facts.camera
        layout = Layout(profile, name, {}, facts, camera, attributes, paths)
        found.append(_match_all(index, layout, depth, without))
    layout = max(found, key=_preference)
    if len(found) > 1:
        layout.chosen_layer = layout.layer.rstrip(".")
        others = ", ".join(other.layer.rstrip(".") for other in found if other is not layout)
        layout.warnings.append(f"view layer {layout.chosen_layer} is read, as it has the most "
                               f"AOVs, not {others}: --layer NAME chooses")
    layout.warnings += _colour_warnings(layout)
    return layout


def take_opaque_colour(layout: Layout, index: ChannelIndex) -> None:
    """Let the colour before transparents be the frame's colour, as there is an overlay to composite
    over it.

    Its own alpha, channel A beside it, becomes the frame's; the alpha of all together includes the
    overlay already.
    """
    match = layout.planes.pop(Role.OPAQUE_COLOUR, None)
    if match is None:
        return
    layout.planes[Role.COLOUR] = match
    together = layout.planes.pop(Role.ALPHA, None)
    alpha = _alpha_beside(match, layout, index)
    if alpha:
        layout.planes[Role.ALPHA] = alpha
    elif together:
        layout.warnings.append(
            f"alpha {together.names} includes the overlay and is not used: write the alpha before "
            f"transparents beside {match.names}"
        )


def _alpha_beside(match: Match, layout: Layout, index: ChannelIndex) -> Match | None:
    names = next(names for names in match.rule.candidates(layout.layer)
                 if index.find(names) == match.channels)
    channels = index.find([f"{names[0].rpartition('.')[0]}.A"],
                          lambda found: are_together((*found, match.channels[0])))
    rules = layout.profile.rules(Role.ALPHA)
    return Match(rules[0], channels) if channels and rules else None


@dataclass
class PictureChoice:
    """Which of several pictures is read.

    Attributes:
        name: of the layer that is read, '' for the channels without a layer.
        others: channels that could as well be the picture, and the names of their layers.
        before: the planes of all of them together.
    """

    name: str
    others: Mapping[tuple[Channel, ...], str]
    before: Mapping[Role, Match]

    def told(self, layout: Layout, parts: Collection[tuple[Channel, ...]]) -> list[str]:
        """A line on the choice. parts: channels that are known to be parts of the picture."""
        known = {*parts, *(match.channels for match in layout.planes.values())}
        others = [make_printable(name)
                  for channels, name in self.others.items() if channels not in known]
        if not others:
            return []
        own = make_printable(self.name or self.before[Role.COLOUR].names)
        lost = [role for role in self.before if role not in layout.planes]
        more = f"; {', '.join(lost)} beside these is not read" if lost else ""
        return [f"of several pictures {own} is read, not {', '.join(others)}: --layer NAME "
                f"chooses{more}"]


def choose_picture(layout: Layout, index: ChannelIndex) -> PictureChoice | None:
    """The choice where other channels may as well be the picture as those of the colour, but none
    that the profile knows as parts of it.

    What lies beside the others in parts of their own then goes by the names of these parts only.
    """
    match, profile = layout.planes[Role.COLOUR], layout.profile
    own = match.channels[0]
    named = {channels: names[0].rpartition(".")[0]
             for names in match.rule.candidates(layout.layer)
             if "." in names[0] and (channels := index.find(names))}
    found = index.pictures_beside(match.channels, match.channels in named)
    if profile.name == "generic":
        found |= named
    patterns = [name.replace("{layer}", layout.layer).lower()
                for rule in profile.parts for name in rule.names]
    others = {channels: name for channels, name in found.items()
              if channels != match.channels
              and not any(fnmatchcase(name.lower(), pattern) for pattern in patterns)}
    if not others:
        return None
    apart = [channels for channels in others if not are_together((own, channels[0]))]
    name = index.part_name(own) if apart else own.name.rpartition(".")[0]
    index.set_aside(apart)
    return PictureChoice(name, others, layout.planes)


_DEFAULT_LAYERS = ("viewlayer.", "view layer.", "renderlayer.")
"""Names that Blender gives to its first view layer."""


def _preference(layout: Layout) -> tuple[bool, int, bool]:
    """How likely a view layer is the one that is meant."""
    name = layout.layer.lower()
    return (Role.COLOUR in layout.planes and name != "overlay.", len(layout.planes),
            name in _DEFAULT_LAYERS)


def _match_all(index: ChannelIndex, layout: Layout, depth: DepthOption | None,
               without: Collection[Role]) -> Layout:
    for rule in layout.profile.planes:
        if rule.role not in layout.planes and rule.role not in without:
            if depth is not None and rule.role is Role.DEPTH:
                _match_rule(index, layout, depth.rule(rule), given=True)
            else:
                _match_rule(index, layout, rule, given=False)
    layout.warnings += [reason
                        for role, reason in layout.unused.items() if role not in layout.planes]
    return layout


def _colour_warnings(layout: Layout) -> list[str]:
    match, warnings = layout.planes.get(Role.COLOUR), []
    part = match.channels[0].part if match else None
    if part and not part.area.holds(part.data):
        warnings.append("overscan beyond that of the first frame is cut off")
    return warnings


def _match_rule(index: ChannelIndex, layout: Layout, rule: PlaneRule, given: bool) -> None:
    """Find a plane; `given`: the user says what it holds, not the profile."""
    found = [channels for names in _candidates(layout, rule)
             if (channels := _find(index, layout, rule, names))]
    channels = next((channels for channels in found if channels not in layout.barred), None)
    if (channels is None
        or index.find(name.replace("{layer}", layout.layer) for name in rule.requires) is None):
        return
    if any(index.find([name.replace("{layer}", layout.layer)]) is not None
           for name in rule.without):
        return
    match = Match(rule, channels)
    if rule.role is Role.NORMAL and rule.space != "world" and layout.camera.world_to_camera is None:
        layout.unused[rule.role] = (f"normals {match.names} are in camera space and no "
                                    "worldToCamera header: not used")
        layout.barred.update(found)
        return
    if rule.role is Role.MOTION and rule.unit == "velocity" and layout.camera.max_velocity is None:
        layout.unused[rule.role] = (
            f"motion {match.names} is scaled by a largest velocity that the file does not hold: "
            "not used; give max_velocity, in pixels, under [camera] in a profile"
        )
        return
    if rule.role is Role.MOTION and rule.per == "shutter" and layout.camera.shutter is None:
        layout.unused[rule.role] = (
            f"motion {match.names} lasts as long as the shutter is open, which the file does not "
            "hold: not used; give shutter, in frames, under [camera] in a profile"
        )
        return
    number = missing_number(rule, layout.camera) if rule.role is Role.DEPTH else None
    if number == "fov" and not given:
        layout.warnings.append(
            f"depth {match.names} is distance from the eye, used as it is: give --depth "
            "ray,fov=DEGREES, or fov_x under [camera] in a profile"
        )
    elif number:
        raise missing_error(layout.paths[channels[0].word], match.names, rule, number)
    layout.planes[rule.role] = match


def _candidates(layout: Layout, rule: PlaneRule) -> Sequence[tuple[str, ...]]:
    """Names to look for, best first: alpha where the colour is."""
    found = rule.candidates(layout.layer)
    if rule.role is Role.ALPHA and Role.COLOUR in layout.planes:
        layer = _layer_of([channel.name for channel in layout.planes[Role.COLOUR].channels])
        return sorted(found, key=lambda names: _layer_of(names) != layer)
    return found


def _find(index: ChannelIndex, layout: Layout, rule: PlaneRule,
          names: tuple[str, ...]) -> tuple[Channel, ...] | None:
    """Channels of these names that may be the plane."""
    def fits(channels: tuple[Channel, ...]) -> bool:
        first, layer = channels[0], _layer_of(names)
        colour, apart = layout.planes.get(Role.COLOUR), layout.layer.lower().rstrip(".")
        is_called_so = "alpha" in layer or (apart and layer.startswith(apart))
        if (rule.role is Role.ALPHA and colour and are_together(colour.channels)
            and not is_called_so):
            return are_together((first, colour.channels[0]))
        if rule.role is Role.DEPTH and not layer:
            return not has_siblings(first, "XYZ")  # else it is of a position or normal
        if rule.role is Role.COLOUR and len(set(channels)) == 1:
            return not (has_siblings(first, "X") or has_siblings(first, ("RY", "BY")))
        return True

    return index.find(names, fits)


def _layer_of(names: Sequence[str]) -> str:
    """Layer of channels by full name, in lower case; '' where they have none."""
    return names[0].lower().rpartition(".")[0]


def _detect(index: ChannelIndex, attributes: Mapping[str, Any]) -> Profile:
    """The first built-in profile that fits. Frames with the same names and the same facts have the
    same profile."""
    return _first_that_fits(index.names, tuple((name, str(attributes.get(name, "")))
                                               for name in telling_names()))


@cache
def telling_names() -> tuple[str, ...]:
    """Names of the header attributes by which profiles are told apart."""
    rules = (rule for name in profile_names() for rule in load_profile(name).detect)
    return tuple({name: None for rule in rules for name, _ in rule.header})


@lru_cache(64)
def _first_that_fits(names: Names, facts: tuple[tuple[str, str], ...]) -> Profile:
    """Looked up once for all frames of a sequence."""
    profiles, told = [load_profile(name) for name in profile_names()], dict(facts)
    return next((profile for profile in profiles if _fits(names, profile, told)), profiles[-1])


def _fits(names: Names, profile: Profile, facts: Mapping[str, str]) -> bool:
    keys = dict(names).keys()
    return any(
        all(re.search(pattern, facts[name]) for name, pattern in rule.header)
        and any(_meets(keys, rule, layer) for layer in _layers(names, profile))
        for rule in profile.detect
    )


def _meets(keys: Collection[str], rule: DetectRule, layer: str) -> bool:
    """Whether the channels are there that must be, and none that must not."""
    there, absent = ([name.replace("{layer}", layer).lower() for name in names]
                     for names in (rule.channels, rule.without))
    return (all(_is_there(keys, name) for name in there)
            and not any(_is_there(keys, name) for name in absent))


def _is_there(keys: Collection[str], name: str) -> bool:
    return name in keys or ("*" in name and any(fnmatchcase(key, name) for key in keys))


def _layers(names: Names, profile: Profile) -> list[str]:
    """What precedes the profile's marker channel: 'ViewLayer.' of 'ViewLayer.Combined.R'; ''
    without a marker."""
    return (before(names, profile.marker) if profile.marker else []) or [""]


def _distinct(index: ChannelIndex, layers: list[str], marker: str) -> list[str]:
    """The layers without those that are one of them by another name, as a layer also goes by its
    part's name."""
    found: dict[tuple[Channel, ...] | None, str] = {}
    for layer in layers:
        found.setdefault(index.find([f"{layer}{marker}"]) if marker else None, layer)
    return list(found.values())


@dataclass
class GuideLayout:
    """Where the guides of a frame are, and what the header of their file says about the camera."""

    path: Path
    planes: dict[Role, Match]
    camera: Camera

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return next(iter(self.planes.values())).size

    def spec(self) -> GuideSpec:
        """Size and roles."""
        return GuideSpec(*self.size, tuple(self.planes), str(self.path))


def take_larger_planes(layout: Layout) -> dict[Role, Match]:
    """Planes larger than the colour, taken out of the layout: guides, as the same files hold the
    colour at render size.

    Raises GuideError where they differ in size.
    """
    if Role.COLOUR not in layout.planes:
        return {}
    size = layout.planes[Role.COLOUR].size
    found = {role: layout.planes[role]
             for role in OUTPUT_SIZE_ROLES if _is_larger(layout.planes.get(role), size)}
    for role in found:
        del layout.planes[role]
    if found:
        _check_one_size(layout.paths[next(iter(found.values())).channels[0].word], found)
    return found


def drop_smaller_planes(layout: Layout) -> None:
    """Take planes that are smaller than the colour out of the layout, where the colour is a picture
    that postfx wrote: they are the render's, kept beside it."""
    colour = layout.planes.get(Role.COLOUR)
    if colour is None or not colour.channels[0].part.is_picture:
        return
    smaller = [role for role, match in layout.planes.items() if match.size[0] < colour.size[0]]
    for role in smaller:
        del layout.planes[role]
    if smaller:
        layout.warnings.append(f"AOVs {', '.join(smaller)} are of the render before it was "
                               "enlarged: not read")


def planes_that_guide(layout: Layout, path: Path) -> dict[Role, Match]:
    """Guides out of files of their own. Raises MissingPlaneError when they hold none, GuideError
    where they differ in size."""
    found = {role: layout.planes[role] for role in OUTPUT_SIZE_ROLES if role in layout.planes}
    if not found:
        raise MissingPlaneError(
            f"{path}: holds none of the AOVs that guide ({', '.join(OUTPUT_SIZE_ROLES)}) by "
            f"profile {layout.profile.name}: render one of them, or name it in a profile "
            "(--profile FILE.toml)"
        )
    _check_one_size(path, found)
    return found


def _check_one_size(path: Path, planes: Mapping[Role, Match]) -> None:
    if len({match.size for match in planes.values()}) > 1:
        sizes = ", ".join(f"{role} {match.size[0]}x{match.size[1]}"
                          for role, match in planes.items())
        raise GuideError(f"{path}: guides differ in size: {sizes}: render them at one size, the "
                         "output's")


def _is_larger(match: Match | None, size: tuple[int, int]) -> bool:
    return (match is not None and match.size != size and match.size[0] >= size[0]
            and match.size[1] >= size[1])
