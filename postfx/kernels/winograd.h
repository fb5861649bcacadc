// A convolution of 3x3 pixels by tiles: S. Winograd's F(4x4, 3x3), as A. Lavin and S. Gray give it
// ("Fast Algorithms for Convolutional Neural Networks", 2016). A tile of 4x4 results takes 36
// products a pair of channels where the sums as they are written take 144.
//
// A strip is a row of tiles. Tiles lie beside each other in vectors, so that all that is done to
// the 6x6 numbers of a tile is done to as many tiles as a vector has numbers.
#pragma once
#include "rows.h"

constexpr int TILE = 4;             // results along a side
constexpr int SIDE = TILE + 2;      // numbers along a side that they are made of
constexpr int PLACES = SIDE * SIDE;
constexpr int AT_ONCE = 2 * WIDE;   // tiles whose sums lie in registers
#if defined(__AVX512F__) || defined(__aarch64__)
constexpr int GROUP = 8;            // results whose sums do, of 32 registers
#else
constexpr int GROUP = 6;            // of 16
#endif
constexpr int MOST_TILES = WIDE == 16 ? 64 : 48;  // of a strip, so that they stay in caches

FN Long rounded_up(Long count, Long step) { return (count + step - 1) / step * step; }

struct Layer {
    Long channels, results, height, width;

    Long groups() const { return (results + GROUP - 1) / GROUP; }
    Long tiles_across() const { return (width + TILE - 1) / TILE; }
    // Of a strip: as many as leave fewest unused in a row of strips, and then as many as may be.
    Long tiles() const {
        Long best = AT_ONCE;
        for (Long some = AT_ONCE; some <= MOST_TILES; some += AT_ONCE)
            if (rounded_up(tiles_across(), some) <= rounded_up(tiles_across(), best)) best = some;
        return best;
    }
    Long strips_across() const { return (tiles_across() + tiles() - 1) / tiles(); }
    Long strips() const { return (height + TILE - 1) / TILE * strips_across(); }
    Long weights() const { return groups() * PLACES * channels * GROUP; }
};

// Six numbers of a row or column of a tile, and four results of six sums.
template <class F> FN void forth(F a, F b, F c, F d, F e, F f, F* to) {
    const F even = e - 4.0f * c, odd = d - 4.0f * b, near = e - c, far = 2.0f * (d - b);
    to[0] = 4.0f * a - 5.0f * c + e;
    to[1] = even + odd;
    to[2] = even - odd;
    to[3] = near + far;
    to[4] = near - far;
    to[5] = 4.0f * b - 5.0f * d + f;
}
FN void back(Wide a, Wide b, Wide c, Wide d, Wide e, Wide f, Wide* to) {
    const Wide sum = b + c, less = b - c, far_sum = d + e, far_less = d - e;
    to[0] = a + sum + far_sum;
    to[1] = less + 2.0f * far_less;
    to[2] = sum + 4.0f * far_sum;
    to[3] = less + 8.0f * far_less + f;
}

// A picture whose channels a layer reads. Each pixel of one that has half the size is read as four.
struct Source {
    const float* at;
    Long channels;
    bool is_half;
};

// Weights (results, some, 3, 3) of some channels, the first of which is given -> those of a layer,
// (groups, PLACES, channels, GROUP), which are 0 before.
FN void forth_weight(const float* three, Long step, double* to) {
    const double a = three[0], b = three[step], c = three[2 * step];
    to[0] = a / 4;
    to[1] = -(a + b + c) / 6;
    to[2] = -(a - b + c) / 6;
    to[3] = a / 24 + b / 12 + c / 6;
    to[4] = a / 24 - b / 12 + c / 6;
    to[5] = c;
}
ONCE void prepare_weights(const Layer& layer, const float* weights, Long first, Long some,
                          float* to) {
    for (Long k = 0; k < layer.results; k++)
        for (Long c = 0; c < some; c++) {
            const float* nine = weights + 9 * (k * some + c);
            float rows[SIDE][3];
            double six[SIDE];
            for (int x = 0; x < 3; x++) {
                forth_weight(nine + x, 3, six);
                for (int i = 0; i < SIDE; i++) rows[i][x] = float(six[i]);
            }
            float* own = to + (k / GROUP * PLACES * layer.channels + first + c) * GROUP + k % GROUP;
            for (int i = 0; i < SIDE; i++) {
                forth_weight(rows[i], 1, six);
                for (int j = 0; j < SIDE; j++)
                    own[(SIDE * i + j) * layer.channels * GROUP] = float(six[j]);
            }
        }
}

// Numbers of a row, from the first to before the end, of one of half as many, each of which counts
// twice.
FN void take_twice(const float* half, Long first, Long end, float* to) {
    if (first % 2 && first < end) *to++ = half[first++ / 2];
    const float* from = half + first / 2;
    const Long pairs = (end - first) / 2;
    for (Long i = 0; i < pairs; i++) to[2 * i] = to[2 * i + 1] = from[i];
    if ((end - first) % 2) to[2 * pairs] = from[pairs];
}

// Makes strips of a layer's results, with memory of its own.
struct Strips {
    const Layer layer;
    const Source* pictures;  // as many as have all channels
    const float *weights, *bias;
    float* out;
    const bool is_rectified;              // whether results below 0 become 0
    const Long tiles, row_size;
    Room<float> room;
    float *numbers, *sums, *rows, *phases;
    const float* taken[SIDE];  // the rows that are transformed next

    Strips(Layer of, const Source* from, const float* by, const float* add, float* to,
           bool clipped)
        : layer(of), pictures(from), weights(by), bias(add), out(to), is_rectified(clipped),
          tiles(of.tiles()), row_size(TILE * tiles + 4 * WIDE),
          room(PLACES * of.channels * tiles + PLACES * GROUP * tiles + SIDE * row_size
               + TILE * (tiles + WIDE)) {
        numbers = room.at;                                  // (PLACES, channels, tiles)
        sums = numbers + PLACES * layer.channels * tiles;   // (PLACES, GROUP, tiles)
        rows = sums + PLACES * GROUP * tiles;               // (SIDE, row_size)
        phases = rows + SIDE * row_size;                    // (TILE, tiles + WIDE)
    }

    void make(Long strip) {
        const Long top = strip / layer.strips_across() * TILE;
        const Long left = strip % layer.strips_across() * TILE * tiles;
        float* to = numbers;
        const float* end = numbers + layer.channels * tiles;
        for (const Source* picture = pictures; to < end; picture++)
            for (Long c = 0; c < picture->channels; c++, to += tiles) {
                take_rows(*picture, c, top - 1, left - 1);
                transform_rows(to);
            }
        for (Long group = 0; group < layer.groups(); group++) {
            const float* own = weights + group * PLACES * layer.channels * GROUP;
            for (Long place = 0; place < PLACES; place++)
                for (Long t = 0; t < tiles; t += AT_ONCE)
                    add_products(own + place * layer.channels * GROUP,
                                 numbers + place * layer.channels * tiles + t,
                                 sums + place * GROUP * tiles + t);
            for (Long k = group * GROUP; k < smaller<Long>((group + 1) * GROUP, layer.results); k++)
                write_tiles(k, top, left);
        }
    }

private:
    // Where six rows of a channel are from a place on: in the picture, or with zeros around it.
    FN_MEMBER void take_rows(const Source& picture, Long channel, Long top, Long left) {
        const Long halved = picture.is_half, width = layer.width >> halved;
        const float* plane = picture.at + channel * (layer.height >> halved) * width;
        const Long size = TILE * tiles + 2;
        const Long first = left < 0 ? 0 : left, end = smaller(left + size, layer.width);
        const bool is_inside = left >= 0 && left + size + WIDE <= layer.width && !halved;
        for (Long i = 0; i < SIDE; i++) {
            float* row = rows + i * row_size;
            const Long y = top + i;
            taken[i] = row;
            if (y < 0 || y >= layer.height) {
                fill(row, 0, size, 0.0f);
            } else if (is_inside) {
                taken[i] = plane + y * layer.width + left;
            } else {
                const float* from = plane + (y >> halved) * width;
                float* to = row + first - left;
                fill(row, 0, first - left, 0.0f);
                if (halved) take_twice(from, first, end, to);
                else __builtin_memcpy(to, from + first, sizeof(float) * (end - first));
                fill(row, end - left, size, 0.0f);
            }
        }
    }

    // The 6x6 numbers of each tile of these rows, down and then across.
    FN_MEMBER void transform_rows(float* to) const {
        for (Long x = 0; x < TILE * tiles + 2; x += WIDE) {
            Wide six[SIDE];
            forth(row_at(0, x), row_at(1, x), row_at(2, x), row_at(3, x), row_at(4, x),
                  row_at(5, x), six);
            for (int i = 0; i < SIDE; i++) store(rows + i * row_size + x, six[i]);
        }
        const Long phase = tiles + WIDE, place = layer.channels * tiles;
        for (int i = 0; i < SIDE; i++) {
            const float* row = rows + i * row_size;
            for (Long t = 0; t < tiles; t += WIDE)
                for (int x = 0; x < TILE; x++)
                    store(phases + x * phase + t, pick<Wide, TILE>(row + TILE * t + x));
            for (int x = 0; x < 2; x++) phases[x * phase + tiles] = row[TILE * tiles + x];
            for (Long t = 0; t < tiles; t += WIDE) {
                const float* at = phases + t;
                Wide six[SIDE];
                forth(load<Wide>(at), load<Wide>(at + phase), load<Wide>(at + 2 * phase),
                      load<Wide>(at + 3 * phase), load<Wide>(at + 1), load<Wide>(at + phase + 1),
                      six);
                for (int x = 0; x < SIDE; x++) store(to + (SIDE * i + x) * place + t, six[x]);
            }
        }
    }
    FN_MEMBER Wide row_at(int i, Long x) const { return load<Wide>(taken[i] + x); }

    // The sums over all channels of a group's weights times the numbers of some tiles.
    FN_MEMBER void add_products(const float* by, const float* from, float* to) const {
        Wide found[GROUP][2] = {};
        for (Long c = 0; c < layer.channels; c++) {
            const Wide a = load<Wide>(from + c * tiles), b = load<Wide>(from + c * tiles + WIDE);
            UNROLL for (int k = 0; k < GROUP; k++) {
                const Wide weight = by[c * GROUP + k];
                found[k][0] = found[k][0] + weight * a;
                found[k][1] = found[k][1] + weight * b;
            }
        }
        UNROLL for (int k = 0; k < GROUP; k++) {
            store(to + k * tiles, found[k][0]);
            store(to + k * tiles + WIDE, found[k][1]);
        }
    }

    // One result of each tile of a strip, across and then down.
    FN_MEMBER void write_tiles(Long k, Long top, Long left) const {
        const Long place = GROUP * tiles, height = smaller<Long>(TILE, layer.height - top);
        const Wide add = bias[k];
        float* to = out + (k * layer.height + top) * layer.width + left;
        for (Long t = 0; t < tiles && left + TILE * t < layer.width; t += WIDE) {
            const float* from = sums + k % GROUP * tiles + t;
            const auto sum_at = [=](int y, int x) {
                return load<Wide>(from + (SIDE * y + x) * place);
            };
            Wide columns[SIDE][TILE];
            for (int x = 0; x < SIDE; x++)
                back(sum_at(0, x), sum_at(1, x), sum_at(2, x), sum_at(3, x), sum_at(4, x),
                     sum_at(5, x), columns[x]);
            for (Long y = 0; y < height; y++) {
                Wide four[TILE];
                back(columns[0][y], columns[1][y], columns[2][y], columns[3][y], columns[4][y],
                     columns[5][y], four);
                for (int x = 0; x < TILE; x++) {
                    four[x] += add;
                    // in this order NaN stays
                    if (is_rectified) four[x] = larger(Wide(0.0f), four[x]);
                }
                float* row = to + y * layer.width + TILE * t;
                const Long count = layer.width - left - TILE * t;
                float line[TILE * WIDE];
                float* at = count < TILE * WIDE ? line : row;
                spread_four<TILE>(at, four[0], four[1], four[2], four[3]);
                if (at == line) __builtin_memcpy(row, line, sizeof(float) * count);
            }
        }
    }
};
