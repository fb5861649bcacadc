"""What the denoised upscaler runs for one frame: its tensors, argument tables and the order of its commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from postfx.kernels import (
    denoise_features,
    denoise_filter,
    denoise_guides,
    denoise_history,
    denoise_layout,
    denoise_prepare,
    denoise_upsample,
)
from postfx.kernels.kernel import Kernel
from postfx.passes._denoise_network import Network, heads_of, seen_by
from postfx.runtime import ArgumentTable, CommandBuffer, ComputeEncoder, Device, Library, PipelineState, Tensor

ALIGN = 16
LEVELS = 4


@dataclass(frozen=True)
class Sizes:
    """Render size, the same padded for the network, and output size."""

    h: int
    w: int
    height: int
    width: int

    @property
    def padded(self) -> tuple[int, int]:
        return -(-self.h // ALIGN) * ALIGN, -(-self.w // ALIGN) * ALIGN

    def level(self, i: int) -> tuple[int, int]:
        """Padded size of a pyramid level."""
        return self.padded[0] >> i, self.padded[1] >> i

    def area(self, i: int) -> np.ndarray:
        """Rows and columns of a pyramid level that hold picture."""
        return np.array([-(-self.h // 2**i), -(-self.w // 2**i)], np.float32)


def has_model(model: str) -> bool:
    """Whether a model comes with postfx."""
    return model in Library().names()


class Graph:
    """Pipeline states, tensors and argument tables of one size; the history is kept in two sets used in turn.

    A guided graph's models read guides beside the features, and colour has no reflectance until output size. Of several
    models the first is in use until `use` takes another.
    """

    def __init__(self, device: Device, sizes: Sizes, models: Sequence[str], guided: bool = False) -> None:
        self._device, self._sizes, self._guided = device, sizes, guided
        dims = dict(zip(("height", "width"), sizes.padded, strict=True))
        networks = {model: device.pipeline_state(Library(), model, dims) for model in models}
        self._tables: dict[str, ArgumentTable] = {}
        self._make_tensors(networks[models[0]])
        self._make_tables()
        between = cache(self._new)  # of several networks only one runs in a frame
        self._networks = {model: Network(state, self._seen, self._heads, between) for model, state in networks.items()}
        self.model = models[0]
        self._turn = 0

    def use(self, model: str) -> None:
        """Take another model from the next frame on. The history goes on, but for the hidden state: another network
        cannot read it, and nothing in its place is what every network knows from first frames."""
        if model == self.model:
            return
        self.model = model
        state = self._state[1 - self._turn]
        values = state.download()
        values[..., -denoise_layout.HIDDEN:] = 0
        state.upload(values)

    def encode(self, commands: CommandBuffer, planes: Mapping[str, Tensor], params: np.ndarray) -> Tensor:
        """Record one frame; returns the output colour tensor."""
        self._turn ^= 1
        self._params.upload(params)
        for name in ("scale", "dilate", "history", *self._looks, "accumulate", "remodulate", "upsample"):
            self._bind(name, planes)
        with commands.compute_encoder("prepare") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            self._run(encoder, "scale", "dilate")
            for names in (("history",), self._looks):
                encoder.barrier()
                self._run(encoder, *names)
        self._networks[self.model].encode(commands)
        with commands.compute_encoder("filter") as encoder:
            encoder.barrier(after=("compute", "machine-learning"), before="compute")
            for i, name in enumerate(self._filter_order):
                if i:
                    encoder.barrier()
                self._run(encoder, name)
        with commands.compute_encoder("upsample") as encoder:
            encoder.barrier(after="compute", before="compute")
            self._run(encoder, "upsample")
        return self._output

    def _new(self, name: str, shape: tuple[int, ...], dtype: str = "float32") -> Tensor:
        return self._device.heap.transient(name, shape, dtype)

    def _kept(self, name: str, shape: tuple[int, ...]) -> Tensor:
        return self._device.heap.tensor(name, shape)

    def _make_tensors(self, network: PipelineState) -> None:
        s = self._sizes
        self._params = self._kept("params", (5,))
        self._depth_scale = self._new("depth scale", (1,))
        self._moved = self._new("moved", (s.h, s.w, 2))
        self._warped = self._new("warped", (s.height, s.width, 3))
        self._past = self._new("past", (s.h, s.w, 4))
        self._radiance = self._new("radiance", (3, s.h + 2, s.w + 2))
        self._output = self._new("output", (s.height, s.width, 3))
        self._heads = {name: self._new(name, shape) for name, shape in heads_of(network).items()}
        self._seen = {name: self._new(name, shape) for name, shape in seen_by(network).items()}
        # Before the first frame the history holds nothing, and nothing of it is used: it only has to be defined.
        self._history = [self._zeros("history", (s.height, s.width, 3)) for _ in range(2)]
        self._state = [self._zeros("state", (s.h, s.w, 4 + denoise_layout.HIDDEN)) for _ in range(2)]
        self._depth = [self._zeros("depth", (s.h, s.w, 1)) for _ in range(2)]
        if self._guided:
            self._black = self._zeros("no reflectance", (s.h, s.w, 3))  # makes a factor of one

    def _zeros(self, name: str, shape: tuple[int, ...]) -> Tensor:
        tensor = self._kept(name, shape)
        tensor.fill(0)
        return tensor

    def _make_tables(self) -> None:
        prepare = {"params": self._params, "moved": self._moved, "warped": self._warped, "past": self._past,
                   "depth_scale": self._depth_scale, "fine": self._heads["fine"], **self._seen}
        levels = [self._new(f"level {i}", (4, *self._sizes.level(i))) for i in range(LEVELS + 1)]
        filtered = [self._new(f"filtered {i}", (3, *self._sizes.level(i))) for i in range(LEVELS + 1)]
        upsample = denoise_upsample.UPSAMPLE_GUIDED if self._guided else denoise_upsample.UPSAMPLE
        self._looks = ("features", "guides") if self._guided else ("features",)
        for name, kernel in (("scale", denoise_prepare.SCALE), ("dilate", denoise_prepare.DILATE),
                             ("history", denoise_history.HISTORY), ("features", denoise_features.FEATURE),
                             ("guides", denoise_guides.GUIDE), ("accumulate", denoise_prepare.ACCUMULATE),
                             ("remodulate", denoise_filter.REMODULATE), ("upsample", upsample)):
            self._table(name, kernel, **prepare, level=levels[0], radiance=self._radiance, output=self._output,
                        filtered=filtered[0])
        self._filter_order = ["accumulate", *(f"pool {i}" for i in range(1, LEVELS + 1))]
        for i in range(1, LEVELS + 1):
            self._table(f"pool {i}", denoise_filter.POOL, finer=levels[i - 1], level=levels[i])
        for i in range(LEVELS, -1, -1):
            heads, mixed = self._heads["fine" if i == 0 else f"level{i}"], levels[i]
            if i < LEVELS:
                mixed = self._new(f"mixed {i}", (3, *self._sizes.level(i)))
                self._table(f"mix {i}", denoise_filter.MIX_LEVELS, coarse=filtered[i + 1], level=levels[i],
                            heads=heads, mixed=mixed)
                self._filter_order.append(f"mix {i}")
            area = self._kept(f"area {i}", (2,))
            area.upload(self._sizes.area(i))
            self._table(f"filter {i}", denoise_filter.FILTER, mixed=mixed, heads=heads, area=area, filtered=filtered[i])
            self._filter_order.append(f"filter {i}")
        self._filter_order.append("remodulate")

    def _table(self, name: str, kernel: Kernel, **tensors: Tensor) -> None:
        """An argument table for a kernel, with those of the tensors that it names."""
        table = ArgumentTable(self._device.compute_state(kernel))
        for binding in kernel.reads + kernel.writes:
            if binding in tensors:
                table[binding] = tensors[binding]
        self._tables[name] = table

    def _bind(self, name: str, planes: Mapping[str, Tensor]) -> None:
        """Bind what changes from frame to frame: the frame's planes and the two sets of history."""
        last, now = self._turn, 1 - self._turn
        if self._guided and name == "remodulate":
            planes = dict.fromkeys(denoise_layout.REFLECTANCE, self._black)
        changing = dict(planes) | {
            "history": self._history[last], "state": self._state[last], "last_depth": self._depth[last],
            "next_history": self._history[now], "next_state": self._state[now], "next_depth": self._depth[now]}
        table = self._tables[name]
        for binding in table.state.bindings:
            if binding.name in changing:
                table[binding.name] = changing[binding.name]

    def _run(self, encoder: ComputeEncoder, *names: str) -> None:
        for name in names:
            encoder.dispatch(self._tables[name].state, self._tables[name])
