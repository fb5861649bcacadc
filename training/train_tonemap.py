"""Train the HDRNet tone mapper on a packed set (see make_tonemap_set.py).

    python -m training.train_tonemap --data tonemap_set.npz --out runs/tonemap --minutes 5

Reads from top to bottom: options, data, network, loop, validation, checkpoint. Runs on CUDA, or on a CPU at toy size.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import time
from pathlib import Path

import numpy as np
import torch

from training.looks import Look, target
from training.networks.hdrnet import HDRNet, default_params, lowres, shape, slice_apply_dense
from training.tonemap_data import SHIFT, Views

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--data", required=True)
parser.add_argument("--out", required=True, help="folder for checkpoint.pt and log.jsonl")
parser.add_argument("--minutes", type=float, default=5.0, help="wall-clock length; the learning rate follows it")
parser.add_argument("--batch", type=int, default=16)
parser.add_argument("--rate", type=float, default=1.5e-3)
parser.add_argument("--scale", type=float, default=1.0, help="shrinks the training pictures, for toy runs")
parser.add_argument("--every", type=float, default=30.0, help="seconds between validations")
parser.add_argument("--resume", help="start from this checkpoint's weights")
parser.add_argument("--seed", type=int, default=1)

CONSISTENCY, GRADIENT, CHROMA, SQUARED = 0.5, 0.5, 0.5, 4.0


def picture_loss(out: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """L1 + squared error in sRGB values, their gradients, and two opponent channels; overshoot past white is free."""
    d = out - wanted
    d = torch.where(((wanted >= 1) & (d > 0)) | ((wanted <= 0) & (d < 0)), 0.01 * d, d)
    gradient = (d[..., 1:] - d[..., :-1]).abs().mean() + (d[..., 1:, :] - d[..., :-1, :]).abs().mean()
    opponent = (d[:, 0] - d[:, 1]).abs().mean() + (d[:, 2] - 0.5 * (d[:, 0] + d[:, 1])).abs().mean()
    return d.abs().mean() + SQUARED * d.square().mean() + GRADIENT * gradient + CHROMA * opponent


def render(net: HDRNet, colour: torch.Tensor, params: torch.Tensor, noise: float = 0.0) -> torch.Tensor:
    """Display colour before the last clip; `noise` disturbs what the coefficient network sees."""
    low = lowres(colour, params)
    grid, guide = net(low + noise * torch.randn_like(low))
    return slice_apply_dense(shape(colour, params), guide, grid)


def windows(x: torch.Tensor, dy: int, dx: int) -> torch.Tensor:
    """The view of a padded batch that is shifted by (dy, dx) pixels."""
    return x[..., dy : x.shape[-2] - SHIFT + dy, dx : x.shape[-1] - SHIFT + dx]


def losses(
    net: HDRNet, batch: torch.Tensor, wanted: torch.Tensor, params: torch.Tensor, shift: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Picture loss of two shifted views, and how much more they differ where they overlap than their targets do."""
    h, w = batch.shape[-2] - SHIFT, batch.shape[-1] - SHIFT
    dy, dx = shift
    first = render(net, windows(batch, 0, 0), params)
    second = render(net, windows(batch, dy, dx), params, noise=0.01)
    picture = 0.5 * (picture_loss(first, windows(wanted, 0, 0)) + picture_loss(second, windows(wanted, dy, dx)))
    a, b = first[..., dy:, dx:], second[..., : h - dy, : w - dx]
    return picture, (a.clamp(0, 1) - b.clamp(0, 1)).abs().mean()


@torch.no_grad()
def validate(net: HDRNet, packed: np.lib.npyio.NpzFile, params: torch.Tensor) -> dict[str, float]:
    """PSNR in sRGB values of each held-out picture against the colour pipeline's own output."""
    scores = {}
    for i, name in enumerate(packed["validation_names"]):
        colour = torch.from_numpy(packed[f"validation_input_{i}"].astype(np.float32)).to(params.device)
        wanted = torch.from_numpy(packed[f"validation_target_{i}"].astype(np.float32) / 65535).to(params.device)
        out = render(net, colour.permute(2, 0, 1)[None], params)[0].clamp(0, 1).permute(1, 2, 0)
        scores[str(name)] = -10 * math.log10(float((out - wanted).square().mean()) + 1e-12)
    return scores


def main() -> None:
    args = parser.parse_args()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    name = torch.cuda.get_device_name() if device.type == "cuda" else "CPU"
    torch.manual_seed(args.seed)
    torch.backends.cudnn.allow_tf32 = True  # convolutions only: the interpolation weights need all their bits
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)

    packed = np.load(args.data)
    look = Look(*map(float, packed["local"]), view=None)
    cube = torch.from_numpy(packed["cube"].astype(np.float32) / 65535).to(device)
    views = Views(packed, device, args.seed)
    params = default_params().to(device)

    net, history = HDRNet().to(device), []
    if args.resume:
        before = torch.load(args.resume, map_location=device)
        net.load_state_dict(before["weights"])
        history = before["history"]
    average = copy.deepcopy(net).requires_grad_(False)
    optimizer = torch.optim.AdamW(net.parameters(), lr=args.rate, weight_decay=1e-4)
    print(
        f"{device}: {sum(p.numel() for p in net.parameters())} parameters, {len(views.pictures)} pictures", flush=True
    )

    start, last, step, sums = time.time(), 0.0, 0, torch.zeros(2, device=device)
    steps_since = 0
    with open(out / "log.jsonl", "w") as log:
        while True:
            elapsed = time.time() - start
            progress = min(1.0, elapsed / (60 * args.minutes))
            if elapsed - last >= args.every or progress >= 1:
                scores = validate(average, packed, params)
                mean_loss = (sums / max(1, steps_since)).tolist()
                row = {"step": step, "seconds": round(elapsed, 1), "picture": mean_loss[0], "consistency": mean_loss[1]}
                row |= {"psnr": {k: round(v, 3) for k, v in scores.items()}}
                print(json.dumps(row), flush=True)
                log.write(json.dumps(row) + "\n")
                run = {"steps": step, "seconds": row["seconds"], "device": name, "torch": str(torch.__version__)}
                run |= {"batch": args.batch, "rate": args.rate, "scale": args.scale, "seed": args.seed}
                state = {"weights": average.state_dict(), "psnr": row["psnr"], "history": [*history, run]}
                torch.save(state | {"pictures": [str(x) for x in packed["names"]]}, out / "checkpoint.pt")
                last, steps_since = elapsed, 0
                sums.zero_()
                if progress >= 1:
                    break
            warm = min(1.0, (step + 1) / 200)
            for group in optimizer.param_groups:
                group["lr"] = args.rate * warm * (0.5 + 0.5 * math.cos(math.pi * progress)) + 1e-6
            with torch.no_grad():
                batch = views.batch(args.batch, args.scale)
                wanted = target(batch, look, cube)
            shift = tuple(int(v) for v in views.random.integers(0, SHIFT + 1, 2))
            picture, consistency = losses(net, batch, wanted, params, shift)
            optimizer.zero_grad(set_to_none=True)
            (picture + CONSISTENCY * consistency).backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimizer.step()
            decay = min(0.999, (step + 1) / (step + 10))
            with torch.no_grad():
                torch._foreach_lerp_(list(average.parameters()), list(net.parameters()), 1 - decay)
            sums += torch.stack([picture.detach(), consistency.detach()])
            step += 1
            steps_since += 1


if __name__ == "__main__":
    main()
