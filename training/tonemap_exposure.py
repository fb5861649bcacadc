"""Teaching a look whose all is one exposure before its view: a regression on the stops of many views."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from training.looks import MID_GREY, key_stops
from training.networks.cube import default_shaper
from training.networks.exposure import Exposure, levels
from training.networks.hdrnet import lowres
from training.tonemap_data import Views
from training.tonemap_loop import Recipe, Report, run_of, validate

VIEWS, STEPS, BATCH, RATE, DECAY = 8000, 8000, 256, 3e-3, 1e-3
ROUND = 0.05  # stops: below, errors count squared


def teach_exposure(
    source: Views, recipe: Recipe, held: dict[str, np.ndarray], wanted: dict[str, np.ndarray],
    watch: Callable[[Report], None],
) -> dict[str, Any]:
    """The part of a checkpoint that comes of it; of a recipe only the seed counts, as this takes but some minutes."""
    start = time.monotonic()
    found, target = examples(source, VIEWS)
    net = Exposure(source.cube)
    loss = fit(net, found, target, recipe.seed)
    scores = validate(net, held, wanted)
    report = Report(STEPS, round(time.monotonic() - start, 1), loss, 0.0, scores)
    watch(report)
    run = run_of(recipe, report, source.device)
    facts = {name: run[name] for name in ("steps", "device", "torch", "seconds", "seed")}
    history = {**facts, "views": VIEWS, "batch": BATCH, "rate": RATE}
    return {"weights": net.cpu().state_dict(), "psnr": scores, "history": [history]}


@torch.no_grad()
def examples(source: Views, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Of `count` views their levels (count,7), and the stops from mid grey at which the look puts their mean (count,1).
    """
    found, target, shaper = [], [], default_shaper(source.device)
    for _ in range(count):
        view = source.views(1)
        mean, those = levels(lowres(view, shaper))
        found.append(those)
        target.append(key_stops(view)[:, None] + source.look.gain + mean - math.log2(MID_GREY))
    return torch.cat(found), torch.cat(target)


def fit(net: Exposure, found: torch.Tensor, target: torch.Tensor, seed: int) -> float:
    """Fit the dense layers to examples; the mean absolute error that is left, in stops."""
    net.to(found.device)
    random = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.AdamW(net.dense.parameters(), lr=RATE, weight_decay=DECAY)
    for step in range(STEPS):
        for group in optimizer.param_groups:
            group["lr"] = RATE * (0.5 + 0.5 * math.cos(math.pi * step / STEPS))
        some = torch.randint(len(found), (BATCH,), generator=random).to(found.device)
        loss = F.smooth_l1_loss(net.key(found[some]), target[some], beta=ROUND)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        return float((net.key(found) - target).abs().mean())
