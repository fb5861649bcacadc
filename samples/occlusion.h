// Rays through boxes and balls, for occlusion.py.
#include "rows.h"

constexpr double PI = 3.141592653589793;
constexpr double NEAREST = 1e-6, LIFTED = 1e-4;  // of a ray: where it begins to hit, and its origin
constexpr double FAR = __builtin_inf();
constexpr double LATTICE[2] = {0.7548776662466927, 0.5698402909980532};  // R2, Roberts 2018

extern "C" double sin(double), cos(double);

struct Shape {
    double centre[3];
    double half[3];       // sizes of a box; of a ball the radius, and the last is 0
    double cosine, sine;  // of a box's turn about y
    double unused;
};
typedef View<const double, 2> Shapes;
typedef View<const double, 3> Ways;

// Distance to the first of the shapes; the normal there.
static double nearest(const Shapes& shapes, const double* origin, const double* way,
                      double* normal) {
    double found = FAR;
    for (Long k = 0; k < shapes.size[0]; k++) {
        const Shape& shape = *(const Shape*)shapes(k);
        double from[3];
        for (int c = 0; c < 3; c++) from[c] = origin[c] - shape.centre[c];
        const double radius = shape.half[0];
        if (shape.half[2] == 0) {
            double along = 0, apart = -radius * radius;
            for (int c = 0; c < 3; c++) along += from[c] * way[c], apart += from[c] * from[c];
            const double inside = along * along - apart;
            const double t = inside > 0 ? -along - __builtin_sqrt(inside) : -1;
            if (t > NEAREST && t < found) {
                found = t;
                for (int c = 0; c < 3; c++) normal[c] = (from[c] + t * way[c]) / radius;
            }
            continue;
        }
        const double cosine = shape.cosine, sine = shape.sine;
        const double p[3] = {cosine * from[0] - sine * from[2], from[1],
                             sine * from[0] + cosine * from[2]};
        const double d[3] = {cosine * way[0] - sine * way[2], way[1],
                             sine * way[0] + cosine * way[2]};
        double enter = -FAR, leave = FAR, side = 1;
        int axis = 0;
        for (int a = 0; a < 3; a++) {
            const double slope = __builtin_fabs(d[a]) > 1e-12 ? 1 / d[a] : 1e12;
            const double one = (-shape.half[a] - p[a]) * slope,
                         other = (shape.half[a] - p[a]) * slope;
            const double begins = one < other ? one : other, ends = one < other ? other : one;
            if (begins > enter) {
                enter = begins, axis = a, side = d[a] > 0 ? -1 : d[a] < 0 ? 1 : 0;
            }
            if (ends < leave) leave = ends;
        }
        if (enter > NEAREST && enter < found && enter < leave) {
            found = enter;
            const double u = axis == 0 ? side : 0, v = axis == 2 ? side : 0;
            normal[0] = cosine * u + sine * v;
            normal[1] = axis == 1 ? side : 0;
            normal[2] = cosine * v - sine * u;
        }
    }
    return found;
}

// Distance along each way, and normals.
static void first_hits(Long first, Long last, Shapes shapes, View<const double, 1> eye, Ways ways,
                       View<double, 2> depth, View<double, 3> normals) {
    for (Long y = first; y < last; y++) {
        for (Long x = 0; x < ways.size[1]; x++)
            depth(y)[x] = nearest(shapes, eye.at, ways(y, x), normals(y, x));
    }
}
EXPORT(first_hits, first_hits)

// Shares of cosine-weighted rays that are longer than each radius.
static void visibility(Long first, Long last, Shapes shapes, View<const double, 1> eye, Ways ways,
                       View<const double, 2> depth, Ways normals, View<const double, 1> radii,
                       Ways turns, View<const double, 1> rays, View<double, 3> visible) {
    const int count = int(*rays.at);
    for (Long y = first; y < last; y++) {
        for (Long x = 0; x < ways.size[1]; x++) {
            const double *n = normals(y, x), *turn = turns(y, x);
            double origin[3], way[3], spare[3];
            for (int c = 0; c < 3; c++)
                origin[c] = eye.at[c] + depth(y)[x] * ways(y, x)[c] + LIFTED * n[c];
            // a frame around the normal: Duff 2017
            const double sign = n[2] >= 0 ? 1 : -1, a = -1 / (sign + n[2]), b = n[0] * n[1] * a;
            for (Long r = 0; r < radii.size[0]; r++) visible(r, y)[x] = 0;
            for (int k = 0; k < count; k++) {
                const double u = turn[0] + k * LATTICE[0],
                             angle = 2 * PI * (turn[1] + k * LATTICE[1]);
                const double share = u - __builtin_floor(u), radius = __builtin_sqrt(share);
                const double i = radius * cos(angle), j = radius * sin(angle);
                const double up = __builtin_sqrt(1 - share);
                way[0] = i * (1 + sign * n[0] * n[0] * a) + j * b + up * n[0];
                way[1] = i * sign * b + j * (sign + n[1] * n[1] * a) + up * n[1];
                way[2] = -i * sign * n[0] - j * n[1] + up * n[2];
                const double distance = nearest(shapes, origin, way, spare);
                for (Long r = 0; r < radii.size[0]; r++)
                    if (distance > radii.at[r]) visible(r, y)[x] += 1.0 / count;
            }
        }
    }
}
EXPORT(visibility, visibility)
