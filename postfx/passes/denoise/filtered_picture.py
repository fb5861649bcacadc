"""A second network that filters parts and noisy alpha, where the picture's network cannot: it gives
the picture alone, or reads a picture that was denoised before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from postfx.frame import Part
from postfx.kernels.denoise import GAIN
from postfx.passes import ResidentFrame
from postfx.passes.denoise.alpha import has_noisy_alpha
from postfx.passes.denoise.assembly import FrameNetworks
from postfx.passes.denoise.geometry import Sizes
from postfx.passes.denoise.history import FILTERED_PICTURE, PartHistory
from postfx.passes.denoise.models import blanks_volumes, grid_of
from postfx.passes.denoise.parts import Layers, OwnRun
from postfx.passes.denoise.planes import Planes
from postfx.passes.denoise.window import THE_PICTURE, FrameWork
from postfx.runtime import CommandBuffer, Device, Tensor


class FilteredPicture:
    """Filters parts and noisy alpha by a network that predicts filters.

    The network filters the picture, too, as its own history: parts add up to that picture, and
    alpha's edges follow it.

    Args:
        sizes: of the frames.
        model: the network of filters.
        reactive: whether frames have a mask that tells where the history is not used.
        parts: those of the frames.
        layers: parts, and alpha.
        history: of the layers; it has a history for this network, too.
    """

    def __init__(self, device: Device, sizes: Sizes, model: str, reactive: bool,
                 parts: Iterable[Part], layers: Layers, history: PartHistory) -> None:
        self._model, self._layers, self._history = model, layers, history
        self._has_parts, self._blanks = any(parts), blanks_volumes(model)
        own = replace(sizes, grid=grid_of([model]))
        self._networks = FrameNetworks(device, own, [model], history.own[FILTERED_PICTURE],
                                       reactive=reactive, layered=True)
        self._own = own_networks(self._networks, history)

    def runs_on(self, frame: ResidentFrame) -> bool:
        """Whether a frame has something to filter."""
        return self._has_parts or has_noisy_alpha(frame)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame, planes: Mapping[str, Tensor],
               hazy: Planes, work: FrameWork) -> Tensor:
        """Record the work on parts and alpha; returns the picture that was filtered with them.

        Args:
            planes: of the picture's network, by the kernels' names, with the noisy colour.
            hazy: makes stand-ins for planes that a volume hides.
            work: the work on the picture, of which this network has its own form.
        """
        keep = work.keep and FILTERED_PICTURE in self._history.ran
        band = None if work.cells is None else self._networks.layout(work.cells)
        own = work._replace(model=self._model, keep=keep, still=work.still and keep, band=band)
        seen = {**planes, **(hazy.stand_ins(frame) if self._blanks else {})}
        layers, targets = self._layers.begin(commands, frame, seen, own)
        picture = self._networks.encode(commands, seen, own, layers, targets)
        encode_own(commands, self._own, self._layers.own_runs(frame, seen, own), own)
        self._history.ran += (FILTERED_PICTURE,)
        return picture


def own_networks(networks: FrameNetworks, history: PartHistory) -> dict[str, FrameNetworks]:
    """The same networks for each part that has filters of its own, by the part's name."""
    return {name: networks.beside(own) for name, own in history.own.items()
            if name != FILTERED_PICTURE}


def encode_own(commands: CommandBuffer, networks: Mapping[str, FrameNetworks],
               runs: Iterable[OwnRun], work: FrameWork) -> None:
    """Record the network's work on parts that have filters of their own, by `own_networks`."""
    for run in runs:
        still = run.params[GAIN] == work.params[GAIN]
        own = work._replace(params=run.params, still=work.still and bool(still))
        networks[run.name].encode(commands, run.planes, own, (),
                                  {THE_PICTURE: {"output": run.output}})
