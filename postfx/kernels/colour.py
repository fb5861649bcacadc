"""Colour by look-up: a shaper, a cube of colours, and the code values of a display.

Cube: (size, size, size, 3): red, green, blue, channel. Tetrahedral look-up: of the eight corners around a colour only
the four on the path from the lowest to the highest count, so greys come from the cube's diagonal. Formula: Kasson et
al. 1995, "Performing color space conversions with three-dimensional linear interpolation".

Shaper: a matrix, then log2(1 + exposure * x / toe) * scale in [0, 1]. The matrix converts Rec.709 to wider primaries
(Rec.2020 for the shipped looks), so that colours outside Rec.709, which are negative there, are not clipped. Light
above the range is scaled down as a whole: its channels keep their ratio, and so its hue.

`apply_cube` looks exposed light up in a cube, through the shaper. Bindings (float32): colour (height, width, 3)
scene-linear; params (3,): exposure, toe and scale of the shaper; matrix (9,) row-major, to the cube's primaries; cube;
output (height, width, 3). Negative values after the matrix and NaN count as 0. The torch definition is
`training.kernels.tonemap.ApplyCube`.

`encode_display` converts light or SDR code values to a display's code values: decode, convert primaries, clip, encode.
Bindings (float32): colour (height, width, 3); params (12,): 3x3 matrix row-major, whether colour is code values (0 or
1), the light above which it clips, and the exponent of the luminance by which light is multiplied; decode (4098,):
light of evenly spaced code values 0..1; encode (4098,): code values over the eighth root of light 0..1; output (height,
width, 3) code values 0..1. NaN becomes 0. Both tables repeat their last value; `postfx.passes.display` makes them. The
torch definition is `training.kernels.tonemap.EncodeDisplay`.

`convert_primaries` is a matrix alone: colour (height, width, 3); matrix (9,) row-major; output (height, width, 3), of
any sign. The torch definition is `training.kernels.tonemap.ConvertPrimaries`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postfx.colour import LUMA_REC2020
from postfx.kernels import Kernel
from postfx.kernels.numeric import BRIGHTEST, Real, add_four, clamp, compiled, fused, inline, load_four, store_four

ZERO, ONE = np.float32(0.0), np.float32(1.0)


@compiled
def cube_row(shaped: np.ndarray, cube: np.ndarray, places: np.ndarray, shares: np.ndarray, output: np.ndarray) -> None:
    """Look a row up: shaped (3, width), clipped to [0, 1], to output (width, 3). NaN counts as 0.

    `places` (3, width) int32 and `shares` (3, width) float32 are scratch. First where and how much, in vector code,
    then the look-ups: measured four times as fast as pixel by pixel.
    """
    size = cube.shape[0]
    _find(shaped, size, places, shares)
    _gather(cube.reshape(3 * size * size * size), 3 * (size * size + size + 1), places, shares, output)


@fused
def _find(shaped: np.ndarray, size: int, places: np.ndarray, shares: np.ndarray) -> None:
    """Numbers before the first three of the four corners, and the shares of a colour, largest first."""
    last, end = np.float32(size - 1), np.int32(size - 2)
    along_red, along_green, along_blue = np.int32(3 * size * size), np.int32(3 * size), np.int32(3)
    red, green, blue = shaped[0], shaped[1], shaped[2]
    first, second, third = places[0], places[1], places[2]
    most, middle, least = shares[0], shares[1], shares[2]
    for x in range(red.shape[0]):
        r = min(max(red[x], ZERO), ONE) * last
        g = min(max(green[x], ZERO), ONE) * last
        b = min(max(blue[x], ZERO), ONE) * last
        i, j, k = min(np.int32(r), end), min(np.int32(g), end), min(np.int32(b), end)
        r, g, b = r - np.float32(i), g - np.float32(j), b - np.float32(k)
        # The first step goes along the axis of the largest share, the last along that of the smallest.
        step = along_red if r >= g and r >= b else (along_green if g >= b else along_blue)
        final = along_blue if r >= b and g >= b else (along_green if r >= g else along_red)
        most[x], least[x] = max(max(r, g), b), min(min(r, g), b)
        middle[x] = max(min(r, g), min(max(r, g), b))
        at = i * along_red + j * along_green + k * along_blue
        first[x], second[x], third[x] = at, at + step, at + (along_red + along_green + along_blue) - final


@fused
def _gather(flat: np.ndarray, across: int, places: np.ndarray, shares: np.ndarray, output: np.ndarray) -> None:
    """Weighted sums of the corners' colours; the fourth corner is `across` numbers after the first. Colours are read
    with the number behind, the fourth with the one before it, as it may be the cube's last."""
    target, last, none = output.reshape(output.size), output.shape[0] - 1, (ZERO, ZERO, ZERO, ZERO)
    first, second, third, most, middle, least = places[0], places[1], places[2], shares[0], shares[1], shares[2]
    for x in range(output.shape[0]):
        a, b, c = np.uint64(first[x]), np.uint64(second[x]), np.uint64(third[x])  # signs would be looked at
        _, r, g, blue = load_four(flat, a + np.uint64(across - 1))
        near = add_four(none, load_four(flat, b), most[x] - middle[x])
        far = add_four(none, (r, g, blue, blue), least[x])
        found = add_four(add_four(near, load_four(flat, a), ONE - most[x]),
                         add_four(far, load_four(flat, c), middle[x] - least[x]), ONE)
        if x < last:
            store_four(target, 3 * x, found)
        else:
            output[x, 0], output[x, 1], output[x, 2], _ = found


EXPOSURE, TOE, SCALE = 0, 1, 2  # places in `params`
SQRT_HALF_BITS = np.int32(0x3F3504F3)
CUBIC, QUINTIC, SEPTIC = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7)
TWO_OVER_LN2 = np.float32(2.0 / np.log(2.0))


@fused
def shape_row(row: np.ndarray, params: np.ndarray, matrix: np.ndarray, out: np.ndarray, scratch: np.ndarray) -> None:
    """Shape a row of colour (width, 3) into out (3, width); `scratch` is int32 (width,). NaN counts as 0.

    The logarithm splits off the exponent and sums the series of atanh over the mantissa in [0.707, 1.414):
    absolute error below 3e-7, and every loop is one that the compiler turns into vector code.
    """
    gain, scale = np.float32(params[EXPOSURE] / params[TOE]), np.float32(params[SCALE])
    most = np.float32(2.0 ** min(126.0, 1.0 / params[SCALE]) - 1.0)
    rr, rg, rb, gr, gg, gb = matrix[0], matrix[1], matrix[2], matrix[3], matrix[4], matrix[5]
    br, bg, bb = matrix[6], matrix[7], matrix[8]
    red, green, blue, flat = out[0], out[1], out[2], row.reshape(row.size)
    for x in range(red.size):
        r, g = clamp(flat[3 * x], -BRIGHTEST, BRIGHTEST), clamp(flat[3 * x + 1], -BRIGHTEST, BRIGHTEST)
        b = clamp(flat[3 * x + 2], -BRIGHTEST, BRIGHTEST)
        red[x] = max(rr * r + rg * g + rb * b, ZERO) * gain
        green[x] = max(gr * r + gg * g + gb * b, ZERO) * gain
        blue[x] = max(br * r + bg * g + bb * b, ZERO) * gain
    for x in range(red.size):
        fit = most / max(max(red[x], green[x]), max(blue[x], most))
        red[x], green[x], blue[x] = red[x] * fit + ONE, green[x] * fit + ONE, blue[x] * fit + ONE
    for c in range(3):
        _log_row(out[c], scale, scratch)


@fused
def _log_row(values: np.ndarray, scale: Real, scratch: np.ndarray) -> None:
    """Replace values >= 1 by min(log2(value) * scale, 1)."""
    bits = values.view(np.int32)
    for x in range(values.shape[0]):
        exponent = (bits[x] - SQRT_HALF_BITS) >> np.int32(23)
        bits[x] = bits[x] - (exponent << np.int32(23))
        scratch[x] = exponent
    for x in range(values.shape[0]):
        z = (values[x] - ONE) / (values[x] + ONE)
        q = z * z
        series = z * (ONE + q * (CUBIC + q * (QUINTIC + q * SEPTIC)))
        values[x] = min((np.float32(scratch[x]) + TWO_OVER_LN2 * series) * scale, ONE)


@compiled
def apply_cube_rows(y0: int, y1: int, colour: np.ndarray, params: np.ndarray, matrix: np.ndarray, cube: np.ndarray,
                    output: np.ndarray) -> None:
    """Output rows y0..y1-1."""
    width = colour.shape[1]
    shaped, scratch = np.empty((3, width), np.float32), np.empty(width, np.int32)
    places, shares = np.empty((3, width), np.int32), np.empty((3, width), np.float32)
    for y in range(y0, y1):
        shape_row(colour[y], params, matrix, shaped, scratch)
        cube_row(shaped, cube, places, shares, output[y])


APPLY_CUBE = Kernel(
    name="apply_cube",
    reads=("colour", "params", "matrix", "cube"),
    writes=("output",),
    rows=apply_cube_rows,
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (3,),
        "matrix": (9,),
        "cube": ("size", "size", "size", 3),
        "output": ("height", "width", 3),
    },
    pixels=(1, 2),
)


def apply_cube_fours_rows(y0: int, y1: int, colour: np.ndarray, params: np.ndarray, matrix: np.ndarray,
                          cube: np.ndarray, output: np.ndarray) -> None:
    """What the kernel below computes. Only a GPU runs it."""
    apply_cube_rows(y0, y1, colour, params, matrix, np.ascontiguousarray(cube[..., :3]), output)


APPLY_CUBE_FOURS = replace(APPLY_CUBE, name="apply_cube_fours", rows=apply_cube_fours_rows,
                           shapes={**APPLY_CUBE.shapes, "cube": ("size", "size", "size", 4)})


def form_of(cube: np.ndarray, on_gpu: bool) -> tuple[Kernel, np.ndarray]:
    """The kernel that looks colours up in a cube (size, size, size, 3), and the cube as it reads it: on a GPU with a
    number more, so that a colour is read at once."""
    return (APPLY_CUBE_FOURS, np.pad(cube, ((0, 0), (0, 0), (0, 0), (0, 1)))) if on_gpu else (APPLY_CUBE, cube)


STEPS = 4096
ROOT = 8
CODES, MOST, EXPONENT = 9, 10, 11  # places in `params`
DARK = 1e-9
COUNT = np.float32(STEPS)
RED, GREEN, BLUE = map(np.float32, LUMA_REC2020)


@inline
def look_up(table: np.ndarray, place: Real) -> Real:
    """A table between its entries; place is in [0, STEPS]."""
    i = int(place)
    low = table[i]
    return low + (place - np.float32(i)) * (table[i + 1] - low)


@inline
def make_finite(value: Real) -> Real:
    """A NaN becomes 0, an infinity finite."""
    value = value if value == value else ZERO
    return min(max(value, -BRIGHTEST), BRIGHTEST)


@inline
def encode_light(light: Real, most: Real, gain: Real, table: np.ndarray) -> Real:
    """Code value of light, which is cut to [0, most] and then multiplied by a gain."""
    unit = min(min(max(light, ZERO), most) * gain, ONE)
    return look_up(table, np.sqrt(np.sqrt(np.sqrt(unit))) * COUNT)


@compiled
def encode_display_rows(y0: int, y1: int, colour: np.ndarray, params: np.ndarray, decode: np.ndarray,
                        encode: np.ndarray, output: np.ndarray) -> None:
    """Output rows y0..y1-1."""
    m = params
    most, exponent, codes = params[MOST], params[EXPONENT], params[CODES] > ZERO
    for y in range(y0, y1):
        for x in range(colour.shape[1]):
            r, g, b = make_finite(colour[y, x, 0]), make_finite(colour[y, x, 1]), make_finite(colour[y, x, 2])
            if codes:
                r = look_up(decode, min(max(r, ZERO), ONE) * COUNT)
                g = look_up(decode, min(max(g, ZERO), ONE) * COUNT)
                b = look_up(decode, min(max(b, ZERO), ONE) * COUNT)
            red = m[0] * r + m[1] * g + m[2] * b
            green = m[3] * r + m[4] * g + m[5] * b
            blue = m[6] * r + m[7] * g + m[8] * b
            gain = ONE
            if exponent != ZERO:
                luminance = (RED * min(max(red, ZERO), most) + GREEN * min(max(green, ZERO), most)
                             + BLUE * min(max(blue, ZERO), most))
                gain = max(luminance, np.float32(DARK)) ** exponent
            output[y, x, 0] = encode_light(red, most, gain, encode)
            output[y, x, 1] = encode_light(green, most, gain, encode)
            output[y, x, 2] = encode_light(blue, most, gain, encode)


ENCODE_DISPLAY = Kernel(
    name="encode_display",
    reads=("colour", "params", "decode", "encode"),
    writes=("output",),
    rows=encode_display_rows,
    row_axis=("output", 0),
    shapes={
        "colour": ("height", "width", 3),
        "params": (12,),
        "decode": (STEPS + 2,),
        "encode": (STEPS + 2,),
        "output": ("height", "width", 3),
    },
)


@compiled
def convert_primaries_rows(y0: int, y1: int, colour: np.ndarray, matrix: np.ndarray, output: np.ndarray) -> None:
    """Output rows y0..y1-1."""
    m, (_, width, _) = matrix, colour.shape
    for y in range(y0, y1):
        row, target = colour[y].reshape(3 * width), output[y].reshape(3 * width)
        for x in range(width):
            r, g, b = row[3 * x], row[3 * x + 1], row[3 * x + 2]
            target[3 * x] = m[0] * r + m[1] * g + m[2] * b
            target[3 * x + 1] = m[3] * r + m[4] * g + m[5] * b
            target[3 * x + 2] = m[6] * r + m[7] * g + m[8] * b


CONVERT_PRIMARIES = Kernel(
    name="convert_primaries",
    reads=("colour", "matrix"),
    writes=("output",),
    rows=convert_primaries_rows,
    row_axis=("output", 0),
    shapes={"colour": ("height", "width", 3), "matrix": (9,), "output": ("height", "width", 3)},
)
