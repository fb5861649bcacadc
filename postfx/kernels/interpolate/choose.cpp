// Rows of which path shows what is at a cell between two frames.
#include "choose.h"

constexpr float FAR = 1e30f;  // stands for an unknown depth or a larger one
constexpr float ALIKE = 0.04f;  // relative difference in depth of paths that are one surface
constexpr float SURE = 0.7f;  // share of a cell's paths that the other frame must see
constexpr float BETTER = 1.5f;  // times as well another path must fit to be taken
constexpr float SAME = 0.5f;  // pixels by which a flow must differ from the whole way of a path
constexpr float EXPLAINED = 2.0f;  // times the misfit and noise of a flow that leads elsewhere
constexpr float ELSE = 0.5f;  // share of a depth below which something is another thing, in front
constexpr float BETTER_STILL = 4.0f;  // times as well another path must fit than one that stands
constexpr float UNSEEN = 0.12f;  // stands for the misfit of a path that cannot be compared
constexpr float UNSEEN_NOISE = 2.0f;  // what is added to it, in units of the noise
constexpr float TRUSTED = 0.5f;  // share of that misfit below which a path is seen after all
constexpr float TWIST = 0.15f;  // change of the way along a pixel that windows do not follow
constexpr float EVEN = 0.5f;  // pixels by which the way may be uneven from cell to cell
constexpr float BEFORE = 0.85f;  // share of the depth behind a thing that keeps its cell
constexpr float ONE_THING = 0.7f;  // share of its contrast by which it may differ between frames
constexpr float APART = 0.15f;  // misfit from which what stands still must be something else
constexpr float NEARLY = 0.99f;  // share of a bound that a sum of rounded numbers keeps to
constexpr Long BESIDE[5][2] = {{0, 0}, {0, 1}, {1, 0}, {0, -1}, {-1, 0}};  // cells that are tried

// A path of one frame's side, in pixels: that frame shows it, the other one if most paths that
// arrived are seen.
FN Path side_path(const float* side, bool is_last, float scale) {
    const float seen = side[4] >= SURE ? 1.0f : 0.0f;
    return {scale * side[0], scale * side[1], scale * side[2], scale * side[3],
            is_last ? seen : 1.0f, is_last ? 1.0f : seen};
}

// The path of a flow, by shares of it that lead to the frame before and to the one after.
FN Path path_by(const float* flow, float back, float on) {
    return {back * flow[0], back * flow[1], on * flow[0], on * flow[1], 1.0f, 1.0f};
}

// What arrived at the cells, of both sides: paths, in cells, and depth, FAR without.
struct Arrived {
    Both<Field> paths;
    Both<Plane> depth;
    typedef Arrays<Both<Field>, Both<Plane>> Members;
};

// The nearer path of both sides at each cell, or their mean where they are alike; NaN without.
static void merge_row(Long y, Arrived of, Places scales, NewField own) {
    const float scale = *scales.at;
    for (Long x = 0; x < own.size[1]; x++) {
        const float a = of.depth.before(y)[x], b = of.depth.after(y)[x];
        Path path = side_path(of.paths.before(y, x), false, scale);
        const Path other = side_path(of.paths.after(y, x), true, scale);
        const float most = 1.5f * ALIKE * smaller<float>(b, a);
        if (a < FAR && b < FAR && size_of<float>(a - b) <= most) {
            // each side is sure of its own frame, and asked about the other one
            const bool is_seen = other.first + path.last > 0.0f;
            path = {0.5f * (path.ax + other.ax), 0.5f * (path.ay + other.ay),
                    0.5f * (path.bx + other.bx), 0.5f * (path.by + other.by),
                    is_seen ? other.first : 1.0f, is_seen ? path.last : 1.0f};
        } else if (!(a < b)) {
            path = other;
        }
        store(own(y, x), path);
    }
}
EXPORT(merge_sides, merge_row)

// How much both sides' paths differ from a cell's own one, and that from those to the right and
// below, in pixels: its last two numbers.
static void change_row(Long y, Both<Field> sides, Places scales, NewField own) {
    const Long h = own.size[0], w = own.size[1];
    const float scale = *scales.at;
    const Long below = y == h - 1 ? y : y + 1;
    for (Long x = 0; x < w; x++) {
        const float *before = sides.before(y, x), *after = sides.after(y, x);
        float* cell = own(y, x);
        float apart = most_apart(before, cell, scale);
        const float other = most_apart(after, cell, scale);
        if (*before != *before) apart = 0.0f;  // where there is no path
        cell[6] = *after == *after ? larger<float>(other, apart) : apart;
        cell[7] = most_changed(cell, own(y, x == w - 1 ? x : x + 1), own(below, x));
    }
}
EXPORT(measure_change, change_row)

// Whether no path of both sides at a cell and at the four beside it differs from its own: known by
// their changes from cell to cell.
FN bool is_alone(const Field& own, Long y, Long x) {
    constexpr float MOST = NEARLY * OTHER;
    const float* left = own(y, larger<Long>(x - 1, 0));
    const float* up = own(larger<Long>(y - 1, 0), x);
    const float* right = own(y, smaller<Long>(x + 1, own.size[1] - 1));
    const float* low = own(smaller<Long>(y + 1, own.size[0] - 1), x);
    const float* cell = own(y, x);
    const float beside = larger<float>(low[6], right[6]) + cell[7];
    return larger<float>(beside, cell[6]) <= MOST && left[6] + left[7] <= MOST
        && up[6] + up[7] <= MOST;
}

// Whether around a cell one frame is turned or stretched evenly against the other one, by much.
FN bool is_turning(const Field& own, Long y, Long x, float size) {
    if (!(1 <= y && y < own.size[0] - 1 && 1 <= x && x < own.size[1] - 1)) return false;
    const float before = larger<float>(own(y, x - 1)[7], own(y - 1, x)[7]);
    if (before + own(y, x)[7] < NEARLY * TWIST * size) return false;
    const float* cell = own(y, x);
    float most = 0.0f;
    double uneven = 0.0;
    for (Long c = 0; c < 2; c++) {
        for (int turn = 0; turn < 2; turn++) {
            const float* one = own(y - turn, x - 1 + turn);
            const float* other = own(y + turn, x + 1 - turn);
            const float twist = other[c + 2] - one[c + 2] - other[c] + one[c];
            most = larger<float>(size_of<float>(twist), most);
            const double bend = one[c] + other[c] - 2.0 * cell[c];
            const double bend_after = one[c + 2] + other[c + 2] - 2.0 * cell[c + 2];
            const double bent = larger<double>(size_of(bend_after), size_of(bend));
            uneven = larger<double>(bent, uneven);
        }
    }
    return 2.0f * TWIST * size < most && uneven < EVEN;
}

// The cell of a pixel's place, which is held in the picture.
struct Place {
    Long y, x;
};
FN Place cell_of(const Plane& cells, double y, double x, float size) {
    return {Long(within_double((y + 0.5) / size, double(cells.size[0] - 1))),
            Long(within_double((x + 0.5) / size, double(cells.size[1] - 1)))};
}

// What the paths of cells are chosen from: a cell's own one, and how it changes; those of both
// sides; the flow of both frames to the other one, in pixels, or empty, and that of what the frame
// after reflects to the one before; what the planes of both frames tell of where their pixels go,
// for flows; and their depth.
struct Numbers {
    float time, scale, noise;
};
struct Choice {
    Toned toned;
    Field own;
    Arrived arrived;
    Both<Field> flow;
    Field mirrored;
    Both<Field> ends;
    Both<Plane> seen, depth;
    Given<Numbers> numbers;
    typedef Arrays<Toned, Field, Arrived, Both<Field>, Field, Both<Field>, Both<Plane>, Both<Plane>,
                   Given<Numbers>> Members;
};

// Misfit of the path that a frame's planes give what it shows at a pixel; -1 where the other frame
// hides it.
FN float end_misfit(const Choice& of, const Field& ends, const Plane& seen, double y, double x) {
    const float size = of.numbers->scale;
    const Place at = cell_of(seen, y, x, size);
    if (!(seen(at.y)[at.x] > 0.0f)) return -1.0f;
    const float* own = ends(at.y, at.x);
    return misfit(of.toned, y, x,
                  {size * own[0], size * own[1], size * own[2], size * own[3], 1.0f, 1.0f});
}

// Whether what a flow shows in one of the frames goes elsewhere by its planes, with a misfit of
// `most` or less: the flow then leads from one thing to another.
static inline bool is_explained(const Choice& of, double y, double x, const Path& path,
                                float most) {
    const float one = end_misfit(of, of.ends.before, of.seen.before, y + path.ay, x + path.ax);
    if (0.0f <= one && one <= most) return true;
    const float other = end_misfit(of, of.ends.after, of.seen.after, y + path.by, x + path.bx);
    return 0.0f <= other && other <= most;
}

// A path that may show a cell, how far away it leads, and what tells of it.
enum Source { NONE, SIDE, FLOW, MIRROR };
struct Candidate {
    Path path;
    float depth;
    Source source;
};

// Chooses between the paths of one cell. Paths are tried one by one: `best` is the misfit of the
// one that is taken, -2 as long as nothing was compared, as many cells have no other path around
// them.
struct Chooser {
    const Choice& of;
    Long row, column;
    double y, x;  // the cell's middle, in pixels
    float noise, unseen, depth, better;
    Path own, taken, tried;
    float best = -2.0f, margin = 0.0f;
    bool is_seen = false;

    FN_MEMBER Chooser(const Choice& of, Long row, Long column, double y, double x)
        : of(of), row(row), column(column), y(y), x(x), noise(of.numbers->noise),
          unseen(UNSEEN + UNSEEN_NOISE * noise),
          depth(smaller<float>(of.arrived.depth.after(row)[column],
                               of.arrived.depth.before(row)[column])),
          own(path_at(of.own(row, column))), taken(own), tried(own) {
        better = own.is_still() ? BETTER_STILL : BETTER;
    }
    FN_MEMBER bool owns_both() const { return own.first + own.last == 2.0f; }
    FN_MEMBER bool fits(float misfit) const {
        return 0.0f <= misfit && misfit < TRUSTED * unseen;
    }

    // The path of a side at a cell beside this one.
    FN_MEMBER Candidate from_side(bool is_last, const Long (&step)[2]) const {
        const Field& paths = is_last ? of.arrived.paths.after : of.arrived.paths.before;
        const Plane& depths = is_last ? of.arrived.depth.after : of.arrived.depth.before;
        const Long j = row + step[0], i = column + step[1];
        if (!(0 <= j && j < paths.size[0] && 0 <= i && i < paths.size[1])) return {{}, 0.0f, NONE};
        const float scale = of.numbers->scale;
        if (!(most_apart(paths(j, i), of.own(row, column), scale) > OTHER)) {
            return {{}, 0.0f, NONE};
        }
        return {side_path(paths(j, i), is_last, scale), depths(j)[i], SIDE};
    }
    // The path of a frame's flow. Two bars that look alike are not one: what leads to another thing
    // in front is none.
    FN_MEMBER Candidate from_flow(bool is_last) const {
        const float time = of.numbers->time;
        const float* flow = (is_last ? of.flow.after : of.flow.before)(row, column);
        return {is_last ? path_by(flow, time, time - 1.0f) : path_by(flow, -time, 1.0f - time),
                depth, FLOW};
    }
    // The path of what is reflected: there, the motion is that of the place to which the path
    // leads.
    FN_MEMBER Candidate from_mirror() const {
        const float time = of.numbers->time, scale = of.numbers->scale;
        const Path path = path_by(of.mirrored(row, column), time, time - 1.0f);
        if (!path.is_path()) return {path, depth, MIRROR};
        const Long h = of.own.size[0], w = of.own.size[1];
        const Long j = Long(within_double(double(row) + path.by / scale + 0.5, double(h - 1)));
        const Long i = Long(within_double(double(column) + path.bx / scale + 0.5, double(w - 1)));
        return {path_by(of.mirrored(j, i), time, time - 1.0f), depth, MIRROR};
    }

    // Whether a flow tells something else than the cell's own path; then its depth is that of what
    // it shows.
    FN_MEMBER bool is_other_thing(Candidate& candidate) const {
        const Path& path = candidate.path;
        const float right = size_of<float>(path.bx - path.ax - own.bx + own.ax);
        const float down = size_of<float>(path.by - path.ay - own.by + own.ay);
        if (larger<float>(down, right) < SAME) return false;
        const float size = of.numbers->scale;
        const Place before = cell_of(of.depth.before, y + path.ay, x + path.ax, size);
        const Place after = cell_of(of.depth.after, y + path.by, x + path.bx, size);
        const float one = of.depth.before(before.y)[before.x];
        const float other = of.depth.after(after.y)[after.x];
        if (larger<float>(other, one) < ELSE * candidate.depth && candidate.depth < FAR) {
            return false;
        }
        candidate.depth = smaller<float>(other, one);
        return true;
    }
    // Whether the cell's own path shows a thing in front of what the candidate does: the wall fits
    // around a thin bar, not at it.
    FN_MEMBER bool is_in_front(const Candidate& candidate) const {
        if (!(depth < BEFORE * candidate.depth && owns_both())) return false;
        const float allowed = of.toned.difference(y, x, candidate.path) + noise
                            + ONE_THING * of.toned.contrast(y, x, own, candidate.path);
        return of.toned.difference(y, x, own) <= allowed;
    }

    // Takes a candidate if it fits much better; false where nothing can.
    FN_MEMBER bool consider(Candidate candidate) {
        const Path& path = candidate.path;
        if (candidate.source == NONE || !path.is_path()) return true;
        if (!(differ(path, taken) && differ(path, tried))) return true;
        tried = path;
        if (candidate.source == FLOW && !is_other_thing(candidate)) return true;
        if (is_in_front(candidate)) return true;
        if (candidate.source == SIDE) margin = noise;
        if (best < -1.0f) {
            best = misfit(of.toned, y, x, own);
            is_seen = fits(best) && candidate.source == SIDE;
            if (!fits(best) && (best < 0.0f || own.first + own.last < 2.0f)) best = unseen;
        }
        if (best <= noise) return false;
        float fit = misfit(of.toned, y, x, path);
        const bool is_fit = fits(fit);
        if (!is_fit && (fit < 0.0f || path.first + path.last < 2.0f)) fit = unseen;
        if (!((best < APART ? better : BETTER) * fit + margin < best)) return true;
        if (candidate.source == FLOW && is_fit && own.first + own.last < 2.0f
            && is_explained(of, y, x, path, EXPLAINED * (fit + noise))) {
            return true;
        }
        best = fit;
        taken = path;
        is_seen = is_fit;
        return true;
    }
    // Tries paths in order: of both sides at this cell and beside it, of both flows, of mirrors.
    FN_MEMBER void consider_all(bool alone) {
        for (int side = alone ? 2 : 0; side < 2; side++) {
            for (const auto& step : BESIDE) {
                if (!consider(from_side(side == 1, step))) return;
            }
        }
        if (of.flow.before.size[0]) {
            if (!consider(from_flow(false)) || !consider(from_flow(true))) return;
        }
        if (of.mirrored.size[0]) consider(from_mirror());
    }
};

// The path of each cell: its own, or another one around it or of the flow that fits much better.
// The last two numbers are left.
static void choose_rows(Long first, Long last, Choice of, NewField cells) {
    const float scale = of.numbers->scale;
    const double middle = double(float(0.5 * (scale - 1.0f)));
    for (Long y = first; y < last; y++) {
        for (Long x = 0; x < cells.size[1]; x++) {
            const bool alone = is_alone(of.own, y, x);
            const float* own = of.own(y, x);
            bool has_flow = of.mirrored.size[0] > 0;
            if (of.flow.before.size[0]) {
                const float *ahead = of.flow.before(y, x), *back = of.flow.after(y, x);
                has_flow = has_flow || *ahead == *ahead || *back == *back;
            }
            // around what turns, no window that is moved alone fits
            const bool turns = own[4] + own[5] == 2.0f && is_turning(of.own, y, x, scale);
            if ((alone && !has_flow) || turns) {
                store<Eight>(cells(y, x), load<Eight>(own));
                continue;
            }
            Chooser chooser(of, y, x, double(scale) * double(y) + middle,
                            double(scale) * double(x) + middle);
            chooser.consider_all(alone);
            Path path = chooser.taken;
            if (chooser.is_seen) path.first = path.last = 1.0f;
            store(cells(y, x), path);
        }
    }
}
EXPORT(choose_paths, choose_rows)

// The share of detail over 8x6 places whose paths change from place to place as from a cell to the
// next ones.
static inline float turned_sharpness(const Toned& of, const Field& cells, Long row, Long column,
                                     const Numbers& numbers) {
    const float size = 1.0f / numbers.scale, middle = float(0.5 * (numbers.scale - 1.0f));
    const float* here = cells(row, column);
    const float *right = cells(row, column + 1), *low = cells(row + 1, column);
    const double y = double(numbers.scale) * double(row) + middle;
    const double x = double(numbers.scale) * double(column) + middle;
    Detail found = {0.0f, 0.0f};
    float above[8][2] = {};
    for (int j = 0; j <= ROWS; j++) {
        float left = 0.0f, left_after = 0.0f;
        for (int i = 0; i < 8; i++) {
            const float v = float(j) - 0.5f * ROWS, u = float(i) - 3.5f;
            const float down = v * size, across = u * size;
            float way[4];
            for (int c = 0; c < 4; c++) {
                way[c] = here[c] + across * (right[c] - here[c]) + down * (low[c] - here[c]);
            }
            const Path path = {way[0], way[1], way[2], way[3], 1.0f, 1.0f};
            const float one = of.value_before(y + v, x + u, path);
            const float other = of.value_after(y + v, x + u, path);
            if (i && j) {
                const float along = one - left, along_after = other - left_after;
                const float under = one - above[i][0], under_after = other - above[i][1];
                const float apart = along - along_after, apart_under = under - under_after;
                const float common = along + along_after, common_under = under + under_after;
                found.apart += apart * apart + apart_under * apart_under;
                found.common += common * common + common_under * common_under;
            }
            left = above[i][0] = one;
            left_after = above[i][1] = other;
        }
    }
    return share_of(found, numbers.noise);
}

// How sharp the pictures are at cells, measured once for two by two that follow one path, around
// their middle. The first row is even. Cells are joined.
static void detail_rows(Long first, Long last, Toned of, Given<Numbers> numbers, NewField cells) {
    const Long rows = cells.size[0], columns = cells.size[1];
    const double scale = double(numbers->scale);
    const Field known = {cells.at, {rows, columns, cells.size[2]}};
    for (Long y = first; y < last; y++) {
        for (Long x = 0; x < columns; x++) {
            float* cell = cells(y, x);
            const float* even = cells(y - y % 2, x - x % 2);
            const Path path = path_at(cell);
            if (even != cell) {
                const Path one = path_at(even);
                if (!differ(path, one) && path.first + path.last == one.first + one.last) {
                    cell[6] = even[6];
                    continue;
                }
            }
            if (cell[7] > 1.0f && y < rows - 1 && x < columns - 1) {
                const bool is_hidden = path.first + path.last < 2.0f;
                cell[6] = is_hidden ? 1.0f : turned_sharpness(of, known, y, x, *numbers);
                continue;
            }
            const double at = even == cell ? scale - 0.5 : double(float(0.5 * (scale - 1.0)));
            cell[6] = sharpness(of, scale * double(y) + at, scale * double(x) + at, path,
                                numbers->noise);
        }
    }
}
EXPORT(measure_detail, detail_rows)

// Misfit of one of 4x4 cells of the frame after that the frame before shows too; -1 elsewhere.
static void misfit_row(Long row, Toned of, Field ends, Plane seen, Places scales, NewPlane found) {
    const float size = *scales.at, middle = float(0.5 * (size - 1.0f));
    for (Long column = 0; column < found.size[1]; column++) {
        const Long y = 4 * row + 2, x = 4 * column + 2;
        const float* own = ends(y, x);
        const Path path = {size * own[0], size * own[1], size * own[2], size * own[3], 1.0f, 1.0f};
        const double down = double(size) * double(y) + middle;
        const double right = double(size) * double(x) + middle;
        found(row)[column] = seen(y)[x] != 0.0f ? misfit(of, down, right, path) : -1.0f;
    }
}
EXPORT(measure_misfits, misfit_row)
