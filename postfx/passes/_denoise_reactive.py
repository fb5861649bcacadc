"""Where the denoised upscaler leaves its history alone: what is seen there does not move with the surface behind it."""

from __future__ import annotations

from dataclasses import dataclass

from postfx.errors import PassOptionError
from postfx.frame import FrameSpec, Role
from postfx.kernels.denoise_reactive import REACTIVE
from postfx.passes.base import ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Tensor

SOURCES = {"auto": (Role.REACTIVE, Role.OPAQUE_COLOUR), "plane": (Role.REACTIVE,),
           "difference": (Role.OPAQUE_COLOUR,), "none": ()}
"""Words of the option `reactive` -> planes that the mask is made of, best first."""


@dataclass(frozen=True)
class ReactiveOption:
    """How the mask is made.

    Attributes:
        kind: one of `SOURCES`.
        scale: of the difference of the two colours as they are seen, each within 0..1; the mask is held within 1.
        threshold: below this difference the mask is 0.
    """

    kind: str
    scale: float = 4.0
    threshold: float = 0.05

    def role(self, spec: FrameSpec) -> Role | None:
        """The plane that the mask is made of; None where there is none, or no motion and therefore no history."""
        found = [role for role in SOURCES[self.kind] if spec.has(role)]
        return found[0] if found and spec.has(Role.MOTION) else None

    def demanded(self) -> tuple[Role, ...]:
        """The plane that the user asked for by name."""
        return SOURCES[self.kind] if len(SOURCES[self.kind]) == 1 else ()

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        """How the mask is made, for the user."""
        role = self.role(spec)
        if role is Role.OPAQUE_COLOUR:
            return (f"reactive mask from the difference of colour and {role}: times {self.scale:g}, "
                    f"0 below {self.threshold:g}",)
        return (f"reactive mask from the plane '{role}'",) if role else ()


def parse_reactive(text: str) -> ReactiveOption:
    """Option of a text: auto, plane, difference or none, then scale= and threshold=, parted by commas.

    'difference,scale=8,threshold=0.02' marks faint smoke, too. Raises PassOptionError for anything else.
    """
    kind, *pairs = [word.strip() for word in text.split(",")]
    if kind not in SOURCES:
        raise PassOptionError(f"reactive '{text}': begin with {', '.join(SOURCES)}")
    numbers = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        if name not in ("scale", "threshold"):
            raise PassOptionError(f"reactive '{text}': unknown '{name}': use scale= or threshold=")
        try:
            numbers[name] = float(value)
        except ValueError:
            numbers[name] = -1.0
        if not numbers[name] >= 0:
            raise PassOptionError(f"reactive '{text}': '{pair}' needs a number from 0 on, e.g. {name}=0.1")
    return ReactiveOption(kind, **numbers)


class Reactive:
    """The mask of each frame: its plane, or made of the difference of two colours."""

    def __init__(self, device: Device, spec: FrameSpec, option: ReactiveOption) -> None:
        self._role, self._option = option.role(spec), option
        if self._role is Role.OPAQUE_COLOUR:
            self._difference = device.heap.tensor("difference", (3,))
            self._output = device.heap.transient("reactive", (spec.height, spec.width, 1))
            tensors = {"difference": self._difference, "reactive": self._output}
            self._table = ArgumentTable(device.compute_state(REACTIVE), tensors)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> dict[str, Tensor]:
        """Record the work, where there is any; returns the mask by its name for the kernels, or nothing."""
        if self._role is None:
            return {}
        if self._role is Role.REACTIVE:
            return {"reactive": frame[Role.REACTIVE]}
        self._difference.upload([frame.exposure, self._option.scale, self._option.threshold])
        self._table["colour"], self._table["opaque_colour"] = frame[Role.COLOUR], frame[Role.OPAQUE_COLOUR]
        with commands.compute_encoder("reactive") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._table.state, self._table)
        return {"reactive": self._output}
