"""Kernels around the network: they pack its input and unpack its output, by precision.

Half precision: the network reads and writes all channels of a pixel together (NHWC). ``packed``
holds the planes of ``features`` or ``guides``, padded with zeros to a multiple of 8 channels for
tensor cores. ``raw`` is the output of the network's last convolutions; the copy to the layout of
the other kernels applies their activations. A raw fine head has the four phases of 2x2 pixels one
after the other, top left first. A CPU gains nothing from half precision.

Float32: activations of the fine head, and its four phases moved to their places. ``phased_fine``
(1, 4 * 80, hp / 2, wp / 2) is the output of the last convolution: for each channel the four phases
of 2x2 pixels, top left first. One pass takes less time than activations and a shuffle inside the
network, each of which reads and writes 160 MB at 960x540.

``log_error`` (1, 1, hp, wp) is the logarithm of each pixel's expected squared error.

Integers, output: the last products are summed in 32 bits and scaled here. ``products`` are sums of
8-bit products; ``scaling`` (2, C) holds a factor and an offset for each channel, which give its
logit. Scaling and activations are one pass. Each channel of the fine head has four phases, as
above.

Codes: the last products are computed here, too, row by row, so that most of them never leave the
cache. ``codes`` (1, h, w, C) are what the last convolution reads in 8 bits, ``factors`` (n, C) its
weights in 7; those of levels end with rows of zeros up to a multiple of four. The sums are the
integers above.

Integers, input: planes in 8 bits, all channels of a pixel together. ``coding`` (2, C) holds each
channel's factor and its code of zero; codes are clipped to 0..255. ``stored`` (1, h, w, C) may have
more channels than ``planes``, without meaning. With a ring, it has one more row and column on every
side, where all channels are zero.
"""

from __future__ import annotations

from postfx.compiled.library import Rows
from postfx.kernels import Kernel
from postfx.kernels.denoise import FINE, KERNEL, in_half, kernel

LANES = 8
LEVEL = KERNEL + 1
FINE_PHASES = 4


def width(channels: int) -> int:
    """Channels of a packed or raw tensor for so many channels."""
    return -(-channels // LANES) * LANES


def opened_shape(name: str, rows: int, columns: int) -> tuple[int, ...]:
    """Shape of a head ('fine', 'level1', ...) whose raw form has this many rows and columns."""
    return (1, FINE, 2 * rows, 2 * columns) if name == "fine" else (1, LEVEL, rows, columns)


HALF = "float16"
LEVEL_WIDTH = width(LEVEL)
PACK = Kernel("denoise_pack", ("planes",), ("packed",), Rows("denoise_pack"), ("packed", 1),
              {"planes": (1, "channels", "hp", "wp"), "packed": (1, "hp", "wp", "wide")},
              {"packed": HALF})
OPEN = Kernel("denoise_open", ("raw",), ("heads",), Rows("denoise_open"), ("heads", 2),
              {"raw": (1, "hp", "wp", LEVEL_WIDTH), "heads": (1, LEVEL, "hp", "wp")}, {"raw": HALF})
OPEN_FINE = Kernel("denoise_open_fine", ("raw_fine",), ("fine",), Rows("denoise_open_fine"),
                   ("fine", 2), {"raw_fine": (1, "half_hp", "half_wp", FINE_PHASES * FINE),
                                 "fine": (1, FINE, "2*half_hp", "2*half_wp")},
                   {"raw_fine": HALF})
in_half(OPEN, "heads")
in_half(OPEN_FINE, "fine")


OPEN_PHASED = kernel("open_phased", ("phased_fine",), ("fine",), None, ("fine", 2),
                     phased_fine=(1, 4 * FINE, "half_hp", "half_wp"),
                     fine=(1, FINE, "2*half_hp", "2*half_wp"))


LEAST_LOG_ERROR = -14.0
"""Logarithm of the least squared error that networks predict."""
MOST_LOG_ERROR = 0.0
"""Logarithm of the largest one."""

OPEN_ERROR = kernel("open_error", ("log_error", "part_rows", "part_columns"), ("error",), None,
                    ("error", 0), log_error=(1, 1, "hp", "wp"), error=("th", "tw", 1))


OPEN_PRODUCTS = Kernel(
    "denoise_open_products", ("products", "scaling"), ("heads",), Rows("denoise_open_products"),
    ("heads", 2), {"products": (1, "heads", "hp", "wp"), "scaling": (2, "heads"),
                   "heads": (1, "heads", "hp", "wp")},
    {"products": "int32"})
OPEN_FINE_PRODUCTS = Kernel(
    "denoise_open_fine_products", ("products", "scaling"), ("fine",),
    Rows("denoise_open_fine_products"), ("fine", 2),
    {"products": (1, 4 * FINE, "half_hp", "half_wp"), "scaling": (2, 4 * FINE),
     "fine": (1, FINE, "2*half_hp", "2*half_wp")},
    {"products": "int32"})


# The fine head's integer products and what is made of them are most of a frame's memory. So
# compiled rows put the latter where the former were: as phases lie apart, `SOME` channels before,
# where all products are opened by then.
SOME = 8
OPEN_SOME_PRODUCTS = Kernel(
    "denoise_open_some_products", ("products", "scaling", "first"), ("fine",),
    Rows("denoise_open_some_products"), ("fine", 2),
    {"products": (1, "4*channels", "half_hp", "half_wp"), "scaling": (2, 4 * FINE), "first": (1,),
     "fine": (1, "channels", "2*half_hp", "2*half_wp")},
    {"products": "int32"})


FOURS = 4
"""Rows of factors that are multiplied at once."""
OPEN_CODES = kernel("open_codes", ("codes", "factors", "scaling"), ("heads",), None, ("heads", 2),
                    codes=(1, "hp", "wp", "codes"), heads=(1, "outputs", "hp", "wp"))
OPEN_FINE_CODES = kernel("open_fine_codes", ("codes", "factors", "scaling"), ("fine",), None,
                         ("fine", 2), fine=(1, "channels", "half_hp", 2, "2*half_wp"))


def _kernel(name: str, rows: str, columns: str) -> Kernel:
    return Kernel(name, ("planes", "coding"), ("stored",), Rows(name), ("stored", 1),
                  {"planes": (1, "channels", "hp", "wp"), "coding": (2, "wide"),
                   "stored": (1, rows, columns, "wide")},
                  {"stored": "uint8"})


STORE = _kernel("denoise_store", "hp", "wp")
STORE_RINGED = _kernel("denoise_store_ringed", "ringed_hp", "ringed_wp")
