"""Forward and backward of a training step as CUDA graphs, one for each shape of batch.

A recurrent step over eight frames launches some ten thousand small kernels; replayed as a graph they cost a third.
The learning rate lives in the optimiser, outside of the graph, so it may change every step.
"""
from collections.abc import Callable
from dataclasses import fields, replace

import torch
from torch import Tensor, nn

from training.dataset import Batch
from training.networks.denoise_upscale import Inputs


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
        self.captured: dict[torch.Size, tuple[torch.cuda.CUDAGraph, Batch, list[Tensor]]] = {}
        self.pool = None

    def __call__(self, batch: Batch) -> list[Tensor]:
        if not batch.references.is_cuda:
            return self._run(batch)
        shape = batch.references.shape
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
        held = Batch([replace(f, **{name: x.clone() for name, x in tensors(f).items()}) for f in batch.frames],
                     batch.references.clone())
        aside = torch.cuda.Stream()
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(3):
                self._run(held)
        torch.cuda.current_stream().wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=self.pool):
            results = self._run(held)
        self.pool = self.pool or graph.pool()
        return graph, held, results


def tensors(inputs: Inputs) -> dict[str, Tensor]:
    """What a frame holds, by name, without what it leaves out."""
    held = {field.name: getattr(inputs, field.name) for field in fields(inputs)}
    return {name: x for name, x in held.items() if x is not None}


def copy_batch(source: Batch, target: Batch) -> None:
    """Copy every tensor of one batch into another of the same shapes."""
    for a, b in zip(source.frames, target.frames, strict=True):
        held = tensors(b)
        for name, x in tensors(a).items():
            held[name].copy_(x)
    target.references.copy_(source.references)
