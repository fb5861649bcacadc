"""Neural tone mapper: exposed scene-linear colour in, display colour of a trained look out, steady
over time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Never

import numpy as np

from postfx.errors import PassOptionError, offer
from postfx.frame import FrameSpec, Role
from postfx.kernels import Kernel
from postfx.kernels.colour import APPLY_CUBE, form_of
from postfx.kernels.tonemap import EXPOSE, FOLLOW, LIGHT, LOWRES, SLICE_APPLY, SMOOTH_GRID
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.runtime import CommandBuffer, Device, Library, ModelError, PipelineState, Tensor
from postfx.runtime.models import check_card_beside

_KEEP = 0.6
"""Part of the last grid that is kept, for looks whose card does not say it."""
_FOLLOW = 0.6
"""Part of the way that the grid goes in a frame when light changes, likewise."""
_MOST = 1e6
"""Largest constant of a look: no sum of a few products overflows."""
_SHAPER = "toe and scale above 0, and a matrix of 9 numbers"


class Shaper(NamedTuple):
    """The curve that a look's model was trained behind; see ``postfx.kernels.colour``."""

    toe: float
    scale: float
    matrix: np.ndarray


def find_tone_mapper(tag: str) -> tuple[Library, str]:
    """The library and the name in it of a look by tag, or of a model file."""
    if tag.endswith(".onnx"):
        return Library(Path(tag).parent), Path(tag).stem
    return Library(), f"tonemap.{tag}"


def looks_by_name() -> list[str]:
    """Names of the looks that come with postfx."""
    return [name.removeprefix("tonemap.")
            for name in Library().names() if name.startswith("tonemap.")]


def _check_look(look: str) -> None:
    """Raise PassOptionError for a look that is not there, by name or as a file."""
    looks = looks_by_name()
    if look.endswith(".onnx"):
        if not Path(look).is_file():
            raise PassOptionError(f"look '{look}': no such file: check the path and its rights")
        check_card_beside(Path(look))
    elif look not in looks:
        raise PassOptionError(f"no look '{look}'{offer(look, looks, 'give')}, or a file of a model")


def shaper(library: Library, model: str) -> Shaper:
    """The shaper of a model, from its card. ModelError if it is missing or impossible."""
    given: Any = library.card(model).get("shaper")
    try:
        found = Shaper(float(given["toe"]), float(given["scale"]),
                       np.array(given["matrix"], np.float32))
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ModelError(f"card of model '{model}' gives no shaper ({_SHAPER}): export the model "
                         "again") from None
    if found.matrix.shape != (9,) or not (np.isfinite(found.matrix).all() and 0 < found.toe < np.inf
                                          and 0 < found.scale < np.inf):
        raise ModelError(f"card of model '{model}' gives a shaper that cannot be: it needs "
                         f"{_SHAPER}")
    return found


def keep_of(library: Library, model: str) -> float:
    """Part of the last frame's grid that a look keeps, from its card. ModelError when it is not
    from 0 to below 1."""
    given = library.card(model).get("keep", _KEEP)
    if not _is_number(given) or not 0 <= given < 1:
        raise ModelError(f"card of model '{model}' keeps {given!r} of the last grid, not 0 to "
                         "below 1")
    return float(given)


def follow_of(library: Library, model: str) -> float:
    """Part of the way that the grid goes in a frame when light changes, from a look's card.
    ModelError when it is not from 0 to 1."""
    given = library.card(model).get("follow", _FOLLOW)
    if not _is_number(given) or not 0 <= given <= 1:
        raise ModelError(f"card of model '{model}' follows {given!r} of a change of light, not 0 "
                         "to 1")
    return float(given)


def _is_number(given: object) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool)


def check_constants(model: str, constants: Mapping[str, np.ndarray], has_grid: bool) -> None:
    """ModelError when a look's constants are not those that the kernels take: they look up without
    checking bounds."""
    wanted = {"cube", "guide"} if has_grid else {"cube"}
    if set(constants) != wanted:
        raise ModelError(f"model '{model}' is not a look: its card marks "
                         f"{', '.join(sorted(constants)) or 'no output'} as constant, not "
                         f"{', '.join(sorted(wanted))}")
    shape = constants["cube"].shape
    if len(shape) != 4 or min(shape) < 2 or shape[3] != 3:
        raise ModelError(f"model '{model}' is not a look: its cube is {shape}, not (n, n, n, 3) "
                         "with n of 2 and more")
    if not all((np.abs(values) <= _MOST).all() for values in constants.values()):
        raise ModelError(f"model '{model}' is not a look: it holds NaN or numbers beyond {_MOST:g}")


class _History(NamedTuple):
    """The tensors that a frame leaves to the next: the smoothed grid or exposure, and the light
    that it is made for."""

    held: Tensor
    light: Tensor


class _Kind(NamedTuple):
    """A kind of look with a network.

    Attributes:
        made: the network's output: a grid of colour matrices, or one exposure.
        hold: kernel that keeps it steady over time.
        show: kernel that applies it to the picture.
        shown_by: the argument of `show` that takes it.
    """

    made: str
    hold: Kernel
    show: Kernel
    shown_by: str


_LOOK_KINDS = _Kind("grid", SMOOTH_GRID, SLICE_APPLY, "grid"), _Kind("stops", EXPOSE, APPLY_CUBE,
                                                                     "params")


class ToneMap(Pass):
    """Gives scene-linear light a look for an sRGB display.

    A small network looks at a 256x256 copy and gives a grid of colour matrices, looked up at every
    pixel (HDRNet), or one exposure. A colour cube follows. Looks that depend on colour alone are a
    cube without a network.

    Options:
        look: its name, as in ``tonemap.<look>``, or the file of a model:
            ``looks/tonemap.mine.onnx``.
        keep: part of the last frame's grid or exposure that is kept in steady light, 0 up to (not
            including) 1, by default as the look's card says; less is kept while light changes
            (``postfx.kernels.tonemap``), and none at the first frame and at cuts. Still pictures do
            not change; 0 ignores earlier frames.

    Colour comes out sRGB-encoded in [0, 1]. Raises PassOptionError for a look that is not there and
    a keep outside [0, 1).
    """

    name: ClassVar[str] = "tonemap"

    renamed: ClassVar[Mapping[str, str]] = MappingProxyType({"tag": "look"})

    def __init__(self, look: str = "aces2", *, keep: float | None = None, **unknown: Never) -> None:
        super().__init__(look=look, keep=keep, **unknown)
        _check_look(str(look))
        if keep is not None and not 0 <= self._number("keep", keep) < 1:
            raise PassOptionError(f"pass '{self.name}' keeps 0 to below 1 of the last grid, not "
                                  f"{keep}")

    def reflect(self, spec: FrameSpec) -> Reflection:
        output = FrameSpec(spec.width, spec.height, spec.planes, "srgb")
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=output)

    def skip(self, spec: FrameSpec) -> str | None:
        return None if spec.encoding == "scene-linear" else f"colour is {spec.encoding} already"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        library, model = find_tone_mapper(str(self.options["look"]))
        network = device.pipeline_state(library, model)
        made = {binding.name for binding in network.bindings}
        self._kind = next((kind for kind in _LOOK_KINDS if kind.made in made), None)
        check_constants(model, network.constants, "grid" in made)
        self._shaper, given = shaper(library, model), self.options["keep"]
        keep = keep_of(library, model) if given is None else float(given)
        self._following = keep, follow_of(library, model)
        self._params = device.heap.tensor("tonemap params", (3,))
        matrix = device.heap.tensor("tonemap matrix", (9,))
        matrix.upload(self._shaper.matrix)
        self._output = device.heap.transient("display colour", (spec.height, spec.width, 3))
        self._show = self._kind.show if self._kind else APPLY_CUBE
        constants = dict(network.constants)
        if self._show is APPLY_CUBE:
            self._show, constants["cube"] = form_of(constants["cube"], device.gpu is not None)
        self._shaping = {"params": self._params, "matrix": matrix}
        self._shown = self._shaping | {"output": self._output} | {
            name: device.wrap(name, values) for name, values in constants.items()}
        if self._kind:
            self._compile_network(device, network, self._kind)
        device.make_ready(self._show)
        super().compile(device, spec)

    def _compile_network(self, device: Device, network: PipelineState, kind: _Kind) -> None:
        """Make the network ready, with the kernels and tensors around it."""
        self._network = network
        device.make_ready(LOWRES, LIGHT, FOLLOW, kind.hold)
        self._lowres, self._made = (device.heap.transient(name, network.shapes[name])
                                    for name in ("lowres", kind.made))
        self._light = device.heap.transient("tonemap light", LIGHT.fixed_shape("light"))
        self._pace = device.heap.tensor("tonemap pace", FOLLOW.fixed_shape("params"))
        self._history = [_History(device.heap.tensor("held", kind.hold.fixed_shape("result")),
                                  device.heap.tensor("light followed", FOLLOW.fixed_shape("after")))
                         for _ in range(2)]
        for tensor in (*self._history[0], *self._history[1]):
            tensor.fill(0)

    def reset(self) -> None:
        self._fresh = False

    def history(self) -> dict[str, np.ndarray]:
        return ({name: tensor.content() for name, tensor in self._history[1]._asdict().items()}
                if self._fresh else {})

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._fresh = bool(history)
        if self._fresh:
            for name, tensor in self._history[1]._asdict().items():
                tensor.upload(history[name])

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._params.put(np.array([frame.exposure_factor, self._shaper.toe, self._shaper.scale],
                                  np.float32))
        colour = frame[Role.COLOUR]
        if self._kind:
            past = self._fresh and not frame.reset
            self._pace.put(np.array([*self._following, past, self._shaper.scale], np.float32))
            self._history.reverse()
            commands.repeat((self, self._output, colour, self._history[0].light),
                            partial(self._encode_network, commands, colour, self._kind))
            self._fresh = True
        else:
            commands.repeat((self, self._output, colour),
                            partial(self._encode_cube, commands, colour))
        frame.set(Role.COLOUR, self._output)

    def _encode_cube(self, commands: CommandBuffer, colour: Tensor) -> None:
        commands.run(self._show, "cube", colour=colour, **self._shown)

    def _encode_network(self, commands: CommandBuffer, colour: Tensor, kind: _Kind) -> None:
        """Record the network and the kernels around it. The two sets of the history swap from frame
        to frame."""
        before, after = self._history
        commands.run(LOWRES, "lowres", colour=colour, lowres=self._lowres, **self._shaping)
        commands.run(LIGHT, "lowres", lowres=self._lowres, light=self._light)
        commands.run(FOLLOW, "lowres", light=self._light, params=self._pace, before=before.light,
                     after=after.light)
        commands.run(self._network, "coefficients",
                     **{"lowres": self._lowres, kind.made: self._made})
        held = {"current": self._made, "previous": before.held, "keep": after.light,
                "result": after.held}
        commands.run(kind.hold, "show", **held,
                     **{name: self._shown[name] for name in kind.hold.reads if name in self._shown})
        commands.run(self._show, "show",
                     **self._shown | {"colour": colour, kind.shown_by: after.held})
