"""Draw the curves of one or more training runs of the denoised upscaler.

    python -m training.measure.plot_curves RUN [RUN ...] -o curves.png

A run is a folder of training/denoise/train.py; PSNR (dB) and flicker of training windows and of the held-out
scenes against steps, with the learning rate.
"""
import argparse
import csv
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

# Columns of the tables: training rows are step, seconds, rate, loss, psnr, flicker, norm; validation rows have no rate.
PANELS = (("PSNR (dB)", 4, 2), ("flicker", 5, 3), ("learning rate", 2, None))


def rows(path: Path) -> list[list[float]]:
    """The numbers of a table; none where it is not there yet."""
    if not path.exists():
        return []
    with path.open() as file:
        return [[float(x) for x in row] for row in csv.reader(file)]


def draw(runs: list[Path], target: Path) -> None:
    """Write the picture; one colour a run, training thin and validation thick."""
    figure, axes = plt.subplots(1, len(PANELS), figsize=(14, 4), constrained_layout=True)
    for i, run in enumerate(runs):
        training, validation = rows(run / "log.csv"), rows(run / "validation.csv")
        for axis, (title, column, checked) in zip(axes, PANELS, strict=True):
            axis.set(title=title, xlabel="step")
            axis.grid(alpha=0.3)
            axis.plot([r[0] for r in training], [r[column] for r in training], color=f"C{i}", alpha=0.4, linewidth=0.8)
            if checked:
                axis.plot([r[0] for r in validation], [r[checked] for r in validation], color=f"C{i}", marker=".",
                          label=run.name)
    axes[0].legend(title="held-out scenes")
    figure.savefig(target, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, default=Path("curves.png"))
    args = parser.parse_args()
    draw(args.runs, args.output)
    print(args.output)


if __name__ == "__main__":
    main()
