"""`postfx models`: the trained models that are installed."""

from __future__ import annotations

import argparse
import json
from typing import Any

DESCRIPTION = """\
List the installed models with the summaries of their cards. --model TAG chooses the fastest variant
for the device: PASS.TAG.int8 (integers) on a CPU, PASS.TAG.fp16 (half precision) on a GPU, else
PASS.TAG. --model TAG.fp32 chooses PASS.TAG. Variants .guides run when there are guides, and
variants .1x when the output has the render's size."""
EXAMPLES = """\
examples:
  postfx models
  postfx models --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("--json", action="store_true",
                        help="print one JSON object: model name -> card")


def execute(arguments: argparse.Namespace) -> int:
    """List the models; returns the exit code."""
    from postfx.runtime import Library  # loads ONNX Runtime, which --help must not wait for
    from postfx.system import models_dir

    library = Library(models_dir())
    cards = {name: library.card(name) for name in library.names()}
    lines = [_line(name, card, library.path(name).stat().st_size) for name, card in cards.items()]
    print(json.dumps(cards) if arguments.json else "\n".join(lines))
    return 0


def _line(name: str, card: dict[str, Any], size: int) -> str:
    parameters = (f"{card['parameters'] / 1e6:.2f} M parameters" if "parameters" in card
                  else "no card")
    precision = card.get("precision", "fp32") if card else ""
    return (f"{name:<31}{precision:<6}{size / 1e6:5.2f} MB  "
            f"{parameters:<19}{card.get('summary', '')}".rstrip())
