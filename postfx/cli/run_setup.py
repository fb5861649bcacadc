"""What the arguments of `postfx run` ask for, settled by the first frame: what is read, what runs
on it, and what is written."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import Any

from postfx.cli.interruptions import Faults, OnError, Standin, check_memory, first_readable
from postfx.cli.run_options import (
    RUN,
    explain_kept,
    explain_overlay,
    find_partner,
    make_run_up,
    refuse_layer,
    refuse_views,
)
from postfx.cli.usual_network import choose_network, choose_pixel_filter, is_chosen
from postfx.errors import OptionError, WriteError
from postfx.exposure import SMOOTH_MODE, ExposureMeter, SmoothExposure, colours_of
from postfx.frame import Frame, FrameSpec, Part, Role
from postfx.io.parts import group_parts
from postfx.io.read_options import ESTIMATED_MOTION
from postfx.io.sequence import Sequence, read_sequence
from postfx.io.writer import ExistingFiles, OutputFiles, write_frame
from postfx.passes import Pass
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.default_network import USUAL_NETWORK
from postfx.passes.denoise.options import enlargement
from postfx.passes.display import is_shown, make_display_passes
from postfx.passes.exposure_tool import asked_form
from postfx.passes.registry import create, insert_passes, parse_pass
from postfx.pipeline import Pipeline
from postfx.plan import Skip, from_files
from postfx.runtime import Device
from postfx.temporal.plain_albedo import is_plain
from postfx.temporal.reverse_order import Backwards
from postfx.wrap import WRAP_AROUND, WRAP_AUTO, WRAP_NONE, is_panorama

NOWHERE = "nowhere to write: give -o OUTPUT, e.g. -o out/clean.####.exr"


class RunSetup:
    """Everything that a run reads, runs and writes.

    Raises PostfxError when the arguments, the first frame or the outputs do not fit together.

    Attributes:
        arguments: of the command line.
        skips: what the arguments leave out, and why.
        sequence: the input.
        outputs: where results go; None for a plan that writes none.
        first: number of the first frame that can be read; the plan is made for it.
        is_smooth: whether exposure follows from all frames.
        backwards: runs frames in reverse order for --both-ways; None for none.
        run_up: what runs before the first frame of a shot; None for nothing.
        pipeline: the passes on their device.
        plan: of the first frame.
        kept: a line that says which channels of the input are written again.
        channels: plane -> names of its channels in the first frame's files.
        enable: plane -> where the user switches it on in the renderer.
        guides: planes at output size that are read from files.
        format: options of the files' writer.
        faults: goes on after frames that fail, as far as --on-error allows.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        RUN.refuse_conflicts(arguments)
        self.arguments = arguments
        device = Device(**self.values("device"))
        self.skips: list[Skip] = []
        if arguments.yielded:
            self.skips.append(Skip(f"{' '.join(arguments.yielded)} of --preset {arguments.preset}",
                                   "other options that are given do not go with it"))
        policy = OnError(arguments.on_error)

        # What is read and written.
        self.sequence = read_sequence(arguments.input, arguments.frames, scratch=device.scratch,
                                      **self.values("sequence"))
        self.outputs = _find_outputs(arguments, self.sequence)
        refuse_layer(arguments, self.outputs)
        self._refuse_error_in_pictures()
        if policy is OnError.STOP and not (arguments.explain or arguments.skip_existing):
            self.sequence.refuse_holes(self.sequence.numbers)
        self.is_smooth = arguments.exposure == SMOOTH_MODE
        exposure = (SmoothExposure(colours_of(self.sequence, policy is not OnError.STOP))
                    if self.is_smooth else ExposureMeter(arguments.exposure))
        # before any file is opened, which tells of it
        native = not is_shown(self._is_picture, **self.values("look"))
        self.sequence.colours = dataclasses.replace(self.sequence.colours, native=native)
        self.first = first_readable(self.sequence, OnError.SKIP if arguments.explain else policy)

        # What runs.
        cuts = "auto" if arguments.cuts == "auto" else "none"
        denoising = None if arguments.no_denoise else self._denoiser_options(device)
        is_covered = asked_form() == "whole"  # by a checkerboard, under which nothing is denoised
        both_ways = self._goes_both_ways() and not is_covered
        wrap = self._find_wrap()
        self.backwards = (Backwards(self.sequence, device,
                                    exposure if self.is_smooth else arguments.exposure, cuts,
                                    wrap=wrap, **denoising | {"error": False})
                          if denoising is not None and both_ways else None)
        self.run_up = None if is_covered else make_run_up(arguments, self.sequence, cuts)
        self._parts = self._find_parts()
        partner = None if is_covered else self._find_partner(denoising)
        passes, skips = self._make_passes(denoising, self.backwards is not None, partner)
        self.skips += skips
        # without checks, as the run looks at the first frames itself, which knows the files
        self.pipeline = Pipeline(passes, device, exposure, cuts, self.run_up, checks=False,
                                 wrap=wrap)
        refuse_views(self.sequence, self.outputs)
        self._explain_first_frame()
        if (not arguments.explain and arguments.model != "classic" and device.memory.host_visible
            and not device.scratch):
            check_memory(self.plan, self.sequence)
        self.guides = from_files(self.plan.guides)
        self.format = self.values("writer")
        standin = None
        if policy is OnError.COPY:
            plain, _ = self._make_passes(None if denoising is None else self._resample_options())
            standin = Standin(self.sequence, plain, device, exposure)
        self.faults = Faults(policy, standin)

    def check_outputs(self) -> None:
        """Raise WriteError or OptionError where outputs cannot be written, or hold what is asked
        for."""
        arguments = self.arguments
        if self.outputs is None:
            return
        self.outputs.check_storage(self.plan.output.encoding, arguments.bits,
                                   arguments.compression)
        if not arguments.explain:
            self.outputs.check(self.sequence.numbers)

    def values(self, part: str) -> dict[str, Any]:
        """Arguments of one part of a run, by name."""
        return RUN.values_for(part, self.arguments)

    @property
    def files(self) -> OutputFiles:
        """The outputs; WriteError where there are none."""
        if self.outputs is None:
            raise WriteError(NOWHERE)
        return self.outputs

    def write(self, path: Path, frame: Frame,
              provenance: Mapping[str, str | float] | None = None) -> Path:
        """Write a file as the run's options ask for, with ``provenance`` in its header; returns its
        path. Raises WriteError."""
        return write_frame(path, frame, relax=self.pipeline.device.memory.relax,
                           provenance=provenance, **self.format)

    @property
    def is_exposed(self) -> bool:
        """Whether the exposure is in the pixels that are written."""
        return self.plan.output.encoding != self.plan.input.encoding

    @property
    def undone_stddev(self) -> float:
        """The standard deviation in pixels of the pixel filter that the denoiser undoes; 0 for
        none."""
        return max((step.instance.undone_stddev(self.plan.input) for step in self.plan.steps
                    if isinstance(step.instance, DenoiseUpscale)), default=0.0)

    @property
    def leaves_filters(self) -> bool:
        """Whether the denoiser leaves noise that a pixel filter has spread."""
        return any(isinstance(step.instance, DenoiseUpscale)
                   and step.instance.leaves_filters(self.plan.input) for step in self.plan.steps)

    @cached_property
    def is_still(self) -> bool:
        """Whether there is one picture, which is no part of a shot."""
        return len(self.sequence.present()) == 1 and not self.sequence.before(self.first, 1)

    @property
    def _is_picture(self) -> bool:
        """Whether the output is a picture for a display."""
        return self.outputs is not None and self.outputs.display

    def _refuse_error_in_pictures(self) -> None:
        """OptionError where the AOV 'error' is asked for, and the output cannot hold it."""
        if self.arguments.no_denoise or not self._is_picture:
            return
        if self.values("denoiser").get("error"):
            raise OptionError(f"{self.arguments.output}: pictures for a display hold no AOV "
                              "'error': write EXR, or leave error out of --aov")

    @cached_property
    def _first_spec(self) -> FrameSpec:
        """The first frame's spec, before it is known what is left out of it: for its sizes."""
        with self.sequence.open(self.first) as files:
            return files.spec()

    def _denoiser_options(self, device: Device) -> dict[str, Any]:
        """The denoiser's options. They name the pixel filter that is undone, and without --model
        the network that is best, unless time or memory is bounded."""
        given = self.values("denoiser")
        if not is_chosen(self.arguments, given):
            choice = choose_network(self._first_spec, given, device)
            if choice.lack:
                self.skips.append(Skip("the best network", choice.lack))
            given["model"] = choice.network
        elif "model" not in given:
            bound = "--memory" if self.arguments.budget is None else "--budget"
            self.skips.append(Skip("the best network", f"{bound} takes {USUAL_NETWORK} unless "
                                                       "--model names another"))
        return {**given, "pixel_filter": choose_pixel_filter(self.sequence, self.first, given)}

    def _goes_both_ways(self) -> bool:
        """Whether the denoiser is to run in both directions: not if albedo shows no textures, which
        is noted."""
        if self.arguments.both_ways and self._has_plain_albedo():
            self.arguments.both_ways = False
            self.skips.append(Skip("both_ways", "albedo shows no textures, so that more history in "
                                                "one order shows more of them"))
        return bool(self.arguments.both_ways) and self.arguments.strength != 0

    def _has_plain_albedo(self) -> bool:
        """Whether the first frame's diffuse albedo shows none of the textures: a default, an
        override material, or one colour for each object."""
        with self.sequence.open(self.first) as files:
            if not files.spec().has(Role.DIFFUSE_ALBEDO):
                return False
            planes = files.read(self.first, [Role.DIFFUSE_ALBEDO, Role.COLOUR], []).planes
        return {Role.DIFFUSE_ALBEDO, Role.COLOUR} <= planes.keys() and is_plain(
            planes[Role.DIFFUSE_ALBEDO], planes[Role.COLOUR])

    def _find_wrap(self) -> str:
        """Whether frames are panoramas, by the option or the first frame's header, as the pipeline
        names it."""
        if self.arguments.wrap != WRAP_AUTO:
            return str(self.arguments.wrap)
        with self.sequence.open(self.first) as files:
            return WRAP_AROUND if is_panorama(files.layout.attributes) else WRAP_NONE

    def _find_parts(self) -> tuple[Part, ...]:
        """Parts of the picture that --aov and --aov-denoise ask for; none where the output cannot
        hold them."""
        if self.sequence.options.parts is None:
            return ()
        if is_shown(self._is_picture, **self.values("look")):
            self.skips.append(Skip("light groups and passes",
                                   "they are scene-linear, the output is not"))
            self.sequence.options = self.sequence.options.without_parts()
            return ()
        with self.sequence.open(self.first) as files:
            parts = tuple(found.part for found in files.parts.values())
            if not any(part.is_light for part in parts):
                return parts
            frame = files.read(self.first, [Role.COLOUR], [])
        grouped, notes = group_parts(parts, frame[Role.COLOUR], frame.parts)
        for note in notes:
            self.sequence.warn(note)
        return grouped

    def _find_partner(self, denoising: dict[str, Any] | None) -> str | None:
        """The other denoiser that runs beside ours, None for none. denoising: options of ours, None
        where it does not run."""
        if denoising is None or self.arguments.strength == 0:
            return None
        enlarges = enlargement(self._first_spec, denoising) > 1
        partner, lack = find_partner(getattr(self.arguments, "with"), enlarges)
        self.skips += [Skip("Open Image Denoise", lack)] if lack else []
        return partner

    def _make_passes(self, denoising: dict[str, Any] | None, both_ways: bool = False,
                     partner: str | None = None) -> tuple[list[Pass], list[Skip]]:
        """The passes, the denoiser with these options, or without one if they are None; and what is
        left out."""
        passes, skips, parts = [], [], {"parts": self._parts} if self._parts else {}
        if denoising is None:
            skips.append(Skip("denoise_upscale", "--no-denoise"))
        else:
            if partner:
                passes.append(create("partner", of=partner,
                                     pixel_filter=denoising.get("pixel_filter", "auto")))
            passes.append(create("denoise_upscale", **denoising, **parts))
        passes += [create("both_ways", **parts)] if both_ways else []
        if denoising is not None and partner:
            strength = denoising.get("strength")
            passes.append(create("mix_partner", strength=1.0 if strength is None else strength,
                                 scale=enlargement(self._first_spec, denoising),
                                 model=denoising.get("model", "m"), both_ways=both_ways, **parts))
        passes += [create("overlay")] if self.arguments.overlay == "composite" else []
        shown, not_shown = make_display_passes(self._is_picture, **self.values("look"))
        asked = map(parse_pass, getattr(self.arguments, "pass") or ())
        chain = insert_passes([*passes, *shown], tuple(asked), len(passes))
        if both_ways and chain[0].name not in ("denoise_upscale", "partner"):
            raise OptionError("--both-ways denoises frames as they are in their files, before "
                              f"pass '{chain[0].name}': let the pass run after=denoise_upscale, or "
                              "leave --both-ways out")
        return chain, skips + not_shown

    def _explain_first_frame(self) -> None:
        """Make the plan by the first frame's files, and settle what of them is written again."""
        with ExitStack() as stack:
            files = stack.enter_context(self.sequence.open(self.first))
            self.skips += explain_overlay(self.arguments, files)
            self.channels = {role: match.names for role, match in files.layout.planes.items()}
            self.enable = files.layout.hints()
            if self.sequence.options.motion == ESTIMATED_MOTION:  # which is no fault of the files
                self.enable.pop(Role.MOTION, None)
            spec = files.spec()
            self.plan = self.pipeline.explain(self.backwards.spec(spec) if self.backwards
                                              else spec)
            others = [stack.enter_context(self.sequence.reader(view).open(self.first))
                      for view in self.sequence.views]
            size = self.plan.output.width, self.plan.output.height
            self.kept, skips = explain_kept(self.arguments, files, size, others)
            self.skips += skips

    def _resample_options(self) -> dict[str, Any]:
        """Options of a denoiser that only resamples, to the plan's size."""
        size = self.arguments.size
        return {"strength": 0.0, **({"size": size} if size
                                    else {"scale": self.plan.output.width / self.plan.input.width})}


def _find_outputs(arguments: argparse.Namespace, sequence: Sequence) -> OutputFiles | None:
    existing = ExistingFiles.OVERWRITE if arguments.overwrite else ExistingFiles.REFUSE
    existing = ExistingFiles.SKIP if arguments.skip_existing else existing
    if not arguments.output and not arguments.explain:
        raise WriteError(NOWHERE)
    return OutputFiles(arguments.output, sequence, existing) if arguments.output else None
