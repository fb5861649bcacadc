"""Renders clips of the validation set in one process: see `training.measure.validation render`, which starts it.

python -m training.measure.validation.worker --out DIR --clips N [--start K --stride M]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from training.datagen.render_worker import add_share, clip_path, work
from training.measure.validation.clips import save


def add_options(parser: argparse.ArgumentParser) -> list[str]:
    """How clips are rendered; the names of the options, for those who hand them on."""
    before = {action.dest for action in parser._actions}
    parser.add_argument("--variant", default="cuda_ad_rgb", help="Mitsuba variant")
    parser.add_argument("--width", type=_side, default=384, help="of the output, a multiple of 6")
    parser.add_argument("--height", type=_side, default=216)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--reference-error", type=float, default=0.004, help="of references after x/(1+x)")
    parser.add_argument("--most-spp", type=int, default=8192, help="views that need more for it are passed over")
    return [action.dest for action in parser._actions if action.dest not in before]


def _side(text: str) -> int:
    """A number of pixels that all scales divide."""
    if not text.isdigit() or int(text) % 6 or int(text) == 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a multiple of 6, which 1.5x, 2x and 3x need")
    return int(text)


def maker(args: argparse.Namespace) -> Callable[[int], tuple[str, int]]:
    """A function that renders and writes a clip, as `training.datagen.render_worker.work` takes it."""
    import mitsuba as mi

    mi.set_variant(args.variant)
    from training.datagen.tracing import Tracer  # these import Mitsuba types, so only after the variant is set
    from training.measure.validation.render import Options, light_paths, render_clip

    batch = 1 << (25 if args.variant.startswith("cuda") else 21)
    options = Options((args.width, args.height), args.frames, args.reference_error, args.most_spp, batch)
    tracer = Tracer()

    def make(index: int) -> tuple[str, int]:
        reference, renders, facts = render_clip(
            tracer, index, options, lambda text: print(f"clip.{index:05d} {text}", file=sys.stderr, flush=True))
        save(clip_path(args.out, index), reference, renders, facts)
        return f"{facts['scene']} ({facts['trait']})", light_paths(facts, args.frames)

    return make


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_share(parser)
    add_options(parser)
    args = parser.parse_args(argv)
    return work(args, maker(args))


if __name__ == "__main__":
    sys.exit(main())
