// Rows of what pictures show that their planes do not tell: motion, and what lies over the scene.
#include "flow.h"

constexpr float AGREE = 0.5f;  // pixels by which the way there and back may miss
constexpr Long BESIDE = 3;  // cells to what is beside a cell in a patch
constexpr float OTHERWISE = 2.0f;  // cells by which that must move differently to matter
constexpr float SAME = 0.5f;  // pixels by which a flow must differ from motion by planes
constexpr float THIRD = 1.0f / 3.0f;
constexpr float LEAST_APART = 2e-3f;  // difference that even what fits best is taken to have
constexpr float EDGE = 0.02f;  // relative difference of colours that is an edge
constexpr float LEAST_MOTION = 0.5f;  // pixels by which the scene behind an overlay must move

// Grey of the range 0 to 1, with margins, in which differences are about as visible in the dark as
// in the light: numbers are the light in the middle, and pixels of a margin. Rows above and below
// the picture are left as they are.
static void tone_row(Long y, Field picture, Places numbers, NewPlane toned) {
    const Long w = picture.size[1], margin = Long(numbers.at[1]);
    const float level = numbers.at[0];
    const float* from = picture(y);
    float* row = toned(y + margin) + margin;
    across(0, w, EACH(F, Long x) {
        F shade[3];
        for (int c = 0; c < 3; c++) {
            const F bright = larger<F>(pick<F, 3>(from + 3 * x + c), F(0.0f));
            shade[c] = root_of(bright / (bright + level));
        }
        store<F>(row + x, (shade[0] + shade[1] + shade[2]) * THIRD);
    });
    for (Long beside = 0; beside < margin; beside++) {
        row[beside - margin] = row[0];
        row[w + beside] = row[w - 1];
    }
}
EXPORT(tone_rows, tone_row)

// Means of 2x2 pixels within a margin.
static void average_rows(Long first, Long last, Plane picture, Places margins, NewPlane means) {
    const Long margin = Long(*margins.at);
    for (Long y = first; y < last; y++) {
        const float* upper = picture(2 * y + margin) + margin;
        const float* lower = upper + picture.size[1];
        across(0, means.size[1], EACH(F, Long x) {
            const F left = pick<F, 2>(upper + 2 * x) + pick<F, 2>(lower + 2 * x);
            const F sum = left + pick<F, 2>(upper + 2 * x + 1) + pick<F, 2>(lower + 2 * x + 1);
            store<F>(means(y) + x, sum * 0.25f);
        });
    }
}
EXPORT(average_fours, average_rows)

// Linear interpolation between centres, in pixels of the larger picture.
static Status enlarge_rows(Long first, Long last, Field flow, NewField larger_flow) {
    const Long h = flow.size[0], w = flow.size[1];
    const Long height = larger_flow.size[0], width = larger_flow.size[1];
    const WideTwo size = {double(float(double(width) / double(w))),
                          double(float(double(height) / double(h)))};
    const Room<Beside> places(width);
    if (!places) return NO_MEMORY;
    for (Long x = 0; x < width; x++) {
        const Beside place = centre_between(x, w, width);
        places.at[x] = {place.first, place.second, double(float(place.share))};
    }
    for (Long y = first; y < last; y++) {
        const Beside down = centre_between(y, h, height);
        for (Long x = 0; x < width; x++) {
            const WideTwo moved = motion_between(flow, down, places.at[x]) * size;
            store<Two>(larger_flow(y, x), __builtin_convertvector(moved, Two));
        }
    }
    return DONE;
}
EXPORT(enlarge_flow, enlarge_rows)

// Motion of each patch and its misfit, from the coarser level's: down and right, then up and left,
// so that motion spreads in both directions. Pictures have margins.
static void search_rows(Long, Long, Plane one, Plane other, Field flow, NewField moved) {
    const Searched of = {one.at, other.at, one.size[0] - 2 * MARGIN, one.size[1] - 2 * MARGIN};
    const Long rows = moved.size[0], columns = moved.size[1], half = PATCH / 2;
    const WideTwo size = {double(float(double(of.w) / double(flow.size[1]))),
                          double(float(double(of.h) / double(flow.size[0])))};
    for (int turn = 0; turn < 2; turn++) {
        const Long step = turn == 0 ? -1 : 1;
        for (Long k = 0; k < rows * columns; k++) {
            const Long at = turn == 0 ? k : rows * columns - 1 - k;
            const Long row = at / columns, column = at % columns;
            const Long top = row * STRIDE, left = column * STRIDE;
            float* own = moved(row, column);
            Found best = {own[0], own[1], own[2]};
            if (turn == 0) {
                const Beside down = centre_between(smaller<Long>(top + half, of.h - 1),
                                                   flow.size[0], of.h);
                const Beside across = centre_between(smaller<Long>(left + half, of.w - 1),
                                                     flow.size[1], of.w);
                const WideTwo start = motion_between(flow, down, across) * size;
                best = {start[0], start[1], misfit(of, top, left, start[0], start[1])};
            }
            const float began = best.misfit;
            const Long near[2][2] = {{row + step, column}, {row, column + step}};
            for (const auto& place : near) {
                const bool is_there = place[0] >= 0 && place[0] < rows && place[1] >= 0
                                   && place[1] < columns;
                if (!is_there) continue;
                const float* beside = moved(place[0], place[1]);
                const float fit = misfit(of, top, left, beside[0], beside[1]);
                if (fit < best.misfit) best = {beside[0], beside[1], fit};
            }
            if (turn == 0 || best.misfit < began) best = descend(of, top, left, best);
            own[0] = float(best.u);
            own[1] = float(best.v);
            own[2] = best.misfit;
        }
    }
}
EXPORT(search_flow, search_rows)

// Motion of each pixel: the mean of the patches over it, by how well they fit there.
static void spread_row(Long y, Plane one, Plane other, Field moved, NewField flow) {
    const Searched of = {one.at, other.at, flow.size[0], flow.size[1]};
    const Long rows = moved.size[0], columns = moved.size[1], reach = PATCH / STRIDE - 1;
    const Long last_row = smaller<Long>(y / STRIDE, rows - 1);
    for (Long x = 0; x < of.w; x += STRIDE) {
        const Long last_column = smaller<Long>(x / STRIDE, columns - 1);
        const Four own = load<Four>(of.patch(y, x));
        WideFour sum = 0.0, across = 0.0, down = 0.0;
        for (Long row = larger<Long>(last_row - reach, 0); row <= last_row; row++) {
            for (Long column = larger<Long>(last_column - reach, 0); column <= last_column;
                 column++) {
                const float u = moved(row, column)[0], v = moved(row, column)[1];
                const Window there = of.at(float(double(y) + v), float(double(x) + u));
                const Four apart = magnitude(Lines<Four, 1>(there).row[0] - own);
                const WideFour share = 1.0 / __builtin_convertvector(LEAST_APART + apart, WideFour);
                sum += share;
                across += share * double(u);
                down += share * double(v);
            }
        }
        const WideFour right = across / sum, below = down / sum;
        for (Long k = 0; k < smaller<Long>(STRIDE, of.w - x); k++) {
            flow(y, x + k)[0] = float(right[k]);
            flow(y, x + k)[1] = float(below[k]);
        }
    }
}
EXPORT(spread_flow, spread_row)

// NaN where a motion leads out of the picture, or to where the other one does not lead back; else
// the motion in pixels of a picture that is larger by the scale.
static void consistent_rows(Long first, Long last, Field one, Field other, Places scales,
                            NewField kept) {
    const Long h = one.size[0], w = one.size[1];
    const float scale = *scales.at, most = AGREE / scale;
    for (Long y = first; y < last; y++) {
        for (Long x = 0; x < w; x++) {
            const float *moved = one(y, x);
            float* out = kept(y, x);
            out[0] = out[1] = __builtin_nanf("");
            const double u = double(x) + moved[0], v = double(y) + moved[1];
            const bool inside = u > -0.5 && u < double(w) - 0.5 && v > -0.5 && v < double(h) - 0.5;
            if (!inside) continue;
            const WideTwo back = motion_between(other, beside_of(v, h), beside_of(u, w));
            if (!(size_of(back[0] + moved[0]) <= most && size_of(back[1] + moved[1]) <= most)) {
                continue;
            }
            out[0] = scale * moved[0];
            out[1] = scale * moved[1];
        }
    }
}
EXPORT(keep_consistent, consistent_rows)

// Whether what is beside a cell moves otherwise: patches there show both, and their flow is of
// neither.
FN bool is_edge(const Field& motion, Long y, Long x) {
    const Long up = larger<Long>(y - BESIDE, 0), left = larger<Long>(x - BESIDE, 0);
    const Long low = smaller<Long>(y + BESIDE, motion.size[0] - 1);
    const Long right = smaller<Long>(x + BESIDE, motion.size[1] - 1);
    float most = 0.0f;
    for (int c = 0; c < 2; c++) {
        const float here = motion(y, x)[c];
        const float* beside[4] = {motion(up, x), motion(low, x), motion(y, left), motion(y, right)};
        for (const float* other : beside) {
            most = larger<float>(size_of<float>(other[c] - here), most);
        }
    }
    return most > OTHERWISE;
}

// Flow after a share of its way: numbers are cells of a pixel, and that share. What planes tell,
// too, is left out; where several arrive, that counts whose ends look most alike. least: more than
// pictures differ.
static void move_row(Long y, Field flow, Field known, Both<Plane> pictures, Places numbers,
                     NewPlane least, NewField brought) {
    const Long h = least.size[0], w = least.size[1];
    const float size = numbers.at[0], share = numbers.at[1];
    for (Long x = 0; x < w; x++) {
        const float *own = flow(y, x), *by_planes = known(y, x);
        const float u = size * own[0], v = size * own[1];
        if (u != u) continue;
        const float off = size_of<float>(u - by_planes[0]);
        if (larger<float>(size_of<float>(v - by_planes[1]), off) < SAME * size) {
            if (least(y)[x] > 1.0f) brought(y, x)[0] = __builtin_nanf("");
            continue;
        }
        if (is_edge(known, y, x)) continue;
        const double down = double(y) + v + 0.5, right = double(x) + u + 0.5;
        const bool inside = down >= 0.0 && right >= 0.0 && down < double(h) && right < double(w);
        if (!inside) continue;
        const float there = pictures.after(Long(down))[Long(right)];
        const float apart = size_of<float>(pictures.before(y)[x] - there);
        const Long top = floor_to_whole(double(y) + share * v);
        const Long left = floor_to_whole(double(x) + share * u);
        for (Long corner = 0; corner < 4; corner++) {
            const Long b = top + corner / 2, a = left + corner % 2;
            if (b < 0 || b >= h || a < 0 || a >= w || !(apart < least(b)[a])) continue;
            least(b)[a] = apart;
            store<Two>(brought(b, a), load<Two>(own));
        }
    }
}
EXPORT(move_flow, move_row)

// Overlays.

// Whether a pixel has the same colour in both frames.
FN bool is_same(const Both<Field>& pictures, Long y, Long x) {
    const float *one = pictures.before(y, x), *other = pictures.after(y, x);
    return one[0] == other[0] && one[1] == other[1] && one[2] == other[2];
}
struct Pixel {
    int y, x;
};
constexpr Pixel NEXT[4] = {{0, 1}, {1, 0}, {0, -1}, {-1, 0}};

// Marks as unknown what is drawn over both pictures and stands still while the scene behind it
// moves. Such pixels have the same bits in both frames and an edge beside them that has, too, and
// their motion is half a pixel or more; `reach` pixels with the same bits around them belong to
// them.
static Status overlay_rows(Long, Long, Both<Field> pictures, Field motion, Places reaches,
                           View<bool, 2> known) {
    const Long h = known.size[0], w = known.size[1];
    const int reach = int(*reaches.at);
    const Room<int> steps(h * w);
    const Room<Pixel> queue(h * w);
    if (!steps || !queue) return NO_MEMORY;
    Long head = 0, tail = 0;
    const auto is_there = PIXELS(Long j, Long i) { return j >= 0 && j < h && i >= 0 && i < w; };
    for (Long i = 0; i < h * w; i++) steps.at[i] = -1;
    for (Long y = 0; y < h; y++) {
        for (Long x = 0; x < w; x++) {
            const float* moved = motion(y, x);
            const float size = size_of<float>(moved[0]) + size_of<float>(moved[1]);
            if (!(is_same(pictures, y, x) && size >= LEAST_MOTION)) continue;
            for (const Pixel& next : NEXT) {
                const Long j = y + next.y, i = x + next.x;
                if (!is_there(j, i) || !is_same(pictures, j, i) || steps.at[y * w + x] >= 0) {
                    continue;
                }
                const float *own = pictures.before(y, x), *other = pictures.before(j, i);
                bool has_edge = false;
                for (int c = 0; c < 3; c++) {
                    const float light = size_of<float>(own[c]) + size_of<float>(other[c]);
                    has_edge = has_edge || size_of<float>(own[c] - other[c]) > EDGE * light;
                }
                if (!has_edge) continue;
                steps.at[y * w + x] = 0;
                queue.at[tail++] = {int(y), int(x)};
            }
        }
    }
    while (head < tail) {
        const Pixel at = queue.at[head++];
        const int step = steps.at[at.y * w + at.x];
        known(at.y)[at.x] = false;
        if (step >= reach) continue;
        for (const Pixel& next : NEXT) {
            const Long j = at.y + next.y, i = at.x + next.x;
            if (!is_there(j, i) || steps.at[j * w + i] >= 0 || !is_same(pictures, j, i)) continue;
            steps.at[j * w + i] = step + 1;
            queue.at[tail++] = {int(j), int(i)};
        }
    }
    return DONE;
}
EXPORT(find_overlay, overlay_rows)
