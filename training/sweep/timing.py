"""Run time of a variant's network and of the filters that it drives, on this CPU as postfx runs them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postfx.kernels import denoise_filter
from postfx.kernels.denoise_filter import kernel_row
from postfx.kernels.denoise_layout import FINE, KERNEL
from postfx.kernels.kernel import Kernel
from postfx.kernels.numeric import compiled
from postfx.passes._denoise_window import Sizes, Window
from postfx.runtime import ArgumentTable, Device, Library, Tensor
from training.sweep.variants import Variant

WARM_RUNS = 2


@compiled
def small_rows(y0, y1, mixed, heads, area, filtered):
    """The 3x3 kernel of a level."""
    total = np.empty(filtered.shape[2], np.float32)
    for y in range(y0, y1):
        kernel_row(y, 3, mixed, heads[0], area, total, filtered)


SMALL_FILTER = replace(denoise_filter.FILTER, name="sweep_filter", rows=small_rows)


class Times(NamedTuple):
    """Milliseconds of each run."""

    network: list[float]
    filters: list[float]


class Step(NamedTuple):
    """A kernel and its arguments."""

    kernel: Kernel
    tensors: dict[str, Tensor]


def measure(device: Device, path: Path, variant: Variant, width: int, height: int, runs: int) -> Times:
    """Time a variant's exported network, and its filters, on a frame of width x height, padded as it needs."""
    align = 2**variant.levels
    h, w = (-(-side // align) * align for side in (height, width))
    network = device.pipeline_state(Library(path.parent), path.stem, {"height": h, "width": w})
    bound = {binding.name: device.heap.tensor(binding.name, binding.shape) for binding in network.bindings}
    _randomise(bound["features"])
    table = ArgumentTable(network, bound)
    times = Times([], [])
    for _ in range(WARM_RUNS + runs):
        commands = device.command_buffer("network")
        with commands.machine_learning_encoder("network") as encoder:
            encoder.dispatch_network(network, table)
        commands.commit()
        commands.wait()
        times.network.append(commands.timings[0][1])
    steps = [(step, _table(device, step)) for step in filter_steps(device, variant, h, w)]
    for _ in range(WARM_RUNS + runs):
        commands = device.command_buffer("filters")
        with commands.compute_encoder("filters") as encoder:
            for step, arguments in steps:
                encoder.barrier()
                encoder.dispatch(device.compute_state(step.kernel), arguments)
        commands.commit()
        commands.wait()
        times.filters.append(commands.timings[0][1])
    return Times(*(series[WARM_RUNS:] for series in times))


def filter_steps(device: Device, variant: Variant, h: int, w: int) -> Iterator[Step]:
    """The pyramid's kernels in order, on random colours and weights: pool, then mix and filter from coarse to fine.

    Heads have as many channels as the kernels read at most; how many there are beside does not change the time.
    """
    window = Window.whole(Sizes(h, w, 2 * h, 2 * w, 2**variant.levels))
    sizes = [window.level(i) for i in range(variant.levels + 1)]
    colours = [_new(device, 4, *size) for size in sizes]
    heads = [_new(device, 1, KERNEL + 1 if i else FINE, *size) for i, size in enumerate(sizes)]
    smooth = [_new(device, 3, *size) for size in sizes]
    kernel = denoise_filter.FILTER if variant.taps == 5 else SMALL_FILTER
    for i in range(variant.levels):
        rows, columns = _wrapped(device, "finer", window.finer(i + 1))
        yield Step(denoise_filter.POOL, {"finer": colours[i], "finer_rows": rows, "finer_columns": columns,
                                         "level": colours[i + 1]})
    for i in reversed(range(variant.levels + 1)):
        area = device.wrap("area", np.array(sizes[i], np.float32))
        mixed = colours[i]
        if i < variant.levels:
            mixed = _new(device, 3, *sizes[i])
            rows, columns = _wrapped(device, "coarse", window.coarser(i))
            yield Step(denoise_filter.MIX_LEVELS, {"coarse": smooth[i + 1], "level": colours[i], "heads": heads[i],
                                                   "coarse_rows": rows, "coarse_columns": columns, "mixed": mixed})
        yield Step(kernel, {"mixed": mixed, "heads": heads[i], "area": area, "filtered": smooth[i]})


def _wrapped(device: Device, name: str, sides: tuple[np.ndarray, np.ndarray]) -> tuple[Tensor, Tensor]:
    return device.wrap(f"{name}_rows", sides[0]), device.wrap(f"{name}_columns", sides[1])


def _table(device: Device, step: Step) -> ArgumentTable:
    return ArgumentTable(device.compute_state(step.kernel), step.tensors)


def _new(device: Device, *shape: int) -> Tensor:
    tensor = device.heap.tensor("picture", shape)
    _randomise(tensor)
    return tensor


def _randomise(tensor: Tensor) -> None:
    tensor.upload(np.random.default_rng(0).random(tensor.shape, np.float32))
