"""Planes of a frame beside the network: stand-ins for those that it lacks or that are noise, planes
that are only resampled, and the reactive mask; at the end the detail that the colour gets back,
what alpha gets of its samples, and the blend with the input by strength.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from postfx.frame import GUIDE_ROLES, ROLES, FrameSpec, Role
from postfx.kernels import Kernel
from postfx.kernels.denoise import FARTHEST, NEAR_CELL, kernel
from postfx.kernels.denoise.alpha import CORRECT, FIT, GATHER
from postfx.kernels.denoise.history import REACTIVE
from postfx.kernels.denoise.output import DETAIL, JUDGE, RESTORE, STRENGTH, SUMS, TILE
from postfx.kernels.denoise.prepare import DILATE
from postfx.kernels.image import ENLARGE_OVERLAY, RESAMPLE, positions
from postfx.kernels.partner import ENLARGE_MOTION
from postfx.kernels.statistics import bounds_of_cells, coverage_noise
from postfx.passes import ResidentFrame
from postfx.passes.denoise.history import LayerHistory
from postfx.passes.denoise.options import ReactiveOption, Size
from postfx.passes.denoise.tiling import Rows, full_rows, rows_of, tiles_with
from postfx.runtime import CommandBuffer, Device, Tensor
from postfx.sampling import three_by_three

# Values of planes that a frame lacks at both sizes; networks are trained with the same values.
ABSENT = {Role.DIFFUSE_ALBEDO: 0.0, Role.SPECULAR_ALBEDO: 0.0, Role.NORMAL: 0.0,
          Role.ROUGHNESS: 0.5, Role.DEPTH: 1.0, Role.MOTION: 0.0}
MIRRORED_ROLES = {Role.DENOISING_ALBEDO: 0.0, Role.DENOISING_NORMAL: 0.0}
"""The same of planes that follow mirrors and glass, which only some networks read."""
HAZY = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.DEPTH)
"""Planes that are left out in a volume: they show the surface behind it for the samples that came
so far."""
FOUND_VOLUME_SHARE, LOST_VOLUME_SHARE = 0.12, 0.08
"""From this share of noise in what depth covers on a frame shows a volume, and below the second it
no longer does."""


class Resampler:
    """Resizes a plane of every frame: cubic; depth by the nearest sample, so that misses do not mix
    with hits; overlay colours limited by their coverage, for edges without halos.

    The result is sampled at pixel centres plus `jitter`, in pixels of the result.
    """

    def __init__(self, device: Device, name: str, role: Role, size: Size, out_size: Size) -> None:
        self._size, self._out_size, self._nearest = size, out_size, role is Role.DEPTH
        new = device.heap.tensor
        self._rows, self._columns = (new(f"{name} rows", out_size[:1]),
                                     new(f"{name} columns", out_size[1:]))
        self._aimed: tuple[tuple[float, float], tuple[float, float]] | None = None
        self.output = device.heap.transient(name, (*out_size, ROLES[role].channels))
        self._kernel = ENLARGE_OVERLAY if role is Role.OVERLAY else RESAMPLE
        device.make_ready(self._kernel)

    def encode(self, commands: CommandBuffer, label: str, image: Tensor,
               jitter: tuple[float, float], out_jitter: tuple[float, float] = (0.0, 0.0)) -> Tensor:
        """Record the work for an image whose samples are `jitter` of its own pixels off their
        centres; returns the result."""
        self.aim(jitter, out_jitter)
        self.run(commands, label, image)
        return self.output

    def aim(self, jitter: tuple[float, float],
            out_jitter: tuple[float, float] = (0.0, 0.0)) -> None:
        """Once a frame: its images have samples at these places."""
        if (jitter, out_jitter) == self._aimed:
            return
        for axis, tensor in enumerate((self._rows, self._columns)):
            size, out_size = self._size[axis], self._out_size[axis]
            shift = jitter[1 - axis] - out_jitter[1 - axis] * size / out_size
            at = positions(size, out_size, shift)
            tensor.upload(np.rint(at) if self._nearest else at)
        self._aimed = jitter, out_jitter

    def run(self, commands: CommandBuffer, label: str, image: Tensor,
            parts: Sequence[tuple[Tensor, Rows]] = ()) -> None:
        """Record the work for an image, of several that are sampled at the same places.

        Args:
            parts: rows to make, each in a tensor of the result's size; none: all rows, in `output`.
        """
        for output, rows in parts or [(self.output, (0, self._out_size.height))]:
            if rows[0] < rows[1]:
                commands.run(self._kernel, label, image=image, rows=rows_of(self._rows, rows),
                             columns=self._columns, output=rows_of(output, rows))


class Planes:
    """Planes and guides under the names that the kernels give them: 'normal', and 'guide_normal' at
    output size.

    A plane that the frame has at one size only is resampled to the other; a missing plane is
    constant. So are depth and albedo where depth is noise: in a volume.

    Attributes:
        hazy: whether the last frame showed a volume.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size, guided: bool,
                 mirrored: bool = False) -> None:
        """`mirrored`: also the planes that follow mirrors and glass."""
        render, read = Size(spec.height, spec.width), (*ABSENT,
                                                       *(MIRRORED_ROLES if mirrored else ()))
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
               blank: bool = True) -> Mapping[str, Tensor]:
        """Record the resampling, if any; returns every plane by name. `blank`: where the frame
        shows a volume, depth and albedo are left out."""
        for role, resampler in self._reduced.items():
            resampler.encode(commands, "resample", frame.guides[role], frame.guide_jitter,
                             frame.jitter)
        for role, resampler in self._enlarged.items():
            resampler.encode(commands, "resample", frame[role], frame.jitter, frame.guide_jitter)
        planes = {"colour": frame[Role.COLOUR]} | {name: frame[role]
                                                   for role, name in self._held.items()}
        planes |= {f"guide_{role}": frame.guides[role] for role in self._guides}
        planes |= {str(role): resampler.output for role, resampler in self._reduced.items()}
        planes |= {f"guide_{role}": resampler.output for role, resampler in self._enlarged.items()}
        self.hazy = blank and self.hazy
        return planes | self._constants | (self._find_haze(frame) if blank else {})

    def _find_haze(self, frame: ResidentFrame) -> dict[str, Tensor]:
        """Stand-ins for the planes that a volume hides, if it does. Planes on the device are looked
        at where a sequence begins."""
        if Role.DEPTH not in self._held:
            return {}
        if not frame.is_away or frame.reset or not self._looked:
            self.hazy = shows_volume(frame.host_planes[Role.DEPTH], self.hazy and not frame.reset)
            self._looked = True
        if self.hazy and not self._haze:
            size = Size(self._spec.height, self._spec.width)
            self._haze = {str(role): absent_plane(self._device, role, size)
                          for role in HAZY if role in self._held}
        return self._haze if self.hazy else {}


def shows_volume(depth: np.ndarray, before: bool = False) -> bool:
    """Whether hits and misses of depth (h, w, 1) are noise, as they are where Cycles scatters light
    in a volume; `before`: the last frame's were."""
    return coverage_noise(depth[..., 0], float(FARTHEST)) > (LOST_VOLUME_SHARE if before
                                                             else FOUND_VOLUME_SHARE)


def absent_plane(device: Device, role: Role, size: Size) -> Tensor:
    """What stands for a plane that a frame lacks."""
    shape, value = (*size, ROLES[role].channels), (ABSENT | MIRRORED_ROLES)[role]
    if device.scratch is None:
        return device.wrap(f"absent {role}", np.full(shape, value, np.float32))
    return device.wrap(f"absent {role}", device.scratch.full(shape, value))


CENTRED = (0.0, 0.0)


def passthrough_roles(spec: FrameSpec) -> tuple[Role, ...]:
    """Alpha, overlay and the colours of later frames and of a partner, as far as a frame has them;
    an overlay may have output size. With a partner's colour go motion and strength, which its
    mixture needs."""
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
        """Before the commands of a frame that are not for all of it."""
        self.written["error"].fill(0)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> Tensor:
        """Record what brings it to the output's size; returns the plane."""
        error = self.written["error"]
        return (self._resampler.encode(commands, "error", error, frame.jitter) if self._resampler
                else error)


class LargerMotion:
    """Brings motion to the output's size and pixels, each from the nearest render pixel."""

    def __init__(self, device: Device, render: Size, output: Size) -> None:
        rows, columns = (positions(*sizes) for sizes in zip(render, output, strict=True))
        ratio = np.array([output.width / render.width, output.height / render.height], np.float32)
        arrays = {"rows": rows, "columns": columns, "ratio": ratio}
        self._places = {name: device.wrap(f"{name} of motion", array)
                        for name, array in arrays.items()}
        self._enlarged = device.heap.transient("motion of the output", (*output, 2))
        device.make_ready(ENLARGE_MOTION)

    def encode(self, commands: CommandBuffer, motion: Tensor) -> Tensor:
        """Record the work; returns the motion."""
        commands.run(ENLARGE_MOTION, "motion", motion=motion, enlarged=self._enlarged,
                     **self._places)
        return self._enlarged


class Passthrough:
    """Resamples alpha and overlay, from the frame's jittered samples to pixel centres.

    An overlay that is 0 everywhere, or whose pixels match the output's, is not resampled.
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

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        """Record the work; the frame's planes are then those of the output's size. Alpha that was
        already replaced is left alone."""
        if self._motion:
            frame.set(Role.MOTION, self._motion.encode(commands, frame[Role.MOTION]))
        if Role.LATER in frame.guides:
            frame.set(Role.LATER, frame.guides[Role.LATER])
        if self._overlay_is_guide:
            blank = not frame.is_away and not frame.host_guides[Role.OVERLAY].any()
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
                frame.set(role, resampler.encode(commands, str(role), plane, jitter))

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
            device.make_ready(REACTIVE)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> dict[str, Tensor]:
        """Record the work, if any; returns the mask by its name for the kernels, or an empty
        mapping."""
        if self._role is None:
            return {}
        if self._role is Role.REACTIVE:
            return {"reactive": frame[Role.REACTIVE]}
        self._difference.upload([frame.exposure_factor, self._option.scale, self._option.threshold])
        commands.run(REACTIVE, "reactive", colour=frame[Role.COLOUR],
                     opaque_colour=frame[Role.OPAQUE_COLOUR],
                     difference=self._difference, reactive=self._output)
        return {"reactive": self._output}


# Samples a pixel: up to which no detail is looked for, that count once, and that count at most.
NO_DETAIL_SAMPLES = 16
FULL_EVIDENCE_SAMPLES = 64
MOST_EVIDENCE_SAMPLES = 96
PER_TILE = "judged", "sums", "detail"


class Restore:
    """For results of the input's size. Leaves frames alone that are known to have at most 16
    samples a pixel, and jittered ones, whose samples do not lie where the result's pixels do."""

    def __init__(self, device: Device, size: Size) -> None:
        self._device = device
        new, between = device.heap.tensor, device.heap.transient
        tiles = -(-size.height // TILE), -(-size.width // TILE)
        self._params, self._evidence = new("restore params", (4,)), new("evidence", (1,))
        self._output = between("restored", (*size, 3))
        self._judged, self._tiles = new("judged", (*tiles, 1)), tiles
        self._rows, self._known = (0, size.height), np.zeros(tiles, bool)  # what 'judged' holds
        self._tensors = {"params": self._params, "evidence": self._evidence,
                         "sums": between("sums", (*tiles, SUMS)), "judged": self._judged,
                         "detail": between("detail", (*tiles, 1)), "output": self._output}
        device.make_ready(JUDGE, DETAIL, RESTORE)

    def acts_on(self, frame: ResidentFrame) -> bool:
        """Whether a frame may get detail back."""
        return (frame.jitter == (0.0, 0.0)
                and (frame.samples or FULL_EVIDENCE_SAMPLES) > NO_DETAIL_SAMPLES)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, denoised: Tensor, rows: Rows,
               cells: np.ndarray | None = None) -> Tensor:
        """Record the work on the frame's own colour and the denoised one in `rows`, of which tiles
        with active `cells` are judged, without cells all; returns the colour."""
        if not self.acts_on(frame):
            return denoised
        self._rows = rows
        self._judge_only(np.ones(self._tiles, bool) if cells is None else tiles_with(cells))
        self._params.upload([frame.exposure_factor, 0.0, 0.0, 0.0])
        self._evidence.upload([min(frame.samples or FULL_EVIDENCE_SAMPLES, MOST_EVIDENCE_SAMPLES)
                               / FULL_EVIDENCE_SAMPLES])
        planes = {**self._tensors, "colour": frame[Role.COLOUR], "denoised": denoised}
        for work in (JUDGE, DETAIL, RESTORE):
            self._run(commands, work, planes)
        return self._output

    def encode_part(self, commands: CommandBuffer, noisy: Tensor, denoised: Tensor,
                    output: Tensor) -> Tensor:
        """Record the same work on a part of the picture, after the picture itself: the part gets
        back the same share."""
        self._run(commands, RESTORE,
                  {**self._tensors, "colour": noisy, "denoised": denoised, "output": output})
        return output

    def _run(self, commands: CommandBuffer, work: Kernel, tensors: Mapping[str, Tensor]) -> None:
        commands.run(work, "restore", **{name: self._part_of(name, tensors[name])
                                         for name in work.reads + work.writes})

    def _judge_only(self, tiles: np.ndarray) -> None:
        if not np.array_equal(tiles, self._known):
            self._known = tiles
            self._judged.upload(tiles[..., None].astype(np.float32))

    def _part_of(self, name: str, tensor: Tensor) -> Tensor:
        """The frame's rows of a tensor, or the rows of tiles that these are in."""
        first, end = self._rows
        if name in ("colour", "denoised", "output"):
            return rows_of(tensor, self._rows)
        return rows_of(tensor, (first // TILE, -(-end // TILE))) if name in PER_TILE else tensor


FEW_SAMPLES, DRIFT_VARIANCE, SETTLED, LONGEST_ALPHA_FRAMES, RANDOM, SHARPER_ALPHA, BY_COLOUR = (
    4, 1 / 32, 6, 16, 1 / 48, 0.4, 0.5
)
"""Samples a pixel of files that do not say. Variance, in units of a sample's, that a move adds to a
mean of alpha; as how many samples filtered alpha counts; frames over which still alpha is averaged;
variance in a sample's units that structure is compared with; how much sharper alpha is made that is
twice as large; and the share of alpha that comes from colours where it has structure."""


class Alpha:
    """Brings filtered alpha nearer to a mean of its samples over the frames, which knows the
    quarters of a pixel where things move by parts of one, and to the colours. Where alpha is 0 or 1
    all around, there is nothing to do.

    Attributes:
        enlarged: where filtered alpha goes.
    """

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self._scale = min(max(output.width / spec.width - 1, 0.0), 1.0)
        new, between = device.heap.tensor, device.heap.transient
        self._rates, self._gain = new("rates of alpha", (4,)), new("gain of alpha", (4,))
        rows, columns = (device.wrap(name, np.arange(size, dtype=np.float32)) for name, size in
                         (("alpha rows", spec.height), ("alpha columns", spec.width)))
        moved = between("motion of alpha", (spec.height, spec.width, 2))
        self._output, self.enlarged = (between("alpha", (*output, 1)),
                                       between("enlarged alpha", (*output, 1)))
        self._pixels = {"part_rows": rows, "part_columns": columns}
        self._near = new("near alpha", (-(-spec.height // NEAR_CELL), -(-spec.width // NEAR_CELL)))
        self._moved, self._finds_cells = moved, device.gpu is not None
        self._fit = between("alpha by colours", (4, spec.height, spec.width))
        device.make_ready(DILATE, GATHER, FIT, CORRECT, *(NEAR_ALPHA,) * self._finds_cells)

    def gather(self, commands: CommandBuffer, frame: ResidentFrame, planes: Mapping[str, Tensor],
               history: LayerHistory, keep: bool) -> dict[str, Tensor]:
        """Record the work that adds a frame's own alpha to the mean; returns what filters read of
        it. Jittered alpha does not lie where the pixels do, and counts for nothing but in its own
        frame."""
        samples, jittered = frame.samples or FEW_SAMPLES, frame.jitter != (0.0, 0.0)
        if not self._finds_cells:
            self._near.upload(near_cells(frame.host_planes[Role.ALPHA][..., 0]))
        self._rates.upload([float(keep and not history.resized and not jittered), 1 / samples,
                            DRIFT_VARIANCE, 1 / LONGEST_ALPHA_FRAMES])
        self._gain.upload([0.0 if jittered else 1 / SETTLED, RANDOM / samples,
                           0.0 if jittered else SHARPER_ALPHA * self._scale,
                           0.0 if jittered else BY_COLOUR])
        last, found = (quarters.view(quarters.name,
                                     (2 * quarters.shape[0], 2 * quarters.shape[1], 1))
                                 for quarters in (history.last["samples"], history.next["samples"]))
        self._next = {"next_samples": found, "next_doubt": history.next["doubt"]}
        commands.run(DILATE, "gather alpha", motion=planes[Role.MOTION], depth=planes[Role.DEPTH],
                     moved=self._moved, **self._pixels)
        if self._finds_cells:
            commands.run(NEAR_ALPHA, "gather alpha", alpha=frame[Role.ALPHA], near=self._near)
        commands.run(GATHER, "gather alpha", alpha=frame[Role.ALPHA], moved=self._moved,
                     rates=self._rates,
                     near=self._near, samples=last, doubt=history.last["doubt"], **self._next)
        return {"next_samples": found, "near": self._near}

    def correct(self, commands: CommandBuffer, picture: Tensor) -> Tensor:
        """Record the work on alpha that was filtered and enlarged, given the picture that the
        filters made; returns alpha."""
        commands.run(FIT, "correct alpha", next_samples=self._next["next_samples"], picture=picture,
                     near=self._near, fit=self._fit)
        commands.run(CORRECT, "correct alpha", enlarged=self.enlarged, moved=self._moved,
                     near=self._near, gain=self._gain, fit=self._fit, picture=picture,
                     corrected=self._output, **self._next)
        return self._output


def near_cells(alpha: np.ndarray) -> np.ndarray:
    """Cells of alpha (h, w): 2 where 3x3 of them are not all alike, 1 beside those, else 0."""
    low, high = bounds_of_cells(alpha, NEAR_CELL)
    differ = three_by_three(low, 1, np.minimum) != three_by_three(high, 1, np.maximum)
    found: np.ndarray = differ + three_by_three(differ, 1, np.maximum).astype(np.float32)
    return found


def near_rows(y0: int, y1: int, alpha: np.ndarray, near: np.ndarray) -> None:
    """What the kernel below computes. No device runs it: elsewhere the host looks at alpha, which
    is its own."""
    near[y0:y1] = near_cells(alpha[..., 0])[y0:y1]


NEAR_ALPHA = kernel("near", ("alpha",), ("near",), near_rows, ("near", 0), alpha=("h", "w", 1),
                    near=("alpha_h", "alpha_w"))
"""Cells where alpha is worked on, on a GPU."""


class Plain:
    """The input resampled to output size, at pixel centres, in linear light, without overshooting
    its samples."""

    def __init__(self, device: Device, spec: FrameSpec, output: Size) -> None:
        self._resampler = Resampler(device, "plain", Role.COLOUR, Size(spec.height, spec.width),
                                    output)
        self.output = self._resampler.output

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> Tensor:
        """Record the work; returns the colour at output size."""
        return self._resampler.encode(commands, "plain", frame[Role.COLOUR], frame.jitter)

    def aim(self, frame: ResidentFrame) -> None:
        """Once a frame: its colour has samples at these places."""
        self._resampler.aim(frame.jitter)

    def run(self, commands: CommandBuffer, colour: Tensor,
            parts: Sequence[tuple[Tensor, Rows]] = ()) -> None:
        """Record the work, for some rows of some tensors if `parts` are given."""
        self._resampler.run(commands, "plain", colour, parts)


class Strength:
    """Blends from the input to the result by `amount`, times the plane `strength` if the frame has
    one."""

    def __init__(self, device: Device, spec: FrameSpec, output: Size, amount: float) -> None:
        self.plain = Plain(device, spec, output)
        self._in_place = device.runs_rows
        self._output, self._copy = (device.heap.transient(name, (*output, 3))
                                    for name in ("blend", "denoised rows"))
        self._is_whole = amount == 1
        self._amount = device.wrap("amount", np.full(1, amount, np.float32))
        device.make_ready(STRENGTH)
        render, held = Size(spec.height, spec.width), spec.has(Role.STRENGTH)
        self._plane = Resampler(device, "strength", Role.STRENGTH, render, output) if held else None
        self._strength = self._plane.output if self._plane else device.wrap(
            "full strength", np.ones((*output, 1), np.float32))

    def begin(self, frame: ResidentFrame, rows: Rows) -> dict[str, Tensor]:
        """Where the denoised picture should go: to the result, as 'output', if most of its rows are
        denoised fully, so that these are neither blended nor copied."""
        plane = frame.host_planes.get(Role.STRENGTH) if self._is_whole and self._in_place else None
        if plane is None:
            return {}
        first, end = self._full = full_rows(plane, positions(len(plane), self._output.shape[0],
                                                             frame.jitter[1]), rows)
        return {"output": self._output} if 2 * (end - first) > rows[1] - rows[0] else {}

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, denoised: Tensor, rows: Rows,
               unblended: Callable[[], None]) -> Tensor:
        """Record the blend of the frame's own colour with the denoised one in `rows`, all others
        have no strength; returns the colour. If the strength is 1 everywhere, that is the denoised
        one, and `unblended` is told."""
        if self.is_full(frame):
            unblended()
            return denoised
        colour, strength = frame[Role.COLOUR], frame[Role.STRENGTH] if self._plane else None
        full = self._full if denoised is self._output else (rows[1], rows[1])
        self.plain.aim(frame)
        if self._plane:
            self._plane.aim(frame.jitter)
        commands.repeat((self, colour, strength, denoised, rows, full),
                        partial(self._record, commands, colour, strength, denoised, rows, full))
        return self._output

    def _record(self, commands: CommandBuffer, colour: Tensor, strength: Tensor | None,
                denoised: Tensor, rows: Rows, full: Rows) -> None:
        blended, others = ([(rows[0], full[0]), (full[1], rows[1])],
                           [(0, rows[0]), (rows[1], self._output.shape[0])])
        self.plain.run(commands, colour, [*((self.plain.output, some) for some in blended),
                                          *((self._output, some) for some in others)])
        if self._plane and strength:
            self._plane.run(commands, "strength", strength,
                            [(self._strength, some) for some in blended])
        if denoised is self._output:
            self._blend(commands, denoised, denoised, self._copy, *blended)  # with itself
            denoised = self._copy
        self._blend(commands, self.plain.output, denoised, self._output, *blended)

    def _blend(self, commands: CommandBuffer, plain: Tensor, denoised: Tensor, output: Tensor,
               *parts: Rows) -> None:
        tensors = {"plain": plain, "denoised": denoised, "strength": self._strength,
                   "output": output}
        for rows in (some for some in parts if some[0] < some[1]):
            commands.run(STRENGTH, "strength", amount=self._amount, **{
                name: rows_of(tensor, rows) for name, tensor in tensors.items()})

    def encode_part(self, commands: CommandBuffer, noisy: Tensor, denoised: Tensor,
                    rows: Rows, plain: Resampler, output: Tensor) -> Tensor:
        """Record the same work on a part of the picture, after the picture itself; `plain`
        resamples parts."""
        others = (output, (0, rows[0])), (output, (rows[1], output.shape[0]))
        plain.run(commands, "strength", noisy, [(plain.output, rows), *others])
        self._blend(commands, plain.output, denoised, output, rows)
        return output

    def is_full(self, frame: ResidentFrame) -> bool:
        """Whether a frame is denoised fully everywhere, although it has a plane that could say
        otherwise."""
        strength = frame.host_planes.get(Role.STRENGTH) if self._is_whole else None
        return strength is not None and bool((strength >= 1).all())
