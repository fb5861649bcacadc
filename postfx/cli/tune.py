"""`postfx tune`: a network for one shot. The work is done by `training.denoise.tune`, which needs
PyTorch."""

from __future__ import annotations

import argparse
import subprocess
import sys

from postfx.cli.options import Option, Options, Section, parse_number, parse_positive
from postfx.cli.run_options import FILES, INPUT, RUN

DESCRIPTION = """\
Adapt a network to a shot: xl, the default of 'postfx run', or a smaller one. It learns from clean
renders of a few frames (--references), or, without any, from a second render of the same frames
with another seed (--halves): each is the target of the other. A quarter of the targets is held back
to measure the gain. Where nothing is gained there, nothing is written, and the exit code is 1.

The result is FILE.onnx and its card, which 'postfx run --model FILE.onnx' takes at the render's
size. Needs a checkout of postfx and its extra 'train', which brings PyTorch. Runs on a GPU where
PyTorch finds one: there 5 minutes are enough. On a CPU ten minutes gain less.
"""
EXAMPLES = """\
examples:
  postfx tune 'shot/####.exr' --references 'ref/####.exr' -o nets/shot.onnx
  postfx tune 'seed1/####.exr' --halves 'seed2/####.exr' -o nets/shot.onnx --minutes 10
  postfx run 'shot/####.exr' -o 'clean/####.exr' --model nets/shot.onnx

exit codes: 0 written; 1 no gain on what was held back, nothing written; 2 an error whose message
says how to fix it
"""

TUNE = Options(Section("", (
    INPUT,
    Option(flag="--references", metavar="FRAMES", is_file=True, either="target",
           help="clean renders of some frames of INPUT, numbered alike"),
    Option(flag="--halves", metavar="FRAMES", is_file=True, either="target",
           help="INPUT rendered again with another seed and as many samples"),
    Option(flag="--output", short="-o", metavar="FILE.onnx",
           help="network to write, with its card beside it"),
    Option(flag="--model", choices=("xl", "m", "s"), default="xl",
           help="network to begin with (default: xl)"),
    Option(flag="--minutes", metavar="M", type=parse_number, default=10.0,
           help="minutes of training (default: 10)"),
    Option(flag="--steps", metavar="N", type=parse_positive,
           help="steps of training, instead of --minutes"),
    Option(flag="--seed", metavar="N", type=int, default=0,
           help="seed of all random choices (default: 0)"),
    Option(flag="--frames", metavar="RANGE", help="frames of the shot, e.g. 1-100"),
    Option(flag="--overwrite", help="replace a network that is there"),
    Option(flag="--device", choices=("auto", "cpu", "cuda"), default="auto",
           help="where to train (default: auto, a GPU where PyTorch finds one)"),
    RUN["--profile"],
    *FILES,
    Option(flag="--json", help="print one JSON object"),
)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    TUNE.add_to(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Check the arguments, then train in a process of its own; returns the exit code."""
    from importlib.util import find_spec
    from pathlib import Path

    from postfx.errors import OptionError, OutputExistsError, WriteError

    TUNE.refuse_conflicts(arguments)
    if not (arguments.references or arguments.halves):
        raise OptionError("nothing to learn from: give --references with clean frames, or --halves "
                          "with a second render")
    if not arguments.output:
        raise WriteError("nowhere to write: give -o FILE.onnx")
    if not arguments.output.endswith(".onnx"):
        raise WriteError(f"{arguments.output}: is no network's name: name it FILE.onnx")
    if Path(arguments.output).exists() and not arguments.overwrite:
        raise OutputExistsError(f"{arguments.output}: is already there: give --overwrite")
    if find_spec("torch") is None or find_spec("training") is None:
        raise OptionError("tune needs PyTorch and the folder 'training': in a checkout of postfx, "
                          "pip install -e '.[train]', and run it there")
    return subprocess.run([sys.executable, "-m", "training.denoise.tune", *arguments.words[1:]],
                          check=False).returncode
