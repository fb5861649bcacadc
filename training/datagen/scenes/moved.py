"""Where surface points were in the previous frame: a matrix for each shape, and a shift for each corner that bends."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

RIGID = 0xFFFFFFFF


@dataclass(frozen=True)
class Motions:
    """Tables on the device: 3x4 `matrices` by shape id, `starts` of a shape's triangles in `corners`, or RIGID.

    `corners` holds, for each triangle of a shape that bends, 3 shifts to be added after the matrix.
    """

    matrices: mi.Float
    starts: mi.UInt32
    corners: mi.Float

    @classmethod
    def of(cls, matrices: np.ndarray, bending: dict[int, np.ndarray]) -> Motions:
        """From matrices (S, 3, 4) and, by shape id, shifts (M, 3, 3) of triangles."""
        starts, total = np.full(len(matrices), RIGID, np.uint32), 0
        for shape_id, shifts in bending.items():
            starts[shape_id] = total
            total += len(shifts)
        corners = np.concatenate([shifts.ravel() for shifts in bending.values()] or [np.zeros(9)])
        flat = matrices.astype(np.float32).ravel()
        return cls(mi.Float(flat), mi.UInt32(starts), mi.Float(corners.astype(np.float32)))

    def vector(self, row: mi.UInt32, v: mi.Vector3f) -> mi.Vector3f:
        columns = [self._column(row, k) for k in range(3)]
        return columns[0] * v.x + columns[1] * v.y + columns[2] * v.z

    def point(self, row: mi.UInt32, hit: mi.PreliminaryIntersection3f, point: mi.Point3f) -> mi.Point3f:
        """Of the surface `point` of shape `row` that a preliminary intersection found."""
        start = dr.gather(mi.UInt32, self.starts, row)
        bends = start != RIGID
        triangle = dr.select(bends, start + hit.prim_index, 0)
        b1, b2 = hit.prim_uv.x, hit.prim_uv.y
        shift = sum(weight * mi.Vector3f(*(dr.gather(mi.Float, self.corners, triangle * 9 + 3 * corner + i, bends)
                                           for i in range(3)))
                    for corner, weight in enumerate((1 - b1 - b2, b1, b2)))
        moved = self.vector(row, mi.Vector3f(point)) + self._column(row, 3)
        return mi.Point3f(moved + dr.select(bends, shift, 0))

    def _column(self, row: mi.UInt32, column: int) -> mi.Vector3f:
        return mi.Vector3f(*(dr.gather(mi.Float, self.matrices, row * 12 + 4 * i + column) for i in range(3)))
