// Rows of small networks and of hash grids: see neural.py.
//
// Points go through the layers in strips, whose numbers lie beside one another. Sums are made in
// one order whatever a processor's vectors hold, so they are the same bits.
#include "neural.h"
#include "rows.h"

typedef View<const float, 2> Points;
typedef View<const float, 2> Partials;
typedef View<float, 2> Sums;

constexpr Long STRIP = 32;   // points of a strip
constexpr Long STRIPS = 8;   // kept until their gradients are summed: a core's cache has room
constexpr int LANES = 16;     // parts of a sum over points: two of a strip's points in each
constexpr Long PAIR = 2 * WIDE;  // points whose sums are held in registers at once

// Layers.

// A network's sizes, and where the parameters of its layers begin.
struct Network {
    Long layers, inputs, encoded, bands, widest;
    int activation;
    Long sizes[MOST_LAYERS + 1], starts[MOST_LAYERS + 1];

    explicit Network(const Facts& facts)
        : layers(Long(facts.layers)), inputs(Long(facts.inputs)), encoded(Long(facts.encoded)),
          bands(Long(facts.bands)), widest(0), activation(int(facts.activation)), sizes{},
          starts{} {
        for (Long layer = 0; layer <= layers; layer++) {
            sizes[layer] = Long(facts.sizes[layer]);
            widest = larger<Long>(sizes[layer], widest);
            if (layer == 0) continue;
            starts[layer] = starts[layer - 1] + (sizes[layer - 1] + 1) * sizes[layer];
        }
    }
};

// What the first layer reads of `count` points, in rows of a strip; 0 beside them.
static void encode(const Network& network, const Points& points, Long first, Long count,
                   float* rows) {
    for (Long k = 0; k < network.inputs; k++) {
        float* row = rows + k * STRIP;
        for (Long p = 0; p < count; p++) row[p] = points(first + p)[k];
        for (Long p = count; p < STRIP; p++) row[p] = 0.0f;
    }
    float* to = rows + network.inputs * STRIP;
    float factor = 1.0f;
    for (Long band = 0; band < network.bands; band++) {
        for (Long k = 0; k < network.encoded; k++) {
            for (Long p = 0; p < STRIP; p += WIDE) {
                const Wide turns = load<Wide>(rows + k * STRIP + p) * factor;
                const Wide whole = floor_of(turns + 0.5f);
                const Wide rest = (turns - whole) * 3.14159265358979f;
                const Waves<Wide> waves = waves_of<Wide>(whole, rest);
                store<Wide>(to + p, waves.sine);
                store<Wide>(to + STRIP + p, waves.cosine);
            }
            to += 2 * STRIP;
        }
        factor *= 2.0f;
    }
}

// Weights of a layer, as they lie or, TURNED, with rows as columns.
template <bool TURNED> struct Weights {
    const float* at;
    Long reads;

    FN_MEMBER const float* operator()(Long row, Long column) const {
        return TURNED ? at + column * reads + row : at + row * reads + column;
    }
};

// ROWS rows of the product of weights and a strip's `count` rows, from a bias each or from 0.
template <int ROWS, bool TURNED>
FN void combine_rows(const Weights<TURNED>& weights, const float* biases, const float* source,
                     Long count, Long row, float* target) {
    for (Long p = 0; p < STRIP; p += PAIR) {
        Wide low[ROWS], high[ROWS];
        UNROLL for (int j = 0; j < ROWS; j++) {
            low[j] = Wide(biases ? biases[row + j] : 0.0f);
            high[j] = low[j];
        }
        for (Long i = 0; i < count; i++) {
            const Wide one = load<Wide>(source + i * STRIP + p);
            const Wide other = load<Wide>(source + i * STRIP + p + WIDE);
            UNROLL for (int j = 0; j < ROWS; j++) {
                const float weight = *weights(row + j, i);
                low[j] += weight * one;
                high[j] += weight * other;
            }
        }
        UNROLL for (int j = 0; j < ROWS; j++) {
            store<Wide>(target + (row + j) * STRIP + p, low[j]);
            store<Wide>(target + (row + j) * STRIP + p + WIDE, high[j]);
        }
    }
}
template <bool TURNED>
static void combine(const Weights<TURNED> weights, const float* biases, const float* source,
                    Long count, Long rows, float* target) {
    constexpr int MOST = WIDE == 16 ? 8 : 4;  // rows: sums fill half of the registers
    Long row = 0;
    for (; row + MOST <= rows; row += MOST) {
        combine_rows<MOST>(weights, biases, source, count, row, target);
    }
    if (MOST == 8 && row + 4 <= rows) {
        combine_rows<4>(weights, biases, source, count, row, target);
        row += 4;
    }
    if (row + 2 <= rows) {
        combine_rows<2>(weights, biases, source, count, row, target);
        row += 2;
    }
    if (row < rows) combine_rows<1>(weights, biases, source, count, row, target);
}

// Replace numbers by the activation of them; slopes are kept where there is a place for them.
template <int KIND> static void activate_by(float* values, Long count, float* slopes) {
    for (Long k = 0; k < count; k += WIDE) {
        const Active<Wide> found = activated<KIND, Wide>(load<Wide>(values + k));
        store<Wide>(values + k, found.value);
        if (slopes) store<Wide>(slopes + k, found.slope);
    }
}
FN void activate(int kind, float* values, Long count, float* slopes) {
    if (kind == RELU) activate_by<RELU>(values, count, slopes);
    else if (kind == GELU) activate_by<GELU>(values, count, slopes);
    else activate_by<SINE>(values, count, slopes);
}

// One layer of a strip.
static void run_layer(const Network& network, Long layer, const float* parameters,
                      const float* source, float* target, float* slopes) {
    const Long reads = network.sizes[layer], makes = network.sizes[layer + 1];
    const float* weights = parameters + network.starts[layer];
    combine(Weights<false>{weights, reads}, weights + reads * makes, source, reads, makes, target);
    if (layer < network.layers - 1) activate(network.activation, target, makes * STRIP, slopes);
}

static Status forward_rows(Long first, Long last, Given<Facts> facts, Places parameters,
                           Points points, Sums values) {
    const Network network(*facts);
    const Long outputs = values.size[1];
    const Room<float> room(2 * network.widest * STRIP);
    if (!room) return NO_MEMORY;
    for (Long begin = first; begin < last; begin += STRIP) {
        const Long count = smaller<Long>(STRIP, last - begin);
        float *source = room.at, *target = source + network.widest * STRIP;
        encode(network, points, begin, count, source);
        for (Long layer = 0; layer < network.layers; layer++) {
            run_layer(network, layer, parameters.at, source, target, nullptr);
            float* const made = target;
            target = source;
            source = made;
        }
        for (Long p = 0; p < count; p++) {
            for (Long j = 0; j < outputs; j++) values(begin + p)[j] = source[j * STRIP + p];
        }
    }
    return DONE;
}
EXPORT(neural_forward, forward_rows)

// Gradients.

// Sums of neighbours: of the first vector, then of the second one.
template <int... I> FN Wide add_neighbours(Wide a, Wide b, List<int, I...>) {
    return TWO_OF(a, b, 2 * I) + TWO_OF(a, b, 2 * I + 1);
}
FN float total_of(Wide x) {
    for (int count = WIDE; count > 1; count /= 2) x = add_neighbours(x, x, Lanes());
    return x[0];
}

// Vectors that hold all lanes, and the sum of what was made of each.
constexpr int PARTS = LANES / WIDE;
template <class T> FN T total_of_parts(const T (&parts)[PARTS]) {
    if constexpr (PARTS == 4) return (parts[0] + parts[1]) + (parts[2] + parts[3]);
    else if constexpr (PARTS == 2) return parts[0] + parts[1];
    else return parts[0];
}

// Some columns of a row.
constexpr int DOWN = 4, ACROSS = WIDE == 16 ? 4 : 2, BLOCK = DOWN * ACROSS;
typedef float Columns __attribute__((ext_vector_type(ACROSS)));

// Add to a block of the matrix of weights' gradients the sums over points of left[j, p]
// right[i, p], of strips one after the other. Its rows and columns beyond the last repeat that.
struct Correlation {
    const float *left, *right;
    Long rows, columns, strips;
    float* gradients;

    FN_MEMBER void add_block(Long row, Long column) const {
        const float *lefts[DOWN], *rights[ACROSS];
        UNROLL for (int v = 0; v < DOWN; v++) lefts[v] = left + clip(row + v, rows) * STRIP;
        UNROLL for (int u = 0; u < ACROSS; u++) {
            rights[u] = right + clip(column + u, columns) * STRIP;
        }
        Wide found[BLOCK / WIDE][PARTS];
        for (int part = 0; part < PARTS; part++) add_part(lefts, rights, part, found);
        float sums[BLOCK];
        UNROLL for (int k = 0; k < BLOCK / WIDE; k++) {
            store<Wide>(sums + k * WIDE, total_of_parts<Wide>(found[k]));
        }
        if (row + DOWN <= rows && column + ACROSS <= columns) {
            UNROLL for (int v = 0; v < DOWN; v++) {
                float* const to = gradients + (row + v) * columns + column;
                Columns all, more;
                __builtin_memcpy(&all, to, sizeof all);
                __builtin_memcpy(&more, sums + v * ACROSS, sizeof more);
                all += more;
                store(to, all);
            }
            return;
        }
        for (Long v = 0; v < DOWN && row + v < rows; v++) {
            for (Long u = 0; u < ACROSS && column + u < columns; u++) {
                gradients[(row + v) * columns + column + u] += sums[v * ACROSS + u];
            }
        }
    }

    // The sums of the lanes in one vector.
    FN_MEMBER void add_part(const float* const (&lefts)[DOWN],
                            const float* const (&rights)[ACROSS], int part,
                            Wide (&found)[BLOCK / WIDE][PARTS]) const {
        Wide totals[BLOCK] = {};
        for (Long strip = 0; strip < strips; strip++) {
            for (Long p = part * WIDE; p < STRIP; p += LANES) {
                const Long here = strip * rows * STRIP + p, there = strip * columns * STRIP + p;
                Wide others[ACROSS];
                UNROLL for (int u = 0; u < ACROSS; u++) others[u] = load<Wide>(rights[u] + there);
                UNROLL for (int v = 0; v < DOWN; v++) {
                    const Wide one = load<Wide>(lefts[v] + here);
                    UNROLL for (int u = 0; u < ACROSS; u++) {
                        totals[ACROSS * v + u] += one * others[u];
                    }
                }
            }
        }
        UNROLL for (int count = BLOCK; count > BLOCK / WIDE; count /= 2) {
            UNROLL for (int k = 0; k < count / 2; k++) {
                totals[k] = add_neighbours(totals[2 * k], totals[2 * k + 1], Lanes());
            }
        }
        UNROLL for (int k = 0; k < BLOCK / WIDE; k++) found[k][part] = totals[k];
    }
};

// A group's points in a core's cache: of each layer what it reads of all strips, and the
// derivatives by that before its activation, which begin as the activation's slopes.
struct Kept {
    Room<float> room;
    float *layers[MOST_LAYERS + 1], *deltas[MOST_LAYERS + 1], *spare;

    explicit Kept(const Network& network)
        : room(count_of(network)), layers{}, deltas{}, spare(room.at) {
        float* place = spare + network.widest * STRIP;
        for (Long layer = 0; layer <= network.layers; layer++) {
            const Long count = STRIPS * STRIP * network.sizes[layer];
            layers[layer] = place;
            deltas[layer] = place + count;
            place += 2 * count;
        }
    }
    explicit operator bool() const { return bool(room); }

    static Long count_of(const Network& network) {
        Long count = network.widest * STRIP;
        for (Long layer = 0; layer <= network.layers; layer++) {
            count += 2 * STRIPS * STRIP * network.sizes[layer];
        }
        return count;
    }
};

// Of points: the sum of squared errors, and how many are learnt.
struct Error {
    double total;
    Long learnt;
};

// Derivatives of a strip's error by its values, times `share`; 0 of points that are not learnt.
static Error compare(const float* values, const View<const float, 2>& targets, Long first,
                     Long count, float share, float* deltas) {
    const Long outputs = targets.size[1];
    Error error = {0.0, 0};
    for (Long k = 0; k < outputs * STRIP; k++) deltas[k] = 0.0f;
    for (Long p = 0; p < count; p++) {
        const float* target = targets(first + p);
        bool known = true;
        for (Long j = 0; j < outputs; j++) {
            known = known && size_of<float>(target[j]) < __builtin_inff();
        }
        if (!known) continue;
        error.learnt++;
        for (Long j = 0; j < outputs; j++) {
            const float difference = values[j * STRIP + p] - target[j];
            error.total += double(difference * difference);
            deltas[j * STRIP + p] = 2.0f * share * difference;
        }
    }
    return error;
}

// Derivatives of every layer's result before its activation, in the place of the activation's
// slopes.
static void pull_back(const Network& network, const float* parameters, const Kept& kept,
                      Long strip) {
    for (Long layer = network.layers - 1; layer > 0; layer--) {
        const Long reads = network.sizes[layer], makes = network.sizes[layer + 1];
        const Weights<true> weights = {parameters + network.starts[layer], reads};
        combine(weights, nullptr, kept.deltas[layer + 1] + strip * makes * STRIP, makes, reads,
                kept.spare);
        float* const slopes = kept.deltas[layer] + strip * reads * STRIP;
        for (Long k = 0; k < reads * STRIP; k += WIDE) {
            store<Wide>(slopes + k, load<Wide>(slopes + k) * load<Wide>(kept.spare + k));
        }
    }
}

// Derivatives by the inputs of a strip's points, one in a row.
static void pull_inputs(const Network& network, const float* parameters, const Kept& kept,
                        Long strip, Long count, Long inputs, float* pulls) {
    const Long reads = network.sizes[0], makes = network.sizes[1];
    combine(Weights<true>{parameters, reads}, nullptr, kept.deltas[1] + strip * makes * STRIP,
            makes, reads, kept.spare);
    for (Long p = 0; p < count; p++) {
        for (Long k = 0; k < inputs; k++) pulls[p * inputs + k] = kept.spare[k * STRIP + p];
    }
}

// Add what the strips' points ask to the gradients of all parameters.
static void add_gradients(const Network& network, const Kept& kept, Long strips, float* gradients) {
    for (Long layer = 0; layer < network.layers; layer++) {
        const Long reads = network.sizes[layer], makes = network.sizes[layer + 1];
        float* const weights = gradients + network.starts[layer];
        float* const biases = weights + reads * makes;
        const Correlation correlation = {kept.deltas[layer + 1], kept.layers[layer], makes, reads,
                                         strips, weights};
        for (Long j = 0; j < makes; j += DOWN) {
            for (Long i = 0; i < reads; i += ACROSS) correlation.add_block(j, i);
        }
        for (Long j = 0; j < makes; j++) {
            float parts[PARTS];
            for (int part = 0; part < PARTS; part++) {
                Wide sum = Wide(0.0f);
                for (Long strip = 0; strip < strips; strip++) {
                    const Long at = (strip * makes + j) * STRIP + part * WIDE;
                    sum += load<Wide>(correlation.left + at);
                    sum += load<Wide>(correlation.left + at + LANES);
                }
                parts[part] = total_of(sum);
            }
            biases[j] += total_of_parts<float>(parts);
        }
    }
}

static Status gradient_rows(Long first, Long last, Given<Facts> facts, Places parameters,
                            Points points, View<const float, 2> targets, Sums partials,
                            Sums pulls) {
    const Network network(*facts);
    const Long total = points.size[0], groups = partials.size[0], sums = partials.size[1];
    const Long outputs = targets.size[1];
    const double numbers = double(total * outputs);
    const Kept kept(network);
    if (!kept) return NO_MEMORY;
    for (Long group = first; group < last; group++) {
        float* const gradients = partials(group);
        for (Long k = 0; k < sums; k++) gradients[k] = 0.0f;
        Error error = {0.0, 0};
        const Long end = (group + 1) * total / groups;
        Long begin = group * total / groups;
        while (begin < end) {
            Long strips = 0;
            for (; strips < STRIPS && begin < end; strips++) {
                const Long count = smaller<Long>(STRIP, end - begin);
                encode(network, points, begin, count,
                       kept.layers[0] + strips * network.sizes[0] * STRIP);
                for (Long layer = 0; layer < network.layers; layer++) {
                    const Long target = strips * network.sizes[layer + 1] * STRIP;
                    run_layer(network, layer, parameters.at,
                              kept.layers[layer] + strips * network.sizes[layer] * STRIP,
                              kept.layers[layer + 1] + target, kept.deltas[layer + 1] + target);
                }
                const Long made = strips * outputs * STRIP;
                const Error off = compare(kept.layers[network.layers] + made, targets, begin, count,
                                          float(1.0 / numbers), kept.deltas[network.layers] + made);
                error.total += off.total;
                error.learnt += off.learnt;
                pull_back(network, parameters.at, kept, strips);
                if (pulls.size[0] == total) {
                    pull_inputs(network, parameters.at, kept, strips, count, pulls.size[1],
                                pulls(begin));
                }
                begin += count;
            }
            add_gradients(network, kept, strips, gradients);
        }
        gradients[sums - 2] = float(error.total / numbers);
        gradients[sums - 1] = float(double(error.learnt) / double(total));
    }
    return DONE;
}
EXPORT(neural_gradients, gradient_rows)

// Steps of Adam.

// What makes the sum of groups a mean over the points that are learnt; 0 if there are none.
FN float scale_of(const Partials& partials) {
    float share = 0.0f;
    for (Long group = 0; group < partials.size[0]; group++) share += partials(group + 1)[-1];
    return share > 0.0f ? 1.0f / share : 0.0f;
}

// A step's size, and what makes the root of the mean square one.
struct Pace {
    float size, scale;
};
FN double power_of(double base, Long times) {
    double power = 1.0;
    for (; times > 0; times /= 2) {
        if (times % 2) power *= base;
        base *= base;
    }
    return power;
}
FN Pace pace_of(const Hyper& hyper, float step) {
    const Long steps = Long(step);
    return {float(double(hyper.rate) / (1.0 - power_of(double(hyper.slow), steps))),
            float(1.0 / __builtin_sqrt(1.0 - power_of(double(hyper.slower), steps)))};
}

// One step of a parameter, whose mean and mean square change.
template <class F> FN F step_of(const Hyper& hyper, Pace pace, F gradient, F& mean, F& square) {
    mean = hyper.slow * mean + (1.0f - hyper.slow) * gradient;
    square = hyper.slower * square + (1.0f - hyper.slower) * gradient * gradient;
    return pace.size * mean / (root_of(square) * pace.scale + hyper.epsilon);
}

static void adam_rows(Long first, Long last, Partials partials, Given<Hyper> hyper,
                      View<float, 1> parameters, Sums moments) {
    constexpr Long PIECE = 512;  // parameters whose groups are summed at once
    if (first >= last) return;
    const float learnt = scale_of(partials), step = moments(first)[2] + 1.0f;
    const Pace pace = pace_of(*hyper, step);
    for (Long begin = first; begin < last; begin += PIECE) {
        const Long count = smaller<Long>(PIECE, last - begin);
        float sums[PIECE];
        for (Long k = 0; k < count; k++) sums[k] = 0.0f;
        for (Long group = 0; group < partials.size[0]; group++) {
            const float* row = partials(group) + begin;
            across_once(0, count, EACH(F, Long k) {
                store<F>(sums + k, load<F>(sums + k) + load<F>(row + k));
            });
        }
        float *const own = parameters.at + begin, *const kept = moments(begin);
        across_once(0, count, EACH(F, Long k) {
            F mean = pick<F, 3>(kept + 3 * k), square = pick<F, 3>(kept + 3 * k + 1);
            const F change = step_of<F>(*hyper, pace, load<F>(sums + k) * learnt, mean, square);
            store_triples<F>(kept + 3 * k, mean, square, F(step));
            store<F>(own + k, load<F>(own + k) - change);
        });
    }
}
EXPORT(neural_adam, adam_rows)

// Hash grids.

constexpr double UNITS = 17592186044416.0;  // derivatives are summed as whole numbers: 2^44 of 1
constexpr float MOST_PULL = 131072.0f;      // one that fits into 64 bits, and some others with it
constexpr Long PRIMES[3] = {1, 2654435761, 805459861};

// The cell of a level that a point lies in: what each axis adds to the entry of its two corners,
// and their shares.
template <int DIMS> struct Cell {
    Long places[DIMS][2];
    float shares[DIMS][2];
    Long entries;
    bool is_dense;

    Cell(const GridFacts& grid, Long level, const float* point) : entries(Long(grid.entries)) {
        const Long side = Long(grid.sides[level]);
        Long corners = 1;
        UNROLL for (int axis = 0; axis < DIMS; axis++) corners *= side + 1;
        is_dense = corners <= entries;
        Long step = 1;
        UNROLL for (int axis = 0; axis < DIMS; axis++) {
            const float place = within<float>(point[axis], 0.0f, 1.0f) * float(side);
            const Long cell = smaller<Long>(Long(place), side - 1);
            const Long factor = is_dense ? step : PRIMES[axis];
            places[axis][0] = cell * factor;
            places[axis][1] = (cell + 1) * factor;
            shares[axis][1] = place - float(cell);
            shares[axis][0] = 1.0f - shares[axis][1];
            step *= side + 1;
        }
    }

    // Calls use(entry, share) for each corner.
    template <class Use> FN_MEMBER void each(const Use& use) const {
        UNROLL for (int corner = 0; corner < 1 << DIMS; corner++) {
            Long sum = 0, mixed = 0;
            float share = 1.0f;
            UNROLL for (int axis = 0; axis < DIMS; axis++) {
                const int bit = corner >> axis & 1;
                sum += places[axis][bit];
                mixed ^= places[axis][bit];
                share *= shares[axis][bit];
            }
            use((is_dense ? sum : mixed) & (entries - 1), share);
        }
    }
};

template <int DIMS>
static void read_grid(Long first, Long last, const GridFacts& grid,
                      const View<const float, 2>& table, const Points& points, const Sums& rows) {
    const Long numbers = Long(grid.numbers), levels = Long(grid.levels);
    for (Long p = first; p < last; p++) {
        const float* const point = points(p);
        float* row = rows(p);
        for (Long level = 0; level < levels; level++, row += numbers) {
            for (Long k = 0; k < numbers; k++) row[k] = 0.0f;
            Cell<DIMS>(grid, level, point).each(PIXELS(Long entry, float share) {
                const float* const held = table(level) + entry * numbers;
                for (Long k = 0; k < numbers; k++) row[k] += share * held[k];
            });
        }
        for (Long k = DIMS; k < points.size[1]; k++) *row++ = point[k];
    }
}
static void grid_rows(Long first, Long last, Given<GridFacts> grid, View<const float, 2> table,
                      Points points, Sums rows) {
    if (grid->dims == 2.0f) read_grid<2>(first, last, *grid, table, points, rows);
    else read_grid<3>(first, last, *grid, table, points, rows);
}
EXPORT(neural_grid, grid_rows)

// A derivative in units; NaN adds nothing.
FN Long units_of(float pull) {
    const double bounds = within<float>(known<float>(pull), -MOST_PULL, MOST_PULL);
    return Long(__builtin_rint(bounds * UNITS));
}

template <int DIMS>
static void pull_grid(Long first, Long last, const GridFacts& grid, const Points& points,
                      const Points& pulls, const View<Long, 2>& sums) {
    const Long numbers = Long(grid.numbers);
    for (Long level = first; level < last; level++) {
        Long* const row = sums(level);
        for (Long k = 0; k < sums.size[1]; k++) row[k] = 0;
        for (Long p = 0; p < points.size[0]; p++) {
            const float* const pull = pulls(p) + level * numbers;
            Cell<DIMS>(grid, level, points(p)).each(PIXELS(Long entry, float share) {
                Long* const held = row + entry * numbers;
                for (Long k = 0; k < numbers; k++) held[k] += units_of(share * pull[k]);
            });
        }
    }
}
static void grid_pull_rows(Long first, Long last, Given<GridFacts> grid, Points points,
                           Points pulls, View<Long, 2> sums) {
    if (grid->dims == 2.0f) pull_grid<2>(first, last, *grid, points, pulls, sums);
    else pull_grid<3>(first, last, *grid, points, pulls, sums);
}
EXPORT(neural_grid_pull, grid_pull_rows)

// Entries that no point reached stay as they are.
static void grid_step_rows(Long first, Long last, View<const Long, 2> sums, Partials partials,
                           Given<Hyper> hyper, Sums table, View<float, 3> moments) {
    const float learnt = scale_of(partials);
    float known_step = 0.0f;
    Pace pace = {0.0f, 0.0f};
    for (Long level = first; level < last; level++) {
        for (Long k = 0; k < table.size[1]; k++) {
            const Long units = sums(level)[k];
            if (units == 0) continue;
            float *const own = table(level) + k, *const kept = moments(level, k);
            kept[2] += 1.0f;
            // Entries that are reached together have taken as many steps.
            if (kept[2] != known_step) {
                known_step = kept[2];
                pace = pace_of(*hyper, known_step);
            }
            *own -= step_of<float>(*hyper, pace, float(double(units) / UNITS) * learnt, kept[0],
                                   kept[1]);
        }
    }
}
EXPORT(neural_grid_step, grid_step_rows)
