"""Colour for a display: `Display` converts it, `View` tone-maps it without a network."""

from __future__ import annotations

from functools import partial
from typing import ClassVar, Never

import numpy as np

from postfx.colour import REC709, Chromaticities, matrix_between, to_xyz
from postfx.colour.displays import Display as Target
from postfx.colour.displays import parse_display
from postfx.colour.views import AXIS_SCALE, AXIS_TOE, VIEWS, bake, find_view, is_view
from postfx.errors import ColourError, PassOptionError, offer
from postfx.frame import LINEAR, FrameSpec, Role
from postfx.kernels import BRIGHTEST
from postfx.kernels.colour import (
    ENCODE_DISPLAY,
    ROOT,
    SHOW_NEUTRAL,
    SHOW_REINHARD,
    STEPS,
    form_of,
)
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.passes.registry import create
from postfx.plan import Skip
from postfx.runtime import CommandBuffer, Device, Tensor
from postfx.workers import Workers

THREAD_ROWS = 32
"""Rows of a picture that one thread shows at a time."""
VIEW_KERNELS = {"neutral": SHOW_NEUTRAL, "reinhard": SHOW_REINHARD}
"""Views that are kernels, by name; the display's kernel encodes their light."""


class Display(Pass):
    """Colour to code values of a display, in its primaries; values that the display cannot show are
    clipped.

    Scene-linear colour is exposed first; its 1 becomes diffuse white. Pictures made for an SDR
    display keep their colours: white stays white, on an HDR display at the light that it gives to
    diffuse white, and nothing is brighter.

    Options:
        display: 'srgb', 'p3', 'rec709', 'rec2020', 'pq' or 'hlg', the last two with ',peak=NITS'
            (1000) and ',white=NITS' (203, diffuse white), see `postfx.colour.displays`.
    """

    name: ClassVar[str] = "display"

    def __init__(self, display: str = "srgb", **unknown: Never) -> None:
        super().__init__(display=display, **unknown)
        self._target = parse_display(display)

    def reflect(self, spec: FrameSpec) -> Reflection:
        _source(spec, self._target)
        output = FrameSpec(spec.width, spec.height, spec.planes, str(self._target))
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=output)

    def skip(self, spec: FrameSpec) -> str | None:
        return f"colour is {spec.encoding} already" if spec.encoding == str(self._target) else None

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        if _source(spec, self._target) is None or not self._target.hdr:
            return ()
        return (f"the picture was made for {spec.encoding}: its white is shown at "
                f"{self._target.white:g} nits, nothing is brighter",)

    def compile(self, device: Device, spec: FrameSpec) -> None:
        source = _source(spec, self._target)
        self._params = device.heap.tensor("display params", (12,))
        self._output = device.heap.transient("display colour", (spec.height, spec.width, 3))
        self._curves = _curves(device, source, self._target)
        device.make_ready(ENCODE_DISPLAY)
        self._exposed, self._source = spec.encoding == "scene-linear", source
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._params.upload(parameters(self._source, self._target,
                                       frame.exposure_factor if self._exposed else 1.0))
        commands.run(ENCODE_DISPLAY, "encode", colour=frame[Role.COLOUR], params=self._params,
                     output=self._output, **self._curves)
        frame.set(Role.COLOUR, self._output)


def parameters(source: Target | None, target: Target, exposure_factor: float = 1.0,
               primaries: Chromaticities = REC709) -> np.ndarray:
    """Parameters of the kernel `encode_display`, from code values of a display, or from light of
    some primaries (None)."""
    matrix = matrix_between(source.kind.primaries if source else primaries, target.kind.primaries)
    exponent = 1 / target.system_gamma - 1
    matrix = matrix * exposure_factor / target.unit
    values = [*matrix.ravel(), source is not None, target.most / target.unit, exponent]
    return np.array(values, np.float32)


def decoding(source: Target | None) -> np.ndarray:
    """Table `decode` of the kernel; zeros where colour is light."""
    light = (source.kind.curve.decode(np.linspace(0, 1, STEPS + 1)) if source
             else np.zeros(STEPS + 1))
    return _table(light)


def encoding(target: Target) -> np.ndarray:
    """Table `encode` of the kernel. Between the entries it errs by less than 2e-6 (PQ: 5e-6) of the
    code range."""
    return _table(target.kind.curve.encode(np.linspace(0, 1, STEPS + 1) ** ROOT))


def _curves(device: Device, source: Target | None, target: Target) -> dict[str, Tensor]:
    """Both tables of the kernel as tensors."""
    found = {}
    for name, values in (("decode", decoding(source)), ("encode", encoding(target))):
        found[name] = device.heap.tensor(f"display {name}", values.shape)
        found[name].upload(values)
    return found


def _table(values: np.ndarray) -> np.ndarray:
    return np.append(values, values[-1]).astype(np.float32)


def _source(spec: FrameSpec, target: Target) -> Target | None:
    """The display of the colour's code values, None for light. Raises PassOptionError for HDR
    pictures."""
    source = None if spec.encoding in LINEAR else parse_display(spec.encoding)
    if source and source.hdr and str(source) != str(target):
        raise PassOptionError(f"pass 'display' cannot turn {source} into {target}: tone-map for "
                              "that display instead")
    return source


class View(Pass):
    """Exposed scene-linear colour to code values of a display, by a view of OpenColorIO, a look-up
    table or a formula.

    Formulas are kernels. Other views are evaluated for every pixel on the host, and so are formulas
    where kernels run by their portable definitions. With `exact=False` a cube of 65x65x65 stands in
    for these, on the device, which takes a fraction of the time. In saturated light it is up to 10
    of 255 steps off.

    Options:
        view: 'neutral' (Khronos PBR Neutral), 'reinhard', 'ocio:VIEW' of the config $OCIO or the
            built-in ACES 2 config, 'ocio:VIEW@DISPLAY', or 'FILE.cube,input=SPACE', see
            `postfx.colour.views.find_view`.
        display: the display to make the picture for, see `Display`. A view that is
            made for one display keeps it: 'neutral' gives srgb, a table the display that it is made
            for.
        exact: whether the view is evaluated for every pixel, not looked up in a cube. What is not
            finite counts as 0, or as the brightest light there is.

    Raises ColourError if there is no such view.
    """

    name: ClassVar[str] = "view"

    def __init__(self, view: str = "neutral", *, display: str = "srgb", exact: bool = True,
                 **unknown: Never) -> None:
        super().__init__(view=view, display=display, exact=exact, **unknown)
        self._view_name, self._exact = view, bool(exact)
        self._view = find_view(view, parse_display(display))
        self.choice = self._view.title
        self._matrix = matrix_between(REC709, self._view.primaries)
        # a table is read now, so that a broken one is told before any frame
        self._view.apply(np.zeros((1, 3)))

    @property
    def output(self) -> str:
        """Encoding of the colour that comes out."""
        return str(self._view.display)

    def reflect(self, spec: FrameSpec) -> Reflection:
        output = FrameSpec(spec.width, spec.height, spec.planes, self.output)
        return Reflection(reads=(Role.COLOUR,), writes=(Role.COLOUR,), output=output)

    def skip(self, spec: FrameSpec) -> str | None:
        return None if spec.encoding == "scene-linear" else f"colour is {spec.encoding} already"

    def compile(self, device: Device, spec: FrameSpec) -> None:
        size = spec.height, spec.width, 3
        self._output, self._cube = device.heap.transient("display colour", size), {}
        self._numbers: tuple[float, ...] = (AXIS_TOE, AXIS_SCALE)
        # formulas have no portable definition
        has_formulas = device.runs_rows or device.gpu is not None
        self._formula = VIEW_KERNELS.get(self._view_name) if has_formulas else None
        if self._formula:
            own, display = self._view.primaries, self._view.display
            self._numbers = (*self._matrix.ravel(), *to_xyz(own)[1], display.most)
            self._light = device.heap.transient("display light", size)
            self._encoding = {"params": device.heap.tensor("display params", (12,)),
                              **_curves(device, None, display)}
            self._encoding["params"].upload(parameters(None, display, primaries=own))
            device.make_ready(self._formula, ENCODE_DISPLAY)
        elif self._exact:
            self._workers = Workers(device.threads, "postfx view")
            self._state = device.host_state("view", ("colour", "params"), ("output",), self._show)
        else:
            kernel, values = form_of(bake(self._view), device.gpu is not None)
            self._cube = {"matrix": device.heap.tensor("view matrix", (9,)),
                          "cube": device.heap.tensor("cube", values.shape)}
            self._cube["matrix"].upload(self._matrix.ravel())
            self._cube["cube"].upload(values)
            self._state = device.compute_state(kernel)
        self._params = device.heap.tensor("view params", (1 + len(self._numbers),))
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._params.put(np.array([frame.exposure_factor, *self._numbers], np.float32))
        colour = frame[Role.COLOUR]
        commands.repeat((self, colour, self._output), partial(self._record, commands, colour))
        frame.set(Role.COLOUR, self._output)

    def _record(self, commands: CommandBuffer, colour: Tensor) -> None:
        if self._formula:
            commands.run(self._formula, "show", colour=colour, params=self._params,
                         output=self._light)
            commands.run(ENCODE_DISPLAY, "encode", colour=self._light, output=self._output,
                         **self._encoding)
        else:
            commands.run(self._state, "view", colour=colour, params=self._params,
                         output=self._output, **self._cube)

    def _show(self, colour: np.ndarray, params: np.ndarray, output: np.ndarray) -> None:
        matrix, most = self._matrix * float(params[0]), float(BRIGHTEST)

        def show_rows(first: int) -> None:
            rows = slice(first, first + THREAD_ROWS)
            light = np.nan_to_num(colour[rows].astype(np.float64), posinf=most,
                                  neginf=-most) @ matrix.T
            output[rows] = self._view.apply(np.clip(light, -most, most))

        list(self._workers.map(show_rows, range(0, len(colour), THREAD_ROWS)))


def is_shown(is_picture: bool, tonemap: str | None = None, display: str | None = None,
             **_: object) -> bool:
    """Whether the options of a look, and files that hold pictures, ask for colours of a display."""
    return is_picture or display is not None or tonemap is not None


def make_display_passes(
    is_picture: bool, tonemap: str | None = None, no_tonemap: bool = False,
    display: str | None = None, fast: bool = False
) -> tuple[list[Pass], list[Skip]]:
    """Passes that make pictures for a display, and what is left out.

    is_picture: the files hold such pictures. fast: whether a cube stands in for a view.

    Raises ColourError for an unknown display or view.
    """
    if not is_shown(is_picture, tonemap, display):
        why = ("--no-tonemap" if no_tonemap
               else "EXR output stays scene-linear; --tonemap changes that")
        return [], [Skip("tonemap", why)]
    shown_on = str(parse_display(display or "srgb"))
    if no_tonemap:
        return [create("display", display=shown_on)], [Skip("tonemap", "--no-tonemap")]
    if tonemap and is_view(tonemap):
        view = View(view=tonemap, display=shown_on, exact=not fast)
        mapper: Pass = view
        made_for = view.output
    else:
        mapper = create("tonemap", **({"look": _find_look(tonemap)} if tonemap else {}))
        made_for = "srgb"
    return [mapper] + ([create("display", display=shown_on)] if made_for != shown_on else []), []


def _find_look(tag: str) -> str:
    """The tag or file of a network; ColourError that lists all looks for any other word."""
    from postfx.passes.tonemap import looks_by_name  # which loads what views do without

    tags = looks_by_name()
    if tag not in tags and not tag.endswith(".onnx"):
        looks = [*tags, *VIEWS]
        raise ColourError(f"no look '{tag}'{offer(tag, looks, 'there are')}, ocio:VIEW, "
                          "FILE.cube,input=SPACE and FILE.onnx")
    return tag
