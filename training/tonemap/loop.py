"""The tone mapper's training loop: a source of pictures with targets in, an averaged network out."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from postfx.system import models_dir
from training.denoise.loss import psnr
from training.tonemap.exposure_net import Exposure
from training.tonemap.model import GUIDE_PARTS, HDRNet, Shaper, default_shaper, look_up, lowres, shape, slice_grid_dense

# Where training starts ----------------------------------------------------------------------------------------------
# Where a tone mapper's training starts: at a shipped model, or at nothing.

STATE = dict[str, torch.Tensor]


def start_network(start: str, cube: torch.Tensor) -> HDRNet:
    """A network with the weights of a model, by tag or file, and with another cube; a fresh one for 'none'."""
    net = HDRNet(cube)
    if start != "none":
        net.load_state_dict(weights_of(find_model(start), net.state_dict()) | {"cube": cube})
    return net


def find_model(start: str) -> Path:
    """A model file by its own name, or by the tag of a shipped look."""
    path = Path(start) if start.endswith(".onnx") else models_dir() / f"tonemap.{start}.onnx"
    if not path.is_file():
        raise SystemExit(f"{path}: no such model to start from: name another with --start, or 'none'")
    return path


def shipped_cubes() -> dict[str, torch.Tensor]:
    """Cubes of all shipped looks, by tag."""
    found = {path.name.split(".")[1]: _initializers(path) for path in sorted(models_dir().glob("tonemap.*.onnx"))}
    return {tag: torch.from_numpy(values["cube"].copy()) for tag, values in found.items()}


def weights_of(path: Path, like: STATE) -> STATE:
    """Weights of an exported network; what the exporter left out because it is zero stays as in `like`."""
    found = _initializers(path)
    if "guide" not in found:
        raise SystemExit(f"{path}: not a look with a grid: start from another, or from 'none'")
    parts = np.split(found["guide"], np.cumsum(list(GUIDE_PARTS.values()))[:-1])
    found |= {f"guide.{name}": part for name, part in zip(GUIDE_PARTS, parts, strict=True)}
    return {name: torch.from_numpy(found[name].copy()).reshape(value.shape) if name in found else value
            for name, value in like.items()}


def _initializers(path: Path) -> dict[str, np.ndarray]:
    """All constants of a model, float32."""
    import onnx  # a machine that starts from nothing may lack it

    return {item.name.removesuffix("_half"): onnx.numpy_helper.to_array(item).astype(np.float32)
            for item in onnx.load(path).graph.initializer}


# The loop -----------------------------------------------------------------------------------------------------------

SHIFT = 8  # largest shift, in pixels, between the two views of a consistency pair
CONSISTENCY, GRADIENT, CHROMA, SQUARED, SHAPED = 0.5, 0.5, 0.5, 4.0, 1.0
WARM_UP = 100  # steps


class Source(Protocol):
    """What can be trained on."""

    random: np.random.Generator

    def batch(self, size: int, scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Exposed colour (N,3,H+8,W+8), the look of it, and its shaped colour before the look's cube where known."""


@dataclass(frozen=True)
class Recipe:
    """How to train: seconds of wall clock, which the learning rate follows; `scale` shrinks the pictures; `only` names
    the parts of the network that change, none means all."""

    seconds: float
    batch: int = 16
    rate: float = 1.5e-3
    scale: float = 1.0
    seed: int = 1
    every: float = 30.0
    only: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """Where a training stands: PSNR of each held-out picture, mean losses since the last report."""

    step: int
    seconds: float
    picture: float
    consistency: float
    psnr: dict[str, float]


def picture_loss(out: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """L1 + squared error in sRGB values, their gradients, and two opponent channels."""
    d = out - wanted
    gradient = (d[..., 1:] - d[..., :-1]).abs().mean() + (d[..., 1:, :] - d[..., :-1, :]).abs().mean()
    opponent = (d[:, 0] - d[:, 1]).abs().mean() + (d[:, 2] - 0.5 * (d[:, 0] + d[:, 1])).abs().mean()
    return d.abs().mean() + SQUARED * d.square().mean() + GRADIENT * gradient + CHROMA * opponent


def render(
    net: HDRNet, colour: torch.Tensor, shaper: Shaper, noise: float = 0.0
) -> tuple[torch.Tensor, torch.Tensor]:
    """Display colour, and shaped colour before the cube; `noise` disturbs what the coefficient network sees."""
    low = lowres(colour, shaper)
    grid, guide, cube = net(low + noise * torch.randn_like(low))
    shaped = slice_grid_dense(shape(colour, *shaper), guide, grid)
    return look_up(shaped, cube), shaped


def windows(x: torch.Tensor, dy: int, dx: int) -> torch.Tensor:
    """The view of a padded batch that is shifted by (dy, dx) pixels."""
    return x[..., dy : x.shape[-2] - SHIFT + dy, dx : x.shape[-1] - SHIFT + dx]


def losses(
    net: HDRNet,
    batch: tuple[torch.Tensor, torch.Tensor, torch.Tensor | None],
    shaper: Shaper,
    shift: tuple[int, int],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Loss of two shifted views, and how much more they differ where they overlap than their targets do.

    Where it is known what colour meets the view, the difference from it counts too: the view is flat in highlights, so
    an error there would have no gradient.
    """
    colour, wanted, before = batch
    h, w = colour.shape[-2] - SHIFT, colour.shape[-1] - SHIFT
    total, found = 0.0, []
    for (dy, dx), noise in (((0, 0), 0.0), (shift, 0.01)):
        out, shaped = render(net, windows(colour, dy, dx), shaper, noise)
        total = total + 0.5 * picture_loss(out, windows(wanted, dy, dx))
        if before is not None:
            total = total + 0.5 * SHAPED * (shaped - windows(before, dy, dx)).abs().mean()
        found.append(out)
    dy, dx = shift
    return total, (found[0][..., dy:, dx:] - found[1][..., : h - dy, : w - dx]).abs().mean()


@torch.no_grad()
def validate(net: HDRNet | Exposure, held: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> dict[str, float]:
    """PSNR in sRGB values of each held-out picture."""
    device, scores = net.cube.device, {}
    for name, colour in held.items():
        x = torch.from_numpy(colour.astype(np.float32)).permute(2, 0, 1)[None].to(device)
        scores[name] = score(net.render(x, default_shaper(device)).cpu(), wanted[name])
    return scores


def score(out: torch.Tensor, wanted: np.ndarray) -> float:
    """PSNR of (1,3,H,W) against (H,W,3), in dB."""
    return round(float(psnr(out, torch.from_numpy(wanted).permute(2, 0, 1)[None])), 3)


def train(
    net: HDRNet,
    source: Source,
    recipe: Recipe,
    held: dict[str, np.ndarray],
    wanted: dict[str, np.ndarray],
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[tuple[HDRNet, Report]]:
    """Train for `recipe.seconds`; yields the averaged network and a report every `recipe.every` seconds and at last."""
    _freeze(net, recipe.only)
    shaper, average = default_shaper(net.cube.device), copy.deepcopy(net).requires_grad_(False)
    trained = [p for p in net.parameters() if p.requires_grad]
    averaged = [a for a, p in zip(average.parameters(), net.parameters(), strict=True) if p.requires_grad]
    optimizer = torch.optim.AdamW(trained, lr=recipe.rate, weight_decay=1e-4)
    start, last, step, since, sums = clock(), 0.0, 0, 0, torch.zeros(2, device=net.cube.device)
    while True:
        elapsed = clock() - start
        progress = min(1.0, elapsed / recipe.seconds)
        if elapsed - last >= recipe.every or progress >= 1:
            picture, consistency = (sums / max(1, since)).tolist()
            yield average, Report(step, round(elapsed, 1), picture, consistency, validate(average, held, wanted))
            last, since = elapsed, 0
            sums.zero_()
        if progress >= 1:
            return
        for group in optimizer.param_groups:
            warm = min(1.0, (step + 1) / WARM_UP)
            group["lr"] = recipe.rate * warm * (0.5 + 0.5 * math.cos(math.pi * progress)) + 1e-6
        with torch.no_grad():
            batch = source.batch(recipe.batch, recipe.scale)
        shift = tuple(int(v) for v in source.random.integers(0, SHIFT + 1, 2))
        picture, consistency = losses(net, batch, shaper, shift)
        optimizer.zero_grad(set_to_none=True)
        (picture + CONSISTENCY * consistency).backward()
        torch.nn.utils.clip_grad_norm_(trained, 1.0)
        optimizer.step()
        with torch.no_grad():
            torch._foreach_lerp_(averaged, trained, 1 - min(0.999, (step + 1) / (step + 10)))
        sums += torch.stack([picture.detach(), consistency.detach()])
        step, since = step + 1, since + 1


def _freeze(net: HDRNet, only: tuple[str, ...]) -> None:
    """Leave as it is whatever has no name of `only` in its own; all is trained where there are no names."""
    names = [name for name, p in net.named_parameters() if p.requires_grad]
    for part in only:
        if not any(part in name.split(".") for name in names):
            raise SystemExit(f"the network has no part '{part}': it has {', '.join(sorted(set(names)))}")
    for name, p in net.named_parameters():
        p.requires_grad_(p.requires_grad and (not only or not set(only).isdisjoint(name.split("."))))


def run_of(recipe: Recipe, report: Report, device: torch.device) -> dict[str, object]:
    """What a card says about one training."""
    name = torch.cuda.get_device_name() if device.type == "cuda" else "CPU"
    run = {"steps": report.step, "device": name, "torch": str(torch.__version__)}
    return {**run, **asdict(recipe), "seconds": report.seconds}
