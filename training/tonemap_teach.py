"""Teaching the tone mapper a look whose pipeline is known; the result is a checkpoint to export."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from training.looks import describe
from training.networks.cube import default_shaper, look_up, shape
from training.networks.hdrnet import HDRNet
from training.tonemap_data import Views
from training.tonemap_exposure import teach_exposure
from training.tonemap_loop import Recipe, Report, Source, run_of, score, train
from training.tonemap_set import Lesson, Pictures
from training.tonemap_start import start_network

Checkpoint = dict[str, Any]
"""cube; weights, None where the cube is all; look; pictures trained on; psnr of those held out; history of runs."""
Watch = Callable[[Report], None]
Examples = dict[str, np.ndarray]


def teach_look(
    task: Lesson, pictures: Pictures, start: str, recipe: Recipe, device: torch.device, watch: Watch
) -> Checkpoint:
    """Learn a look whose pipeline is known; what depends on colour alone needs no training."""
    common = {"look": describe(task.look), "cube": task.cube, "pictures": list(pictures.train)}
    if task.look.is_global:
        return {**common, "weights": None, "history": [], "psnr": cube_psnr(task.cube, pictures.held, task.wanted)}
    source = Views(pictures, task.look, task.cube, device, recipe.seed)
    if task.look.is_exposure:
        return {**common, **teach_exposure(source, recipe, pictures.held, task.wanted, watch)}
    net = start_network(start, task.cube).to(device)
    return {**common, **run(net, source, recipe, pictures.held, task.wanted, watch)}


def run(net: HDRNet, source: Source, recipe: Recipe, held: Examples, wanted: Examples, watch: Watch) -> Checkpoint:
    """Train; the part of a checkpoint that comes of it."""
    for average, report in train(net, source, recipe, held, wanted):  # noqa: B007
        watch(report)
    weights = copy.deepcopy(average).cpu().state_dict()
    return {"weights": weights, "psnr": report.psnr, "history": [run_of(recipe, report, net.cube.device)]}


def cube_psnr(cube: torch.Tensor, held: Examples, wanted: Examples) -> dict[str, float]:
    """PSNR in sRGB values of each held-out picture by a cube alone."""
    scores = {}
    for name, rgb in held.items():
        x = torch.from_numpy(rgb.astype(np.float32)).permute(2, 0, 1)[None]
        scores[name] = score(look_up(shape(x, *default_shaper()), cube), wanted[name])
    return scores
