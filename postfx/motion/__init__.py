"""Motion that planes show: of a camera, by the points that it sees, and of pictures, by optical
flow."""

from __future__ import annotations

from postfx.frame import Role

MOTION_SOURCES = (Role.DIFFUSE_ALBEDO, Role.NORMAL)
"""Planes that motion is estimated from; one of them is enough."""
