"""The validation set: held-out scenes at 1x, 1.5x, 2x and 3x, and every method measured on them.

python -m training.measure.validation render --out CLIPS --clips 6 [--gpus 0,1]      needs Mitsuba
python -m training.measure.validation sheet CLIPS sheet.png                   a picture of the clips
python -m training.measure.validation compare CLIPS -o RESULTS [--models m]  needs the extra 'bench'
python -m training.measure.validation expand CLIPS FOLDER                 the clips as EXR sequences

A clip is eight frames of a scene with references, 1x at 1 sample a pixel, 2x at 4 (as many light
paths), 1.5x and 3x at 1 to 8, all planes, and guides at output size (see clips.py). `render` writes
CLIPS/clip.NNNNN.npz and continues an earlier run; `training.datagen.render` explains its options.
`compare` runs `postfx bench` on every render.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from training.datagen.render import add_farm, run, worker_command
from training.datagen.render_worker import add_share, clip_path, work
from training.measure.validation.clips import save


def arguments(argv: list[str] | None = None) -> tuple[argparse.Namespace, list[str]]:
    """The arguments, and the names of those that are passed to workers."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    render = commands.add_parser("render", help="render clips on all GPUs of a machine")
    add_farm(render)
    render.set_defaults(processes_per_gpu=2)
    handed = add_options(render)
    one = commands.add_parser("work", help="one process of 'render', which starts it")
    add_share(one)
    add_options(one)
    for name, target in (("sheet", "picture to write"), ("expand", "folder to write"),
                         ("compare", None)):
        command = commands.add_parser(name)
        command.add_argument("clips", type=Path, help="folder that 'render' filled")
        if target:
            command.add_argument("target", type=Path, help=target)
    compare = commands.choices["compare"]
    compare.add_argument("-o", "--results", type=Path, required=True)
    compare.add_argument("--methods", help="as 'postfx bench' takes them (default: all)")
    compare.add_argument("--models", help="tags of networks (default: all)")
    compare.add_argument("--renders", default="x1,x1.5,x2,x3", help="which renders of the clips")
    compare.add_argument("--runs", type=int, default=1)
    compare.add_argument("--device", default="auto")
    compare.add_argument("--keep", action="store_true", help="reuse the results of an earlier run")
    return parser.parse_args(argv), handed


def add_options(parser: argparse.ArgumentParser) -> list[str]:
    """Add the options for rendering clips; returns their names, to pass them on."""
    before = {action.dest for action in parser._actions}
    parser.add_argument("--variant", default="cuda_ad_rgb", help="Mitsuba variant")
    parser.add_argument("--width", type=_side, default=384, help="of the output, a multiple of 6")
    parser.add_argument("--height", type=_side, default=216)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--reference-error", type=float, default=0.004,
                        help="of references after x/(1+x)")
    parser.add_argument("--most-spp", type=int, default=8192,
                        help="views that need more for it are skipped")
    return [action.dest for action in parser._actions if action.dest not in before]


def _side(text: str) -> int:
    """A number of pixels that all scales divide."""
    if not text.isdigit() or int(text) % 6 or int(text) == 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a multiple of 6, which 1.5x, 2x and 3x "
                                         "need")
    return int(text)


def maker(args: argparse.Namespace) -> Callable[[int], tuple[str, int]]:
    """A function that renders and writes a clip, for `training.datagen.render_worker.work`."""
    from training.datagen.variant import use_variant

    use_variant(args.variant)
    # these import Mitsuba types, so only after the variant is set
    from training.datagen.tracing import Tracer
    from training.measure.validation.render import Options, light_paths, render_clip

    batch = 1 << (25 if args.variant.startswith("cuda") else 21)
    options = Options((args.width, args.height), args.frames, args.reference_error, args.most_spp,
                      batch)
    tracer = Tracer()

    def make(index: int) -> tuple[str, int]:
        reference, renders, facts = render_clip(
            tracer, index, options,
            lambda text: print(f"clip.{index:05d} {text}", file=sys.stderr, flush=True))
        save(clip_path(args.out, index), reference, renders, facts)
        return f"{facts['scene']} ({facts['trait']})", light_paths(facts, args.frames)

    return make


def clips(folder: Path) -> list[Path]:
    """Clips of a folder; ends the program if there are none."""
    found = sorted(folder.glob("clip.*.npz"))
    if not found:
        raise SystemExit(f"error: {folder} holds no clip: run 'render --out {folder} --clips 6' "
                         "first")
    return found


def main(argv: list[str] | None = None) -> int:
    args, handed = arguments(argv)
    if args.command == "render":
        return run(args, worker_command("training.measure.validation", args, handed, "work"))
    if args.command == "work":
        return work(args, maker(args))
    if args.command == "sheet":
        from training.measure.validation.clips import draw

        draw(clips(args.clips), args.target)
    if args.command == "expand":
        # needs OpenImageIO, which a renderer may lack
        from training.measure.validation.compare import expand

        for clip in clips(args.clips):
            print(expand(clip, args.target)[0])
    if args.command == "compare":
        from training.measure.validation.compare import compare, report

        report(args.results, compare(clips(args.clips), args))
    return 0


if __name__ == "__main__":
    sys.exit(main())
