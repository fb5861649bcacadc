"""Kernels around a network in half precision, which reads and writes all channels of a pixel together (NHWC).

``packed`` holds the planes of ``features`` or ``guides`` and zeros up to a multiple of 8 channels, as tensor cores want
them. ``raw`` is what the network's last convolutions write: their activations belong to the copy that brings them into
the layout of the other kernels. A raw fine head has the four phases of 2x2 pixels one after the other, top left first.
The rows are NumPy: GPUs have sources of their own, and a CPU gains nothing by half precision.
"""

import numpy as np

from postfx.kernels.denoise_layout import BLEND, FINE, KERNEL, MEMORY
from postfx.kernels.kernel import Kernel

LANES = 8
LEVEL = KERNEL + 1
STEEPEST = np.float32(8)
PHASES = 4


def width(channels: int) -> int:
    """Channels that a packed or raw tensor has for these."""
    return -(-channels // LANES) * LANES


def opened(name: str, rows: int, columns: int) -> tuple[int, ...]:
    """Shape of a head, 'fine' or 'level1' and so on, of which the raw one has so many rows and columns."""
    return (1, FINE, 2 * rows, 2 * columns) if name == "fine" else (1, LEVEL, rows, columns)


def pack_rows(y0: int, y1: int, planes: np.ndarray, packed: np.ndarray) -> None:
    """Channels last, in half precision."""
    channels = planes.shape[1]
    packed[0, y0:y1, :, :channels] = planes[0, :, y0:y1].transpose(1, 2, 0)
    packed[0, y0:y1, :, channels:] = 0


def open_rows(y0: int, y1: int, raw: np.ndarray, heads: np.ndarray) -> None:
    """Weights of a level's filters and its mix, which means nothing at the coarsest level."""
    logits = raw[0, y0:y1, :, :LEVEL].astype(np.float32).transpose(2, 0, 1)
    heads[0, :KERNEL, y0:y1] = _weights(logits[:KERNEL])
    heads[0, KERNEL:, y0:y1] = _gates(logits[KERNEL:])


def open_fine_rows(y0: int, y1: int, raw_fine: np.ndarray, fine: np.ndarray) -> None:
    """The fine head: weights, gates and the hidden state."""
    for y in range(y0, y1):
        for side in range(2):
            first = FINE * (2 * (y % 2) + side)
            logits = raw_fine[0, y // 2, :, first:first + FINE].astype(np.float32).T
            row = fine[0, :, y, side::2]
            row[:BLEND] = _weights(logits[:BLEND])
            row[BLEND:MEMORY] = _gates(logits[BLEND:MEMORY])
            row[MEMORY:] = np.tanh(logits[MEMORY:])


def _weights(logits: np.ndarray) -> np.ndarray:
    return np.exp(np.clip(logits, -STEEPEST, STEEPEST))


def _gates(logits: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(logits, -80, 80)))


HALF = "float16"
LEVEL_WIDTH = width(LEVEL)
PACK = Kernel("denoise_pack", ("planes",), ("packed",), pack_rows, ("packed", 1),
              {"planes": (1, "channels", "hp", "wp"), "packed": (1, "hp", "wp", "wide")}, {"packed": HALF})
OPEN = Kernel("denoise_open", ("raw",), ("heads",), open_rows, ("heads", 2),
              {"raw": (1, "hp", "wp", LEVEL_WIDTH), "heads": (1, LEVEL, "hp", "wp")}, {"raw": HALF})
OPEN_FINE = Kernel("denoise_open_fine", ("raw_fine",), ("fine",), open_fine_rows, ("fine", 2),
                   {"raw_fine": (1, "half_hp", "half_wp", PHASES * FINE), "fine": (1, FINE, "2*half_hp", "2*half_wp")},
                   {"raw_fine": HALF})
