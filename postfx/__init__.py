"""postfx: post-processing of rendered image sequences."""

from postfx.frame import Frame, FrameSpec, Role
from postfx.paths import models_dir

__all__ = ["Frame", "FrameSpec", "Role", "models_dir"]
