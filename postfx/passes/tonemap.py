"""Neural tone mapper: exposed scene-linear colour in, display colour of a trained look out, steady over time."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from postfx.frame import FrameSpec, Role
from postfx.kernels.lowres import LOWRES
from postfx.kernels.slice_apply import SLICE_APPLY
from postfx.kernels.smooth import SMOOTH
from postfx.passes.base import Pass, PassOptionError, Reflection, ResidentFrame
from postfx.runtime import ArgumentTable, CommandBuffer, Device, Library, ModelError, Tensor


class ToneMap(Pass):
    """HDRNet: a small network looks at a 256x256 copy and gives a grid of colour matrices, looked up at every pixel.

    Options:
        tag: the look, as in ``tonemap.<tag>``.
        keep: part of the last frame's grid that is kept, 0 up to (not including) 1; the grid of a still picture does
            not change. It is dropped at the first frame and at cuts.

    Colour comes out sRGB-encoded in [0, 1]. Raises PassOptionError for a keep outside [0, 1).
    """

    name: ClassVar[str] = "tonemap"
    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({"tag": "aces2", "keep": 0.6})

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        if not 0 <= float(self.options["keep"]) < 1:
            raise PassOptionError(f"pass '{self.name}' keeps 0 to below 1 of the last grid, not {self.options['keep']}")

    def reflect(self, spec: FrameSpec) -> Reflection:
        output = FrameSpec(spec.width, spec.height, {Role.COLOUR: 3, **dict(spec.planes)}, "srgb")
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=output)

    def skip(self, spec: FrameSpec) -> str | None:
        return None if spec.encoding == "scene-linear" else f"colour is {spec.encoding} already"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        library, model = Library(), f"tonemap.{self.options['tag']}"
        self._shaper = _shaper(library, model)
        self._network = device.pipeline_state(library, model)
        shapes = {binding.name: binding.shape for binding in self._network.bindings}
        new, between = device.heap.tensor, device.heap.transient
        self._params, self._keep = new("tonemap params", (3,)), new("tonemap keep", (1,))
        self._lowres, self._grid = between("lowres", shapes["lowres"]), between("grid", shapes["grid"])
        self._history = [new("smoothed grid", shapes["grid"]) for _ in range(2)]
        for grid in self._history:
            grid.fill(0)
        guide = device.wrap("guide", self._network.constants["guide"])
        self._output = between("display colour", (spec.height, spec.width, 3))
        self._tables = {
            "lowres": ArgumentTable(device.compute_state(LOWRES), {"params": self._params, "lowres": self._lowres}),
            "smooth": ArgumentTable(device.compute_state(SMOOTH), {"current": self._grid, "keep": self._keep}),
            "slice": ArgumentTable(
                device.compute_state(SLICE_APPLY), {"params": self._params, "guide": guide, "output": self._output}
            ),
            "network": ArgumentTable(self._network, {"lowres": self._lowres, "grid": self._grid}),
        }
        super().compile(device, spec)

    def reset(self) -> None:
        self._fresh = False

    def history(self) -> dict[str, np.ndarray]:
        return {"grid": self._history[1].content()} if self._fresh else {}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._fresh = bool(history)
        if self._fresh:
            self._history[1].upload(history["grid"])

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        keep = float(self.options["keep"]) if self._fresh and not frame.reset else 0.0
        self._params.upload(np.array([frame.exposure, *self._shaper], np.float32))
        self._keep.upload(np.array([keep], np.float32))
        self._bind(frame[Role.COLOUR])
        with commands.compute_encoder("lowres") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            encoder.dispatch(self._tables["lowres"].state, self._tables["lowres"])
        with commands.machine_learning_encoder("coefficients") as encoder:
            encoder.barrier(after="compute", before="machine-learning")
            encoder.dispatch_network(self._network, self._tables["network"])
        with commands.compute_encoder("slice") as encoder:
            encoder.barrier(after="machine-learning", before="compute")
            encoder.dispatch(self._tables["smooth"].state, self._tables["smooth"])
            encoder.barrier()
            encoder.dispatch(self._tables["slice"].state, self._tables["slice"])
        frame.set(Role.COLOUR, self._output)
        self._fresh = True

    def _bind(self, colour: Tensor) -> None:
        """Bind the frame's colour, and swap the two grids of the history."""
        self._history.reverse()
        previous, result = self._history
        self._tables["lowres"]["colour"] = colour
        self._tables["smooth"]["previous"], self._tables["smooth"]["result"] = previous, result
        self._tables["slice"]["colour"], self._tables["slice"]["grid"] = colour, result


def _shaper(library: Library, model: str) -> tuple[float, float]:
    """Toe and scale of the shaper that a model was trained with, from its card."""
    shaper = library.card(model).get("shaper")
    if not isinstance(shaper, dict) or not {"toe", "scale"} <= shaper.keys():
        raise ModelError(f"card of model '{model}' gives no shaper (toe and scale): export the model again")
    return float(shaper["toe"]), float(shaper["scale"])
