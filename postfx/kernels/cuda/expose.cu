// Exposure over time: previous (3,), current (1, 1), keep (1, 4), params (3,) -> result (3,).
// In double precision, so that the exposure of a still picture stays as it is to the bit.
const double MOST = 64.0;  // NaN is not below it, either

extern "C" __global__ void expose(View previous, View current, View keep, View params, View result) {
    PIXEL(1, 1);  // one thread makes all three numbers
    double stops = current.at[0];
    const double kept = keep.at[0], change = log2(double(previous.at[0])) - stops;
    if (kept > 0.0 && fabs(change) <= MOST) stops += kept * change;  // it may be unset
    result.at[0] = float(exp2(stops));
    result.at[1] = params.at[1] / params.at[0];
    result.at[2] = params.at[2];
}
