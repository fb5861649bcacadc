"""The contract of a pass: it reflects on a spec, compiles once for it, and encodes every frame.

A pass is one file or package, found through the entry-point group `postfx.passes`. It gets a
`ResidentFrame`, whose planes are tensors on the device. docs/howto/passes.md builds a pass.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from functools import lru_cache
from inspect import Parameter, signature
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from postfx.errors import FrameError, NotCompiledError, PassOptionError, offer
from postfx.frame import ROLES, FrameSpec, GuideSpec, Role, find_role
from postfx.planes import is_blank
from postfx.runtime.memory import follow_torch

if TYPE_CHECKING:
    import numpy as np

    from postfx.runtime import CommandBuffer, Device, Tensor


MOST_SIZES = 4
"""Most frame sizes for which a pass stays compiled."""


@dataclass(frozen=True)
class Reflection:
    """What a pass does with a frame of one spec.

    Attributes:
        reads: planes it cannot do without.
        may_read: planes it uses if the frame has them.
        writes: planes it replaces or adds.
        output: spec of the frame it leaves. Planes and guides that are not in it are dropped, so a
            pass that changes the size names only those that exist at the new size.
        may_read_guides: planes at output size that it uses if the frame has them.
        parts: names of the parts of the picture that it reads, and leaves at the output's size.
        notes: short clauses for the user on its work on such frames.
    """

    reads: tuple[Role, ...]
    writes: tuple[Role, ...]
    output: FrameSpec
    may_read: tuple[Role, ...] = ()
    may_read_guides: tuple[Role, ...] = ()
    notes: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()


@dataclass
class ResidentFrame:
    """A frame whose planes are tensors on the device, on its way through the passes.

    Attributes:
        spec: current size, planes and encoding of the frame.
        tensors: role -> tensor (height, width, channels) float32, units and directions as in
            `postfx.frame.ROLES`.
        number: frame number in its sequence.
        jitter: sub-pixel sample position minus 0.5, pixels of the rendered frame, x right, y down.
            A pass whose output is no longer jittered sets it to (0, 0).
        exposure_factor: > 0; the viewer should see this frame's light times this factor.
        reset: True when history must be dropped before this frame.
        unusable: True when most of the colour was not finite and became 0: the next frame should
            not build on it.
        samples, world_to_camera, fov_x, metadata, guide_jitter: as in `postfx.frame.Frame`.
        guides: role -> tensor at output size, like `tensors`; only those that passes read.
        host_planes: role -> plane on the host, for planes that no pass has replaced. Passes may
            look at them to decide what to record.
        host_guides: likewise, for guides.
        parts: name -> tensor of a part that passes read, see `postfx.frame.Frame`.
        host_parts: likewise, for parts.
        blank: roles of planes that a pass replaced and that are 0 everywhere.
        history_only: True when the frame's picture is not needed, only the history that passes
            keep of it.
        came_on_device: True when the planes came in the device's memory, so that looking at
            `host_planes` copies them.
    """

    spec: FrameSpec
    tensors: dict[Role, Tensor]
    number: int = 1
    jitter: tuple[float, float] = (0.0, 0.0)
    exposure_factor: float = 1.0
    reset: bool = False
    unusable: bool = False
    samples: int | None = None
    world_to_camera: np.ndarray | None = None
    fov_x: float | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    guides: dict[Role, Tensor] = field(default_factory=dict)
    guide_jitter: tuple[float, float] = (0.0, 0.0)
    host_planes: MutableMapping[Role, np.ndarray] = field(default_factory=dict)
    host_guides: MutableMapping[Role, np.ndarray] = field(default_factory=dict)
    parts: dict[str, Tensor] = field(default_factory=dict)
    host_parts: dict[str, np.ndarray] = field(default_factory=dict)
    blank: set[Role] = field(default_factory=set)
    history_only: bool = False
    came_on_device: bool = False

    def __getitem__(self, role: Role) -> Tensor:
        """Tensor of a plane; FrameError when the frame does not hold it."""
        if role not in self.tensors:
            raise FrameError(f"frame {self.number} has no plane '{role}': it has "
                             f"{', '.join(self.tensors)}")
        return self.tensors[role]

    def __contains__(self, role: object) -> bool:
        return role in self.tensors

    def __iter__(self) -> Iterator[Role]:
        return iter(self.tensors)

    def get(self, role: Role) -> Tensor | None:
        """Tensor of a plane, or None when the frame does not hold it."""
        return self.tensors.get(role)

    def is_blank(self, role: Role) -> bool:
        """Whether a plane is known to be 0 everywhere. Planes that came in the device's memory are
        not looked at."""
        if self.came_on_device or role not in self.host_planes:
            return role in self.blank
        return is_blank(self.host_planes[role])

    def set(self, role: Role, tensor: Tensor, blank: bool = False) -> None:
        """Replace or add a plane: a float32 tensor (height, width, channels) that a recorded
        command writes, or, if it is `blank`, of zeros."""
        if (tensor.dtype != "float32" or len(tensor.shape) != 3
            or tensor.shape[2] != ROLES[role].channels):
            expected = f"(height, width, {ROLES[role].channels}) float32"
            raise FrameError(f"tensor '{tensor.name}' is {tensor.shape} {tensor.dtype}: plane "
                             f"'{role}' is {expected}")
        self.tensors[role] = tensor
        self.host_planes.pop(role, None)
        (self.blank.add if blank else self.blank.discard)(role)


class Downloads(MutableMapping[Role, "np.ndarray"]):
    """Host planes of a frame that came in the device's memory: each is copied when something looks
    at it."""

    def __init__(self, tensors: Mapping[Role, Tensor]) -> None:
        self._tensors = dict(tensors)
        self._copies: dict[Role, np.ndarray] = {}

    def __getitem__(self, role: Role) -> np.ndarray:
        if role not in self._copies:
            self._copies[role] = self._tensors[role].download()
        return self._copies[role]

    def __setitem__(self, role: Role, plane: np.ndarray) -> None:
        self._copies[role] = plane

    def __delitem__(self, role: Role) -> None:
        del self._tensors[role]
        self._copies.pop(role, None)

    def __iter__(self) -> Iterator[Role]:
        return iter(self._tensors)

    def __len__(self) -> int:
        return len(self._tensors)

    def pop(self, role: Role, default: Any = None) -> Any:
        """Forget a plane, which was replaced; nothing is copied."""
        self._tensors.pop(role, None)
        return self._copies.pop(role, default)


def share_planes(device: Device, kind: str, planes: Mapping[Role | str, Any],
                 last: Mapping[Role, Tensor] = MappingProxyType({})) -> dict[Role, Tensor]:
    """Arrays of any library as tensors of the device, by role.

    Args:
        kind: what messages call them, such as 'plane'.
        planes: arrays by role.
        last: tensors of the last frame. They are taken again for arrays in the same memory, so that
            commands on them need not be recorded again.

    Raises FrameError for an unknown role, a wrong shape or type, BindingError for an array that
    cannot be read.
    """
    found, waits = {}, False
    for name, plane in planes.items():
        role = find_role(name, kind)
        before = last.get(role)
        if before and before.is_on(plane):
            found[role], waits = before, waits or not device.memory.host_visible
            continue
        tensor = device.wrap(str(role), plane)
        found[role] = tensor = before if before and before.is_same_memory(tensor) else tensor
        if (tensor.dtype != "float32" or len(tensor.shape) != 3
            or tensor.shape[2] != ROLES[role].channels):
            raise FrameError(f"{kind} '{role}' is {tensor.shape} {tensor.dtype}: it needs (height, "
                             f"width, {ROLES[role].channels}) float32")
    if waits:  # once for all, as PyTorch's work on them was given to its stream before
        follow_torch(device.memory)
    return found


def spec_of(planes: Mapping[Role, Tensor], guides: Mapping[Role, Tensor],
            encoding: str) -> FrameSpec:
    """Spec of a frame of tensors. FrameError when sizes differ, GuideError for a role that is no
    guide."""
    return _spec_of(*(tuple([(role, tensor.shape) for role, tensor in held.items()])
                      for held in (planes, guides)),
                    encoding)


Shapes = tuple[tuple[Role, tuple[int, ...]], ...]


@lru_cache(MOST_SIZES)
def _spec_of(planes: Shapes, guides: Shapes, encoding: str) -> FrameSpec:
    if not planes:
        raise FrameError("a frame needs at least one plane")
    for kind, shapes in (("planes", planes), ("guides", guides)):
        if len({shape[:2] for _, shape in shapes}) > 1:
            sizes = ", ".join(f"{role} {shape[1]}x{shape[0]}" for role, shape in shapes)
            raise FrameError(f"{kind} differ in size: {sizes}")
    (height, width, _), sharp = planes[0][1], guides[0][1] if guides else None
    larger = GuideSpec(sharp[1], sharp[0], tuple([role for role, _ in guides])) if sharp else None
    return FrameSpec(width, height, {role: shape[2] for role, shape in planes}, encoding, larger)


class Pass:
    """Base of all passes. A pass is compiled once for a spec and then encodes frame after frame.

    Subclasses set `name`, take their options as keywords with defaults, which they hand to
    `super().__init__`, and implement `reflect`, `compile` and `encode`; `compile` and `encode` call
    `super()` first. The first option may come without its name. A pass never reaches into another:
    planes are shared only through the frame.
    """

    name: ClassVar[str]
    """The pass's name in the registry, on the command line and in timings."""

    defaults: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """Every option with its default value; taken from the signature unless a subclass sets them."""

    reads_render: ClassVar[bool] = False
    """Whether it needs the planes of the render, which passes that change the size drop. It then
    runs first, unless the command line gives it a place."""

    renamed: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Options by their former names: they still work, with a DeprecationWarning."""

    choice: str | None = None
    """The pass's choice for the last frame, as a word for the user; None if it has no choice."""

    notices: tuple[str, ...] = ()
    """Lines on faults of frames that the user should mend, each fault once. The pipeline tells them
    and empties this."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "__init__" in cls.__dict__ and "defaults" not in cls.__dict__:
            options = signature(cls).parameters.values()
            named = Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY
            cls.defaults = MappingProxyType({option.name: option.default
                                             for option in options if option.kind in named})

    def __init__(self, **options: Any) -> None:
        for old in set(options) & set(self.renamed):
            warnings.warn(f"pass '{self.name}': option '{old}' is now '{self.renamed[old]}'",
                          DeprecationWarning, stacklevel=3)
            options[self.renamed[old]] = options.pop(old)
        unknown = sorted(set(options) - set(self.defaults))
        if unknown:
            there = offer(unknown[0], self.defaults or ["none"], "its options are")
            raise PassOptionError(f"pass '{self.name}' has no option '{unknown[0]}'{there}")
        self.options: Mapping[str, Any] = MappingProxyType({**self.defaults, **options})
        self._spec: FrameSpec | None = None

    def __repr__(self) -> str:
        """The call that makes it, with the options that are not the defaults."""
        said = (f"{name}={value!r}" for name, value in self.options.items()
                if name not in self.defaults
                or value is not self.defaults[name] and value != self.defaults[name])
        return f"{type(self).__name__}({', '.join(said)})"

    def __reduce__(self) -> tuple[Callable[..., Pass], tuple[type[Pass], dict[str, Any]]]:
        """Pickled by its options: the copy is not compiled and has no history."""
        return _make_pass, (type(self), dict(self.options))

    def _number(self, option: str, given: Any) -> float:
        """An option that is a number; PassOptionError for what is none."""
        try:
            return float(given)
        except (TypeError, ValueError):
            raise PassOptionError(f"pass '{self.name}' has {option} {given!r}: give a "
                                  "number") from None

    def reflect(self, spec: FrameSpec) -> Reflection:
        """What the pass reads, may read and writes for frames of `spec`. Pure: depends on options
        and spec only."""
        raise NotImplementedError

    def skip(self, spec: FrameSpec) -> str | None:
        """Why the pass would change nothing for frames of `spec`, as a short clause for the user;
        else None.

        Asked before `reflect`, so a pass whose optional plane is absent answers here instead of
        failing.
        """
        return None

    def remarks(self, spec: FrameSpec) -> tuple[str, ...]:
        """What the user should know about the result for frames of `spec`, such as a plane that
        would improve it."""
        return ()

    def accumulates(self, spec: FrameSpec) -> bool:
        """Whether results for frames of `spec` improve with the number of frames of the shot seen
        before."""
        return False

    def compile(self, device: Device, spec: FrameSpec) -> None:
        """Make pipeline states and heap tensors for frames of `spec`, and drop the history. Not
        called when skipped.

        Tensors that are only used within a frame are made by `device.heap.transient`.
        """
        self._spec = spec
        self.reset()

    def resize(self, spec: FrameSpec) -> bool:
        """Prepare for frames that differ from earlier ones in size only, and keep the history.

        Returns False without changing anything if that is impossible; `compile` is called then.
        """
        return False

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        """Record the work for one frame; touch no pixel. Replaces planes by `frame.set(role,
        tensor)`.

        Raises NotCompiledError when the pass was not compiled for this frame's spec.
        """
        if self._spec is not frame.spec and self._spec != frame.spec:
            state = "not compiled" if self._spec is None else "compiled for another spec"
            raise NotCompiledError(f"pass '{self.name}' is {state}: call compile(device, "
                                   "frame.spec) before encode")

    def packages(self) -> Mapping[str, str]:
        """Other packages that decide its pixels, with their versions, for headers and for what
        resumes a run."""
        return {}

    def note_time(self, milliseconds: float) -> None:
        """Called with the device time of the last frame's commands."""

    def savings(self) -> tuple[tuple[str, str], ...]:
        """Work that the frames since `compile` did not need, each with the reason and the measured
        time it saved."""
        return ()

    def reset(self) -> None:
        """Drop the history: the next frame is treated as the first. Does nothing in passes without
        history.

        May be called at any time between frames, also before `compile`.
        """

    def history(self) -> dict[str, np.ndarray] | None:
        """Between two frames: what the next result depends on beside its frame, by name; to be
        looked at before the next frame begins. Empty without a history, None where a pass has one
        and does not tell it."""
        return {} if type(self).reset is Pass.reset else None

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        """After `compile`: go on as a pass that had this `history`. Raises KeyError or BindingError
        if it is not one of this pass, compiled for the same spec."""


def _make_pass(kind: type[Pass], options: dict[str, Any]) -> Pass:
    return kind(**options)
