"""Train one variant: python -m training.sweep.one --variant NAME, and the options of training.train_denoise.

The clock starts when all that a step needs is compiled, so that no variant pays for what others find ready.
"""

from __future__ import annotations

import random
import time

import torch

from training.sweep.trunk import build
from training.sweep.variants import VARIANTS
from training.train_denoise import Trainer, options, set_up

WARM_STEPS = 50  # enough to draw every size of clip


def warm_up(trainer: Trainer) -> None:
    """Compile and capture the steps of all sizes of clip; the weights stay as they are."""
    args = trainer.args
    for seed in range(WARM_STEPS if trainer.device.type == "cuda" else 1):
        trainer.gradient(trainer.augment(trainer.pool.draw(args.batch, args.crop, seed)))
    if trainer.device.type == "cuda":
        torch.cuda.synchronize()


def main() -> None:
    parser = options()
    parser.add_argument("--variant", required=True, choices=VARIANTS)
    args = parser.parse_args()
    device = set_up(args)
    trainer = Trainer(args, 0, 1, device, build(VARIANTS[args.variant]))
    if not trainer.pool.validation:
        raise SystemExit(f"error: {args.clips} has no clip to validate on: one whose number is a multiple of "
                         f"{trainer.pool.held_out}")
    warm_up(trainer)
    torch.manual_seed(args.seed)
    random.seed(args.seed)
    trainer.start = trainer.kept = time.monotonic()
    trainer.run()


if __name__ == "__main__":
    main()
