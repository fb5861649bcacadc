"""Fast gradients of a training step: fused operations, CUDA graphs, all gradients in one buffer.

None of this changes a step's results; a CPU uses only the buffer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from training import ops
from training.denoise import loss as losses
from training.denoise import model as network
from training.denoise import picture
from training.denoise.dataset import Batch
from training.denoise.loss import Results

# Small operations in which a step spends its time. Each is bound by memory as written; compiled by
# itself it becomes one or two GPU kernels forward and as many backward. Compiling the whole step
# would take minutes for every shape.
FUSED = ((ops, ("filter_kernels", "pool", "demodulation", "dilate_motion", "box_mean", "upsample")),
         (network, ("features", "guide_features", "accumulate", "demodulate")),
         (picture, ("network_inputs", "activate")),
         (losses, ("display", "frame_loss", "noisy_frame_loss", "flicker_loss",
                   "explained_by_motion", "even_scale")))


def fuse() -> None:
    """Replace these operations in their modules, for this process."""
    torch._dynamo.config.cache_size_limit = 64
    for module, names in FUSED:
        for name in names:
            setattr(module, name, torch.compile(getattr(module, name), dynamic=False))


class FlatGradient:
    """Gradients of all parameters in one buffer: zeroed, averaged over GPUs, clipped and repaired
    as one tensor.

    ``nonfinite`` counts the steps that were dropped because their gradient was not finite.
    """

    def __init__(self, parameters: list[nn.Parameter]):
        self.buffer = torch.zeros(sum(p.numel() for p in parameters), device=parameters[0].device)
        self.nonfinite = torch.zeros((), device=parameters[0].device)
        start = 0
        for p in parameters:
            stride = p.stride()
            p.grad = self.buffer[start:start + p.numel()].as_strided(p.shape, stride, start)
            start += p.numel()

    def finish(self, limit: float, several: bool) -> Tensor:
        """Average over the GPUs and clip to norm ``limit``; a non-finite gradient becomes zero.
        Returns the norm."""
        if several:
            torch.distributed.all_reduce(self.buffer, torch.distributed.ReduceOp.AVG)
        norm = self.buffer.norm()
        self.nonfinite += ~norm.isfinite()
        self.buffer.mul_((limit / (norm + 1e-6)).clamp(max=1)).nan_to_num_(0, 0, 0)
        return norm


class GradientStep:
    """Call it with a batch: it puts the gradients into ``flat`` and returns the detached results of
    ``loss``.

    On a GPU forward and backward are a CUDA graph, one for each shape of batch: a recurrent step
    over eight frames launches some ten thousand small kernels, and replayed as a graph they take a
    third of the time. The learning rate lives in the optimiser, outside the graph, so it may change
    every step.
    """

    def __init__(self, loss: Callable[[Batch], Results], flat: FlatGradient):
        self.loss, self.flat = loss, flat
        self.captured: dict[tuple[torch.Size, bool],
                            tuple[torch.cuda.CUDAGraph, Batch, list[Any]]] = {}
        self.pool = None

    def __call__(self, batch: Batch) -> list[Any]:
        if not batch.references.is_cuda:
            return self._run(batch)
        shape = batch.references.shape, batch.inverse is not None
        if shape not in self.captured:
            self.captured[shape] = self._capture(batch)
        graph, held, results = self.captured[shape]
        copy_batch(batch, held)
        graph.replay()
        return map_tensors(results, torch.clone)

    def _run(self, batch: Batch) -> list[Any]:
        self.flat.buffer.zero_()
        results = list(self.loss(batch))
        results[0].backward()
        return map_tensors(results, torch.detach)

    def _capture(self, batch: Batch) -> tuple[torch.cuda.CUDAGraph, Batch, list[Any]]:
        held = map_tensors(batch, lambda x: x.clone(memory_format=torch.contiguous_format))
        aside = torch.cuda.Stream()
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(3):
                self._run(held)
        torch.cuda.current_stream().wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        # "thread_local": other threads, such as those that watch the exchange between GPUs, may
        # continue meanwhile.
        with torch.cuda.graph(graph, pool=self.pool, capture_error_mode="thread_local"):
            results = self._run(held)
        self.pool = self.pool or graph.pool()
        return graph, held, results


def map_tensors(value: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """A copy of dataclasses and lists, with ``change`` applied to the tensors in them."""
    if isinstance(value, Tensor):
        return change(value)
    if isinstance(value, list):
        return [map_tensors(x, change) for x in value]
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{f.name: map_tensors(getattr(value, f.name), change)
                                 for f in fields(value)})
    return value


def tensors(value: Any) -> list[Tensor]:
    """All tensors of such a structure, in order."""
    found: list[Tensor] = []

    def keep(x: Tensor) -> Tensor:
        found.append(x)
        return x

    map_tensors(value, keep)
    return found


def copy_batch(source: Batch, target: Batch) -> None:
    """Copy every tensor of one batch into another of the same shapes."""
    torch._foreach_copy_(tensors(target), tensors(source))
