"""A picture and what its source holds beside it as one file: how its parts are made is found once.

The frames of a sequence differ in their pixels and in the values of header attributes. Which parts
a file has, where each attribute comes from and where each channel goes follow from names, types and
windows. So a plan is made for the first frame. A later frame whose headers tell the same takes it.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postfx.caching import LRUCache
from postfx.frame import Frame
from postfx.io.exr import Attribute, Header
from postfx.io.exr.container import (
    STORAGE_ATTRIBUTES,
    ExrContainer,
    NewPart,
    Rows,
    picture_part,
    read_stored,
)
from postfx.io.exr.passthrough import SHARED_ATTRIBUTES, Merge, Recipe, enlarge_rows
from postfx.io.image_file import ImageFile
from postfx.io.windows import Part

_DECIDING = (*STORAGE_ATTRIBUTES, *SHARED_ATTRIBUTES, "name")
"""Attributes of a source's header whose values decide how parts are made."""
_VARYING = "timeCode"
"""The one of these that every frame has its own of: only whether parts have the same counts."""
MOST_KEEP_PLANS = 32
"""A sequence has one for each kind of header that its frames have."""


def merge_source(own: Header, rows: Rows, frame: Frame, alike: Hashable,
                 stack: ExitStack) -> list[NewPart]:
    """Parts of a file that holds a picture and everything else that its frame's source holds.

    Args:
        own: header that the writer gave the picture.
        rows: reads the picture's channels, in the order of that header.
        frame: of the picture. A source that is not an OpenEXR file has nothing to keep.
        alike: what frames have in common that are written alike, their sources apart.
        stack: closes the source's files, from which the parts read while they are written.

    Raises ReadError when the source is broken, OSError when it was removed.
    """
    if frame.source is None or Path(frame.source).suffix.lower() != ".exr":
        return [picture_part(own, rows, apart=True)]
    source = stack.enter_context(ExrContainer(Path(frame.source)))
    rows_read = frame.colour_source.rows if frame.colour_source else None
    if rows_read and rows_read.identity == source.identity:
        source.unpacked.update(rows_read.parts)
    key = alike, tuple(own.attributes), _key_of(source, frame)
    plan = _KEEP_PLANS.find(key) or _KEEP_PLANS.keep(key, KeepPlan(own, source, frame))
    return plan.parts(own, rows, source, stack)


def _key_of(source: ExrContainer, frame: Frame) -> tuple[object, ...]:
    """All of a source, and of what became of its attributes, that decides how parts are made."""
    first, stored = source.headers[0].attributes, []
    for header in source.headers:
        attributes = header.attributes
        stored.append((
            tuple([(name, attribute.kind) for name, attribute in attributes.items()]),
            tuple([attributes.get(name) for name in _DECIDING if name != _VARYING]),
            attributes.get(_VARYING) == first.get(_VARYING),
        ))
    colour, now = frame.colour_source, frame.metadata
    if colour is None:
        return tuple(stored), None
    changed = tuple([name for name, value in colour.attributes.items()
                     if not np.array_equal(value, now.get(name, value))])
    values = tuple([str(now.get(name)) for name in changed if name in SHARED_ATTRIBUTES])
    return (tuple(stored), tuple(colour.attributes), changed, values, colour.part, colour.channels,
            colour.renders, tuple(colour.pixels.items()))


class _Origin(NamedTuple):
    """Where an attribute of a part's header comes from: the picture's header (place 0) or one of
    the source's, by its name there; or the attribute itself where it is the same in all frames."""

    name: str
    place: int = -1
    known_as: str = ""
    fixed: Attribute | None = None


class KeepPlan:
    """How the parts of a file are made, for all frames whose headers tell the same."""

    def __init__(self, own: Header, source: ExrContainer, frame: Frame) -> None:
        merge = Merge(own, source, frame)
        self._enlargement, self._pixels = merge.enlargement, merge.stored.pixels
        recipes = merge.recipes()

        # A header of a recipe holds the very objects that it took over from other headers.
        origins = {id(attribute): (place, name)
                   for place, header in enumerate((own, *source.headers))
                   for name, attribute in header.attributes.items()}
        self._parts = [(recipe, [_Origin(name, *origins[id(attribute)])
                                 if id(attribute) in origins else _Origin(name, fixed=attribute)
                                 for name, attribute in recipe.header.attributes.items()])
                       for recipe in recipes]

    def parts(self, own: Header, rows: Rows, source: ExrContainer,
              stack: ExitStack) -> list[NewPart]:
        """The parts of a frame, of its picture's header and rows and of its open source."""
        headers, found = (own, *source.headers), []
        for recipe, origins in self._parts:
            header = Header({
                name: fixed or headers[place].attributes[known_as]
                for name, place, known_as, fixed in origins
            })
            if recipe.order:
                found.append(self._joined_part(recipe, header, rows, source, stack))
            else:
                chunks = source.copy_chunks(recipe.part)
                found.append(NewPart(header, source.counts[recipe.part], chunks))
        return found

    def _joined_part(self, recipe: Recipe, header: Header, rows: Rows, source: ExrContainer,
                     stack: ExitStack) -> NewPart:
        """A part of channels of the picture and of the source."""
        kept: Rows | None = None
        apart = True
        if recipe.is_enlarged and self._enlargement:
            file = stack.enter_context(ImageFile(source.path, checked=True))
            pixels = {name: axis
                      for (part, name), axis in self._pixels.items() if part == recipe.part}
            kept = enlarge_rows(file, _find_part(file, recipe.part), [*recipe.kept],
                                self._enlargement, pixels)
            apart = False
        elif {*recipe.kept} <= source.storages[recipe.part].channels.keys():
            kept = partial(_read_kept, source, recipe) if recipe.kept else None
        else:
            file = stack.enter_context(ImageFile(source.path, checked=True))
            kept = partial(file.read_stored, _find_part(file, recipe.part), recipe.kept)
            apart = False

        def read(first: int, last: int) -> list[np.ndarray]:
            picture = rows(first, last) if recipe.fresh else ()
            found = [picture[place] for place in recipe.fresh]
            found += kept(first, last) if kept else ()
            return [found[place] for place in recipe.order]

        return picture_part(header, read, apart)


def _read_kept(source: ExrContainer, recipe: Recipe, first: int,
               last: int) -> Sequence[np.ndarray]:
    """The channels that are kept of a part, bit for bit."""
    found = read_stored(source, recipe.part, recipe.kept, first, last)
    if found is not None:
        return found
    with ImageFile(source.path, checked=True) as file:  # which says what is broken
        return file.read_stored(_find_part(file, recipe.part), recipe.kept, first, last)


def _find_part(file: ImageFile, index: int) -> Part:
    return next(part for part in file.parts if part.index == index)


_KEEP_PLANS: LRUCache[tuple[Hashable, ...], KeepPlan] = LRUCache(MOST_KEEP_PLANS)
