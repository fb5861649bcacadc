"""Train the denoised upscaler on clips of the data factory.

One GPU:      python -m training.denoise.train --clips CLIPS --out RUN --minutes 20
Mixed clips:  python -m training.denoise.train --clips mitsuba=3 cycles=2 formula --out RUN \\
                  --minutes 20
Several GPUs: torchrun --nproc-per-node 4 -m training.denoise.train --clips CLIPS --out RUN \\
                  --minutes 20
To try it:    python -m training.denoise.train --clips CLIPS --out RUN --steps 20 --batch 1 \\
                  --crop 32 --widths 16 16

The learning rate rises over 500 steps and then follows the clock: a cosine down to zero at the end
of --minutes. The folders of clips may still be growing. RUN/log.csv and validation.csv hold the
curves (`training.measure.runs curves` draws them). RUN/checkpoint.pt holds the weights, their
average, the optimiser, step, time, arguments and the commit. --resume continues with all of it,
except for the histories of --carry; --start begins a new run from weights alone. Each step seeds
its random numbers by --seed and its own number, so that a resumed run draws the same. --log FILE
adds the run to a table of runs (`training.measure.runs`). The defaults are those of the last
training of m.

This file reads from top to bottom: settings, the few functions that a step needs, the state of a
run, then `train`, one plain loop. The network is in model.py, the loss in loss.py, clips in
clips.py, batches of them in dataset.py, their random changes in augment.py, CUDA graphs and
gradients in gradient.py, and checkpoints in checkpoint.py.
"""

import argparse
import csv
import itertools
import json
import math
import os
import random
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

from training.denoise.augment import Augment
from training.denoise.checkpoint import git_commit, load_weights, read, save, unpack, widen
from training.denoise.clips import Clip
from training.denoise.dataset import Batch, ClipPool, collate, to_batch
from training.denoise.first_stage import FirstStage
from training.denoise.gradient import FlatGradient, GradientStep, fuse
from training.denoise.loss import LIGHT, ClipLoss
from training.denoise.model import DenoiseUpscale, State, Trunk, TrunkConfig, empty_state
from training.denoise.picture import LARGE, PictureConfig, PictureDenoiser, PictureNetwork
from training.denoise.residual import ResidualConfig, ResidualTrunk
from training.measure.runs import append_run

# Settings -----------------------------------------------------------------------------------------

KEEP_MINUTES = 2.0  # between two checkpoints
USUAL_WAIT = 8  # clips a GPU before training starts
PATIENCE = 20.0  # seconds without a new clip after which those that are there are enough
PAUSE = 2.0  # seconds between two looks for clips
WARM_STEPS = 500  # over which the learning rate rises: where it rises faster, units die for good
DECAY = 0.9995  # of the average of the weights
LARGEST_NORM = 1.0  # of a gradient
PLAYING = 8  # playbacks between which --carry draws
# arguments that name files: no checkpoint keeps them
PLACES = ("clips", "out", "start", "resume", "onward", "log", "first")


def options() -> argparse.ArgumentParser:
    """The parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_run_options(parser.add_argument_group("run"))
    add_start_options(parser.add_mutually_exclusive_group())
    add_clip_options(parser.add_argument_group("clips and windows"))
    add_network_options(parser.add_argument_group("network"))
    add_loss_options(parser.add_argument_group("learning and loss"))
    add_change_options(parser.add_argument_group("random changes of clips"))
    return parser


def add_run_options(group: argparse._ActionsContainer) -> None:
    """How long a training takes, and what it writes."""
    group.add_argument("--out", type=Path, required=True, help="folder of the run")
    group.add_argument("--minutes", type=float, default=17,
                       help="length of the training (default: %(default)s)")
    group.add_argument("--steps", type=int,
                       help="length in steps; the cosine then follows steps, not minutes")
    group.add_argument("--seed", type=int, default=0)
    group.add_argument("--log", type=Path, metavar="FILE",
                       help="table of runs (.jsonl) that gets a row at the end")


def add_start_options(group: argparse._ActionsContainer) -> None:
    """What a training begins with; without any of these, random weights."""
    group.add_argument("--start", type=Path,
                       help="weights: checkpoint.pt or denoise_upscale.<tag>.onnx, also of a "
                       "network with fewer channels or levels")
    group.add_argument("--continue", type=Path, dest="onward", metavar="FILE",
                       help="go on from a checkpoint of 'training.denoise.checkpoint pack': its "
                       "weights, their average and the count of steps, with the arguments of this "
                       "call")
    group.add_argument("--resume", type=Path,
                       help="checkpoint.pt of a run to continue, with its arguments")


def add_clip_options(group: argparse._ActionsContainer) -> None:
    """What it learns from."""
    group.add_argument("--clips", type=weighted_folder, required=True, nargs="+",
                       metavar="FOLDER[=WEIGHT]",
                       help="folders of clip.NNNNN.npz; a clip of weight 3 is drawn three times "
                       "as often as one of 1")
    group.add_argument("--wait", type=int,
                       help="clips a GPU to wait for before training starts; default: 8, or "
                       f"those that are there once no other came for {PATIENCE:.0f} seconds")
    group.add_argument("--batch", type=int, default=16,
                       help="clips a GPU and step (default: %(default)s)")
    group.add_argument("--crop", type=int, default=96,
                       help="side of the windows in render pixels, multiple of 16")
    group.add_argument("--volumes", action="store_true",
                       help="leave depth and albedo of volumes as rendered (default: as if files "
                       "lacked them)")
    group.add_argument("--guides", action="store_true", help="read planes at output size")


def add_network_options(group: argparse._ActionsContainer) -> None:
    """The layout of the network."""
    group.add_argument("--widths", type=int, nargs="+", default=[96, 160, 224, 320],
                       help="channels of the levels")
    group.add_argument("--depth", type=int, default=TrunkConfig.depth,
                       help="convolutions a level and direction")
    group.add_argument("--stem", type=int,
                       help="channels of the stem (default: those of the first level)")
    group.add_argument("--reach", type=int, default=TrunkConfig.reach, choices=(2, 4),
                       help="side of the stem, pixels")
    group.add_argument("--trust", action="store_true",
                       help="let the network predict how far it trusts the planes")
    group.add_argument("--residual", action="store_true",
                       help="a trunk of residual blocks from the render size on (residual.py), of "
                       "which --widths, --down and --up tell the layout")
    group.add_argument("--down", type=int, nargs="+", default=list(ResidualConfig.down),
                       metavar="N", help="with --residual: blocks of each level on the way down")
    group.add_argument("--up", type=int, nargs="+", default=list(ResidualConfig.up), metavar="N",
                       help="with --residual: blocks of each level on the way up")
    group.add_argument("--picture", action="store_true",
                       help="a network that gives the picture itself (picture.py); --start with "
                       "the file of training.denoise.open_weights")
    group.add_argument("--large", action="store_true",
                       help="with --picture: the layout of the large published network")
    group.add_argument("--first", type=Path, metavar="FILE",
                       help="train a network that enlarges by 2 what the picture network of this "
                       "checkpoint has denoised: clips of the render's size are shrunk, denoised "
                       "by it, and mixed with the noisy colour (first_stage.py)")


def add_loss_options(group: argparse._ActionsContainer) -> None:
    """How it learns, and from which errors."""
    group.add_argument("--rate", type=float, default=8e-4,
                       help="highest learning rate (default: %(default)s)")
    group.add_argument("--cool", type=float, metavar="SHARE",
                       help="keep the learning rate until this last share of the training, then "
                       "lower it linearly to zero (default: a cosine all along); stable.pt is the "
                       "checkpoint before, to go on from")
    group.add_argument("--published-rate", type=float, default=0.05, metavar="SHARE",
                       help="with --picture: of the learning rate, for the weights of a published "
                       "network; 0 keeps them (default: %(default)s)")
    group.add_argument("--only", nargs="+", metavar="LAYER",
                       help="with --picture: learn these layers alone, by the first words of "
                       "their names; the others stay as they are")
    group.add_argument("--flicker", type=float, default=6.0,
                       help="weight of the temporal difference")
    group.add_argument("--reset", type=float, default=0.03,
                       help="chance that a frame drops its history")
    group.add_argument("--even", type=float, nargs="?", default=0.0, const=8.0, metavar="MOST",
                       help="give clips of little noise more weight, at most this many times as "
                       "much (8)")
    group.add_argument("--light", type=float, nargs=2, default=LIGHT, metavar=("WEIGHT", "KNEE"),
                       help="weight of the relative error of light in cells of 16x16 pixels, and "
                       "the error below which it is squared (default: %(default)s)")
    group.add_argument("--noisy-references", action="store_true",
                       help="references hold noise of their own (clips of clean_references "
                       "--keep-noise): squared errors, as in Noise2Noise, of codes whose bias both "
                       "halves tell; with --clean 0")
    group.add_argument("--reflectance", type=float, default=0.0, metavar="WEIGHT",
                       help="with --trust: weight of the relative error of the trusted "
                       "reflectance against that of a render with many samples (default: "
                       "%(default)s)")
    group.add_argument("--clean-planes", type=float, default=0.0, metavar="WEIGHT",
                       help="with --picture: weight of the error of albedo and normal that the "
                       "network has cleaned (default: %(default)s)")
    group.add_argument("--both-ways", type=float, default=0.0, metavar="SHARE",
                       help="share of the steps that also run clips backwards and score the blend "
                       "of both directions")
    group.add_argument("--carry", type=float, default=0.0, metavar="SHARE",
                       help="share of the steps that continue the history of an earlier one: the "
                       "same windows, with other noise, played the other way (default: "
                       "%(default)s)")


def add_change_options(group: argparse._ActionsContainer) -> None:
    """Shares of the clips that are changed at random."""
    group.add_argument("--clean", type=float, default=Augment.clean, metavar="SHARE",
                       help="share of the offline renders whose colour is moved towards the "
                       "reference (%(default)s)")
    group.add_argument("--false-motion", type=float, default=0.0, metavar="SHARE",
                       help="share of the clips with wrong motion vectors (%(default)s)")
    group.add_argument("--spread-noise", type=float, default=0.0, metavar="SHARE",
                       help="share of the clips whose noise is not quite independent from pixel "
                       "to pixel, as where a pixel filter was undone (%(default)s)")
    group.add_argument("--sparse-planes", type=float, default=0.0, metavar="SHARE",
                       help="share of the clips with albedo, normal and roughness of a render "
                       "with fewer samples")
    group.add_argument("--blend", type=float, default=0.0, metavar="SHARE",
                       help="share of the clips whose noise is mixed from two of their renders "
                       "(%(default)s)")


def weighted_folder(text: str) -> tuple[Path, float]:
    """FOLDER or FOLDER=WEIGHT."""
    folder, _, weight = text.partition("=")
    return Path(folder), float(weight or 1)


def parse(words: list[str] | None = None) -> argparse.Namespace:
    """The arguments; a resumed run's arguments replace the defaults."""
    parser = options()
    args = parser.parse_args(words)
    if args.resume:
        saved = read(args.resume)
        if "optimiser" not in saved:
            parser.error(f"{args.resume} holds weights only: begin a new run with --start")
        parser.set_defaults(**saved["arguments"])
        args = parser.parse_args(words)
    if args.carry and args.both_ways:
        parser.error("--carry and --both-ways exclude each other")
    if args.noisy_references and args.clean:
        parser.error("--noisy-references needs --clean 0: colour that is moved towards a noisy "
                     "reference has its noise")
    if args.only and not args.picture:
        parser.error("--only is for --picture: leave one of the two out, or give both")
    if args.only:
        known = layers_of(network_of(args).trunk)
        for name in args.only:
            if name not in known:
                parser.error(f"--only {name}: the network has {', '.join(known)}")
    return args


# Parts of a step ----------------------------------------------------------------------------------

def rate_at(progress: float, step: int, peak: float, cool: float | None = None) -> float:
    """Learning rate at a share of the training and a step of this run: a linear rise, then a cosine
    to zero, or the peak until the last share ``cool`` of the training."""
    fall = (0.5 * (1 + math.cos(math.pi * progress)) if cool is None
            else min((1 - progress) / max(cool, 1e-9), 1))
    return peak * min((step + 1) / WARM_STEPS, 1) * max(fall, 1e-3)


def trunk_of(args: argparse.Namespace) -> Trunk | ResidualTrunk:
    """The network of the arguments, with random weights."""
    if args.residual:
        layout = ResidualConfig(tuple(args.widths), tuple(args.down), tuple(args.up), args.trust)
        return ResidualTrunk(layout)
    return Trunk(TrunkConfig(tuple(args.widths), args.depth, args.guides, args.stem, args.reach,
                             args.trust))


def network_of(args: argparse.Namespace) -> DenoiseUpscale | PictureDenoiser:
    """The denoiser of the arguments, with random weights."""
    if args.picture:
        return PictureDenoiser(PictureNetwork(LARGE if args.large else PictureConfig()))
    return DenoiseUpscale(trunk=trunk_of(args))


def rate_groups(model: DenoiseUpscale | PictureDenoiser, published: float,
                only: list[str] | None = None) -> list[dict[str, Any]]:
    """The weights that are learnt, by the share of the learning rate that they get; others are
    frozen. ``only`` names the layers that a picture network learns."""
    if not isinstance(model, PictureDenoiser):
        return [{"params": list(model.parameters()), "share": 1.0}]
    if only:
        return [{"params": choose_layers(model.trunk, only), "share": 1.0}]
    before = model.trunk.published()
    own = [weight for weight in model.parameters() if not any(weight is other for other in before)]
    if published:
        return [{"params": own, "share": 1.0}, {"params": before, "share": published}]
    for weight in before:
        weight.requires_grad_(False)
    return [{"params": own, "share": 1.0}]


def choose_layers(network: PictureNetwork, words: list[str]) -> list[nn.Parameter]:
    """The weights of the layers whose names begin with one of some words; all others are frozen."""
    chosen = []
    for name, weight in network.named_parameters():
        weight.requires_grad_(name.partition(".")[0] in words)
        if weight.requires_grad:
            chosen.append(weight)
    return chosen


def layers_of(network: nn.Module) -> list[str]:
    """The first words of the names of a network's weights."""
    return sorted({name.partition(".")[0] for name, _ in network.named_parameters()})


def runs_both_ways(step: int, share: float) -> bool:
    """Whether a step is one of the ``share`` that runs both ways: evenly spread, the same on every
    GPU."""
    return math.floor((step + 1) * share) > math.floor(step * share)


@dataclass
class Playback:
    """Windows that are played forwards and backwards by turns, one turn a step, so that history
    grows longer than a clip. ``state`` is the history after the turns so far, ``begun`` the step of
    the first."""

    begun: int
    turn: int = 0
    state: State | None = None


def pick(playing: list[Playback], step: int, args: argparse.Namespace) -> Playback:
    """One of the playbacks, the same on all GPUs: with the chance ``args.carry`` it goes on, else a
    new one begins."""
    drawn = random.Random(f"{args.seed} {step}")
    place = drawn.randrange(len(playing))
    if not playing[place].turn or drawn.random() >= args.carry:
        playing[place] = Playback(step)
    return playing[place]


def seed_all(*parts: int | str) -> None:
    """Seed Python's and torch's random numbers from these parts."""
    drawn = random.Random(" ".join(map(str, parts)))
    random.seed(drawn.random())
    torch.manual_seed(drawn.getrandbits(48))


def set_direction(batch: Batch, both: bool) -> Batch:
    """The batch for ``both`` directions, or for forwards only."""
    return batch if both else replace(batch, inverse=None)


class Average:
    """Exponential moving average of the weights: what is validated and exported."""

    def __init__(self, model: nn.Module, decay: float):
        self.decay, self.live = decay, dict(model.named_parameters())
        self.weights = {k: v.detach().clone() for k, v in self.live.items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        decay = min(self.decay, (1 + step) / (10 + step))
        targets = list(self.weights.values())
        torch._foreach_mul_(targets, decay)
        torch._foreach_add_(targets, list(self.live.values()), alpha=1 - decay)


@torch.no_grad()
@torch.compiler.set_stance("force_eager")  # nothing is compiled for the sizes of validation
def validate(loss: ClipLoss, weights: dict[str, Tensor], pool: ClipPool,
             both: bool = False) -> tuple[float, float]:
    """PSNR in dB and flicker of the averaged weights on the first noisy render of each held-out
    clip, without augmentation.

    ``both`` scores the blend of both directions. Both figures are NaN if no clip is held out.
    """
    mine = {k: v.clone() for k, v in loss.model.state_dict().items()}
    loss.model.load_state_dict(weights)
    reset, even, loss.reset, loss.even = loss.reset, loss.even, 0.0, 0.0
    results = []
    for clips in by_size(pool.validation, 8):
        batch = set_direction(to_batch(collate(clips, [0] * len(clips))), both)
        results.append(torch.stack(loss(batch)[1:3]) * len(clips))
    loss.reset, loss.even = reset, even
    loss.model.load_state_dict(mine)
    quality, flicker = ((sum(results) / len(pool.validation)).tolist() if results
                        else (math.nan, math.nan))
    return quality, flicker


def by_size(clips: list[Clip], most: int) -> Iterator[list[Clip]]:
    """Groups of at most ``most`` clips of one size."""
    ordered = sorted(clips, key=lambda clip: clip.reference.shape)
    for _, same in itertools.groupby(ordered, lambda clip: clip.reference.shape):
        group = list(same)
        yield from (group[i:i + most] for i in range(0, len(group), most))


def add_row(path: Path, *values: float) -> None:
    """Add a row to one of the run's tables of curves."""
    with path.open("a") as file:
        csv.writer(file).writerow(values)


# Training -----------------------------------------------------------------------------------------

def tell_empty_folders(pool: ClipPool) -> None:
    """Name the folders from which no clip is trained on, as when what fills them has failed."""
    filled = {path.parent for path in pool.seen}
    for folder in pool.folders:
        if folder not in filled:
            print(f"no clip of {folder} is there yet: training on the others until some come",
                  flush=True)


def wait_for_clips(pool: ClipPool, wanted: int | None, where: str) -> None:
    """Wait for as many clips; for `USUAL_WAIT` without a number, or those that are there once no
    other comes."""
    count, since = pool.refresh(), time.monotonic()
    enough = USUAL_WAIT if wanted is None else wanted
    if count < enough:
        print(f"waiting for {enough} clips to train on (--wait): {where} has {count}", flush=True)
    while count < enough:
        if wanted is None and count and time.monotonic() - since > PATIENCE:
            print(f"no more clips come: training on {count}", flush=True)
            return
        time.sleep(PAUSE)
        before, count = count, pool.refresh()
        since = time.monotonic() if count > before else since


class Run:
    """A training under way, and its checkpoints.

    Attributes:
        model: the network with its live weights.
        average: of its weights, which is validated and exported.
        flat, gradient: the gradient of a step, and what computes it.
        optimiser: with the learning rate of the next step.
        step: steps so far, begun: those of the checkpoint that the run goes on from.
        start: when it began, in seconds of the clock, without time between resumed runs.
    """

    def __init__(self, args: argparse.Namespace, pool: ClipPool, model: DenoiseUpscale,
                 device: torch.device, world: int):
        self.args, self.pool, self.model = args, pool, model
        self.device, self.world = device, world
        self.average = Average(model, DECAY)
        self.loss = ClipLoss(model, args.flicker, args.reset, args.even, tuple(args.light),
                             args.reflectance, args.clean_planes, args.noisy_references)
        groups = rate_groups(model, args.published_rate, args.only)
        self.flat = FlatGradient([weight for group in groups for weight in group["params"]])
        self.gradient = GradientStep(self.loss, self.flat)
        self.optimiser = torch.optim.AdamW(groups, lr=args.rate, betas=(0.9, 0.99),
                                           weight_decay=1e-4, fused=device.type == "cuda")
        self.step, self.start = 0, time.monotonic()
        if args.onward:
            self._load(unpack(args.onward))
        self.begun = self.step
        if args.resume:
            self._resume(read(args.resume))

    def _load(self, saved: dict[str, Any]) -> None:
        """Take weights, their average and the count of steps from a checkpoint."""
        self.model.load_state_dict(saved["live"])
        self.average.weights = {k: v.to(self.device) for k, v in saved["weights"].items()}
        self.step = saved["step"]

    def _resume(self, saved: dict[str, Any]) -> None:
        """Go on as the run did that wrote this checkpoint."""
        self._load(saved)
        self.optimiser.load_state_dict(saved["optimiser"])
        self.flat.nonfinite.fill_(saved["nonfinite"])
        self.start = time.monotonic() - saved["seconds"]

    @property
    def seconds(self) -> float:
        """Time so far."""
        return time.monotonic() - self.start

    def progress(self) -> float:
        """Share of the training that is done, by steps or by the clock, the same on every GPU."""
        if self.args.steps is not None:
            return float(self.step / max(self.args.steps, 1))
        passed = self.seconds / (60 * self.args.minutes)
        if self.world == 1:  # without waiting for the GPU, while the next batch is put together
            return float(passed)
        share = torch.tensor([passed], device=self.device)
        dist.broadcast(share, 0)
        return float(share)

    def set_rate(self, done: float) -> float:
        """Set the learning rate for a share of the training that is done; returns it."""
        rate = rate_at(done, self.step - self.begun, self.args.rate, self.args.cool)
        for group in self.optimiser.param_groups:
            group["lr"] = rate * group["share"]
        return rate

    def learn(self, batch: Batch) -> tuple[list[Tensor], State]:
        """One step; returns loss, PSNR, flicker and the gradient's norm, and the history after the
        batch."""
        *results, state = self.gradient(batch)
        norm = self.flat.finish(LARGEST_NORM, self.world > 1)
        self.optimiser.step()
        self.average.update(self.step)
        self.step += 1
        return [*results, norm], state

    def keep(self) -> dict[str, Any]:
        """Validate the averaged weights and write the checkpoint; returns the notes on the run so
        far."""
        args, seconds = self.args, self.seconds
        quality, flicker = validate(self.loss, self.average.weights, self.pool)
        notes = {"steps": self.step, "minutes": round(seconds / 60, 2), "gpus": self.world,
                 "batch": args.batch * self.world, "clips": len(self.pool) * self.world,
                 "validation_psnr": quality, "validation_flicker": flicker}
        if args.both_ways:
            both = validate(self.loss, self.average.weights, self.pool, both=True)
            notes |= {"both_ways": args.both_ways, "both_psnr": both[0], "both_flicker": both[1]}
        save({"config": self.model.config.as_dict(),
              "weights": {k: v.cpu().contiguous() for k, v in self.average.weights.items()},
              "notes": notes,
              "live": self.model.state_dict(),
              "optimiser": self.optimiser.state_dict(),
              "step": self.step,
              "seconds": self.seconds,
              "rate": self.optimiser.param_groups[0]["lr"],
              "seed": args.seed,
              "arguments": {k: v for k, v in vars(args).items() if k not in PLACES},
              "commit": git_commit(),
              "nonfinite": int(self.flat.nonfinite)}, args.out / "checkpoint.pt")
        add_row(args.out / "validation.csv", self.step, round(self.seconds, 1), quality, flicker)
        print("validation", json.dumps(notes), flush=True)
        return notes

    def keep_stable(self) -> None:
        """The checkpoint of the highest learning rate, from which a longer training goes on."""
        self.keep()
        os.replace(self.args.out / "checkpoint.pt", self.args.out / "stable.pt")

    def tell(self, rate: float, recent: list[Tensor]) -> None:
        """Print the means of recent steps, and add them to the log."""
        values = [round(float(x), 5) for x in torch.stack(recent).nanmean(0)]
        print(f"step {self.step} {self.seconds:.0f} s clips {len(self.pool)} rate {rate:.2e} loss "
              f"{values[0]:.4f} psnr {values[1]:.2f} flicker {values[2]:.4f} norm "
              f"{values[3]:.3f} non-finite {int(self.flat.nonfinite)}", flush=True)
        add_row(self.args.out / "log.csv", self.step, round(self.seconds, 1), rate, *values)


def open_pool(args: argparse.Namespace, rank: int, world: int, device: torch.device) -> ClipPool:
    """The clips of a process: it trains on a share of the folders, and one clip in twenty is held
    out."""
    motions: list[str] = []
    if args.both_ways or args.carry:
        motions.append("inverse")
    if args.false_motion:
        motions.append("static")
    prepare = FirstStage(args.first, device) if args.first else None
    return ClipPool(dict(args.clips), device, args.guides, rank, world, motions=tuple(motions),
                    blank_volumes=not args.volumes, prepare=prepare,
                    both_halves=args.noisy_references)


def train(args: argparse.Namespace, rank: int = 0, world: int = 1,
          device: torch.device = torch.device("cpu"),  # noqa: B008
          model: DenoiseUpscale | None = None, pause: int | None = None) -> DenoiseUpscale:
    """Train in one of ``world`` processes; returns the network with its live weights.

    ``model`` stands in for the network of the arguments. ``pause``: stop at this step, with a
    checkpoint to resume.
    """
    pool = open_pool(args, rank, world, device)
    wait_for_clips(pool, args.wait, folder_names(args))
    tell_empty_folders(pool)
    augment = Augment(clean=args.clean, false_motion=args.false_motion,
                      spread=args.spread_noise)
    model = model or network_of(args)
    model = model.to(device, memory_format=torch.channels_last)
    if args.start:
        model.load_state_dict(widen(load_weights(args.start, args.trust), model.state_dict()))
    run = Run(args, pool, model, device, world)
    print(f"{len(pool)} clips to train on, {len(pool.validation)} held out", flush=True)

    cooling = False
    stop_watching = pool.watch() if world == 1 else None
    kept = time.monotonic()
    recent: list[Tensor] = []
    playing = [Playback(run.step) for _ in range(PLAYING)]
    while (done := run.progress()) < 1 and run.step != pause:
        if args.cool and not cooling and done >= 1 - args.cool:
            cooling = True
            if rank == 0:
                run.keep_stable()
        rate = run.set_rate(done)

        # A batch: new windows, or those of an earlier step played the other way.
        play = pick(playing, run.step, args)
        seed_all(args.seed, rank, play.begun)  # the same windows and augmentation for all turns
        drawn = pool.draw(args.batch, args.crop, args.seed + play.begun, args.sparse_planes,
                          play.turn, args.blend)
        batch = augment(drawn)
        seed_all(args.seed, rank, run.step, "resets")
        if args.carry:
            batch = replace(batch, state=play.state or empty_state(batch.frames[0],
                                                                   *batch.references.shape[-2:]))
        batch = set_direction(batch, runs_both_ways(run.step, args.both_ways))

        results, play.state = run.learn(batch)
        play.turn += 1
        recent.append(torch.stack(results))
        if run.step in (1, 5, 20, 50, 100) or run.step % 250 == 0:
            if rank == 0:
                run.tell(rate, recent)
            recent.clear()
        if time.monotonic() - kept > 60 * KEEP_MINUTES:
            if world > 1:
                pool.refresh()
            # windows are drawn from other clips now
            playing = [Playback(run.step) for _ in range(PLAYING)]
            if rank == 0:
                run.keep()
            kept = time.monotonic()
    if stop_watching:
        stop_watching()
    if rank == 0:
        notes = run.keep()
        if args.log and run.step != pause:
            append_run(args.log, run_row(args, notes))
    return model


def folder_names(args: argparse.Namespace) -> str:
    """The folders of clips as on the command line."""
    return " ".join(str(folder) if weight == 1 else f"{folder}={weight:g}"
                    for folder, weight in args.clips)


def run_row(args: argparse.Namespace, notes: dict[str, Any]) -> dict[str, Any]:
    """A row of the table of runs: the arguments and the results."""
    defaults = vars(options().parse_args(["--clips", ".", "--out", ""]))
    changed = {k: v for k, v in vars(args).items() if k not in PLACES and v != defaults[k]}
    return {"run": args.out.name, "date": date.today().isoformat(), "commit": git_commit(),
            "start": str(args.start or "from scratch"), "options": changed,
            "data": folder_names(args), **notes}


def main() -> None:
    args = parse()
    rank, world = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
    device = torch.device(f"cuda:{rank}" if torch.cuda.is_available() else "cpu")
    if device.type == "cuda":
        torch.cuda.set_device(device)
        torch.backends.cudnn.benchmark = torch.backends.cudnn.allow_tf32 = True
        torch.backends.cuda.matmul.allow_tf32 = True
        fuse()
    torch.manual_seed(args.seed)  # the same weights everywhere; batches differ by rank
    random.seed(args.seed + rank)
    args.out.mkdir(parents=True, exist_ok=True)
    if world > 1:
        dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    train(args, rank, world, device)
    if world > 1:
        dist.destroy_process_group()


if __name__ == "__main__":
    main()
