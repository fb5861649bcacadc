// What rows of every enlargement share: columns of the output, and where a row lies among the
// render's.
#pragma once
#include "upsample.h"
#include "../rows.h"

typedef View<const float, 4> FineHead;

FN Head head_of(const FineHead& fine, Long y) {
    return {fine(0, 0, y), fine.size[2] * fine.size[3]};
}

// What is enlarged; `radiance` has the planes that are looked at.
struct Samples {
    Picture radiance, moved, past;
    Params params;
    Window window;
    Picture keep;

    bool doubles(Long width) const { return window.doubles() && width == 2 * moved.size[1]; }
    bool keeps_size(Long width) const { return window.keeps_size() && width == moved.size[1]; }
};

// Memory: a row of colours and their trust, of guides, of shares; and of columns at any scale.
struct Rooms {
    Long width, columns;
    Room<float> floats;
    Room<int> index;

    Rooms(Long width, Long columns)
        : width(width), columns(columns), floats(17 * width + columns), index(width) {}
    explicit operator bool() const { return bool(floats) && bool(index); }
    float* rgb(int c) const { return floats.at + c * width; }
    float* trust() const { return floats.at + 3 * width; }
    float* guide(int c) const { return floats.at + (4 + c) * width; }
    float* lean() const { return floats.at + 8 * width; }
    float* near() const { return floats.at + 9 * width; }
    float* wide() const { return floats.at + 12 * width; }
    float* place() const { return floats.at + 15 * width; }
    float* share() const { return floats.at + 16 * width; }
};

// Render pixels, leans and weights of the output's columns.
FN void fill_columns(const Samples& given, const Rooms& rooms) {
    for (Long x = 0; x < rooms.width; x++) {
        const Place at = column_of(given.window, x, rooms.columns);
        const Distances distances = distances_of(given.params.jitter_x - at.offset);
        rooms.index.at[x] = int(at.index);
        rooms.lean()[x] = lean_of(at.offset);
        for (int i = 0; i < 3; i++) {
            rooms.near()[i * rooms.width + x] = distances.near[i];
            rooms.wide()[i * rooms.width + x] = distances.wide[i];
        }
    }
}

// Row y of the output, in the row `iy` of render pixels.
FN Row row_of_samples(const Samples& given, const Rooms& rooms, const Head& head, Long y, Long iy) {
    const Window& window = given.window;
    const float* kept = given.keep(clip(iy, given.keep.size[0]));
    for (Long x = 0; x < rooms.columns; x++) rooms.share()[x] = kept[clip(x, given.keep.size[1])];
    return {
        .head = head,
        .radiance = given.radiance(0, iy),
        .plane = given.radiance.size[1] * given.radiance.size[2],
        .line = given.radiance.size[2],
        .moved = given.moved(iy),
        .past = given.past(iy),
        .share = rooms.share(),
        .guide = {rooms.guide(0), rooms.guide(1), rooms.guide(2), rooms.guide(3)},
        .left = Long(window.out_left),
        .y = float(y),
        .right = window.out_width - 0.5f,
        .bottom = window.out_height - 0.5f,
        .across = window.out_width / window.width,
        .down = window.out_height / window.height,
    };
}
