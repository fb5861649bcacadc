"""Pairs of a user's own pictures: linear HDR and its grading, and the colour cube that fits them
best."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy import sparse
from scipy.sparse.linalg import cg

from training.tonemap.examples import SHAPES, SHIFT
from training.tonemap.model import HDRNet, default_shaper, look_up, lowres, shape, slice_grid
from training.tonemap.pictures import held_among, read, shrink

# The nearest cube ---------------------------------------------------------------------------------
# Fit a colour cube to pairs of shaped and wanted colours by least squares.
#
# Colours that no pair shows follow their neighbours: second differences of the change from a
# starting cube are kept small, so the change continues evenly where the data ends, and the starting
# cube's own shape stays.

# weights, where that of a cell's data is 1
SMOOTH = 1e-2
"""Of second differences."""
NEAR = 1e-7
"""Of the change of the cube itself."""

# Corners without data converge last: stopping early leaves them as they were.
TOLERANCE = 1e-7
ITERATIONS = 6000


def fit_cube(shaped: np.ndarray, wanted: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Cube (size,size,size,3) float32 in [0, 1], whose values half precision holds exactly.

    shaped: (n, 3) in [0, 1]; wanted: (n, 3) display colour; start: cube that the fit starts from.
    One linear system a channel, solved by conjugate gradients.
    """
    size = start.shape[0]
    matrix = interpolation(shaped, size) * np.sqrt(size**3 / len(shaped))
    missing = wanted * np.sqrt(size**3 / len(shaped)) - matrix @ start.reshape(-1, 3)
    rough = second_differences(size)
    normal = (matrix.T @ matrix + SMOOTH * (rough.T @ rough)
              + NEAR * sparse.identity(size**3)).tocsr()
    scale = sparse.diags(1.0 / normal.diagonal())
    change = [cg(normal, matrix.T @ missing[:, c], rtol=TOLERANCE, maxiter=ITERATIONS, M=scale)[0]
              for c in range(3)]
    cube = start + np.stack(change, -1).reshape(start.shape)
    return cube.clip(0.0, 1.0).astype(np.float16).astype(np.float32)


def interpolation(shaped: np.ndarray, size: int) -> sparse.csr_matrix:
    """Sparse (n, size**3) matrix of tetrahedral interpolation, four weights a row; see
    `postfx.kernels.colour`."""
    at = np.asarray(shaped, np.float64).clip(0.0, 1.0) * (size - 1)
    corner = np.minimum(at.astype(np.int64), size - 2)
    share, steps = at - corner, np.array([size * size, size, 1])
    order = np.argsort(-share, axis=1, kind="stable")
    share = np.take_along_axis(share, order, 1)
    columns = np.cumsum(np.column_stack([corner @ steps, steps[order]]), axis=1)
    weights = np.column_stack([1 - share[:, 0], share[:, 0] - share[:, 1],
                               share[:, 1] - share[:, 2], share[:, 2]])
    rows = np.repeat(np.arange(len(at)), 4)
    return sparse.csr_matrix((weights.ravel(), (rows, columns.ravel())), shape=(len(at), size**3))


def second_differences(size: int) -> sparse.csr_matrix:
    """Second differences of a flat cube along its three axes, stacked."""
    along = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size))
    same = sparse.identity(size)
    axes = ((along, same, same), (same, along, same), (same, same, along))
    return sparse.vstack([sparse.kron(sparse.kron(a, b), c) for a, b, c in axes]).tocsr()


# Pairs of pictures --------------------------------------------------------------------------------

EVERY = 5  # one in so many is held out
SAMPLES = 200_000  # colours that a cube is fitted to


@dataclass(frozen=True)
class Pairs:
    """Linear Rec.709 and sRGB-encoded pictures (H,W,3) float32 by name: for training, and held
    out."""

    train: dict[str, tuple[np.ndarray, np.ndarray]]
    held: dict[str, tuple[np.ndarray, np.ndarray]]


def read_pairs(hdr: Path, sdr: Path, space: str | None, side: int,
               hold_out: list[str] | None) -> Pairs:
    """All files of the same stem in two folders, shrunk to `side`; every fifth is held out if none
    is named."""
    for folder in (hdr, sdr):
        if not folder.is_dir():
            raise SystemExit(f"{folder}: no such folder")
    graded = {path.stem: path for path in sorted(sdr.iterdir()) if path.is_file()}
    names = [path for path in sorted(hdr.iterdir()) if path.stem in graded]
    if len(names) < 2:
        raise SystemExit(f"{hdr}, {sdr}: {len(names)} files of the same name in both: at least 2 "
                         "are needed")
    stems = [path.stem for path in names]
    held = (set(stems[EVERY - 1 :: EVERY] or stems[-1:]) if hold_out is None
            else held_among(stems, hold_out))
    pairs = {path.stem: _pair(path, graded[path.stem], space, side) for path in names}
    return Pairs({k: v for k, v in pairs.items() if k not in held},
                 {k: v for k, v in pairs.items() if k in held})


def _pair(hdr: Path, sdr: Path, space: str | None, side: int) -> tuple[np.ndarray, np.ndarray]:
    light, display = read(str(hdr), space), read(str(sdr), "rec709")
    if light.shape != display.shape:
        sizes = [f"{x.shape[1]}x{x.shape[0]}" for x in (light, display)]
        raise SystemExit(f"{hdr} is {sizes[0]}, but {sdr} is {sizes[1]}: both must show the same "
                         "pixels")
    if display.max() > 1.0:
        raise SystemExit(f"{sdr}: values up to {display.max():.3g}: display pictures are "
                         "sRGB-encoded, 0 to 1")
    return shrink(light, side), shrink(display, side)


def fit(net: HDRNet | None, pairs: Pairs, start: torch.Tensor) -> tuple[torch.Tensor, float]:
    """The cube that fits the pairs best after a network's grid (None: for colour alone), and its
    PSNR in dB."""
    shaped = [before_cube(net, hdr) for hdr, _ in pairs.train.values()]
    flat = [x[0].permute(1, 2, 0).reshape(-1, 3).numpy() for x in shaped]
    wanted = [sdr.reshape(-1, 3) for _, sdr in pairs.train.values()]
    colours, targets = np.concatenate(flat), np.concatenate(wanted)
    pick = np.random.default_rng(0).permutation(len(colours))[:SAMPLES]
    cube = torch.from_numpy(fit_cube(colours[pick], targets[pick], start.numpy()))
    errors = [np.square(look_up(x, cube)[0].permute(1, 2, 0).reshape(-1, 3).numpy() - y).mean()
              for x, y in zip(shaped, wanted, strict=True)]
    return cube, float(-10 * np.log10(np.mean(errors) + 1e-12))


@torch.no_grad()
def before_cube(net: HDRNet | None, hdr: np.ndarray) -> torch.Tensor:
    """Shaped colour (1,3,H,W) before the cube, in [0, 1]."""
    colour, shaper = torch.from_numpy(hdr).permute(2, 0, 1)[None], default_shaper()
    shaped = shape(colour, *shaper)
    if net is None:
        return shaped
    grid, guide, _ = net(lowres(colour, shaper))
    return slice_grid(shaped, guide, grid).clamp(0, 1)


class PairViews:
    """Endless batches of windows of pairs; graded pictures cannot be lit or exposed again."""

    def __init__(self, pairs: Pairs, device: torch.device, seed: int = 1) -> None:
        self.random = np.random.default_rng(seed)
        both = (torch.from_numpy(np.concatenate(pair, -1)).permute(2, 0, 1)
                for pair in pairs.train.values())
        self.pictures = [pair.contiguous().to(device) for pair in both]

    def batch(self, size: int, scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, None]:
        """Linear colour (size,3,H+8,W+8) of one random shape, and its grading."""
        h, w = SHAPES[self.random.integers(len(SHAPES))]
        shape_in_pixels = (int(h * scale) + SHIFT, int(w * scale) + SHIFT)
        views = torch.stack([self._window(shape_in_pixels) for _ in range(size)])
        return views[:, :3], views[:, 3:], None

    def _window(self, size: tuple[int, int]) -> torch.Tensor:
        picture = self.pictures[int(self.random.integers(len(self.pictures)))]
        h, w = picture.shape[-2:]
        share = min(h / size[0], w / size[1]) * self.random.uniform(0.5, 1.0)
        high, wide = max(8, int(size[0] * share)), max(8, int(size[1] * share))
        y, x = int(self.random.integers(h - high + 1)), int(self.random.integers(w - wide + 1))
        window = picture[None, :, y : y + high, x : x + wide]
        view = F.interpolate(window, size=size, mode="bilinear", align_corners=False,
                             antialias=True)[0]
        return view.flip(-1) if self.random.random() < 0.5 else view
