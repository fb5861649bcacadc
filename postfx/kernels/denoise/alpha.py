"""Kernels of alpha: means of its samples over the frames, and filtered alpha that is brought nearer
to them.

The picture's filters blur hairs that are thinner than a pixel, where alpha itself has no noise but
that of which samples hit. So beside filtered alpha there is a mean of the frames' own alpha, by
quarter-pixels: where things move by parts of a pixel, frames add up to more than one frame shows
(Irani and Peleg 1991, "Improving resolution by image registration"). It is a Kalman filter:
``samples`` (2h, 2w, 1) are moved to where things are now, a frame's alpha says what their means
over pixels lack, and ``doubt`` (h, w, 1) is the variance of these in units of alpha (1 - alpha).
Filtered alpha has a variance, too, that of its blur. Both are mixed as their variances say, as far
as filtered alpha has structure: on soft edges, what differs is noise. At last alpha comes nearer to
what the picture's colours say of it: the mean of samples fitted by colours in 3x3 pixels, applied
to the output's colours (He, Sun and Tang 2010, "Guided image filtering"), so that alpha has the
edges that colours have.

Where alpha is 0 or 1 all around, nothing of this is needed: ``near`` (cells, cells) is 2 in cells
of render pixels that are worked on, 1 in those around them, which these read, and 0 elsewhere.
"""

import numpy as np

from postfx.kernels.denoise import NEAR_CELL, kernel
from postfx.kernels.statistics import bounds_of_cells
from postfx.sampling import three_by_three

ALIKE = np.float32(3e-5)
"""Variance that colours are taken to have in any direction, as a share of their mean square."""
DARK = np.float32(1e-20)
"""Variance that they are taken to have beside that share."""
LARGE = np.float32(1e30)
"""Sum of the factors of colours from which on they say nothing."""
LEAST_MOTION = np.float32(1 / 64)
"""Render pixels that count as motion."""
FAINTEST = np.float32(1e-6)
"""The smallest variance that is structure."""
PLANE = np.float32(2 / 3)
"""Variance in 3x3 pixels of a plane that rises by 1 a pixel."""
SLOPED = np.float32(1 / 8)
"""How much of that variance counts as structure."""

# How far 3x3 pixels may differ from what was there before.
LIMIT_OFF = np.float32(3**2)
"""Square of it in standard deviations."""
LEAST_OFF = np.float32(0.02**2)
"""Square of it in alpha, which is always allowed."""

# Weights of three pixels by a Gaussian of one pixel.
SIDE = np.float32(0.27406862)
MIDDLE = np.float32(0.45186276)
QUARTERS = ("2*h", "2*w", 1)
NEAR = ("near_h", "near_w")
GATHER = kernel("gather", ("alpha", "moved", "samples", "doubt", "near", "rates"),
                ("next_samples", "next_doubt"),
                None, ("next_doubt", 0), alpha=("h", "w", 1), moved=("h", "w", 2), samples=QUARTERS,
                doubt=("h", "w", 1), near=NEAR, rates=(4,), next_samples=QUARTERS,
                next_doubt=("h", "w", 1))
FIT = kernel("fit", ("picture", "next_samples", "near"), ("fit",), None, ("fit", 1),
             picture=("height", "width", 3), next_samples=QUARTERS, near=NEAR, fit=(4, "h", "w"))
CORRECT = kernel("correct", ("enlarged", "picture", "fit", "next_samples", "next_doubt", "moved",
                             "near", "gain"),
                 ("corrected",), None, ("corrected", 0), enlarged=("height", "width", 1),
                 picture=("height", "width", 3), fit=(4, "h", "w"), next_samples=QUARTERS,
                 next_doubt=("h", "w", 1),
                 moved=("h", "w", 2), near=NEAR, gain=(4,), corrected=("height", "width", 1))


def near_cells(alpha: np.ndarray) -> np.ndarray:
    """Cells of alpha (h, w): 2 where 3x3 of them are not all alike, 1 beside those, else 0."""
    low, high = bounds_of_cells(alpha, NEAR_CELL)
    differ = three_by_three(low, 1, np.minimum) != three_by_three(high, 1, np.maximum)
    found: np.ndarray = differ + three_by_three(differ, 1, np.maximum).astype(np.float32)
    return found


def near_rows(y0: int, y1: int, alpha: np.ndarray, near: np.ndarray) -> None:
    """What the kernel below computes. No device runs it: elsewhere the host looks at alpha, which
    is its own."""
    near[y0:y1] = near_cells(alpha[..., 0])[y0:y1]


NEAR_ALPHA = kernel("near", ("alpha",), ("near",), near_rows, ("near", 0), alpha=("h", "w", 1),
                    near=("alpha_h", "alpha_w"))
"""Cells where alpha is worked on, on a GPU."""
