"""Train the denoised upscaler on clips of the data factory.

One GPU:      python -m training.denoise.train --clips CLIPS --out RUN --minutes 20
Several GPUs: torchrun --nproc-per-node 4 -m training.denoise.train --clips CLIPS --out RUN --minutes 20

The learning rate rises over 500 steps and follows the clock: a cosine down to zero at the end of --minutes. The folder
of clips may still be filling. RUN/log.csv and validation.csv hold the curves (training/measure/plot_curves.py draws
them). RUN/checkpoint.pt holds the weights, their average, the optimiser, step, time, random states, arguments and the
git commit; --resume goes on with all of it, --start begins a new run from weights alone. The defaults are those of the
last training of m.
"""

import argparse
import csv
import itertools
import json
import math
import os
import random
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

from training import ops
from training.denoise import loss as losses
from training.denoise import model as network
from training.denoise.dataset import Augment, Batch, Clip, ClipPool, collate, to_batch
from training.denoise.loss import ClipLoss
from training.denoise.model import DenoiseUpscale, TrunkConfig
from training.denoise.restore import weights_of

# Fused operations ---------------------------------------------------------------------------------------------------
# Fused versions of the small operations that a training step spends its time in.
#
# Each is memory-bound when run as it is written: compiled on its own it is one or two GPU kernels forward and as many
# backward. The whole step compiled at once would take minutes for every shape.

FUSED = ((ops, ("filter_kernels", "pool", "demodulation", "dilate_motion", "box_mean", "display")),
         (network, ("upsample",)),
         (network, ("features", "guide_features", "accumulate", "demodulate")),
         (losses, ("frame_loss", "flicker_loss", "explained_by_motion", "even_scale")))


def fuse() -> None:
    """Replace the operations in their modules, for this process."""
    torch._dynamo.config.cache_size_limit = 64
    for module, names in FUSED:
        for name in names:
            setattr(module, name, torch.compile(getattr(module, name), dynamic=False))


# CUDA graphs --------------------------------------------------------------------------------------------------------
# Forward and backward of a training step as CUDA graphs, one for each shape of batch, forwards or both ways.
#
# A recurrent step over eight frames launches some ten thousand small kernels; replayed as a graph they cost a third.
# The learning rate lives in the optimiser, outside of the graph, so it may change every step.

class FlatGradient:
    """Gradients of all parameters in one buffer: zeroed, summed over GPUs, clipped and repaired as one tensor.

    ``nonfinite`` counts the steps that a non-finite gradient emptied.
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
        """Mean over the GPUs, clipped to norm ``limit``; a step with a non-finite gradient becomes none."""
        if several:
            torch.distributed.all_reduce(self.buffer, torch.distributed.ReduceOp.AVG)
        norm = self.buffer.norm()
        self.nonfinite += ~norm.isfinite()
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


# Training -----------------------------------------------------------------------------------------------------------

KEEP_MINUTES = 2.0
WARM_STEPS = 500


class Average:
    """Exponential moving average of the weights."""

    def __init__(self, model: nn.Module, decay: float):
        self.decay, self.live = decay, dict(model.named_parameters())
        self.weights = {k: v.detach().clone() for k, v in self.live.items()}

    @torch.no_grad()
    def update(self, step: int) -> None:
        decay = min(self.decay, (1 + step) / (10 + step))
        targets = list(self.weights.values())
        torch._foreach_mul_(targets, decay)
        torch._foreach_add_(targets, list(self.live.values()), alpha=1 - decay)


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=17)
    parser.add_argument("--steps", type=int, help="end, and follow the cosine, by steps and not by minutes")
    parser.add_argument("--batch", type=int, default=16, help="clips a GPU and step")
    parser.add_argument("--crop", type=int, default=96, help="side of the windows in render pixels, multiple of 16")
    parser.add_argument("--rate", type=float, default=8e-4)
    parser.add_argument("--widths", type=int, nargs="+", default=[96, 160, 224, 320])
    parser.add_argument("--depth", type=int, default=TrunkConfig.depth)
    parser.add_argument("--stem", type=int, help="channels of the stem; default: those of the first level")
    parser.add_argument("--reach", type=int, default=TrunkConfig.reach, choices=(2, 4), help="side of the stem, pixels")
    parser.add_argument("--guides", action="store_true", help="read planes at output size")
    parser.add_argument("--trust", action="store_true", help="planes count as far as the network trusts them")
    parser.add_argument("--flicker", type=float, default=6.0, help="weight of the temporal difference")
    parser.add_argument("--reset", type=float, default=0.03, help="chance that a frame drops its history")
    parser.add_argument("--even", action="store_true", help="clips of little noise count as much as noisy ones")
    parser.add_argument("--clean", type=float, default=Augment.clean, metavar="SHARE",
                        help="part of the offline renders whose colour is moved towards the reference (%(default)s)")
    parser.add_argument("--both-ways", type=float, default=0.0, metavar="SHARE",
                        help="part of the steps that run clips backwards, too, and rate the blend of both directions")
    begin = parser.add_mutually_exclusive_group()
    begin.add_argument("--start", type=Path, help="weights: checkpoint.pt or denoise_upscale.<tag>.onnx")
    begin.add_argument("--resume", type=Path, help="checkpoint.pt of a run to go on with, with its arguments")
    parser.add_argument("--wait", type=int, default=8, help="clips a GPU to wait for before training starts")
    parser.add_argument("--seed", type=int, default=0)
    return parser


def parse(words: list[str] | None = None) -> argparse.Namespace:
    """The arguments; those of a run that is resumed take the place of the defaults."""
    parser = options()
    args = parser.parse_args(words)
    if args.resume:
        saved = torch.load(args.resume, map_location="cpu", weights_only=True)
        if "optimiser" not in saved:
            parser.error(f"{args.resume} holds weights only: begin a new run with --start")
        parser.set_defaults(**saved["arguments"])
        args = parser.parse_args(words)
    return args


def git_commit() -> str:
    """The commit of this code, marked where files differ from it; 'unknown' outside of a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
        return done.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def random_state(device: torch.device) -> dict[str, Any]:
    """States of all generators that training draws from."""
    cuda = torch.cuda.get_rng_state(device) if device.type == "cuda" else None
    return {"python": random.getstate(), "torch": torch.get_rng_state(), "cuda": cuda}


def set_random_state(state: dict[str, Any], device: torch.device) -> None:
    """Set them to what ``random_state`` returned."""
    random.setstate(state["python"])
    torch.set_rng_state(state["torch"])
    if state["cuda"] is not None and device.type == "cuda":
        torch.cuda.set_rng_state(state["cuda"], device)


def load_start(path: Path) -> dict[str, Tensor]:
    """Averaged weights of a checkpoint, or the weights of an exported network."""
    if path.suffix == ".onnx":
        return weights_of(path)
    return torch.load(path, map_location="cpu", weights_only=True)["weights"]


@torch.no_grad()
def begin_trust(trunk: network.Trunk) -> None:
    """The last hidden channel of a network that used it otherwise becomes trust in the planes, nearly 1 everywhere."""
    head = slice(4 * (network.FINE - 1), 4 * network.FINE)
    trunk.fine.weight[head] = 0
    trunk.fine.bias[head] = 2
    trunk.stem.weight[:, network.FEATURES - 1] = 0


def rate_at(progress: float, step: int, peak: float) -> float:
    """Learning rate at a share of the training time and a step: where it rises faster, units die for good."""
    return peak * min((step + 1) / WARM_STEPS, 1) * max(0.5 * (1 + math.cos(math.pi * progress)), 1e-3)


def turns(step: int, share: float) -> bool:
    """Whether a step is one of the ``share`` that runs both ways: evenly spread, the same on every GPU."""
    return math.floor((step + 1) * share) > math.floor(step * share)


@torch.no_grad()
@torch.compiler.set_stance("force_eager")  # nothing is compiled for the sizes of validation
def validate(loss: ClipLoss, weights: dict[str, Tensor], pool: ClipPool, both: bool = False) -> tuple[float, float]:
    """PSNR and flicker of the averaged weights on held-out clips, first noisy render of each, no augmentation; of the
    blend of ``both`` directions, or of clips run forwards."""
    mine = {k: v.clone() for k, v in loss.model.state_dict().items()}
    loss.model.load_state_dict(weights)
    reset, even, loss.reset, loss.even = loss.reset, loss.even, 0.0, False
    results = []
    for clips in by_size(pool.validation, 8):
        batch = directed(to_batch(collate(clips, [0] * len(clips))), both)
        results.append(torch.stack(loss(batch)[1:]) * len(clips))
    loss.reset, loss.even = reset, even
    loss.model.load_state_dict(mine)
    quality, flicker = (sum(results) / len(pool.validation)).tolist() if results else (math.nan, math.nan)
    return quality, flicker


def directed(batch: Batch, both: bool) -> Batch:
    """The batch for ``both`` directions, or for forwards only."""
    return batch if both else replace(batch, inverse=None)


def by_size(clips: list[Clip], most: int) -> Iterator[list[Clip]]:
    """Groups of at most ``most`` clips of one size."""
    ordered = sorted(clips, key=lambda clip: clip.reference.shape)
    for _, same in itertools.groupby(ordered, lambda clip: clip.reference.shape):
        group = list(same)
        yield from (group[i:i + most] for i in range(0, len(group), most))


class Trainer:
    """Everything of one process: its clips, model (a given one, or that of the options), optimiser and log."""

    def __init__(self, args: argparse.Namespace, rank: int, world: int, device: torch.device,
                 model: DenoiseUpscale | None = None):
        self.args, self.rank, self.world, self.device = args, rank, world, device
        self.pool = ClipPool(args.clips, device, args.guides, rank, world, inverse=args.both_ways > 0)
        if self.pool.refresh() < args.wait:
            print(f"waiting for {args.wait} clips to train on (--wait): {args.clips} has {len(self.pool)}", flush=True)
        while self.pool.refresh() < args.wait:
            time.sleep(2)
        model = model or DenoiseUpscale(TrunkConfig(tuple(args.widths), args.depth, args.guides, args.stem, args.reach,
                                                    args.trust))
        self.config, self.model = model.config, model.to(device, memory_format=torch.channels_last)
        if args.start:
            self.model.load_state_dict(load_start(args.start))
            if args.trust and args.start.suffix == ".onnx":
                begin_trust(self.model.trunk)
        self.average = Average(self.model, 0.9995)
        self.loss = ClipLoss(self.model, args.flicker, args.reset, args.even)
        self.flat = FlatGradient(list(self.model.parameters()))
        self.gradient = GradientStep(self.loss, self.flat)
        self.optimiser = torch.optim.AdamW(self.model.parameters(), lr=args.rate, betas=(0.9, 0.99), weight_decay=1e-4,
                                           fused=device.type == "cuda")
        print(f"{len(self.pool)} clips to train on, {len(self.pool.validation)} held out", flush=True)
        self.step, self.recent, self.augment = 0, [], Augment(clean=args.clean)
        self.start = self.kept = time.monotonic()
        if args.resume:
            self.resume(torch.load(args.resume, map_location="cpu", weights_only=True))

    def resume(self, saved: dict[str, Any]) -> None:
        """Go on where a checkpoint was written. Only one process draws as it would have: others seed by the step."""
        self.model.load_state_dict(saved["live"])
        self.average.weights = {k: v.to(self.device) for k, v in saved["weights"].items()}
        self.optimiser.load_state_dict(saved["optimiser"])
        self.flat.nonfinite.fill_(saved["nonfinite"])
        self.step = saved["step"]
        self.start = time.monotonic() - saved["seconds"]
        set_random_state(saved["random"], self.device)
        if self.rank:
            random.seed(f"{self.args.seed} {self.rank} {self.step}")

    def progress(self) -> float:
        """Share of the training that is done, by steps or by the clock, the same on every GPU."""
        if self.args.steps is not None:
            return self.step / max(self.args.steps, 1)
        passed = (time.monotonic() - self.start) / (60 * self.args.minutes)
        if self.world == 1:
            return passed  # without waiting for the GPU, while the next batch is put together
        share = torch.tensor([passed], device=self.device)
        dist.broadcast(share, 0)
        return float(share)

    def advance(self, done: float) -> float:
        """Take one step where a share of the training is ``done``; returns its learning rate."""
        rate = rate_at(done, self.step, self.args.rate)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        stack = self.pool.draw(self.args.batch, self.args.crop, self.args.seed + self.step)
        results = self.gradient(directed(self.augment(stack), turns(self.step, self.args.both_ways)))
        norm = self.flat.finish(1.0, self.world > 1)
        self.optimiser.step()
        self.average.update(self.step)
        self.recent.append(torch.stack((*results, norm)))
        self.step += 1
        return rate

    def run(self) -> None:
        while (done := self.progress()) < 1:
            rate = self.advance(done)
            if self.step in (1, 5, 20, 50, 100) or self.step % 250 == 0:
                self.report(rate)
            if time.monotonic() - self.kept > 60 * KEEP_MINUTES:
                self.pool.refresh()
                self.keep()
                self.kept = time.monotonic()
        self.keep()

    def report(self, rate: float) -> None:
        values = [round(float(x), 5) for x in torch.stack(self.recent).nanmean(0)]
        self.recent.clear()
        if self.rank == 0:
            seconds = time.monotonic() - self.start
            print(f"step {self.step} {seconds:.0f} s rate {rate:.2e} loss {values[0]:.4f} psnr {values[1]:.2f} "
                  f"flicker {values[2]:.4f} norm {values[3]:.3f} non-finite {int(self.flat.nonfinite)}", flush=True)
            self.note("log.csv", rate, *values)

    def note(self, name: str, *values: float) -> None:
        """Add a row to one of the run's tables, which plot_curves.py draws."""
        with (self.args.out / name).open("a") as file:
            csv.writer(file).writerow([self.step, round(time.monotonic() - self.start, 1), *values])

    def keep(self) -> None:
        """Validate the averaged weights and write the checkpoint."""
        if self.rank:
            return
        state = random_state(self.device)  # validation draws, too
        quality, flicker = validate(self.loss, self.average.weights, self.pool)
        notes = {"steps": self.step, "minutes": round((time.monotonic() - self.start) / 60, 2), "gpus": self.world,
                 "batch": self.args.batch * self.world, "clips": len(self.pool) * self.world,
                 "validation_psnr": quality, "validation_flicker": flicker}
        if self.args.both_ways:
            both = validate(self.loss, self.average.weights, self.pool, both=True)
            notes |= {"both_ways": self.args.both_ways, "both_psnr": both[0], "both_flicker": both[1]}
        weights = {k: v.cpu().contiguous() for k, v in self.average.weights.items()}
        set_random_state(state, self.device)
        arguments = {k: v for k, v in vars(self.args).items() if k not in ("clips", "out", "start", "resume")}
        saved = {"config": self.config.as_dict(), "weights": weights, "notes": notes, "live": self.model.state_dict(),
                 "optimiser": self.optimiser.state_dict(), "step": self.step, "seconds": time.monotonic() - self.start,
                 "rate": self.optimiser.param_groups[0]["lr"], "seed": self.args.seed, "arguments": arguments,
                 "commit": git_commit(), "random": state, "nonfinite": int(self.flat.nonfinite)}
        partial = self.args.out / "checkpoint.tmp"
        torch.save(saved, partial)
        os.replace(partial, self.args.out / "checkpoint.pt")
        self.note("validation.csv", quality, flicker)
        print("validation", json.dumps(notes), flush=True)


def set_up(args: argparse.Namespace, rank: int = 0) -> torch.device:
    """The folder, the device and the seeds of a process."""
    device = torch.device(f"cuda:{rank}" if torch.cuda.is_available() else "cpu")
    if device.type == "cuda":
        torch.cuda.set_device(device)
        torch.backends.cudnn.benchmark = torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = True
        fuse()
    torch.manual_seed(args.seed)  # the same weights everywhere; batches differ by rank
    random.seed(args.seed + rank)
    args.out.mkdir(parents=True, exist_ok=True)
    return device


def main() -> None:
    args = parse()
    rank, world = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
    device = set_up(args, rank)
    if world > 1:
        dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    Trainer(args, rank, world, device).run()
    if world > 1:
        dist.destroy_process_group()


if __name__ == "__main__":
    main()
