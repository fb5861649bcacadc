"""What the denoised upscaler has ready for frames of one size."""

from __future__ import annotations

from collections.abc import Mapping

from postfx.frame import FrameSpec, Role
from postfx.passes._denoise_carried import Carried
from postfx.passes._denoise_frame import Frames
from postfx.passes._denoise_graph import grid_of
from postfx.passes._denoise_history import History
from postfx.passes._denoise_planes import Planes
from postfx.passes._denoise_reactive import Reactive, ReactiveOption
from postfx.passes._denoise_reflections import Reflections, can_follow
from postfx.passes._denoise_restore import Restore
from postfx.passes._denoise_size import Size
from postfx.passes._denoise_strength import Plain, Strength
from postfx.passes._denoise_window import Sizes
from postfx.runtime import Device


class Ready:
    """Pipeline states, tensors and argument tables for frames of one spec.

    Attributes:
        carried: what is only resampled, beside the colour.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self.carried = Carried(device, spec, output)


class ReadyPlain(Ready):
    """Where no network runs.

    Attributes:
        plain: the input, resampled.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        super().__init__(device, spec, output)
        self.plain = Plain(device, spec, output)


class ReadyNetwork(Ready):
    """Where a network runs.

    Attributes:
        planes: what its kernels read.
        models: the networks of this size by tag, of which each frame takes one.
        frames: what runs them.
        reactive: the mask of where the history is not used.
        reflections: where frames have what it needs, else None.
        restore: at render size only, else None.
        strength: None where all of the picture is fully denoised.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, models: Mapping[str, str], history: History,
                 guided: bool, strength: float, mask: ReactiveOption) -> None:
        super().__init__(device, spec, output)
        sizes = Sizes(spec.height, spec.width, *output, grid_of(models.values()))
        self.models = models
        self.planes = Planes(device, spec, output, guided)
        self.reflections = Reflections(device, spec) if can_follow(spec) else None
        self.reactive = Reactive(device, spec, mask)
        self.frames = Frames(device, sizes, list(models.values()), history, guided, mask.role(spec) is not None)
        self.restore = Restore(device, output) if output == (spec.height, spec.width) else None
        full = strength == 1 and not spec.has(Role.STRENGTH)
        self.strength = None if full else Strength(device, spec, output, strength)
