"""Kernels of the classical filter: accumulation along the motion, an a-trous filter, and enlarging. No network.

It follows SVGF (Schied 2017, "Spatiotemporal Variance-Guided Filtering"), with an a-trous filter (Dammertz 2010,
"Edge-Avoiding A-Trous Wavelet Transform for fast Global Illumination Filtering") of 3x3 taps. The first two hidden
channels of the state hold the first two moments of the light's luminance, so that the history goes on from a network's
frame, and a network's from this.

- `GATHER`: planes and history -> next_state, next_depth; ``light`` (4, th, tw): the accumulated colour without
  reflectance, and the variance of its luminance; ``surface`` (6, th, tw): normal, 1 / depth and its steps to the right
  and down, in which planes are straight; ``factor``.
- `ATROUS`: one pass over `light`, with taps ``step`` (1,) pixels apart -> ``smooth``, the same.
- `RESOLVE`: light, with reflectance again -> output and next_history: samples weighted by their distance from the
  output's pixel. A blend with the last output takes half as much time again for -0.7 to 0.3 dB, in fog 0.9.
"""

import numpy as np

from postfx.kernels.denoise import (
    EXPOSURE,
    GAIN,
    HEIGHT,
    HIDDEN,
    JITTER_X,
    JITTER_Y,
    LEFT,
    MAX_COLOUR,
    MAX_COUNT,
    MAX_DEPTH,
    MAX_FLOAT,
    MAX_LIGHT,
    MOST_LOG,
    MOST_STATE,
    REFLECTANCE,
    STATE,
    TINY,
    TOP,
    UNKNOWN,
    WIDTH,
    kernel,
)
from postfx.kernels.denoise.history import kept_row
from postfx.kernels.denoise.upsample import gauss, pixel_of
from postfx.kernels.numeric import (
    Real,
    add,
    add_eight,
    clamp,
    compiled,
    demodulation,
    exp,
    expm1,
    fused,
    load_eight,
    load_four,
    log_encode,
    mix_eight,
    mix_four,
    place,
    store_eight,
    store_four,
    weigh_picked,
    weigh_three,
)

ZERO, QUARTER, HALF, ONE, FOUR = np.float32(0), np.float32(0.25), np.float32(0.5), np.float32(1), np.float32(4)
STEPS = (1, 2, 4, 8, 16)
"""Distances of the taps, pass by pass."""
LEAST_SHARE = np.float32(1 / 5)
"""Of this frame in the accumulated colour."""
STEP = np.float32(0.1)
"""Relative change of depth from which on a pixel shows something else than in the frame before."""
FLAT, SLANT, LUMINANCE = np.float32(0.02), np.float32(0.3), np.float32(4)
"""Edges: relative depth, share of the depth's own slope, and standard deviations of luminance."""


@fused
def luminance(r: Real, g: Real, b: Real) -> Real:
    """Relative luminance of linear Rec.709."""
    return np.float32(0.2126) * r + np.float32(0.7152) * g + np.float32(0.0722) * b


@fused
def near_row(depth: np.ndarray, near: np.ndarray) -> None:
    """1 / depth of a row; 0 where there is nothing."""
    for x in range(near.size):
        near[x] = ONE / depth[x] if ZERO < depth[x] < MAX_DEPTH else ZERO


@fused
def slope_row(before: np.ndarray, here: np.ndarray, after: np.ndarray, out: np.ndarray) -> None:
    """The smaller step to a neighbour: the larger one may cross an edge."""
    for x in range(out.size):
        left, right = here[x] - before[x], after[x] - here[x]
        out[x] = left if abs(left) < abs(right) else right


PLACES, NEAR = 5, 4
"""Rows of places in the history: its four pixels around each pixel, left to right and down, and the nearest."""


@fused
def is_unknown(a: Real, b: Real, c: Real, d: Real, tx: Real, ty: Real) -> Real:
    """Whether more than a trace of a pixel is missing in the history, by its neighbours' counts and weights."""
    if min(min(a, b), min(c, d)) > ZERO:
        return False
    left, upper = ONE - tx, ONE - ty
    lacking = left * upper if a <= ZERO else ZERO
    lacking += tx * upper if b <= ZERO else ZERO
    lacking += left * ty if c <= ZERO else ZERO
    lacking += tx * ty if d <= ZERO else ZERO
    return lacking > np.float32(UNKNOWN)


@fused
def locate_row(y: int, left: int, moved: np.ndarray, h: int, w: int, keep: np.ndarray, places: np.ndarray,
               shares: np.ndarray, valid: np.ndarray) -> None:
    """Where the pixels of a row lay in the frame before, with edges repeated: ``places`` (5, w) of pixels, and how far
    right of the first and down from it, ``shares`` (2, w). ``valid`` is ``keep`` where that lies in the picture."""
    flat = moved.reshape(moved.size)
    right, bottom = np.float32(w) - HALF, np.float32(h) - HALF
    across, last_x, last_y, one = np.int32(w), np.int32(w - 1), np.int32(h - 1), np.int32(1)
    a, b, c, d, near, tx, ty = places[0], places[1], places[2], places[3], places[NEAR], shares[0], shares[1]
    for x in range(valid.size):
        px, py = np.float32(np.int32(left + x)) + flat[2 * x], np.float32(y) + flat[2 * x + 1]
        held = (px >= -HALF) & (px <= right) & (py >= -HALF) & (py <= bottom)
        valid[x] = keep[x] if held else ZERO
        px, py = min(max(px, ZERO), np.float32(last_x)), min(max(py, ZERO), np.float32(last_y))
        near[x] = np.int32(np.rint(py)) * across + np.int32(np.rint(px))
        x0, y0 = np.int32(px), np.int32(py)
        tx[x], ty[x] = px - np.float32(x0), py - np.float32(y0)
        x1, upper, lower = min(x0 + one, last_x), y0 * across, min(y0 + one, last_y) * across
        a[x], b[x], c[x], d[x] = upper + x0, upper + x1, lower + x0, lower + x1


@fused
def recall_row(places: np.ndarray, shares: np.ndarray, state: np.ndarray, last_depth: np.ndarray, keep: np.ndarray,
               gain: Real, before: np.ndarray, valid: np.ndarray, light: np.ndarray, hidden: np.ndarray) -> None:
    """The state of the frame before along a row, bilinear: ``light`` (w, 4) has the mean colour after an exposure
    change, and the count, ``hidden`` (w, 8) the rest; ``before`` is the nearest pixel's depth.

    ``keep`` (w,) is how much of the history is used: it scales validity, count and hidden state, not the colour. Where
    the history lacks a pixel, its count is -1.
    """
    flat, depths = state.reshape(state.size), last_depth.reshape(last_depth.size)
    lights, rest = light.reshape(light.size), hidden.reshape(hidden.size)
    none = (ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO)
    pixel, count, behind = np.uint64(STATE), np.uint64(3), np.uint64(4)
    for x in range(valid.size):
        before[x], tx, ty = depths[places[NEAR, x]], shares[0, x], shares[1, x]
        a, b = np.uint64(places[0, x]) * pixel, np.uint64(places[1, x]) * pixel
        c, d = np.uint64(places[2, x]) * pixel, np.uint64(places[3, x]) * pixel
        held = valid[x] != ZERO
        lacks = held and is_unknown(flat[a + count], flat[b + count], flat[c + count], flat[d + count], tx, ty)
        if lacks or not held:
            valid[x] = ZERO
            store_four(lights, 4 * x, (ZERO, ZERO, ZERO, -ONE if lacks else ZERO))
            store_eight(rest, HIDDEN * x, none)
            continue
        found = mix_four(mix_four(load_four(flat, a), load_four(flat, b), tx),
                         mix_four(load_four(flat, c), load_four(flat, d), tx), ty)
        store_four(lights, 4 * x, (found[0] * gain, found[1] * gain, found[2] * gain, found[3] * keep[x]))
        more = mix_eight(mix_eight(load_eight(flat, a + behind), load_eight(flat, b + behind), tx),
                         mix_eight(load_eight(flat, c + behind), load_eight(flat, d + behind), tx), ty)
        store_eight(rest, HIDDEN * x, add_eight(none, more, keep[x]))


@compiled
def gather_rows(y0: int, y1: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                normal: np.ndarray, depth: np.ndarray, moved: np.ndarray, state: np.ndarray, last_depth: np.ndarray,
                params: np.ndarray, window: np.ndarray, keep: np.ndarray, next_state: np.ndarray,
                next_depth: np.ndarray, light: np.ndarray, surface: np.ndarray, factor: np.ndarray) -> None:
    """As `accumulate_rows`: a state of zeros is unknown, and so it is at the part's edges within the frame."""
    h, w = colour.shape[:2]
    th, tw = moved.shape[:2]
    top, left = int(window[TOP]), int(window[LEFT])
    rows, columns = min(th, h - top), min(tw, w - left)
    under, beside = top + th < h, left + tw < w
    places, shares = np.empty((PLACES, columns), np.int32), np.empty((2, columns), np.float32)
    past, more = np.empty((columns, 4), np.float32), np.empty((columns, HIDDEN), np.float32)
    before = np.empty(columns, np.float32)
    valid, share = np.empty(columns, np.float32), np.empty(columns, np.float32)
    near, depths = np.empty((3, w + 2), np.float32), depth.reshape(h, w)
    for y in range(y0, y1):
        first = columns if y < rows else 0
        light[:, y, first:], surface[:, y, first:], factor[y, first:] = ZERO, ZERO, ZERO
        next_state[y, first:], next_depth[y, first:] = ZERO, ZERO
        if not first:
            continue
        v = top + y
        kept_row(keep, y, share)
        locate_row(v, left, moved[y], h, w, share, places, shares, valid)
        recall_row(places, shares, state, last_depth, share, params[GAIN], before, valid, past, more)
        for x in range(columns):
            u = left + x
            own = demodulation(diffuse_albedo, specular_albedo, v, u)
            brightest = np.float32(MAX_COLOUR)
            for c in range(3):
                factor[y, x, c] = own[c]
                light[c, y, x] = min(clamp(colour[v, u, c], ZERO, MAX_FLOAT) * params[EXPOSURE] / own[c],
                                     np.float32(MAX_LIGHT))
                brightest = max(brightest, light[c, y, x])
            for c in range(3):
                light[c, y, x] *= np.float32(MAX_COLOUR) / brightest  # the sun keeps its hue
            z = depth[v, u, 0]
            alike = abs(before[x] - z) <= STEP * z or (before[x] >= MAX_DEPTH and z >= MAX_DEPTH)
            count = past[x, 3] if valid[x] > ZERO and alike else ZERO
            alpha = max(ONE / (max(count, ZERO) + ONE), LEAST_SHARE)
            lum, total = luminance(light[0, y, x], light[1, y, x], light[2, y, x]), ZERO
            for c in range(3):
                light[c, y, x] = past[x, c] + (light[c, y, x] - past[x, c]) * alpha
                total += abs(light[c, y, x])
            scale = params[GAIN] / max(valid[x], np.float32(1e-3))
            mean, square = more[x, 0] * scale, more[x, 1] * scale * params[GAIN]
            mean = mean + (lum - mean) * alpha if square > ZERO else lum
            square = square + (lum * lum - square) * alpha if square > ZERO else lum * lum
            counted = min(ONE / alpha, np.float32(MAX_COUNT))
            light[3, y, x] = max(square - mean * mean * (ONE - ONE / counted), ZERO) / counted
            next_depth[y, x, 0] = z
            next_state[y, x] = ZERO
            if total + mean <= MOST_STATE and square <= MAX_LIGHT:
                for c in range(3):
                    next_state[y, x, c] = light[c, y, x]
                next_state[y, x, 3], next_state[y, x, 4], next_state[y, x, 5] = counted, mean, min(square, MOST_STATE)
            elif not total <= MOST_STATE:  # broken: nothing of it
                for c in range(4):
                    light[c, y, x] = ZERO
            for c in range(3):
                surface[c, y, x] = clamp(normal[v, u, c], -ONE, ONE)
        for k in range(3):
            near_row(depths[min(max(v + k - 1, 0), h - 1)], near[k, 1:1 + w])
        near[1, 0], near[1, 1 + w] = near[1, 1], near[1, w]
        surface[3, y, :columns] = near[1, 1 + left:1 + left + columns]
        slope_row(near[1, left:], near[1, 1 + left:], near[1, 2 + left:], surface[4, y, :columns])
        slope_row(near[0, 1 + left:], near[1, 1 + left:], near[2, 1 + left:], surface[5, y, :columns])
        if (y == 0 and top > 0) or (y == th - 1 and under):
            next_state[y] = ZERO
        else:
            if left > 0:
                next_state[y, 0] = ZERO
            if beside:
                next_state[y, tw - 1] = ZERO


@fused
def facing_row(nx: np.ndarray, ny: np.ndarray, nz: np.ndarray, ox: np.ndarray, oy: np.ndarray, oz: np.ndarray,
               weight: np.ndarray) -> None:
    """The cosine between normals to the 32nd power; 1 between pixels without."""
    for x in range(weight.size):
        a, b = nx[x] * ox[x] + ny[x] * oy[x] + nz[x] * oz[x], nx[x] * nx[x] + ny[x] * ny[x] + nz[x] * nz[x]
        a = max(a, ZERO) if b > HALF else ONE
        a = a * a
        a = a * a
        a = a * a
        a = a * a
        weight[x] = a * a


@fused
def edge_row(near: np.ndarray, other: np.ndarray, across: np.ndarray, down: np.ndarray, lum: np.ndarray,
             other_lum: np.ndarray, spread: np.ndarray, dx: Real, dy: Real, share: Real, weight: np.ndarray) -> None:
    """Times the share of a tap, and what depth and luminance leave of it; ``spread`` is 1 / standard deviation."""
    for x in range(weight.size):
        way = across[x] * dx + down[x] * dy
        off = abs(other[x] - near[x] - way) / (FLAT * near[x] + SLANT * abs(way) + np.float32(1e-12))
        off = off + abs(other_lum[x] - lum[x]) * spread[x]
        weight[x] = weight[x] * share * exp(max(-off, np.float32(-60)))


@fused
def add_tap(light: np.ndarray, weight: np.ndarray, total: np.ndarray) -> None:
    """total += weight * light."""
    for x in range(weight.size):
        total[x] += weight[x] * light[x]


@fused
def add_variance(light: np.ndarray, weight: np.ndarray, total: np.ndarray) -> None:
    """total += weight^2 * variance: that of a weighted sum."""
    for x in range(weight.size):
        total[x] += weight[x] * weight[x] * light[x]


@fused
def finish_row(total: np.ndarray, weights: np.ndarray, squared: bool, out: np.ndarray) -> None:
    """The weighted mean, or with `squared` its variance."""
    for x in range(out.size):
        share = ONE / weights[x]
        out[x] = total[x] * share * share if squared else total[x] * share


@fused
def luminance_row(r: np.ndarray, g: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Luminance of a row."""
    for x in range(out.size):
        out[x] = luminance(r[x], g[x], b[x])


@fused
def spread_row(above: np.ndarray, here: np.ndarray, below: np.ndarray, line: np.ndarray, spread: np.ndarray) -> None:
    """1 / (4 standard deviations of luminance), from the variance of 3x3 pixels."""
    for x in range(line.size):
        line[x] = QUARTER * (above[x] + below[x]) + HALF * here[x]
    last = line.size - 1
    for x in range(spread.size):
        found = QUARTER * (line[max(x - 1, 0)] + line[min(x + 1, last)]) + HALF * line[x]
        spread[x] = ONE / (LUMINANCE * np.sqrt(found) + np.float32(1e-4))


@compiled
def atrous_rows(y0: int, y1: int, light: np.ndarray, surface: np.ndarray, step: np.ndarray, window: np.ndarray,
                smooth: np.ndarray) -> None:
    """Taps of 1/4, 1/8 and 1/16; those beyond the picture do not count."""
    reach, (h, w) = int(step[0]), light.shape[1:]
    h, w = min(h, int(window[HEIGHT]) - int(window[TOP])), min(w, int(window[WIDTH]) - int(window[LEFT]))
    lum, other, line = np.empty(w, np.float32), np.empty(w, np.float32), np.empty(w, np.float32)
    spread, weight, weights = np.empty(w, np.float32), np.empty(w, np.float32), np.empty(w, np.float32)
    totals = np.empty((4, w), np.float32)
    for y in range(y0, y1):
        if y >= h:
            smooth[:, y] = ZERO
            continue
        smooth[:, y, w:] = ZERO
        luminance_row(light[0, y, :w], light[1, y, :w], light[2, y, :w], lum)
        spread_row(light[3, max(y - 1, 0), :w], light[3, y, :w], light[3, min(y + 1, h - 1), :w], line, spread)
        for k in range(3):
            totals[k] = QUARTER * light[k, y, :w]
        totals[3] = QUARTER * QUARTER * light[3, y, :w]
        weights[:] = QUARTER
        for j in range(-1, 2):
            v = y + j * reach
            if not 0 <= v < h:
                continue
            luminance_row(light[0, v, :w], light[1, v, :w], light[2, v, :w], other)
            for i in range(-1, 2):
                a, b = max(0, -i * reach), min(w, w - i * reach)
                if (i == 0 and j == 0) or b <= a:
                    continue
                p, q = a + i * reach, b + i * reach
                part = weight[:b - a]
                facing_row(surface[0, y, a:b], surface[1, y, a:b], surface[2, y, a:b], surface[0, v, p:q],
                           surface[1, v, p:q], surface[2, v, p:q], part)
                edge_row(surface[3, y, a:b], surface[3, v, p:q], surface[4, y, a:b], surface[5, y, a:b], lum[a:b],
                         other[p:q], spread[a:b], np.float32(i * reach), np.float32(j * reach),
                         np.float32(0.125 if i == 0 or j == 0 else 0.0625), part)
                add(part, weights[a:b])
                for k in range(3):
                    add_tap(light[k, v, p:q], part, totals[k, a:b])
                add_variance(light[3, v, p:q], part, totals[3, a:b])
        for k in range(4):
            finish_row(totals[k], weights, k == 3, smooth[k, y, :w])


@compiled
def shade_row(light: np.ndarray, factor: np.ndarray, row: np.ndarray) -> None:
    """A row of light with its reflectance, its first and last pixel repeated beside it: (3, w + 2)."""
    w = light.shape[1]
    for c in range(3):
        for x in range(w):
            row[c, x + 1] = light[c, x] * factor[x, c]
        row[c, 0], row[c, w + 1] = row[c, 1], row[c, w]


@fused
def encode_row(row: np.ndarray) -> None:
    """A row of light as its logarithm."""
    for x in range(row.size):
        row[x] = log_encode(row[x])


@fused
def decode_row(logs: np.ndarray, darken: Real, output: np.ndarray) -> None:
    """Light from its logarithms; broken values count as 0."""
    for x in range(logs.size):
        logs[x] = logs[x] if logs[x] <= MOST_LOG else ZERO
    for x in range(logs.size):
        output[x] = expm1(logs[x]) * darken


@compiled
def resolve_rows(y0: int, y1: int, light: np.ndarray, factor: np.ndarray, params: np.ndarray, window: np.ndarray,
                 output: np.ndarray, history: np.ndarray) -> None:
    """The output: light times reflectance, by a Gaussian around each output pixel."""
    width = output.shape[1]
    held_h = min(light.shape[1], int(window[HEIGHT]) - int(window[TOP]))
    held_w = min(light.shape[2], int(window[WIDTH]) - int(window[LEFT]))
    index, near = np.empty(width, np.int64), np.empty((3, width), np.float32)
    for x in range(width):
        index[x], offset = pixel_of(x, LEFT, window, held_w)
        total = TINY
        for i in range(3):
            near[i, x] = gauss(i - 1 + params[JITTER_X] - offset)
            total += near[i, x]
        near[:, x] /= total
    rows, column = np.zeros((3, 3, held_w + 2), np.float32), np.empty((3, held_w + 2), np.float32)
    soft, down, last = np.empty(width, np.float32), np.empty(3, np.float32), -1
    for row in range(y0, y1):
        iy, offset = pixel_of(row, TOP, window, held_h)
        if iy != last:
            for j in range(3):
                at = min(max(iy + j - 1, 0), held_h - 1)
                shade_row(light[:, at, :held_w], factor[at], rows[j])
            last = iy
        total = TINY
        for j in range(3):
            down[j] = gauss(j - 1 + params[JITTER_Y] - offset)
            total += down[j]
        logs = history[row].reshape(3 * width)
        for c in range(3):
            weigh_three(rows[0, c], rows[1, c], rows[2, c], down[0] / total, down[1] / total, down[2] / total,
                        column[c])
            weigh_picked(column[c], near, index, soft)
            encode_row(soft)
            place(soft, c, 3, logs)
        decode_row(logs, ONE / params[EXPOSURE], output[row].reshape(3 * width))


_LIGHT, _SURFACE = (4, "th", "tw"), (6, "th", "tw")
GATHER = kernel("gather", ("colour", *REFLECTANCE, "normal", "depth", "moved", "state", "last_depth", "params",
                           "window", "keep"),
                ("next_state", "next_depth", "light", "surface", "factor"), gather_rows, ("light", 1), light=_LIGHT,
                surface=_SURFACE)
ATROUS = kernel("atrous", ("light", "surface", "step", "window"), ("smooth",), atrous_rows, ("smooth", 1),
                light=_LIGHT, surface=_SURFACE, smooth=_LIGHT, step=(1,))
RESOLVE = kernel("resolve", ("light", "factor", "params", "window"), ("output", "next_history"), resolve_rows,
                 ("output", 0), light=_LIGHT)
