"""Which networks run for frames of a spec: what follows from the options of the pass alone.

One network is asked for by its tag (`models` explains tags). Which model that means depends on the
frames: at the render's size another one runs than where frames are enlarged, and another one where
they have guides. With a time budget, smaller networks may run in its place. Where the network
gives the picture itself and no filters, a second one filters parts and alpha; and where it denoises
only at the render's size, a second one enlarges its result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from postfx.errors import PassOptionError
from postfx.frame import GUIDE_ROLES, FrameSpec, Role
from postfx.passes.denoise.geometry import Size
from postfx.passes.denoise.ladder import family
from postfx.passes.denoise.models import (
    CLASSIC,
    GUIDED,
    UNSCALED,
    denoises_first,
    filter_model,
    gives_picture,
    has_model,
    mixture_model,
    model_of,
    network_name,
    predicts_error,
    reads_mirrored,
    runs_classic,
    short_tag,
)
from postfx.passes.denoise.options import output_size
from postfx.runtime import Device

LARGEST_TAG = "xl"
"""Tag of the largest network that comes with postfx."""


@dataclass(frozen=True)
class NetworkChoice:
    """The networks for frames of a spec, by the options of the pass.

    Attributes:
        tag: of the network that was asked for, or 'classic'.
        scale, size: of the output, as the options give them.
        strength: 0 runs no network.
        has_budget: whether smaller networks may run, to keep to a time.
        has_parts: whether parts of the picture are denoised with it.
        filters_alpha: whether alpha is, too.
        adds_error: whether the network must predict its error.
    """

    tag: str
    scale: float | None
    size: Size | None
    strength: float
    has_budget: bool
    has_parts: bool
    filters_alpha: bool
    adds_error: bool

    def output_size(self, spec: FrameSpec) -> Size:
        """The size of the pass's output. Raises what `options.output_size` does."""
        return output_size(spec, self.scale, self.size)

    def is_render_size(self, spec: FrameSpec) -> bool:
        """Whether the output has the size of the render."""
        return self.output_size(spec) == (spec.height, spec.width)

    def ending(self, spec: FrameSpec) -> str:
        """The ending of the names of the models that fit frames of a spec, see `models.SPECIAL`."""
        return UNSCALED if self.is_render_size(spec) else GUIDED * self.is_guided(spec)

    def tags(self, spec: FrameSpec, has_classic: bool = True) -> tuple[str, ...]:
        """Tags of the networks that frames may take, fastest first; without a budget there is one.
        `has_classic`: whether the device has kernels for the classical filter."""
        smaller = family(self.tag)[:-1] if self.has_budget else ()
        if self.has_parts or self.adds_error or not has_classic:  # which the filter does not do
            smaller = tuple(tag for tag in smaller if tag != CLASSIC)
        ending = self.ending(spec)
        return (*(tag for tag in smaller if has_model(model_of(tag, ending))), self.tag)

    def models(self, spec: FrameSpec, device: Device) -> dict[str, str]:
        """The models that frames may take on a device, by their short tags, fastest first."""
        tags, ending = self.tags(spec, runs_classic(device)), self.ending(spec)
        found = {short_tag(tag): model_of(tag, ending, device) for tag in tags}
        if self.has_first_stage(spec):
            found[short_tag(self.tag)] = mixture_model(self.tag, ending, device)
        return found

    def has_first_stage(self, spec: FrameSpec) -> bool:
        """Whether frames are denoised at their own size before another network enlarges them."""
        may = bool(self.strength) and not self.is_render_size(spec) and denoises_first(self.tag)
        return may and not guides_stand_in(spec)

    def single_stage_model(self, spec: FrameSpec, models: Mapping[str, str],
                           device: Device) -> dict[str, str]:
        """The model for those frames that are not denoised first, by its tag: one of the `models`,
        or one more."""
        model = model_of(self.tag, self.ending(spec), device)
        known = (tag for tag, one in models.items() if one == model)
        return {next(known, network_name(short_tag(self.tag), model)): model}

    def filter_model(self, spec: FrameSpec, models: Mapping[str, str],
                     device: Device) -> str | None:
        """The model that filters parts and noisy alpha where one of the `models` cannot, as it
        gives the picture alone or sees a picture that was denoised before; None if none is
        needed."""
        is_beside = self.has_first_stage(spec) or any(map(gives_picture, models.values()))
        if not is_beside or not (self.has_parts or (self.filters_alpha and spec.has(Role.ALPHA))):
            return None
        return filter_model(self.tag, self.ending(spec), device)

    def has_guided_model(self) -> bool:
        """Whether the network has a model that reads guides."""
        return self.tag != CLASSIC and has_model(model_of(self.tag, GUIDED))

    def reads_guides(self, spec: FrameSpec) -> bool:
        """Whether a network would read the guides of frames of a spec. Not at the render's size:
        the planes, which have the samples of the colour, are better there."""
        return self.has_guided_model() and not self.is_render_size(spec)

    def is_guided(self, spec: FrameSpec) -> bool:
        """Whether frames of a spec have guides that a network reads."""
        return bool(set(spec.guide_roles) & set(GUIDE_ROLES)) and self.reads_guides(spec)

    def reads_mirrored(self, spec: FrameSpec) -> bool:
        """Whether a network reads the planes that follow mirrors and glass. If frames may change
        their size, whether one does at any of the sizes."""
        both = self.size or self.has_first_stage(spec)
        endings = ("", UNSCALED) if both else (self.ending(spec),)
        return any(reads_mirrored(model_of(tag, ending)) for tag in self.tags(spec)
                   for ending in endings)

    def gives_picture(self, spec: FrameSpec) -> bool:
        """Whether the network, or the one that runs first, gives the picture itself. Then another
        network filters parts and alpha, and a renderer's pixel filter is undone."""
        return self.has_first_stage(spec) or gives_picture(model_of(self.tag, self.ending(spec)))

    def check(self, spec: FrameSpec) -> None:
        """Raise PassOptionError where the networks for frames of a spec cannot do what the options
        ask for."""
        if self.adds_error:
            self._check_error(spec)
        if self.strength and not self.is_render_size(spec):
            self._check_enlargement(spec)

    def _check_error(self, spec: FrameSpec) -> None:
        if not self.strength:
            raise PassOptionError("strength 0 runs no network, so none predicts the error: leave "
                                  "one of the two out")
        for tag in self.tags(spec):
            if predicts_error(model_of(tag, self.ending(spec))):
                continue
            raise PassOptionError(f"model '{short_tag(tag)}' does not predict its error at this "
                                  f"size: {_error_remedy()}")

    def _check_enlargement(self, spec: FrameSpec) -> None:
        for tag in self.tags(spec):
            if gives_picture(model_of(tag, self.ending(spec))):
                raise PassOptionError(f"model '{short_tag(tag)}' denoises at the render's size and "
                                      "does not enlarge: give scale 1, or another model")


def guides_stand_in(spec: FrameSpec) -> bool:
    """Whether frames of a spec have guides in place of planes of the render's size."""
    return any(role in spec.guide_roles and not spec.has(role) for role in GUIDE_ROLES)


def _error_remedy() -> str:
    """What to do if a network does not predict its error: take one that does at the render's size,
    if one comes with postfx."""
    able = [tag for tag in family(LARGEST_TAG) if predicts_error(model_of(tag, UNSCALED))]
    return (f"give model '{able[-1]}' and scale 1, or leave the error out" if able
            else "leave the error out")
