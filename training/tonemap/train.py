"""Teach the tone mapper a look: from nothing to an exported, verified model with a card.

    python -m training.tonemap.train mine --pairs HDR_DIR SDR_DIR
    python -m training.tonemap.train film --ocio config.ocio --display "sRGB - Display" \\
        --view Film [--look Warm]
    python -m training.tonemap.train print --lut print.cube,input=ACEScct
    python -m training.tonemap.train local --target local --pictures 'hdr/*.exr' \\
        --panoramas 'env/*.hdr'

The first word is the tag: `postfx run shot.####.exr -o out.####.png --tonemap OUT/tonemap.TAG.onnx`
uses the result. Pairs are files of the same name, linear HDR and sRGB-encoded SDR, at the exposure
of the grading. A look that depends only on colour becomes a cube. If a look only exposes before its
view (key), the exposure is learnt in minutes, from scratch; other looks fine-tune the network of
--start. Training never uses held-out pictures.

This file reads from top to bottom: settings, the start of training, the losses, the two loops
(`train_grid`, `train_exposure`), then the choice between them. The networks are in model.py, looks
in looks.py, pictures in pictures.py, and training views in examples.py.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import torch.nn.functional as F
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from postfx.colour import LINEAR_SPACES
from training.denoise.loss import psnr
from training.tonemap.examples import SHIFT, Source, Views
from training.tonemap.looks import Look, Lut, Ocio, describe, find_look, key_stops
from training.tonemap.model import (
    Exposure,
    HDRNet,
    Shaper,
    default_shaper,
    find_start_model,
    levels,
    look_up,
    lowres,
    shape,
    shipped_cubes,
    slice_grid_dense,
    weights_of,
)
from training.tonemap.pictures import Lesson, Pictures, collect, lesson, load

if TYPE_CHECKING:
    from training.tonemap.pairs import Pairs  # needs SciPy

# Settings -----------------------------------------------------------------------------------------

GPU_MINUTES = 8.0
CPU_MINUTES = 45.0
RATE = 1.5e-3
"""Largest learning rate."""
FINE_RATE = 2e-4
"""The same to fine-tune on a CPU, which has time for few steps from a good start."""
SIDE = 768
"""Longest side of a picture, in pixels."""
WARM_UP = 100
"""Steps in which the learning rate rises."""
ENOUGH = 40.0
"""PSNR of a cube on the training pairs, in dB, from which on colour alone explains the look."""

# weights in the loss
CONSISTENCY = 0.5
"""Of the difference of two shifted views in their overlap."""
SQUARED = 4.0
GRADIENT = 0.5
CHROMA = 0.5
SHAPED = 1.0
"""Of the error before the look's view."""

# an exposure
VIEWS = 8000
"""Views to learn from, and steps."""
EXPOSURE_BATCH = 256
EXPOSURE_RATE = 3e-3
DECAY = 1e-3
"""Weight decay of AdamW."""
ROUND = 0.05
"""Stops; smaller errors count squared."""


@dataclass(frozen=True)
class Recipe:
    """How to train: seconds of wall clock, which the learning rate follows; `scale` shrinks the
    pictures; `only` names the parts of the network to train, or is empty for all; `views` counts
    the views that an exposure is learnt from."""

    seconds: float
    batch: int = 16
    rate: float = RATE
    scale: float = 1.0
    seed: int = 1
    every: float = 30.0
    only: tuple[str, ...] = ()
    views: int = VIEWS


@dataclass(frozen=True)
class Report:
    """Progress of a training: mean losses since the last report, and the PSNR of each held-out
    picture in dB."""

    step: int
    seconds: float
    picture: float
    consistency: float
    psnr: dict[str, float]


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tag", help="name of the look")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--pairs", nargs=2, type=Path, metavar=("HDR_DIR", "SDR_DIR"),
                        help="your own graded pictures")
    source.add_argument("--ocio", metavar="CONFIG",
                        help="OpenColorIO config: a file, or the name of a built-in one")
    source.add_argument("--lut", metavar="FILE",
                        help="look-up table, as --tonemap takes it: FILE,input=SPACE")
    source.add_argument("--target", metavar="LOOK",
                        help="a built-in look, or a .toml file that describes one")
    source.add_argument("--set", metavar="NPZ",
                        help="pack of training.tonemap.pictures that holds the look TAG")
    parser.add_argument("--display", help="display or view of --ocio")
    parser.add_argument("--view", help="display or view of --ocio")
    parser.add_argument("--look", default="",
                        help="look of --ocio, instead of the view's own looks")
    parser.add_argument("--source", default="", help="the config's name of linear Rec.709")
    parser.add_argument("--pictures", nargs="*", default=[],
                        help="HDR photographs (patterns) to learn on")
    parser.add_argument("--panoramas", nargs="*", default=[],
                        help="equirectangular HDR environments (patterns)")
    parser.add_argument("--space", choices=LINEAR_SPACES,
                        help="primaries of all HDR files, linear; default: by header")
    parser.add_argument("--hold-out", nargs="*",
                        help="stems of pictures to measure with; default: every fifth")
    parser.add_argument("--start", default="local",
                        help="tag or file of the model to fine-tune, or 'none'")
    parser.add_argument("--only", nargs="+", default=[], metavar="PART",
                        help="parts of the network to train, as head")
    parser.add_argument("--minutes", type=float,
                        help=f"default: {GPU_MINUTES:g} on a GPU, {CPU_MINUTES:g} on a CPU")
    parser.add_argument("--batch", type=int, help="views a step; default: 16 on a GPU, 4 on a CPU")
    parser.add_argument("--rate", type=float,
                        help=f"default: {RATE:g}, or {FINE_RATE:g} to fine-tune on a CPU")
    parser.add_argument("--scale", type=float,
                        help="factor on the size of views; default: 1 on a GPU, 0.5 on a CPU")
    parser.add_argument("--views", type=int, default=VIEWS,
                        help="views that an exposure is learnt from, and steps (default: "
                        "%(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", type=float, default=30.0, help="seconds between measurements")
    parser.add_argument("-o", "--out", type=Path, help="folder for all results; default: runs/TAG")
    parser.add_argument("--no-export", action="store_true",
                        help="leave a checkpoint for training.tonemap.export")
    return parser


def parse(words: list[str] | None = None) -> argparse.Namespace:
    parser = options()
    args = parser.parse_args(words)
    if args.ocio and not (args.display and args.view):
        parser.error("--ocio needs --display and --view")
    args.out = args.out or Path("runs") / args.tag
    return args


def recipe_of(args: argparse.Namespace, on_gpu: bool) -> Recipe:
    """The recipe of the options, with defaults that suit the machine."""
    return Recipe(
        seconds=60 * (args.minutes or (GPU_MINUTES if on_gpu else CPU_MINUTES)),
        batch=args.batch or (16 if on_gpu else 4),
        rate=args.rate or (RATE if on_gpu or args.start == "none" else FINE_RATE),
        scale=args.scale or (1.0 if on_gpu else 0.5),
        seed=args.seed,
        every=args.every,
        only=tuple(args.only),
        views=args.views,
    )


# Where training starts ----------------------------------------------------------------------------

def start_network(start: str, cube: torch.Tensor) -> HDRNet:
    """A network with the weights of a model, by tag or file, and with another cube; a fresh one for
    'none'."""
    net = HDRNet(cube)
    if start != "none":
        net.load_state_dict(weights_of(find_start_model(start), net.state_dict()) | {"cube": cube})
    return net


def freeze(net: HDRNet, only: tuple[str, ...]) -> None:
    """Train only parts whose name contains one of `only`; all parts if it is empty."""
    names = [name for name, p in net.named_parameters() if p.requires_grad]
    for part in only:
        if not any(part in name.split(".") for name in names):
            raise SystemExit(f"the network has no part '{part}': it has "
                             f"{', '.join(sorted(set(names)))}")
    for name, p in net.named_parameters():
        p.requires_grad_(p.requires_grad
                         and (not only or not set(only).isdisjoint(name.split("."))))


# Losses and scores --------------------------------------------------------------------------------

HeldOut = dict[str, np.ndarray]


def picture_loss(out: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """L1 + squared error in sRGB values, their gradients, and two opponent channels."""
    d = out - wanted
    gradient = ((d[..., 1:] - d[..., :-1]).abs().mean()
                + (d[..., 1:, :] - d[..., :-1, :]).abs().mean())
    opponent = (d[:, 0] - d[:, 1]).abs().mean() + (d[:, 2] - 0.5 * (d[:, 0] + d[:, 1])).abs().mean()
    return d.abs().mean() + SQUARED * d.square().mean() + GRADIENT * gradient + CHROMA * opponent


def render(
    net: HDRNet, colour: torch.Tensor, shaper: Shaper, noise: float = 0.0
) -> tuple[torch.Tensor, torch.Tensor]:
    """Display colour, and shaped colour before the cube; `noise` disturbs the input of the
    coefficient network."""
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
    """Loss of two shifted views, and by how much they differ more in their overlap than their
    targets do.

    If the colour before the view is known, the difference from it counts too: the view is flat in
    highlights, so an error there would have no gradient.
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
def validate(net: HDRNet | Exposure, held: HeldOut, wanted: HeldOut) -> dict[str, float]:
    """PSNR in sRGB values of each held-out picture."""
    device, scores = net.cube.device, {}
    for name, colour in held.items():
        x = torch.from_numpy(colour.astype(np.float32)).permute(2, 0, 1)[None].to(device)
        scores[name] = score(net.render(x, default_shaper(device)).cpu(), wanted[name])
    return scores


def cube_psnr(cube: torch.Tensor, held: HeldOut, wanted: HeldOut) -> dict[str, float]:
    """PSNR in sRGB values of each held-out picture, for a cube alone."""
    scores = {}
    for name, rgb in held.items():
        x = torch.from_numpy(rgb.astype(np.float32)).permute(2, 0, 1)[None]
        scores[name] = score(look_up(shape(x, *default_shaper()), cube), wanted[name])
    return scores


def score(out: torch.Tensor, wanted: np.ndarray) -> float:
    """PSNR of (1,3,H,W) against (H,W,3), in dB."""
    return round(float(psnr(out, torch.from_numpy(wanted).permute(2, 0, 1)[None])), 3)


# The loop of a network with a grid ----------------------------------------------------------------

Watch = Callable[[Report], None]
Checkpoint = dict[str, Any]
"""cube; weights (None for a cube alone); look; training pictures; psnr of held-out pictures;
history of runs."""


def train_grid(net: HDRNet, source: Source, recipe: Recipe, held: HeldOut, wanted: HeldOut,
               watch: Watch, clock: Callable[[], float] = time.monotonic) -> Checkpoint:
    """Train for `recipe.seconds`; returns the training's part of a checkpoint, with the averaged
    weights.

    `watch` gets a report every `recipe.every` seconds and at the end.
    """
    freeze(net, recipe.only)
    shaper, average = default_shaper(net.cube.device), copy.deepcopy(net).requires_grad_(False)
    trained = [p for p in net.parameters() if p.requires_grad]
    averaged = [a for a, p in zip(average.parameters(), net.parameters(), strict=True)
                if p.requires_grad]
    optimizer = torch.optim.AdamW(trained, lr=recipe.rate, weight_decay=1e-4)
    start, last, step, since, sums = clock(), 0.0, 0, 0, torch.zeros(2, device=net.cube.device)
    while True:
        elapsed = clock() - start
        progress = min(1.0, elapsed / recipe.seconds)
        if elapsed - last >= recipe.every or progress >= 1:
            picture, consistency = (sums / max(1, since)).tolist()
            report = Report(step, round(elapsed, 1), picture, consistency,
                            validate(average, held, wanted))
            watch(report)
            last, since = elapsed, 0
            sums.zero_()
        if progress >= 1:
            break
        for group in optimizer.param_groups:
            warm = min(1.0, (step + 1) / WARM_UP)
            group["lr"] = recipe.rate * warm * (0.5 + 0.5 * math.cos(math.pi * progress)) + 1e-6
        with torch.no_grad():
            batch = source.batch(recipe.batch, recipe.scale)
        down, right = map(int, source.random.integers(0, SHIFT + 1, 2))
        picture, consistency = losses(net, batch, shaper, (down, right))
        optimizer.zero_grad(set_to_none=True)
        (picture + CONSISTENCY * consistency).backward()
        torch.nn.utils.clip_grad_norm_(trained, 1.0)
        optimizer.step()
        with torch.no_grad():
            torch._foreach_lerp_(averaged, trained, 1 - min(0.999, (step + 1) / (step + 10)))
        sums += torch.stack([picture.detach(), consistency.detach()])
        step, since = step + 1, since + 1
    weights = copy.deepcopy(average).cpu().state_dict()
    return {"weights": weights, "psnr": report.psnr,
            "history": [history_of(recipe, report, net.cube.device)]}


def history_of(recipe: Recipe, report: Report, device: torch.device) -> dict[str, object]:
    """A card's entry about one training."""
    name = torch.cuda.get_device_name() if device.type == "cuda" else "CPU"
    told = {"steps": report.step, "device": name, "torch": str(torch.__version__), **asdict(recipe)}
    return ({key: value for key, value in told.items() if key != "views"}
            | {"seconds": report.seconds})


# The loop of an exposure --------------------------------------------------------------------------
# A look that is one exposure before its view: a regression on the stops of many views.

@dataclass(frozen=True)
class Levels:
    """N views, each twice, shifted like two frames: the means (N,2,1) and levels (N,2,7) of their
    luminance, and the stops (N,2,1) that the look adds."""

    means: torch.Tensor
    levels: torch.Tensor
    stops: torch.Tensor


def train_exposure(source: Views, recipe: Recipe, held: HeldOut, wanted: HeldOut,
                   watch: Watch) -> Checkpoint:
    """The training's part of a checkpoint. Uses only views and seed of the recipe."""
    start = time.monotonic()
    found = levels_of_views(source, recipe.views)
    net = Exposure(source.cube)
    wrong, apart = fit_exposure(net, found, recipe.seed, recipe.views)
    report = Report(recipe.views, round(time.monotonic() - start, 1), wrong, apart,
                    validate(net, held, wanted))
    watch(report)
    run = history_of(recipe, report, source.device)
    facts = {name: run[name] for name in ("steps", "device", "torch", "seconds", "seed")}
    history = {**facts, "views": recipe.views, "batch": EXPOSURE_BATCH, "rate": EXPOSURE_RATE}
    return {"weights": net.cpu().state_dict(), "psnr": report.psnr, "history": [history]}


@torch.no_grad()
def levels_of_views(source: Views, count: int) -> Levels:
    """Levels of `count` views of a source."""
    found, shaper = [], default_shaper(source.device)
    for _ in range(count):
        view = source.views(1)
        pair = torch.cat([windows(view, 0, 0),
                          windows(view, *source.random.integers(0, SHIFT + 1, 2))])
        found.append((*levels(lowres(pair, shaper)), key_stops(pair)[:, None] + source.look.gain))
    return Levels(*(torch.stack(each) for each in zip(*found, strict=True)))


def fit_exposure(net: Exposure, found: Levels, seed: int, steps: int) -> tuple[float, float]:
    """Fit the dense layers; returns, in stops, the mean error and the mean difference between a
    view's two errors."""
    net.to(found.stops.device)
    random = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.AdamW(net.dense.parameters(), lr=EXPOSURE_RATE, weight_decay=DECAY)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = EXPOSURE_RATE * (0.5 + 0.5 * math.cos(math.pi * step / steps))
        some = torch.randint(len(found.stops), (EXPOSURE_BATCH,),
                             generator=random).to(found.stops.device)
        error = net.stops(found.means[some], found.levels[some]) - found.stops[some]
        wrong = F.smooth_l1_loss(error, torch.zeros_like(error), beta=ROUND)
        optimizer.zero_grad(set_to_none=True)
        (wrong + CONSISTENCY * difference_of_views(error)).backward()
        optimizer.step()
    with torch.no_grad():
        error = net.stops(found.means, found.levels) - found.stops
        return float(error.abs().mean()), float(difference_of_views(error))


def difference_of_views(error: torch.Tensor) -> torch.Tensor:
    """Mean difference between the two errors (N,2,1) of each view: flicker without a change of
    light."""
    return (error[:, 0] - error[:, 1]).abs().mean()


# Which loop a look needs --------------------------------------------------------------------------

def teach_look(
    task: Lesson, pictures: Pictures, start: str, recipe: Recipe, device: torch.device, watch: Watch
) -> Checkpoint:
    """Learn a look whose pipeline is known; one that depends on colour alone needs no training."""
    common = {"look": describe(task.look), "cube": task.cube, "pictures": list(pictures.train)}
    if task.look.is_global:
        return {**common, "weights": None, "history": [],
                "psnr": cube_psnr(task.cube, pictures.held, task.wanted)}
    source = Views(pictures, task.look, task.cube, device, recipe.seed)
    if task.look.is_exposure:
        return {**common, **train_exposure(source, recipe, pictures.held, task.wanted, watch)}
    net = start_network(start, task.cube).to(device)
    return {**common, **train_grid(net, source, recipe, pictures.held, task.wanted, watch)}


def teach_pairs(pairs: Pairs, start: str, recipe: Recipe, device: torch.device,
                watch: Watch) -> Checkpoint:
    """Learn a look from examples: a cube if that explains them, else a network before a cube, if it
    is better.

    The start network also gets a cube fitted to the pairs: with few pictures this may be the best
    result.
    """
    from training.tonemap.pairs import PairViews, fit

    held = {name: hdr for name, (hdr, _) in pairs.held.items()}
    wanted = {name: sdr for name, (_, sdr) in pairs.held.items()}
    common = {"look": {"pairs": sorted(pairs.train)}, "pictures": list(pairs.train)}
    cube, explained = fit(None, pairs, nearest_cube(pairs))
    print(f"colour alone explains the pairs to {explained:.1f} dB", flush=True)
    alone = {**common, "cube": cube, "weights": None, "history": [],
             "psnr": cube_psnr(cube, held, wanted)}
    if explained >= ENOUGH:
        return alone
    net = start_network(start, cube)
    if start != "none":
        net.cube.data = fit(net, pairs, cube)[0]
    weights = copy.deepcopy(net.state_dict())
    begun = {"weights": weights, "history": [], "psnr": validate(net, held, wanted)}
    learnt = train_grid(net.to(device), PairViews(pairs, device, recipe.seed), recipe, held, wanted,
                        watch)
    net.load_state_dict(learnt["weights"])
    net.to("cpu").cube.data = fit(net, pairs, learnt["weights"]["cube"].cpu())[0]
    again = {**learnt, "weights": net.state_dict(), "psnr": validate(net, held, wanted)}
    found = [alone,
             *({**common, **one, "cube": one["weights"]["cube"]} for one in (begun, learnt, again))]
    return max(found, key=lambda one: np.mean(list(one["psnr"].values())))


def nearest_cube(pairs: Pairs) -> torch.Tensor:
    """The shipped look that is nearest to the pairs: it defines colours that they do not show."""
    light, graded = ({name: pair[i] for name, pair in pairs.train.items()} for i in (0, 1))
    return max(shipped_cubes().values(),
               key=lambda cube: sum(cube_psnr(cube, light, graded).values()))


# The command --------------------------------------------------------------------------------------

def look_of(args: argparse.Namespace) -> Look:
    """The look that the options describe."""
    if args.ocio:
        return Look(Ocio(args.ocio, args.display, args.view, args.source, args.look))
    return Look(Lut(args.lut)) if args.lut else find_look(args.target)


def teach(args: argparse.Namespace, device: torch.device, log: Path) -> Checkpoint:
    """Learn the look of the options, with a progress bar and one line a report in `log`."""
    recipe = recipe_of(args, device.type == "cuda")
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    with Progress(*columns) as progress, open(log, "w", encoding="utf-8") as lines:
        bar = progress.add_task(f"{args.tag} on {device}", total=recipe.seconds)

        def watch(report: Report) -> None:
            lines.write(json.dumps(asdict(report)) + "\n")
            lines.flush()
            mean = sum(report.psnr.values()) / max(1, len(report.psnr))
            text = (f"{args.tag} on {device}: step {report.step}, loss {report.picture:.4f}, held "
                    f"out {mean:.2f} dB")
            progress.update(bar, completed=report.seconds, description=text)

        if args.pairs:
            from training.tonemap.pairs import read_pairs

            hdr, sdr = args.pairs
            pairs = read_pairs(hdr, sdr, args.space, SIDE, args.hold_out)
            return teach_pairs(pairs, args.start, recipe, device, watch)
        if args.set:
            pictures, task = load(args.set, args.tag)
        else:
            pictures = collect(args.pictures, args.panoramas, hold_out=args.hold_out, side=SIDE,
                               space=args.space)
            task = lesson(look_of(args), pictures)
        return teach_look(task, pictures, args.start, recipe, device, watch)


def main() -> None:
    args = parse()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(args.seed)
    # convolutions only: the interpolation weights need all their bits
    torch.backends.cudnn.allow_tf32 = True
    args.out.mkdir(parents=True, exist_ok=True)
    checkpoint = teach(args, device, args.out / "log.jsonl")
    torch.save(checkpoint, args.out / "checkpoint.pt")
    for name, value in checkpoint["psnr"].items():
        print(f"{name}: {value:.2f} dB")
    if not args.no_export:
        # needs packages that a training machine may lack
        from training.tonemap.export import export_look

        print(f"verified and written: {export_look(checkpoint, args.tag, args.out, {})}")


if __name__ == "__main__":
    main()
