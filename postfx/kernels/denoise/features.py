"""Kernels that fill what the upscaler's network looks at, row by row so that loops become vector code, and judge how
far to trust guides.

Channels: colour 0, accumulated colour 3 and last output 6 (demodulated, log-encoded), diffuse albedo 9, specular
albedo 12, normal 15, roughness 18, depth 19, its change 20, valid history 21, sample count 22, jitter 23, length of
motion 25, inverse scale 26, hidden state 27. The torch definition is ``training.denoise.model.features``.
"""

import numpy as np

from postfx.kernels import Kernel
from postfx.kernels.denoise import (
    DOUBT,
    EXPOSURE,
    FAINT,
    FEATURES,
    GAIN,
    GUIDE_PLANES,
    GUIDE_REFLECTANCE,
    GUIDES,
    HEIGHT,
    HIDDEN,
    IN_HALF,
    JITTER_X,
    JITTER_Y,
    LEFT,
    MAX_COLOUR,
    MAX_COUNT,
    MAX_DEPTH,
    MAX_FLOAT,
    NEAREST,
    OUT_HEIGHT,
    OUT_LEFT,
    OUT_TOP,
    OUT_WIDTH,
    REFLECTANCE,
    STATE,
    TOP,
    TRUST_CELL,
    UNKNOWN,
    WIDTH,
    kernel,
)
from postfx.kernels.denoise.history import kept_row
from postfx.kernels.denoise.network_io import pack_rows, width
from postfx.kernels.numeric import (
    Real,
    clamp,
    compiled,
    demodulation,
    expm1,
    fused,
    load_eight,
    load_four,
    log,
    log1p,
    log_encode,
    mix_eight,
    mix_four,
)

ZERO, HALF, ONE, TWO, FOUR = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2), np.float32(4)


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
def recall_row(y: int, columns: np.ndarray, moved: np.ndarray, state: np.ndarray, last_depth: np.ndarray,
               keep: np.ndarray, memory: np.ndarray, before: np.ndarray, valid: np.ndarray) -> None:
    """The state of the frame before along a row: bilinear (12, w), edge repeated, and the nearest pixel's depth.

    ``y`` and ``columns`` are places in the frame, ``moved`` (w, 2) is the motion there, ``keep`` (w,) how much of the
    history is used: it scales validity, count and hidden state, not the mean colour.
    """
    h, w = state.shape[:2]
    flat = state.reshape(h * w * STATE)
    for x in range(columns.size):
        px, py = np.float32(columns[x]) + moved[x, 0], np.float32(y) + moved[x, 1]
        held = -0.5 <= px <= w - 0.5 and -0.5 <= py <= h - 0.5
        valid[x] = keep[x] if held else ZERO
        if valid[x] == ZERO:
            memory[:, x] = ZERO
            continue
        near_y, near_x = min(max(int(np.rint(py)), 0), h - 1), min(max(int(np.rint(px)), 0), w - 1)
        before[x] = last_depth[near_y, near_x, 0]
        px, py = min(max(px, ZERO), np.float32(w - 1)), min(max(py, ZERO), np.float32(h - 1))
        x0, y0 = int(px), int(py)
        tx, ty = px - np.float32(x0), py - np.float32(y0)
        right, below = STATE * (min(x0 + 1, w - 1) - x0), STATE * w * (min(y0 + 1, h - 1) - y0)
        at = np.uint64((y0 * w + x0) * STATE)
        to_right, to_below, across = np.uint64(right), np.uint64(below), np.uint64(right + below)
        count = at + np.uint64(3)
        if is_unknown(flat[count], flat[count + to_right], flat[count + to_below], flat[count + across], tx, ty):
            valid[x], memory[:, x], memory[3, x] = ZERO, ZERO, -ONE
            continue
        light = mix_four(mix_four(load_four(flat, at), load_four(flat, at + to_right), tx),
                         mix_four(load_four(flat, at + to_below), load_four(flat, at + across), tx), ty)
        at += np.uint64(4)
        hidden = mix_eight(mix_eight(load_eight(flat, at), load_eight(flat, at + to_right), tx),
                           mix_eight(load_eight(flat, at + to_below), load_eight(flat, at + across), tx), ty)
        memory[0, x], memory[1, x], memory[2, x], memory[3, x] = light[0], light[1], light[2], light[3] * keep[x]
        for c in range(HIDDEN):
            memory[4 + c, x] = hidden[c] * keep[x]


@fused
def mean_row(top: int, bottom: int, warped: np.ndarray, left: np.ndarray, right: np.ndarray, total: np.ndarray,
             mean: np.ndarray) -> None:
    """Mean (3, w) of the output pixels that each render pixel of a row touches: rows ``top`` to ``bottom``."""
    width = warped.shape[1]
    total[:] = ZERO
    for j in range(top, bottom):
        line = warped[j].reshape(3 * width)
        for i in range(3 * width):
            total[i] += line[i]
    for x in range(left.size):
        share = ONE / np.float32((bottom - top) * (right[x] - left[x]))
        r, g, b = ZERO, ZERO, ZERO
        for i in range(left[x], right[x]):
            r += total[3 * i]
            g += total[3 * i + 1]
            b += total[3 * i + 2]
        mean[0, x], mean[1, x], mean[2, x] = r * share, g * share, b * share


@fused
def colour_planes(row: int, colour: np.ndarray, factor: np.ndarray, exposure: Real, memory: np.ndarray, gain: Real,
                  mean: np.ndarray, valid: np.ndarray, features: np.ndarray) -> None:
    """This frame's colour, the accumulated colour and the last output, without reflectance and log-encoded.

    A loop that reads few arrays, each without gaps, becomes vector code: hence the copies and the many loops.
    """
    count, most = valid.size, np.float32(MAX_COLOUR)
    for c in range(3):
        now, kept, last = features[0, c, row], features[0, 3 + c, row], features[0, 6 + c, row]
        for x in range(count):
            now[x] = colour[x, c]
        for x in range(count):
            now[x] = log1p(min(clamp(now[x], ZERO, MAX_FLOAT) * exposure / factor[c, x], most))
        for x in range(count):
            kept[x] = log_encode(memory[c, x] * gain * valid[x])
        for x in range(count):
            last[x] = log_encode(expm1(mean[c, x]) * valid[x] / factor[c, x])


@fused
def bounded_planes(row: int, first: int, picture: np.ndarray, count: int, low: Real, high: Real,
                   features: np.ndarray) -> None:
    """Channels of a picture's row as they are, within bounds."""
    for c in range(picture.shape[1]):
        plane = features[0, first + c, row]
        for x in range(count):
            plane[x] = clamp(picture[x, c], low, high)


@fused
def depth_planes(row: int, depth: np.ndarray, before: np.ndarray, valid: np.ndarray, scale: Real,
                 features: np.ndarray) -> None:
    """Depth relative to the picture's, and its change since the frame before."""
    near, change, count = features[0, 19, row], features[0, 20, row], valid.size
    for x in range(count):
        near[x] = clamp(depth[x, 0], ZERO, MAX_DEPTH)
    for x in range(count):
        ratio = clamp(before[x], NEAREST, MAX_DEPTH) / max(near[x], NEAREST)
        change[x] = min(max(FOUR * log(ratio), -ONE), ONE) * valid[x]
    for x in range(count):
        near[x] = scale / (scale + near[x])


@fused
def motion_plane(row: int, moved: np.ndarray, features: np.ndarray) -> None:
    """Length of the motion, log-encoded."""
    plane = features[0, 25, row]
    for x in range(moved.shape[0]):
        plane[x] = moved[x, 0] * moved[x, 0] + moved[x, 1] * moved[x, 1]
    for x in range(moved.shape[0]):
        plane[x] = log1p(np.sqrt(plane[x])) / FOUR


@fused
def memory_planes(row: int, valid: np.ndarray, memory: np.ndarray, features: np.ndarray) -> None:
    """Validity of the history, its sample count and the hidden state."""
    count = valid.size
    features[0, 21, row, :count] = valid
    for x in range(count):
        features[0, 22, row, x] = max(memory[3, x], ZERO) / np.float32(MAX_COUNT)
    for c in range(HIDDEN):
        features[0, 27 + c, row, :count] = memory[4 + c]


@compiled
def feature_rows(y0: int, y1: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                 normal: np.ndarray, roughness: np.ndarray, depth: np.ndarray, moved: np.ndarray, state: np.ndarray,
                 last_depth: np.ndarray, warped: np.ndarray, depth_scale: np.ndarray, params: np.ndarray,
                 window: np.ndarray, keep: np.ndarray, seen_rows: np.ndarray, seen_columns: np.ndarray,
                 past: np.ndarray, features: np.ndarray) -> None:
    """The network's input and the reprojected accumulation."""
    h, w, height, width = int(window[HEIGHT]), int(window[WIDTH]), int(window[OUT_HEIGHT]), int(window[OUT_WIDTH])
    top, first, above, before_left = int(window[TOP]), int(window[LEFT]), int(window[OUT_TOP]), int(window[OUT_LEFT])
    two, count = np.float32(2), min(moved.shape[1], w - first)
    columns = np.arange(first, first + count)
    left = np.array([x * width // w - before_left for x in columns])
    right = np.array([-(-(x + 1) * width // w) - before_left for x in columns])
    memory, mean = np.empty((STATE, count), np.float32), np.empty((3, count), np.float32)
    factor, before = np.empty((3, count), np.float32), np.ones(count, np.float32)
    valid, share = np.empty(count, np.float32), np.empty(count, np.float32)
    total = np.empty(3 * warped.shape[1], np.float32)
    for row in range(y0, y1):
        here = int(seen_rows[row])
        y = top + here
        for x in range(count):
            factor[0, x], factor[1, x], factor[2, x] = demodulation(diffuse_albedo, specular_albedo, y, first + x)
        kept_row(keep, here, share)
        recall_row(y, columns, moved[here], state, last_depth, share, memory, before, valid)
        mean_row(y * height // h - above, -(-(y + 1) * height // h) - above, warped, left, right, total, mean)
        colour_planes(row, colour[y, first:], factor, params[EXPOSURE], memory, params[GAIN], mean, valid, features)
        bounded_planes(row, 9, diffuse_albedo[y, first:], count, ZERO, two, features)
        bounded_planes(row, 12, specular_albedo[y, first:], count, ZERO, two, features)
        bounded_planes(row, 15, normal[y, first:], count, -ONE, ONE, features)
        bounded_planes(row, 18, roughness[y, first:], count, ZERO, ONE, features)
        depth_planes(row, depth[y, first:], before, valid, depth_scale[0], features)
        motion_plane(row, moved[here, :count], features)
        memory_planes(row, valid, memory, features)
        features[0, 23, row, :] = params[JITTER_X]
        features[0, 24, row, :] = params[JITTER_Y]
        features[0, 26, row, :] = np.float32(w) / np.float32(width)
        for c in range(FEATURES):
            for x in range(count, features.shape[3]):
                features[0, c, row, x] = features[0, c, row, int(seen_columns[x])]
        if row < past.shape[0]:
            for x in range(past.shape[1]):
                at = int(seen_columns[x])
                for c in range(3):
                    past[row, x, c] = memory[c, at] * params[GAIN]
                past[row, x, 3] = memory[3, at]


FEATURE = kernel("features", ("colour", *REFLECTANCE, "normal", "roughness", "depth", "moved", "state", "last_depth",
                              "warped", "depth_scale", "params", "window", "keep", "seen_rows", "seen_columns"),
                 ("past", "features"), feature_rows, ("features", 2))


def packed_feature_rows(y0: int, y1: int, *tensors: np.ndarray) -> None:
    """The same channels last, in half precision."""
    *reads, past, packed = tensors
    features = np.empty((1, FEATURES, *packed.shape[1:3]), np.float32)
    feature_rows(y0, y1, *reads, past, features)
    pack_rows(y0, y1, features, packed)


IN_HALF[FEATURE] = Kernel(
    f"{FEATURE.name}_half", FEATURE.reads, ("past", "packed_features"), packed_feature_rows, ("packed_features", 1),
    {name: shape for name, shape in FEATURE.shapes.items() if name != "features"}
    | {"packed_features": (1, "hp", "wp", width(FEATURES))}, {"packed_features": "float16"})


# Guides: planes at output size, where the network predicts its filters. Channels of ``guides``, for the corners of a
# render pixel at top left, top right, bottom left and bottom right: diffuse albedo 0, specular albedo 3, normal 6,
# roughness 9, depth 10. The torch definition is ``training.denoise.model.guide_features``.

CORNERS = 4
CHANNELS = GUIDES // CORNERS


@fused
def picked_planes(picture: np.ndarray, columns: np.ndarray, low: Real, high: Real, first: int, row: int,
                  guides: np.ndarray) -> None:
    """Pixels of a guide's row at ``columns``, within bounds, as planes from channel ``first`` on."""
    for c in range(picture.shape[1]):
        plane = guides[0, first + c, row]
        for x in range(columns.size):
            plane[x] = clamp(picture[columns[x], c], low, high)


@compiled
def guide_rows(y0: int, y1: int, guide_diffuse_albedo: np.ndarray, guide_specular_albedo: np.ndarray,
               guide_normal: np.ndarray, guide_roughness: np.ndarray, guide_depth: np.ndarray, depth_scale: np.ndarray,
               window: np.ndarray, seen_rows: np.ndarray, seen_columns: np.ndarray, guides: np.ndarray) -> None:
    """The nearest guide pixel at every corner of what the network sees."""
    h, w = int(window[HEIGHT]), int(window[WIDTH])
    top, left = int(window[TOP]), int(window[LEFT])
    height, width = guide_depth.shape[:2]
    scale, padded = depth_scale[0], guides.shape[3]
    columns = np.empty((2, padded), np.int64)
    for x in range(padded):
        for side in range(2):
            columns[side, x] = (4 * (left + int(seen_columns[x])) + 1 + 2 * side) * width // (4 * w)
    for row in range(y0, y1):
        for corner in range(CORNERS):
            y = (4 * (top + int(seen_rows[row])) + 1 + 2 * (corner // 2)) * height // (4 * h)
            at, first = columns[corner % 2], CHANNELS * corner
            picked_planes(guide_diffuse_albedo[y], at, ZERO, TWO, first, row, guides)
            picked_planes(guide_specular_albedo[y], at, ZERO, TWO, first + 3, row, guides)
            picked_planes(guide_normal[y], at, -ONE, ONE, first + 6, row, guides)
            picked_planes(guide_roughness[y], at, ZERO, ONE, first + 9, row, guides)
            picked_planes(guide_depth[y], at, ZERO, MAX_DEPTH, first + 10, row, guides)
            near = guides[0, first + 10, row]
            for x in range(padded):
                near[x] = scale / (scale + near[x])


GUIDE = kernel("guides", (*GUIDE_PLANES, "depth_scale", "window", "seen_rows", "seen_columns"), ("guides",), guide_rows,
               ("guides", 2))


@compiled
def judged_pixel(y: int, x: int, h: int, w: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                 guide_diffuse_albedo: np.ndarray, guide_specular_albedo: np.ndarray) -> tuple[Real, Real]:
    """Squared relative difference of the guides' mean reflectance over a render pixel from that of the render size, and
    the mean squared difference of the guides: the first is large beside it where guides disagree."""
    height, width = guide_diffuse_albedo.shape[:2]
    own_r, own_g, own_b = demodulation(diffuse_albedo, specular_albedo, y, x)
    own_r, own_g, own_b = ONE / own_r, ONE / own_g, ONE / own_b
    top, bottom = y * height // h, ((y + 1) * height + h - 1) // h
    left, right = x * width // w, ((x + 1) * width + w - 1) // w
    mean_r = mean_g = mean_b = spread = ZERO
    for v in range(top, bottom):
        for u in range(left, right):
            r, g, b = demodulation(guide_diffuse_albedo, guide_specular_albedo, v, u)
            r, g, b = r * own_r - ONE, g * own_g - ONE, b * own_b - ONE
            mean_r, mean_g, mean_b = mean_r + r, mean_g + g, mean_b + b
            spread += r * r + g * g + b * b
    share = ONE / np.float32((bottom - top) * (right - left))
    mean_r, mean_g, mean_b = mean_r * share, mean_g * share, mean_b * share
    return mean_r * mean_r + mean_g * mean_g + mean_b * mean_b, spread * share


@compiled
def trust_rows(y0: int, y1: int, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
               guide_diffuse_albedo: np.ndarray, guide_specular_albedo: np.ndarray, window: np.ndarray,
               part_rows: np.ndarray, part_columns: np.ndarray, trust: np.ndarray) -> None:
    """How far the guides' reflectance is trusted, in cells of the part: fully where its mean over a render pixel is the
    reflectance at render size, less where that follows the detail, as with planes of one sample a pixel."""
    h, w = int(window[HEIGHT]), int(window[WIDTH])
    rows, columns = min(part_rows.size, h - int(window[TOP])), min(part_columns.size, w - int(window[LEFT]))
    for row in range(y0, y1):
        for column in range(trust.shape[1]):
            apart = spread = ZERO
            count = 0
            for i in range(TRUST_CELL * row, min(TRUST_CELL * (row + 1), rows)):
                for j in range(TRUST_CELL * column, min(TRUST_CELL * (column + 1), columns)):
                    found = judged_pixel(int(part_rows[i]), int(part_columns[j]), h, w, diffuse_albedo, specular_albedo,
                                         guide_diffuse_albedo, guide_specular_albedo)
                    apart, spread, count = apart + found[0], spread + found[1], count + 1
            trust[row, column, 0] = ONE - DOUBT * apart / (spread + 3 * FAINT * count) if count else ONE


@compiled
def place_of(at: Real, offset: Real, size: int) -> Real:
    """Where a pixel's centre lies among the cells of ``size`` render pixels, from centre to centre."""
    place = (np.float32(at) + offset + HALF) / np.float32(TRUST_CELL) - HALF
    return min(max(place, ZERO), np.float32((size - 1) // TRUST_CELL))


@compiled
def trust_row(trust: np.ndarray, place: Real, places: np.ndarray, row: np.ndarray) -> None:
    """How far each pixel of a row of the output trusts the guides, linear between cells."""
    upper = int(place)
    lower, share = min(upper + 1, trust.shape[0] - 1), place - np.float32(upper)
    for x in range(places.size):
        i = int(places[x])
        j, across = min(i + 1, trust.shape[1] - 1), places[x] - np.float32(i)
        above = trust[upper, i, 0] + (trust[upper, j, 0] - trust[upper, i, 0]) * across
        below = trust[lower, i, 0] + (trust[lower, j, 0] - trust[lower, i, 0]) * across
        row[x] = above + (below - above) * share


TRUST = kernel("trust", (*REFLECTANCE, *GUIDE_REFLECTANCE, "window", "part_rows", "part_columns"), ("trust",),
               trust_rows, ("trust", 0))
