"""Sequences in reverse order, so that frames profit from those after them as they do from those before."""

from postfx.backwards.run_up import RunUp
from postfx.backwards.sweep import Backwards

__all__ = ["Backwards", "RunUp"]
