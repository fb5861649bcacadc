"""Teach the tone mapper a look: from nothing to an exported, verified model with a card.

    python -m training.tonemap.train mine --pairs HDR_DIR SDR_DIR
    python -m training.tonemap.train film --ocio config.ocio --display "sRGB - Display" --view Film [--look Warm]
    python -m training.tonemap.train print --lut print.cube,input=ACEScct
    python -m training.tonemap.train local --target local --pictures 'hdr/*.exr' --panoramas 'env/*.hdr'

The first word is the tag: `postfx run shot.####.exr -o out.####.png --tonemap OUT/tonemap.TAG.onnx` uses the result.
Pairs are files of the same name, linear HDR and sRGB-encoded SDR, exposed as they are. A look that depends on colour
alone becomes a cube. Of one that only exposes before its view (key) the exposure is learnt, in minutes, from nothing;
others are learnt by fine-tuning the network of --start. Held-out pictures are never trained on.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from postfx.colour.primaries import LINEAR_SPACES
from training.tonemap.looks import Look, find_look
from training.tonemap.loop import Recipe, Report
from training.tonemap.pictures import collect, lesson, load
from training.tonemap.teach import Checkpoint, teach_look
from training.tonemap.views import Lut, Ocio

GPU_MINUTES, CPU_MINUTES = 8.0, 45.0
RATE, FINE_RATE = 1.5e-3, 2e-4  # the second where a CPU has few steps for a network that is near already
SIDE = 768  # longest side of a picture


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tag", help="name of the look")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--pairs", nargs=2, type=Path, metavar=("HDR_DIR", "SDR_DIR"), help="your own graded pictures")
    source.add_argument("--ocio", metavar="CONFIG", help="OpenColorIO config: a file, or the name of a built-in one")
    source.add_argument("--lut", metavar="FILE", help="look-up table, as --tonemap takes it: FILE,input=SPACE")
    source.add_argument("--target", metavar="LOOK", help="a built-in look, or a .toml file that describes one")
    source.add_argument("--set", metavar="NPZ", help="packed by training.tonemap.make_set; its look of this tag")
    parser.add_argument("--display", help="of --ocio")
    parser.add_argument("--view", help="of --ocio")
    parser.add_argument("--look", default="", help="of --ocio, instead of the view's own looks")
    parser.add_argument("--source", default="", help="the config's name of linear Rec.709")
    parser.add_argument("--pictures", nargs="*", default=[], help="HDR photographs (patterns) to learn on")
    parser.add_argument("--panoramas", nargs="*", default=[], help="equirectangular HDR environments (patterns)")
    parser.add_argument("--space", choices=LINEAR_SPACES, help="primaries of all HDR files, linear; default: by header")
    parser.add_argument("--hold-out", nargs="*", help="stems of pictures to measure with; default: every fifth")
    parser.add_argument("--start", default="local", help="tag or file of the model to fine-tune, or 'none'")
    parser.add_argument("--only", nargs="+", default=[], metavar="PART", help="what changes of the network, as head")
    parser.add_argument("--minutes", type=float, help=f"default: {GPU_MINUTES:g} on a GPU, {CPU_MINUTES:g} on a CPU")
    parser.add_argument("--batch", type=int)
    parser.add_argument("--rate", type=float, help=f"default: {RATE:g}, or {FINE_RATE:g} to fine-tune on a CPU")
    parser.add_argument("--scale", type=float, help="of the training pictures; default 1 on a GPU, 0.5 on a CPU")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", type=float, default=30.0, help="seconds between measurements")
    parser.add_argument("-o", "--out", type=Path, help="folder for all results; default: runs/TAG")
    parser.add_argument("--no-export", action="store_true", help="leave a checkpoint for training.tonemap.export")
    args = parser.parse_args()
    if args.ocio and not (args.display and args.view):
        parser.error("--ocio needs --display and --view")
    args.out = args.out or Path("runs") / args.tag
    return args


def recipe_of(args: argparse.Namespace, on_gpu: bool) -> Recipe:
    """What was asked for, or what suits the machine."""
    return Recipe(
        seconds=60 * (args.minutes or (GPU_MINUTES if on_gpu else CPU_MINUTES)),
        batch=args.batch or (16 if on_gpu else 4),
        rate=args.rate or (RATE if on_gpu or args.start == "none" else FINE_RATE),
        scale=args.scale or (1.0 if on_gpu else 0.5),
        seed=args.seed,
        every=args.every,
        only=tuple(args.only),
    )


def look_of(args: argparse.Namespace) -> Look:
    """The look that the options describe."""
    if args.ocio:
        return Look(Ocio(args.ocio, args.display, args.view, args.source, args.look))
    return Look(Lut(args.lut)) if args.lut else find_look(args.target)


def teach(args: argparse.Namespace, device: torch.device, log: Path) -> Checkpoint:
    recipe = recipe_of(args, device.type == "cuda")
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    with Progress(*columns) as progress, open(log, "w", encoding="utf-8") as lines:
        bar = progress.add_task(f"{args.tag} on {device}", total=recipe.seconds)

        def watch(report: Report) -> None:
            lines.write(json.dumps(asdict(report)) + "\n")
            lines.flush()
            mean = sum(report.psnr.values()) / max(1, len(report.psnr))
            text = f"{args.tag} on {device}: step {report.step}, loss {report.picture:.4f}, held out {mean:.2f} dB"
            progress.update(bar, completed=report.seconds, description=text)

        if args.pairs:
            from training.tonemap.pairs import read_pairs, teach_pairs  # needs SciPy

            pairs = read_pairs(*args.pairs, args.space, SIDE, args.hold_out)
            return teach_pairs(pairs, args.start, recipe, device, watch)
        if args.set:
            pictures, task = load(args.set, args.tag)
        else:
            pictures = collect(args.pictures, args.panoramas, hold_out=args.hold_out, side=SIDE, space=args.space)
            task = lesson(look_of(args), pictures)
        return teach_look(task, pictures, args.start, recipe, device, watch)


def main() -> None:
    args = parse()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(args.seed)
    torch.backends.cudnn.allow_tf32 = True  # convolutions only: the interpolation weights need all their bits
    args.out.mkdir(parents=True, exist_ok=True)
    checkpoint = teach(args, device, args.out / "log.jsonl")
    torch.save(checkpoint, args.out / "checkpoint.pt")
    for name, score in checkpoint["psnr"].items():
        print(f"{name}: {score:.2f} dB")
    if not args.no_export:
        from training.tonemap.export import export_look  # needs packages that a training machine may lack

        print(f"verified and written: {export_look(checkpoint, args.tag, args.out, {})}")


if __name__ == "__main__":
    main()
