"""Teaching a look whose all is one exposure before its view: a regression on the stops of many views."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from training.looks import key_stops
from training.networks.cube import default_shaper
from training.networks.exposure import Exposure, levels
from training.networks.hdrnet import lowres
from training.tonemap_data import Views
from training.tonemap_loop import CONSISTENCY, SHIFT, Recipe, Report, run_of, validate, windows

VIEWS, STEPS, BATCH, RATE, DECAY = 8000, 8000, 256, 3e-3, 1e-3
ROUND = 0.05  # stops: below, errors count squared


def teach_exposure(
    source: Views, recipe: Recipe, held: dict[str, np.ndarray], wanted: dict[str, np.ndarray],
    watch: Callable[[Report], None],
) -> dict[str, Any]:
    """The part of a checkpoint that comes of it; of a recipe only the seed counts, as this takes but some minutes."""
    start = time.monotonic()
    found = examples(source, VIEWS)
    net = Exposure(source.cube)
    wrong, apart = fit(net, found, recipe.seed)
    scores = validate(net, held, wanted)
    report = Report(STEPS, round(time.monotonic() - start, 1), wrong, apart, scores)
    watch(report)
    run = run_of(recipe, report, source.device)
    facts = {name: run[name] for name in ("steps", "device", "torch", "seconds", "seed")}
    history = {**facts, "views": VIEWS, "batch": BATCH, "rate": RATE}
    return {"weights": net.cpu().state_dict(), "psnr": scores, "history": [history]}


@dataclass(frozen=True)
class Examples:
    """Of N views, each seen twice, shifted as two frames are: the means (N,2,1) and levels (N,2,7) of their luminance,
    and the stops (N,2,1) that the look adds."""

    means: torch.Tensor
    levels: torch.Tensor
    stops: torch.Tensor


@torch.no_grad()
def examples(source: Views, count: int) -> Examples:
    """Of `count` views, as a source makes them."""
    found, shaper = [], default_shaper(source.device)
    for _ in range(count):
        view = source.views(1)
        pair = torch.cat([windows(view, 0, 0), windows(view, *source.random.integers(0, SHIFT + 1, 2))])
        found.append((*levels(lowres(pair, shaper)), key_stops(pair)[:, None] + source.look.gain))
    return Examples(*(torch.stack(each) for each in zip(*found, strict=True)))


def fit(net: Exposure, found: Examples, seed: int) -> tuple[float, float]:
    """Fit the dense layers to examples; what is left, in stops: the mean error, and by how much two views' differ."""
    net.to(found.stops.device)
    random = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.AdamW(net.dense.parameters(), lr=RATE, weight_decay=DECAY)
    for step in range(STEPS):
        for group in optimizer.param_groups:
            group["lr"] = RATE * (0.5 + 0.5 * math.cos(math.pi * step / STEPS))
        some = torch.randint(len(found.stops), (BATCH,), generator=random).to(found.stops.device)
        error = net.stops(found.means[some], found.levels[some]) - found.stops[some]
        wrong = F.smooth_l1_loss(error, torch.zeros_like(error), beta=ROUND)
        optimizer.zero_grad(set_to_none=True)
        (wrong + CONSISTENCY * apart(error)).backward()
        optimizer.step()
    with torch.no_grad():
        error = net.stops(found.means, found.levels) - found.stops
        return float(error.abs().mean()), float(apart(error))


def apart(error: torch.Tensor) -> torch.Tensor:
    """The mean difference of the errors (N,2,1) of both views: what two frames flicker by that their light does not."""
    return (error[:, 0] - error[:, 1]).abs().mean()
