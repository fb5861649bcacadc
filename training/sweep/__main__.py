"""Compare architectures of the denoised upscaler: train variants of one network alike, then measure time against error.

    python -m training.sweep train --clips CLIPS --out RUNS --minutes 5 --gpus 0,1,2,3
    python -m training.sweep measure RUNS -o OUT --size 960x540

`train` gives each variant (variants.py) the same clips, seed and minutes on one GPU, which begin when all is compiled.
The same command goes on where it was ended: finished variants are kept. RUNS/<variant> is a folder as
training.train_denoise leaves it, and said.txt. `measure` times networks and filters on this CPU, which nothing else
should use meanwhile, and writes sweep.csv, sweep.json and sweep.png.
"""

from __future__ import annotations

import argparse
import signal
import statistics
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from training.sweep.jobs import Queue
from training.sweep.variants import Variant, chosen

HANDED = {"batch": int, "crop": int, "rate": float, "wait": int, "seed": int}
"""Options of training.train_denoise that may be given."""


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    train = commands.add_parser("train", help="train variants")
    train.add_argument("--clips", type=Path, required=True)
    train.add_argument("--out", type=Path, required=True, help="folder for RUNS/<variant>")
    train.add_argument("--minutes", type=float, default=5, help="for each variant")
    train.add_argument("--gpus", default="0", help="numbers of the GPUs, with commas between")
    train.add_argument("--only", help="names of variants, with commas between (default: all)")
    for name, kind in HANDED.items():
        train.add_argument(f"--{name}", type=kind, help="as training.train_denoise takes it")
    measure = commands.add_parser("measure", help="time and compare trained variants")
    measure.add_argument("runs", type=Path, help="folder that 'train' filled")
    measure.add_argument("-o", "--out", type=Path, required=True)
    measure.add_argument("--size", default="960x540", type=size, help="render size (default: 960x540)")
    measure.add_argument("--repeat", type=int, default=9, help="runs of which the median is taken")
    return parser.parse_args(argv)


def size(text: str) -> tuple[int, int]:
    width, height = map(int, text.split("x"))
    return width, height


def train(args: argparse.Namespace) -> int:
    """Train what is not there yet; 1 where a variant failed."""
    options = [f"--{name}={getattr(args, name)}" for name in HANDED if getattr(args, name) is not None]
    try:
        names = list(chosen(args.only))
    except ValueError as error:
        raise SystemExit(f"error: {error}") from None
    queue = Queue(names, args.out, args.gpus.split(","), args.minutes, [f"--clips={args.clips}", *options])
    queue.run()
    return 1 if queue.failed else 0


def measure(args: argparse.Namespace) -> int:
    """Measure all checkpoints of a folder."""
    from postfx.bench.job import machine
    from postfx.runtime import Device
    from training.sweep.report import mark_front, markdown, remarks, write

    checkpoints = sorted(args.runs.glob("*/checkpoint.pt"))
    if not checkpoints:
        raise SystemExit(f"error: {args.runs} holds no trained variant: run 'train --out {args.runs}' first")
    device = Device("cpu")
    facts = {"size": "x".join(map(str, args.size)), "runs": args.repeat, "threads": device.threads, **machine()}
    rows = [measured(device, path, args) for path in checkpoints]
    mark_front(rows)
    write(rows, facts, args.out)
    print(markdown(rows))
    print(f"ms: network and filters at {facts['size']}, {facts['threads']} threads, median of {args.repeat} runs")
    print(*remarks(rows), sep="\n")
    return 0


def measured(device: Any, path: Path, args: argparse.Namespace) -> dict[str, Any]:
    """One variant's row."""
    from training.sweep.export import export_variant
    from training.sweep.timing import measure

    checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    variant, notes = Variant.from_dict(checkpoint["config"]), checkpoint["notes"]
    with TemporaryDirectory() as folder:
        exported = Path(folder) / f"{path.parent.name}.onnx"
        export_variant(variant, checkpoint["weights"], exported)
        times = measure(device, exported, variant, *args.size, args.repeat)
    both = [sum(pair) for pair in zip(*times, strict=True)]
    network, filters, whole = map(statistics.median, (*times, both))
    return {"name": path.parent.name, "psnr": notes["validation_psnr"], "flicker": 1000 * notes["validation_flicker"],
            "parameters": sum(weight.numel() for weight in checkpoint["weights"].values()),
            "ms": whole, "ms_min": min(both), "ms_max": max(both), "network_ms": network, "filter_ms": filters,
            **{key: notes[key] for key in ("steps", "minutes", "clips", "batch")}, "config": checkpoint["config"]}


def main(argv: list[str] | None = None) -> int:
    args = arguments(argv)
    return {"train": train, "measure": measure}[args.command](args)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that a queue ends its processes
    sys.exit(main())
