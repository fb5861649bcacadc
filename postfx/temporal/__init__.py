"""Frames in reverse order, so that a frame gains from the frames after it as it does from those before it."""

from postfx.temporal.bidirectional import Backwards
from postfx.temporal.run_up import RunUp

__all__ = ["Backwards", "RunUp"]
