"""Forward and backward of a training step as CUDA graphs, one for each shape of batch, forwards or both ways.

A recurrent step over eight frames launches some ten thousand small kernels; replayed as a graph they cost a third.
The learning rate lives in the optimiser, outside of the graph, so it may change every step.
"""
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from training.dataset import Batch


class FlatGradient:
    """Gradients of all parameters in one buffer: zeroed, summed over GPUs, clipped and mended as one tensor."""

    def __init__(self, parameters: list[nn.Parameter]):
        self.buffer = torch.zeros(sum(p.numel() for p in parameters), device=parameters[0].device)
        start = 0
        for p in parameters:
            stride = p.stride()
            p.grad = self.buffer[start:start + p.numel()].as_strided(p.shape, stride, start)
            start += p.numel()

    def finish(self, limit: float, several: bool) -> Tensor:
        """Mean over the GPUs, clipped to norm ``limit``; a step with a non-finite gradient becomes none."""
        if several:
            torch.distributed.all_reduce(self.buffer, torch.distributed.ReduceOp.AVG)
        norm = self.buffer.norm()
        self.buffer.mul_((limit / (norm + 1e-6)).clamp(max=1)).nan_to_num_(0, 0, 0)
        return norm


class GradientStep:
    """Call it with a batch: gradients are then in ``flat``, and the detached results of ``loss`` are returned."""

    def __init__(self, loss: Callable[[Batch], tuple[Tensor, ...]], flat: FlatGradient):
        self.loss, self.flat = loss, flat
        self.captured: dict[tuple[torch.Size, bool], tuple[torch.cuda.CUDAGraph, Batch, list[Tensor]]] = {}
        self.pool = None

    def __call__(self, batch: Batch) -> list[Tensor]:
        if not batch.references.is_cuda:
            return self._run(batch)
        shape = batch.references.shape, batch.inverse is not None
        if shape not in self.captured:
            self.captured[shape] = self._capture(batch)
        graph, held, results = self.captured[shape]
        copy_batch(batch, held)
        graph.replay()
        return [r.clone() for r in results]

    def _run(self, batch: Batch) -> list[Tensor]:
        self.flat.buffer.zero_()
        results = self.loss(batch)
        results[0].backward()
        return [r.detach() for r in results]

    def _capture(self, batch: Batch) -> tuple[torch.cuda.CUDAGraph, Batch, list[Tensor]]:
        held = mapped(batch, lambda x: x.clone(memory_format=torch.contiguous_format))
        aside = torch.cuda.Stream()
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(3):
                self._run(held)
        torch.cuda.current_stream().wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        # Other threads, such as those that watch over the exchange between GPUs, may go on meanwhile.
        with torch.cuda.graph(graph, pool=self.pool, capture_error_mode="thread_local"):
            results = self._run(held)
        self.pool = self.pool or graph.pool()
        return graph, held, results


def mapped(value: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """The same structure of dataclasses and lists with ``change`` done to its tensors."""
    if isinstance(value, Tensor):
        return change(value)
    if isinstance(value, list):
        return [mapped(x, change) for x in value]
    if is_dataclass(value):
        return replace(value, **{f.name: mapped(getattr(value, f.name), change) for f in fields(value)})
    return value


def tensors(value: Any) -> list[Tensor]:
    """All tensors of such a structure, in order."""
    found: list[Tensor] = []
    mapped(value, lambda x: found.append(x) or x)
    return found


def copy_batch(source: Batch, target: Batch) -> None:
    """Copy every tensor of one batch into another of the same shapes."""
    torch._foreach_copy_(tensors(target), tensors(source))
