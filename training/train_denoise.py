"""Train the denoised upscaler on clips of the data factory.

One GPU:      python -m training.train_denoise --clips CLIPS --out RUN --minutes 20
Several GPUs: torchrun --nproc-per-node 4 -m training.train_denoise --clips CLIPS --out RUN --minutes 20

The learning rate follows the clock: warm-up, then a cosine down to zero at the end of --minutes. The folder of clips
may still be filling. RUN/checkpoint.pt holds the averaged weights, RUN/log.csv the curves; --resume goes on from one.
"""
import argparse
import csv
import json
import math
import os
import time
from pathlib import Path

import torch
import torch.distributed as dist
from torch import Tensor, nn

from training import losses
from training.dataset import Augment, Batch, ClipPool, collate, to_batch
from training.networks import ops
from training.networks.denoise_upscale import DenoiseUpscale, empty_state
from training.networks.trunk import TrunkConfig


class ClipLoss(nn.Module):
    """Run a clip through the recurrent step and sum the losses of its frames."""

    def __init__(self, model: DenoiseUpscale, flicker: float, reset: float):
        super().__init__()
        self.model, self.flicker, self.reset = model, flicker, reset

    def forward(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """Loss, and without gradient the mean PSNR of the clip's second half and the mean flicker."""
        height, width = batch.references.shape[-2:]
        state = empty_state(batch.frames[0], height, width)
        loss, quality, flicker = 0.0, [], []
        count = len(batch.frames)
        previous = None
        for t, inputs in enumerate(batch.frames):
            keep = (torch.rand_like(inputs.depth[:, :, :1, :1]) >= self.reset).float()
            with torch.autocast(inputs.colour.device.type, torch.bfloat16):
                output, state, history = self.model(inputs, state.drop(keep))
            shown, target = ops.display(output), ops.display(batch.references[t])
            loss = loss + losses.frame_loss(shown, target) * (0.5 + t / count)
            if previous is not None:
                moved = losses.reproject_reference(previous[1], inputs.motion)
                explained = losses.explained_by_motion(target, moved)
                change = losses.flicker_loss(shown, losses.reproject_reference(previous[0], inputs.motion), target,
                                             moved, explained)
                loss = loss + self.flicker * change
                flicker.append(change.detach())
            previous = (shown, target)
            if t >= count // 2:
                quality.append(losses.psnr(shown.detach(), target).mean())
        return loss / count, torch.stack(quality).mean(), torch.stack(flicker).mean()


class Average:
    """Exponential moving average of the weights."""

    def __init__(self, model: nn.Module, decay: float):
        self.decay = decay
        self.weights = {k: v.detach().clone().float() for k, v in model.state_dict().items()}

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        decay = min(self.decay, (1 + step) / (10 + step))
        targets = list(self.weights.values())
        torch._foreach_mul_(targets, decay)
        torch._foreach_add_(targets, [v.float() for v in model.state_dict().values()], alpha=1 - decay)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--batch", type=int, default=24, help="clips a GPU and step")
    parser.add_argument("--rate", type=float, default=8e-4)
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 96, 128, 192])
    parser.add_argument("--depth", type=int, default=2)
    parser.add_argument("--flicker", type=float, default=1.0)
    parser.add_argument("--reset", type=float, default=0.03, help="chance that a frame drops its history")
    parser.add_argument("--resume", type=Path)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--wait", type=int, default=8, help="clips a GPU to wait for before training starts")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def rate_at(progress: float, peak: float) -> float:
    """Learning rate at a share of the training time."""
    if progress < 0.02:
        return peak * max(progress / 0.02, 0.02)
    return peak * max(0.5 * (1 + math.cos(math.pi * (progress - 0.02) / 0.98)), 1e-3)


@torch.no_grad()
def validate(loss: ClipLoss, weights: dict[str, Tensor], pool: ClipPool, device: torch.device) -> tuple[float, float]:
    """PSNR and flicker of the averaged weights on held-out clips, first noisy render of each, no augmentation."""
    mine = {k: v.clone() for k, v in loss.model.state_dict().items()}
    loss.model.load_state_dict(weights)
    reset, loss.reset = loss.reset, 0.0
    results = [loss(to_batch(*collate([clip], [0], device)))[1:] for clip in pool.validation]
    loss.reset = reset
    loss.model.load_state_dict(mine)
    scores = torch.tensor(results) if results else torch.zeros(1, 2)
    return float(scores[:, 0].mean()), float(scores[:, 1].mean())


def save(out: Path, config: TrunkConfig, average: Average, optimiser: torch.optim.Optimizer, notes: dict) -> None:
    weights = {k: v.cpu() for k, v in average.weights.items()}
    torch.save({"config": config.as_dict(), "weights": weights, "notes": notes}, out / "checkpoint.tmp")
    os.replace(out / "checkpoint.tmp", out / "checkpoint.pt")
    (out / "notes.json").write_text(json.dumps(notes, indent=1))


def train(args: argparse.Namespace) -> None:
    several = "RANK" in os.environ
    rank, world = (int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])) if several else (0, 1)
    device = torch.device(f"cuda:{rank}" if torch.cuda.is_available() else "cpu")
    if device.type == "cuda":
        torch.cuda.set_device(device)
        torch.backends.cudnn.benchmark = True
        torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    if several:
        dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    torch.manual_seed(args.seed + rank)
    __import__("random").seed(args.seed + rank)
    args.out.mkdir(parents=True, exist_ok=True)

    pool = ClipPool(args.clips, device, rank, world)
    while pool.refresh() < args.wait:
        time.sleep(2)
    config = TrunkConfig(tuple(args.widths), args.depth)
    model = DenoiseUpscale(config).to(device, memory_format=torch.channels_last)
    if args.resume:
        model.load_state_dict(torch.load(args.resume, map_location=device, weights_only=True)["weights"])
    average = Average(model, 0.999)
    optimiser = torch.optim.AdamW(model.parameters(), lr=args.rate, betas=(0.9, 0.99), weight_decay=1e-4)
    loss = ClipLoss(model, args.flicker, args.reset)
    if args.compile:
        model.compile(dynamic=False)
    step_loss = nn.parallel.DistributedDataParallel(loss, [rank] if device.type == "cuda" else None) if several else loss
    log = csv.writer((args.out / "log.csv").open("a")) if rank == 0 else None
    augment, start, step, seen = Augment(), time.monotonic(), 0, time.monotonic()
    recent: list[Tensor] = []
    progress = torch.zeros(1, device=device)
    while True:
        progress.fill_((time.monotonic() - start) / (60 * args.minutes))
        if several:
            dist.broadcast(progress, 0)
        done = float(progress)
        if done >= 1:
            break
        for group in optimiser.param_groups:
            group["lr"] = rate_at(done, args.rate)
        value, quality, flicker = step_loss(pool.draw(args.batch, augment))
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        norm = nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        if bool(torch.isfinite(norm)):
            optimiser.step()
        average.update(model, step)
        recent.append(torch.stack((value.detach(), quality, flicker, norm)))
        step += 1
        if step in (1, 5, 20, 50) or step % 200 == 0:
            row = [step, round((time.monotonic() - start), 1), f"{optimiser.param_groups[0]['lr']:.2e}",
                   *(round(float(x), 5) for x in torch.stack(recent).mean(0))]
            recent.clear()
            if rank == 0:
                print("step %d %.0f s rate %s loss %.4f psnr %.2f flicker %.4f norm %.3f" % tuple(
                    float(x) if i != 2 else x for i, x in enumerate(row)), flush=True)
                log.writerow(row)
        if time.monotonic() - seen > 45:
            seen = time.monotonic()
            clips = pool.refresh(limit=64)
            if rank == 0:
                quality, flicker = validate(loss, average.weights, pool, device)
                notes = {"steps": step, "minutes": (time.monotonic() - start) / 60, "gpus": world, "clips": clips * world,
                         "batch": args.batch * world, "validation_psnr": quality, "validation_flicker": flicker}
                save(args.out, config, average, optimiser, notes)
                print("validation", notes, flush=True)
    if rank == 0:
        quality, flicker = validate(loss, average.weights, pool, device)
        notes = {"steps": step, "minutes": args.minutes, "gpus": world, "batch": args.batch * world,
                 "clips": sum(map(len, pool.training.values())) * world, "validation_psnr": quality,
                 "validation_flicker": flicker}
        save(args.out, config, average, optimiser, notes)
        print("finished", notes, flush=True)
    if several:
        dist.destroy_process_group()


if __name__ == "__main__":
    train(arguments())
