"""Small networks that run, and learn, within the commands of a frame. See docs/neural.md."""

from postfx.neural.network import Network
from postfx.neural.training import Learner

__all__ = ["Learner", "Network"]
