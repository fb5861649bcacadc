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
    MIRRORED,
    MIRRORED_PLANES,
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
from postfx.kernels.denoise.network_io import (
    WORD,
    code_four,
    code_row,
    join_words,
    pack_rows,
    place_words,
    width,
    zero_words,
)
from postfx.kernels.numeric import (
    Real,
    add_eight,
    clamp,
    compiled,
    demodulation,
    demodulation_row,
    expm1,
    fused,
    load_eight,
    load_four,
    log,
    log1p,
    log_encode,
    mix_eight,
    mix_four,
    store_eight,
    store_four,
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


PLANAR = FEATURES - HIDDEN
"""Features that are made as rows of planes; the rest, the hidden state, comes pixel by pixel."""
PLACES, NEAR = 5, 4
"""Rows of places in the history: its four pixels around each pixel, left to right and down, and the nearest."""


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


@fused
def sum_rows(top: int, bottom: int, warped: np.ndarray, total: np.ndarray) -> None:
    """Sum of some rows of a picture."""
    width = warped.shape[1]
    total[:] = ZERO
    for j in range(top, bottom):
        line = warped[j].reshape(3 * width)
        for i in range(3 * width):
            total[i] += line[i]


@fused
def mean_row(rows: int, total: np.ndarray, edges: np.ndarray, mean: np.ndarray) -> None:
    """Mean (3, w) of the output pixels that each render pixel of a row touches, from the sum of ``rows`` rows:
    ``edges`` (2, w) are the first and the one after the last."""
    left, right = edges[0], edges[1]
    if left.size and right[0] - left[0] == 2 and right[-1] - left[0] == 2 * left.size:  # all are pairs
        share, line, red, green, blue = ONE / np.float32(2 * rows), total[3 * left[0]:], mean[0], mean[1], mean[2]
        for x in range(red.size):
            red[x], green[x] = (line[6 * x] + line[6 * x + 3]) * share, (line[6 * x + 1] + line[6 * x + 4]) * share
            blue[x] = (line[6 * x + 2] + line[6 * x + 5]) * share
        return
    for x in range(left.size):
        share = ONE / np.float32(rows * (right[x] - left[x]))
        r, g, b = ZERO, ZERO, ZERO
        for i in range(left[x], right[x]):
            r += total[3 * i]
            g += total[3 * i + 1]
            b += total[3 * i + 2]
        mean[0, x], mean[1, x], mean[2, x] = r * share, g * share, b * share


@fused
def bounded_row(picture: np.ndarray, low: Real, high: Real, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    """The three channels of a row (w, 3) as rows, within bounds."""
    flat = picture.reshape(picture.size)
    for x in range(a.size):
        a[x], b[x] = clamp(flat[3 * x], low, high), clamp(flat[3 * x + 1], low, high)
        c[x] = clamp(flat[3 * x + 2], low, high)


@fused
def light_row(light: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, count: np.ndarray) -> None:
    """The accumulated colour of a row (w, 4) as rows, and its sample count from 0 to 1."""
    flat = light.reshape(light.size)
    for x in range(a.size):
        a[x], b[x], c[x] = flat[4 * x], flat[4 * x + 1], flat[4 * x + 2]
        count[x] = max(flat[4 * x + 3], ZERO) / np.float32(MAX_COUNT)


@fused
def encode_colour(now: np.ndarray, kept: np.ndarray, last: np.ndarray, factor: np.ndarray, exposure: Real,
                  mean: np.ndarray, valid: np.ndarray) -> None:
    """A channel of this frame's colour, of the accumulated colour and of the last output, without reflectance and
    log-encoded. A loop that reads few arrays becomes vector code: hence the many loops."""
    most = np.float32(MAX_COLOUR)
    for x in range(valid.size):
        now[x] = log1p(min(now[x] * exposure / factor[x], most))
    for x in range(valid.size):
        kept[x] = log_encode(kept[x] * valid[x])
    for x in range(valid.size):
        last[x] = log_encode(expm1(mean[x]) * valid[x] / factor[x])


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
def motion_plane(row: int, moved: np.ndarray, count: int, features: np.ndarray) -> None:
    """Length of the motion, log-encoded."""
    plane = features[0, 25, row]
    for x in range(count):
        plane[x] = moved[x, 0] * moved[x, 0] + moved[x, 1] * moved[x, 1]
    for x in range(count):
        plane[x] = log1p(np.sqrt(plane[x])) / FOUR


LINES, FACTOR, MEAN, VALID, SHARE, BEFORE, SHARES = 11, 0, 3, 6, 7, 8, 9
"""Rows of intermediate results of a row: reflectance 3, the last output's mean 3, validity of the history, share of it
that counts, depth before, and shares of the history's pixels 2."""


@compiled
def edges_of(window: np.ndarray, count: int) -> np.ndarray:
    """The first output column that each of a part's first columns touches, and the one after the last: (2, count), of
    the part."""
    w, width, first = int(window[WIDTH]), int(window[OUT_WIDTH]), int(window[LEFT])
    edges = np.empty((2, count), np.int64)
    for x in range(count):
        edges[0, x] = (first + x) * width // w - int(window[OUT_LEFT])
        edges[1, x] = -(-(first + x + 1) * width // w) - int(window[OUT_LEFT])
    return edges


@compiled
def feature_row(here: int, row: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                normal: np.ndarray, roughness: np.ndarray, depth: np.ndarray, moved: np.ndarray, state: np.ndarray,
                last_depth: np.ndarray, warped: np.ndarray, depth_scale: np.ndarray, params: np.ndarray,
                window: np.ndarray, keep: np.ndarray, edges: np.ndarray, lines: np.ndarray, places: np.ndarray,
                total: np.ndarray, light: np.ndarray, hidden: np.ndarray, features: np.ndarray) -> None:
    """The row ``here`` of a part: all features but the hidden state as planes' rows ``row``, up to the frame's right
    edge; ``light`` and ``hidden`` as in `recall_row`."""
    h, w, first, count = int(window[HEIGHT]), int(window[WIDTH]), int(window[LEFT]), edges.shape[1]
    height, above, y = int(window[OUT_HEIGHT]), int(window[OUT_TOP]), int(window[TOP]) + here
    factor, mean, valid, before = lines[FACTOR:MEAN], lines[MEAN:VALID], lines[VALID], lines[BEFORE]
    demodulation_row(diffuse_albedo[y, first:first + count], specular_albedo[y, first:first + count], factor[0],
                     factor[1], factor[2])
    kept_row(keep, here, lines[SHARE])
    locate_row(y, first, moved[here], h, w, lines[SHARE], places, lines[SHARES:], valid)
    recall_row(places, lines[SHARES:], state, last_depth, lines[SHARE], params[GAIN], before, valid, light, hidden)
    top, bottom = y * height // h - above, -(-(y + 1) * height // h) - above
    sum_rows(top, bottom, warped, total)
    mean_row(bottom - top, total, edges, mean)
    planes, end = features[0], first + count
    bounded_row(colour[y, first:end], ZERO, MAX_FLOAT, planes[0, row], planes[1, row], planes[2, row])
    light_row(light[:count], planes[3, row], planes[4, row], planes[5, row], planes[22, row])
    for c in range(3):
        encode_colour(planes[c, row], planes[3 + c, row], planes[6 + c, row], factor[c], params[EXPOSURE], mean[c],
                      valid)
    bounded_row(diffuse_albedo[y, first:end], ZERO, TWO, planes[9, row], planes[10, row], planes[11, row])
    bounded_row(specular_albedo[y, first:end], ZERO, TWO, planes[12, row], planes[13, row], planes[14, row])
    bounded_row(normal[y, first:end], -ONE, ONE, planes[15, row], planes[16, row], planes[17, row])
    rough = planes[18, row]
    for x in range(count):
        rough[x] = clamp(roughness[y, first + x, 0], ZERO, ONE)
    depth_planes(row, depth[y, first:], before, valid, depth_scale[0], features)
    planes[21, row, :count] = valid
    motion_plane(row, moved[here], count, features)
    features[0, 23, row, :] = params[JITTER_X]
    features[0, 24, row, :] = params[JITTER_Y]
    features[0, 26, row, :] = np.float32(w) / np.float32(int(window[OUT_WIDTH]))


@compiled
def feature_rows(y0: int, y1: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                 normal: np.ndarray, roughness: np.ndarray, depth: np.ndarray, moved: np.ndarray, state: np.ndarray,
                 last_depth: np.ndarray, warped: np.ndarray, depth_scale: np.ndarray, params: np.ndarray,
                 window: np.ndarray, keep: np.ndarray, seen_rows: np.ndarray, seen_columns: np.ndarray,
                 past: np.ndarray, features: np.ndarray) -> None:
    """The network's input and the reprojected accumulation."""
    wide, count = past.shape[1], min(past.shape[1], int(window[WIDTH]) - int(window[LEFT]))
    edges, places = edges_of(window, count), np.empty((PLACES, count), np.int32)
    lines, hidden = np.empty((LINES, count), np.float32), np.empty((count, HIDDEN), np.float32)
    total, spare = np.empty(3 * warped.shape[1], np.float32), np.empty((wide, 4), np.float32)
    for row in range(y0, y1):
        light = past[row] if row < past.shape[0] else spare
        feature_row(int(seen_rows[row]), row, colour, diffuse_albedo, specular_albedo, normal, roughness, depth, moved,
                    state, last_depth, warped, depth_scale, params, window, keep, edges, lines, places, total, light,
                    hidden, features)
        for c in range(HIDDEN):
            for x in range(count):
                features[0, PLANAR + c, row, x] = hidden[x, c]
        for c in range(FEATURES):
            for x in range(count, features.shape[3]):
                features[0, c, row, x] = features[0, c, row, int(seen_columns[x])]
        for x in range(count, wide):
            light[x] = light[int(seen_columns[x])]


LOOKS = ("colour", *REFLECTANCE, "normal", "roughness", "depth", "moved", "state", "last_depth", "warped",
         "depth_scale", "params", "window", "keep", "seen_rows", "seen_columns")
FEATURE = kernel("features", LOOKS, ("past", "features"), feature_rows, ("features", 2))


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


@compiled
def stored_feature_rows(y0: int, y1: int, colour: np.ndarray, diffuse_albedo: np.ndarray, specular_albedo: np.ndarray,
                        normal: np.ndarray, roughness: np.ndarray, depth: np.ndarray, moved: np.ndarray,
                        state: np.ndarray, last_depth: np.ndarray, warped: np.ndarray, depth_scale: np.ndarray,
                        params: np.ndarray, window: np.ndarray, keep: np.ndarray, seen_rows: np.ndarray,
                        seen_columns: np.ndarray, coding: np.ndarray, past: np.ndarray, stored: np.ndarray) -> None:
    """The same in 8 bits as `postfx.kernels.denoise.network_io.store_rows` would write it, without a plane between."""
    wide, count = past.shape[1], min(past.shape[1], int(window[WIDTH]) - int(window[LEFT]))
    edges, places = edges_of(window, count), np.empty((PLACES, count), np.int32)
    lines, hidden = np.empty((LINES, count), np.float32), np.empty((count, HIDDEN), np.float32)
    total, spare = np.empty(3 * warped.shape[1], np.float32), np.empty((wide, 4), np.float32)
    ring, features = (stored.shape[1] - seen_rows.size) // 2, np.empty((1, PLANAR, 1, count), np.float32)
    words, codes = np.empty((stored.shape[3] // WORD, count), np.int32), np.empty(HIDDEN * count, np.uint8)
    codings = np.empty((2, HIDDEN * count), np.float32)
    for i in range(HIDDEN * count):
        codings[0, i], codings[1, i] = coding[0, PLANAR + i % HIDDEN], coding[1, PLANAR + i % HIDDEN]
    for at in range(y0, y1):
        row, pixels = at - ring, stored[0, at].view(np.int32)
        if ring:
            zero_words(coding, pixels)
        if not 0 <= row < seen_rows.size:
            continue
        light = past[row] if row < past.shape[0] else spare
        feature_row(int(seen_rows[row]), 0, colour, diffuse_albedo, specular_albedo, normal, roughness, depth, moved,
                    state, last_depth, warped, depth_scale, params, window, keep, edges, lines, places, total, light,
                    hidden, features)
        for c in range(0, PLANAR, WORD):
            code_four(features[0, c, 0], features[0, c + 1, 0], features[0, c + 2, 0],
                      features[0, min(c + 3, PLANAR - 1), 0], c, coding, words[c // WORD])
        code_row(hidden.reshape(hidden.size), codings, codes)
        join_words(codes.view(np.int32), np.int32(coding[1, FEATURES]), words[PLANAR // WORD:])
        place_words(words, pixels[ring:])
        for x in range(count, seen_columns.size):
            pixels[ring + x] = pixels[ring + int(seen_columns[x])]
        for x in range(count, wide):
            light[x] = light[int(seen_columns[x])]


STORED_FEATURE = Kernel(
    f"{FEATURE.name}_stored", (*LOOKS, "coding"), ("past", "stored"), stored_feature_rows, ("stored", 1),
    {name: shape for name, shape in FEATURE.shapes.items() if name != "features"}
    | {"coding": (2, "wide"), "stored": (1, "stored_h", "stored_w", "wide")}, {"stored": "uint8"})
"""Features in 8 bits, with a border or without."""


@compiled
def mirrored_rows(y0: int, y1: int, denoising_albedo: np.ndarray, denoising_normal: np.ndarray, window: np.ndarray,
                  seen_rows: np.ndarray, seen_columns: np.ndarray, mirrored: np.ndarray) -> None:
    """Planes of what mirrors and glass show, as planes: albedo 0, normal 3. The torch definition is
    ``training.denoise.model.mirrored_features``."""
    first, count = int(window[LEFT]), min(seen_columns.size, int(window[WIDTH]) - int(window[LEFT]))
    for row in range(y0, y1):
        y, end = int(window[TOP]) + int(seen_rows[row]), first + count
        bounded_row(denoising_albedo[y, first:end], ZERO, ONE, mirrored[0, 0, row], mirrored[0, 1, row],
                    mirrored[0, 2, row])
        bounded_row(denoising_normal[y, first:end], -ONE, ONE, mirrored[0, 3, row], mirrored[0, 4, row],
                    mirrored[0, 5, row])
        for c in range(MIRRORED):
            for x in range(count, seen_columns.size):
                mirrored[0, c, row, x] = mirrored[0, c, row, int(seen_columns[x])]


MIRROR = kernel("mirrored", (*MIRRORED_PLANES, "window", "seen_rows", "seen_columns"), ("mirrored",), mirrored_rows,
                ("mirrored", 2))


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


TRUST = kernel("trust", (*REFLECTANCE, *GUIDE_REFLECTANCE, "window", "part_rows", "part_columns"), ("trust",),
               trust_rows, ("trust", 0))
