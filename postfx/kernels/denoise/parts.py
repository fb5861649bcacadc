"""Kernels that apply the picture's filters to its parts, such as light groups, and keep their sum
that of the picture.

A part is accumulated with the picture's weights, filtered and enlarged with the picture's kernels,
all of it linear in light and without exposure, so what adds up in the input adds up in the output.
``coding`` (3,) is what is taken off a part's values before they are filtered, what the rest is
multiplied by, 0 and 1 for light, and their limit. ``last_part`` (h, w, 3) and ``next_part`` (th,
tw, 3) are the accumulated values without reflectance; ``past`` tells where they are not used.
Several parts are filtered and enlarged at once, so that the weights are read from memory once for
them.
``complete`` (1,) is 1 for parts that add up to the picture, 0 for some of it, and -1 for others,
which are not brought to it.
"""

from dataclasses import replace

import numpy as np

from postfx.kernels.denoise import REFLECTANCE, in_half, kernel

DARKEST = np.float32(1e-30)
SCALE, SHIFT, LOW, HIGH, KIND = range(5)
"""Of ``decoding``: what a filtered value is multiplied by, what is added, its bounds, and its kind:
above 0 vectors, which get length 1, below 0 distances, of which the reciprocal and the share of the
pixel that has one were filtered; ``SHIFT`` then stands for none."""

STACK = ("parts", "rows", "columns", 3)
IMAGE = ("rows", "columns", 3)
REFLECT = kernel("reflectance", (*REFLECTANCE, "part_rows", "part_columns"), ("factor",), None,
                 ("factor", 0))
ACCUMULATE_PART = kernel(
    "accumulate_part", ("part", "coding", "factor", "past", "moved", "last_part", "fine", "window"),
    ("next_part", "part_level"), None, ("part_level", 1), part=("h", "w", 3), coding=(3,),
    last_part=("h", "w", 3), next_part=("th", "tw", 3), part_level=(3, "hp", "wp"))
UPSAMPLE_LIGHT = replace(
    kernel("upsample_light", ("radiance", "fine", "moved", "past", "last", "params", "window",
                              "keep", "out_rows", "out_columns"), ("light",), None, ("light", 1),
           radiance=("3*parts", "padded_h", "padded_w"), last=("parts", "height", "width", 3),
           light=("parts", "out_th", "out_tw", 3)), pixels=(2, 2))
in_half(ACCUMULATE_PART, "fine")
in_half(UPSAMPLE_LIGHT, "fine")
BALANCE = kernel("balance", ("parts", "reached", "whole", "picture", "complete"), ("balanced",),
                 None, ("balanced", 1), parts=STACK, reached=("parts", "reached_h", "reached_w"),
                 whole=IMAGE, picture=IMAGE, complete=(1,), balanced=STACK)
DECODE = kernel("decode", ("filtered", "decoding"), ("plane",), None, ("plane", 0), filtered=IMAGE,
                decoding=(5,), plane=IMAGE)
DECODE_ONE = kernel("decode_one", ("filtered", "decoding"), ("plane",), None, ("plane", 0),
                    filtered=IMAGE, decoding=(5,), plane=("rows", "columns", 1))
"""`DECODE` of planes of one channel, which were filtered as three."""
