"""Planes of a frame as networks read them, with stand-ins for those that are missing or noise;
planes that are only resampled; and the reactive mask."""

from __future__ import annotations

import numpy as np

from postfx.frame import ALBEDOS, GUIDE_ROLES, ROLES, FrameSpec, Role
from postfx.kernels.denoise import FARTHEST
from postfx.kernels.image import positions
from postfx.kernels.statistics import coverage_noise
from postfx.passes import ResidentFrame
from postfx.passes.denoise.geometry import Size
from postfx.passes.denoise.graph import (
    BLENDED,
    MASKED,
    ONE,
    PASSED_ON,
    RESAMPLED,
    Each,
    kernels_of,
    run_steps,
)
from postfx.passes.denoise.options import ReactiveOption
from postfx.runtime import CommandBuffer, Device, Tensor

# Values of planes that a frame lacks at both sizes; networks are trained with the same values.
ABSENT = {Role.DIFFUSE_ALBEDO: 0.0, Role.SPECULAR_ALBEDO: 0.0, Role.NORMAL: 0.0,
          Role.ROUGHNESS: 0.5, Role.DEPTH: 1.0, Role.MOTION: 0.0}
MIRRORED_ROLES = {Role.DENOISING_ALBEDO: 0.0, Role.DENOISING_NORMAL: 0.0}
"""Values that stand for planes that follow mirrors and glass, where they are missing; only some
networks read them."""
HAZY = (*ALBEDOS, Role.DEPTH)
"""Planes that are left out in a volume: they show the surface behind it for the samples that came
so far."""
FOUND_VOLUME_SHARE = 0.12
"""Share of noise in what depth covers from which on a frame shows a volume."""
LOST_VOLUME_SHARE = 0.08
"""Share below which a frame no longer shows the volume of the one before."""


class Resampler:
    """Resizes a plane of every frame: cubic; depth by the nearest sample, so that misses do not mix
    with hits.

    The result is sampled at pixel centres plus `jitter`, in pixels of the result.

    Attributes:
        rows, columns: where the result's rows and columns lie in the image.
        output: the result.
    """

    def __init__(self, device: Device, name: str, role: Role, size: Size, out_size: Size) -> None:
        self._size, self._out_size, self._nearest = size, out_size, role is Role.DEPTH
        new = device.heap.tensor
        self.rows = new(f"{name} rows", out_size[:1])
        self.columns = new(f"{name} columns", out_size[1:])
        self._aimed: tuple[tuple[float, float], tuple[float, float]] | None = None
        self.output = device.heap.transient(name, (*out_size, ROLES[role].channels))
        device.make_ready(*kernels_of(RESAMPLED, over={"planes": ONE}))

    def aim(self, jitter: tuple[float, float],
            out_jitter: tuple[float, float] = (0.0, 0.0)) -> None:
        """Settle, once a frame, where the samples lie: of the images, and of the results."""
        if (jitter, out_jitter) == self._aimed:
            return
        for axis, tensor in enumerate((self.rows, self.columns)):
            size, out_size = self._size[axis], self._out_size[axis]
            shift = jitter[1 - axis] - out_jitter[1 - axis] * size / out_size
            at = positions(size, out_size, shift)
            tensor.upload(np.rint(at) if self._nearest else at)
        self._aimed = jitter, out_jitter

    def plane(self, image: Tensor, jitter: tuple[float, float],
              out_jitter: tuple[float, float] = (0.0, 0.0)) -> Each:
        """An image to resample, for a step that runs over several; `jitter`: how far its samples
        are off the centres of its pixels."""
        self.aim(jitter, out_jitter)
        return Each(buffers={"image": image, "rows": self.rows, "columns": self.columns,
                             "output": self.output})

    def resample(self, commands: CommandBuffer, image: Tensor, output: Tensor | None = None,
                 ) -> Tensor:
        """Record the work that resamples an image, after `aim`; returns the result."""
        made = self.output if output is None else output
        rows = Each(buffers={"plain": made, "plain_rows": self.rows})
        run_steps(commands, BLENDED, {"colour": image, "plain_columns": self.columns},
                  over={"rows": [rows]})
        return made


class Planes:
    """A frame's planes and guides by the kernels' names: 'normal', and 'guide_normal' at output
    size.

    A plane that the frame has at one size only is resampled to the other; one that it lacks is
    constant. In a volume, where depth is noise, depth and albedo are constant, too.

    Attributes:
        hazy: whether the last frame showed a volume.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, guided: bool,
                 mirrored: bool = False) -> None:
        """`mirrored`: also the planes that follow mirrors and glass."""
        render = Size(spec.height, spec.width)
        read = (*ABSENT, *(MIRRORED_ROLES if mirrored else ()))
        self._device, self._spec, self.hazy, self._looked = device, spec, False, False
        self._haze: dict[str, Tensor] = {}
        self._held = {role: str(role) for role in read if spec.has(role)}
        self._guides = [role for role in GUIDE_ROLES if guided and role in spec.guide_roles]
        self._constants: dict[str, Tensor] = {}
        self._reduced: dict[Role, Resampler] = {}
        self._enlarged: dict[Role, Resampler] = {}
        for role in read:
            if role in spec.guide_roles and not spec.has(role):
                self._reduced[role] = Resampler(device, f"reduced {role}", role, output, render)
            elif not spec.has(role):
                self._constants[role] = absent_plane(device, role, render)
        for role in GUIDE_ROLES if guided else ():
            if role not in spec.guide_roles and spec.has(role):
                self._enlarged[role] = Resampler(device, f"enlarged {role}", role, render, output)
            elif role not in spec.guide_roles:
                self._constants[f"guide_{role}"] = absent_plane(device, role, output)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame,
               blank: bool = True) -> dict[str, Tensor]:
        """Record the resampling, if any; returns every plane by name. `blank`: whether depth and
        albedo are left out of a frame that shows a volume."""
        moved = [resampler.plane(frame.guides[role], frame.guide_jitter, frame.jitter)
                 for role, resampler in self._reduced.items()]
        moved += [resampler.plane(frame[role], frame.jitter, frame.guide_jitter)
                  for role, resampler in self._enlarged.items()]
        if moved:
            run_steps(commands, RESAMPLED, {}, over={"planes": moved})
        planes = {"colour": frame[Role.COLOUR]} | {name: frame[role]
                                                   for role, name in self._held.items()}
        planes |= {f"guide_{role}": frame.guides[role] for role in self._guides}
        planes |= {str(role): resampler.output for role, resampler in self._reduced.items()}
        planes |= {f"guide_{role}": resampler.output for role, resampler in self._enlarged.items()}
        self.hazy = blank and self.hazy
        return planes | self._constants | (self.stand_ins(frame) if blank else {})

    def stand_ins(self, frame: ResidentFrame) -> dict[str, Tensor]:
        """Stand-ins for the planes that a volume hides, by name; empty if the frame shows none.
        Frames that came in the device's memory are only looked at where a sequence begins."""
        if Role.DEPTH not in self._held:
            return {}
        if not frame.came_on_device or frame.reset or not self._looked:
            self.hazy = shows_volume(frame.host_planes[Role.DEPTH], self.hazy and not frame.reset)
            self._looked = True
        if self.hazy and not self._haze:
            size = Size(self._spec.height, self._spec.width)
            self._haze = {str(role): absent_plane(self._device, role, size)
                          for role in HAZY if role in self._held}
        return self._haze if self.hazy else {}


def shows_volume(depth: np.ndarray, before: bool = False) -> bool:
    """Whether hits and misses of depth (h, w, 1) are noise, as where Cycles scatters light in a
    volume. `before`: whether they were in the last frame."""
    return coverage_noise(depth[..., 0], float(FARTHEST)) > (LOST_VOLUME_SHARE if before
                                                             else FOUND_VOLUME_SHARE)


def absent_plane(device: Device, role: Role, size: Size) -> Tensor:
    """The tensor that stands for a plane that a frame lacks."""
    shape, value = (*size, ROLES[role].channels), (ABSENT | MIRRORED_ROLES)[role]
    if device.scratch is None:
        return device.wrap(f"absent {role}", np.full(shape, value, np.float32))
    return device.wrap(f"absent {role}", device.scratch.full(shape, value))


CENTRED = (0.0, 0.0)


def passthrough_roles(spec: FrameSpec) -> tuple[Role, ...]:
    """Planes that are not filtered but handed on: alpha, an overlay, the colours of later frames
    and of a partner, as far as frames of a spec have them. With a partner go motion and strength,
    which its mixture needs."""
    kept = tuple(role for role in (Role.ALPHA, Role.OVERLAY)
                 if spec.has(role) or role in spec.guide_roles)
    if spec.has(Role.PARTNER):
        kept += tuple(role for role in (Role.PARTNER, Role.MOTION, Role.STRENGTH) if spec.has(role))
    return (*kept, Role.LATER) if Role.LATER in spec.guide_roles else kept


class ExpectedError:
    """The plane `error`: what a network expects to be off, for frames at any of its sizes; 0 where
    no network ran.

    Attributes:
        written: where the network's kernels write it, by their name.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        render = Size(spec.height, spec.width)
        self.written = {"error": device.heap.tensor("expected error", (*render, 1))}
        self._resampler = (Resampler(device, "error", Role.ERROR, render, output)
                           if output != render else None)

    def forget(self) -> None:
        """Set it to 0, before a frame of which the network sees only parts."""
        self.written["error"].fill(0)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> Tensor:
        """Record what brings it to the output's size; returns the plane."""
        error = self.written["error"]
        if self._resampler is None:
            return error
        plane = self._resampler.plane(error, frame.jitter)
        run_steps(commands, PASSED_ON, {}, over={"error": [plane]})
        return self._resampler.output


class LargerMotion:
    """Brings motion to the output's size and pixels, each from the nearest render pixel.

    Attributes:
        enlarged: the result.
    """

    def __init__(self, device: Device, render: Size, output: Size) -> None:
        rows, columns = (positions(*sizes) for sizes in zip(render, output, strict=True))
        ratio = np.array([output.width / render.width, output.height / render.height], np.float32)
        arrays = {"rows": rows, "columns": columns, "ratio": ratio}
        self._places = {name: device.wrap(f"{name} of motion", array)
                        for name, array in arrays.items()}
        self.enlarged = device.heap.transient("motion of the output", (*output, 2))

    def plane(self, motion: Tensor) -> Each:
        """The plane to enlarge."""
        return Each(buffers={"motion": motion, "enlarged": self.enlarged, **self._places})


class Passthrough:
    """Resamples planes that are handed on (`passthrough_roles`) to the output's size, from the
    frame's jittered samples to pixel centres.

    Colours of an overlay are limited by their coverage, so that edges have no halos. An overlay
    that is 0 everywhere, or whose pixels match the output's, is not resampled.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self._device, self._output, self._render = device, output, Size(spec.height, spec.width)
        self._overlay_is_guide = Role.OVERLAY in spec.guide_roles
        self._resamplers = {role: Resampler(device, str(role), role, self._size(role), output)
                            for role in passthrough_roles(spec)
                            if role not in (Role.LATER, Role.MOTION)}
        moves = Role.MOTION in passthrough_roles(spec)
        self._motion = LargerMotion(device, self._render, output) if moves else None
        self._nothing: Tensor | None = None
        device.make_ready(*kernels_of(PASSED_ON, over=dict.fromkeys(passthrough_roles(spec), ONE)))

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        """Record the work, and put the results into the frame. Alpha that was already replaced is
        left alone."""
        moved: dict[str, list[Each]] = {}
        if self._motion:
            moved[Role.MOTION] = [self._motion.plane(frame[Role.MOTION])]
            frame.set(Role.MOTION, self._motion.enlarged)
        if Role.LATER in frame.guides:
            frame.set(Role.LATER, frame.guides[Role.LATER])
        if self._overlay_is_guide:
            blank = not frame.came_on_device and not frame.host_guides[Role.OVERLAY].any()
        else:
            blank = frame.is_blank(Role.OVERLAY)
        for role, resampler in self._resamplers.items():
            if role is Role.ALPHA and role not in frame.host_planes:
                continue
            plane, jitter = self._source(role, frame)
            if role is Role.OVERLAY and blank:
                frame.set(role, self._zeros(), blank=True)
            elif role is Role.OVERLAY and self._size(role) == self._output and jitter == CENTRED:
                frame.set(role, plane)
            else:
                moved[role] = [resampler.plane(plane, jitter)]
                frame.set(role, resampler.output)
        if moved:
            run_steps(commands, PASSED_ON, {}, over=moved)

    def _source(self, role: Role, frame: ResidentFrame) -> tuple[Tensor, tuple[float, float]]:
        """A plane, and where its samples lie."""
        if role is Role.OVERLAY and self._overlay_is_guide:
            return frame.guides[role], frame.guide_jitter
        return frame[role], frame.jitter

    def _size(self, role: Role) -> Size:
        return self._output if role is Role.OVERLAY and self._overlay_is_guide else self._render

    def _zeros(self) -> Tensor:
        if self._nothing is None:
            zeros = np.zeros((*self._output, ROLES[Role.OVERLAY].channels), np.float32)
            self._nothing = self._device.wrap("no overlay", zeros)
        return self._nothing


class Reactive:
    """The mask of each frame: its plane, or computed from the difference of two colours."""

    def __init__(self, device: Device, spec: FrameSpec, option: ReactiveOption) -> None:
        self._role, self._option = option.role(spec), option
        if self._role is Role.OPAQUE_COLOUR:
            self._difference = device.heap.tensor("difference", (3,))
            self._output = device.heap.transient("reactive", (spec.height, spec.width, 1))
            device.make_ready(*kernels_of(MASKED))

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> Tensor:
        """Record the work, if any; returns the mask."""
        if self._role is Role.REACTIVE:
            return frame[Role.REACTIVE]
        self._difference.upload([frame.exposure_factor, self._option.scale, self._option.threshold])
        run_steps(commands, MASKED, {
            "colour": frame[Role.COLOUR], "opaque_colour": frame[Role.OPAQUE_COLOUR],
            "difference": self._difference, "reactive": self._output})
        return self._output
