"""Noisy alpha beside a network that gives the picture alone: another network predicts filters for
it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from postfx.passes import ResidentFrame
from postfx.passes.denoise.assembly import Frames
from postfx.passes.denoise.history import ALPHA_PICTURE, PartHistory
from postfx.passes.denoise.models import blanks_volumes, grid_of
from postfx.passes.denoise.parts import Layers, has_noisy_alpha
from postfx.passes.denoise.planes import Planes
from postfx.passes.denoise.tiling import Sizes
from postfx.passes.denoise.window import Work
from postfx.runtime import CommandBuffer, Device, Tensor


class AlphaPicture:
    """Denoises frames with noisy alpha by a network of filters, for the alpha. The picture that it
    makes is its own history, and alpha's edges follow it.

    Args:
        sizes: of the frames.
        model: the network of filters.
        reactive: whether frames have a mask that tells where the history is not used.
        layers: alpha among them.
        history: has one for this network.
    """

    def __init__(self, device: Device, sizes: Sizes, model: str, reactive: bool, layers: Layers,
                 history: PartHistory) -> None:
        self._model, self._layers, self._history = model, layers, history
        self._blanks = blanks_volumes(model)
        own = replace(sizes, grid=grid_of([model]))
        self._frames = Frames(device, own, [model], history.own[ALPHA_PICTURE], False, reactive,
                              True)

    def runs_on(self, frame: ResidentFrame) -> bool:
        """Whether a frame's alpha is noisy."""
        return has_noisy_alpha(frame)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, planes: Mapping[str, Tensor],
               hazy: Planes, work: Work) -> Tensor:
        """Record the work that filters alpha; returns the picture that `Layers.finish` corrects it
        by.

        Args:
            planes: those of the network that gives the picture.
            hazy: makes stand-ins for planes that a volume hides.
            work: what is done for the picture.
        """
        keep = work.keep and ALPHA_PICTURE in self._history.ran
        band = None if work.cells is None else self._frames.layout(work.cells)
        own = work._replace(model=self._model, keep=keep, still=work.still and keep, band=band)
        seen = {**planes, **(hazy.stand_ins(frame) if self._blanks else {})}
        layers, targets = self._layers.begin(commands, frame, seen, own)
        self._frames.use(self._model)
        picture = self._frames.encode(commands, seen, own, layers, targets)
        self._history.ran = (ALPHA_PICTURE,)
        return picture
