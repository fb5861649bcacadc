"""How much each picture of a time between two frames counts.

Up to four pictures are made: along the vectors, along estimated motion, the mean of both frames,
and that of a shot which moves by its vectors and dissolves into another one. Where it is plain
which one is right, it alone counts. Else those count along which colours go on evenly through the
frames around (`ways.unevenness`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from postfx.interpolate.pictures import finite
from postfx.interpolate.ways import (
    ALONE,
    AS_EVEN,
    AS_EVEN_ALONE,
    CLEARLY_BETTER,
    COMPARED_ROWS,
    DOUBTING_ROWS,
    FLOW_HANDICAP,
    LEAST_LEFT_OF_FLOW,
    LEAST_UNEVEN,
    LESS_EVEN_THAN_FLOW,
    MORE_EVEN,
    MOSTLY_NOISE,
    REST_HANDICAP,
    MotionFit,
    shares_of,
    unevenness,
)


class Shares(NamedTuple):
    """How much each picture of a time counts; the sum is 1.

    Attributes:
        vectors: of the one along the vectors, or along estimated motion where there are none.
        flow: of the one along estimated motion, beside vectors.
        mean: of the mean of both frames.
        over_shot: of a shot that moves by the vectors and goes over into another one.
    """

    vectors: float = 0.0
    flow: float = 0.0
    mean: float = 0.0
    over_shot: float = 0.0


BY_VECTORS = Shares(vectors=1.0)
BY_FLOW = Shares(flow=1.0)
BY_MEAN = Shares(mean=1.0)


class Neighbours:
    """Successive frames around a time: the two beside it, and perhaps one more on either side.

    Args:
        colours: (h, w, 3) of two to four frames.
        first: index of the frame before the time, 0 or 1.
        level: light that is toned to about the middle.
    """

    def __init__(self, colours: Sequence[np.ndarray], first: int, level: float) -> None:
        self.count = len(colours)
        self._given, self._first, self._level = colours, first, level

    @cached_property
    def _colours(self) -> list[np.ndarray]:
        return [finite(colour) for colour in self._given]

    def unevenness(self, way: np.ndarray, shot: np.ndarray | None = None, alone: float = ALONE,
                   rows: int = COMPARED_ROWS) -> float:
        """`ways.unevenness` along a way (rows, columns, 2), in pixels."""
        return unevenness(self._colours, self._first, way, self._level, shot, alone, rows)

    def unevenness_over_blend(self, way: np.ndarray) -> float:
        """How unevenly colours change along a way (rows, columns, 2), as a multiple of how unevenly
        they change at one place: about 1 or more where another shot is blended in.

        Only changes that neighbouring cells share count. Noise is equally uneven along every way:
        if most of the change is noise, nothing can be told, and the result is 0.
        """
        measure = partial(self.unevenness, rows=DOUBTING_ROWS)
        along = measure(way, alone=0.0)
        worse = along / max(measure(np.zeros_like(way), alone=0.0), LEAST_UNEVEN)
        is_noise = worse > AS_EVEN and along <= MOSTLY_NOISE * measure(way)
        return 0.0 if is_noise else worse


def shares_beside_vectors(fit: MotionFit, around: Neighbours, vectors: np.ndarray, has_depth: bool,
                          find_flow: Callable[[], np.ndarray]) -> Shares:
    """The shares where the frame after has vectors, and motion was estimated beside them.

    Args:
        fit: how well both explain the two frames.
        around: the frames around the time.
        vectors: (rows, columns, 2) of cells, in pixels.
        has_depth: whether both frames have depth.
        find_flow: makes the motion that is estimated without any vectors, like them; it takes long.
    """
    if fit.vectors_fit and fit.is_thin:
        along_vectors, along_flow = fit.shares_of_thin(around.count)
        return Shares(along_vectors, along_flow)
    if not fit.vectors_fit and fit.is_thin_along_flow:
        return BY_FLOW
    doubt = 0.0
    if fit.vectors_explain_little(around.count):
        doubt = around.unevenness_over_blend(vectors)
    shows_blend = fit.vectors_stand_still and doubt <= MORE_EVEN
    if shows_blend:  # light may change, and goes on through four frames
        is_certain = has_depth or (fit.vectors_fit and around.count == 2)
    else:
        is_doubted = doubt > (AS_EVEN_ALONE if around.count == 2 else AS_EVEN)
        is_certain = fit.vectors_fit and not (fit.in_doubt or is_doubted)
    if is_certain:
        return BY_VECTORS
    return _shares_by_unevenness(fit, around, vectors, find_flow(), shows_blend)


def _shares_by_unevenness(fit: MotionFit, around: Neighbours, vectors: np.ndarray, flow: np.ndarray,
                          shows_blend: bool) -> Shares:
    """The shares by how evenly colours go on along each way.

    Args:
        fit, around, vectors: as in `shares_beside_vectors`.
        flow: motion that is estimated without any vectors, (rows, columns, 2) of cells, in pixels.
        shows_blend: whether the picture along the vectors is a blend, and no worse than one.
    """
    flowing = FLOW_HANDICAP * around.unevenness(flow)
    mean = around.unevenness(np.zeros_like(flow))
    over_shot = given = math.inf
    if around.count == 4:
        over_shot = REST_HANDICAP * around.unevenness(flow, shot=vectors)
    if fit.vectors_fit:
        given = around.unevenness(vectors)
    if fit.vectors_fit and shows_blend:
        if min(flowing, over_shot) > CLEARLY_BETTER * given:
            return BY_VECTORS
        mean = math.inf  # the vectors show it already
    return Shares(*shares_of((given, flowing, mean, over_shot)))


def shares_without_vectors(fit: MotionFit | None, around: Neighbours, flow: np.ndarray) -> Shares:
    """The shares where there are no vectors. Estimated motion alone counts, unless it explains
    little and colours go on about as evenly at the same place.

    Args:
        fit: how well estimated motion explains the frames, in place of vectors, too.
        around: the frames around the time.
        flow: estimated motion (rows, columns, 2) of cells, in pixels.
    """
    if fit is None or fit.is_thin_along_flow:
        return BY_VECTORS
    if fit.flow < LEAST_LEFT_OF_FLOW * fit.still:
        return BY_VECTORS
    if around.unevenness_over_blend(flow) <= LESS_EVEN_THAN_FLOW:
        return BY_VECTORS
    flowing, mean = shares_of((around.unevenness(flow), around.unevenness(np.zeros_like(flow))))
    return Shares(vectors=flowing, mean=mean)
