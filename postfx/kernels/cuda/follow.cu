// How much of the last grid is kept: light (256, 3), params (4,), before (1, 4) -> after (1, 4).
// In double precision, so that nothing depends on the order of the sum.
const double LAG = 1.0 / 4, JUMP = 1.0 / 16, RELEASE = 0.95, MOST = 1e4;  // NaN is not below MOST, either

extern "C" __global__ void follow(View light, View params, View before, View after) {
    const int values = light.size[0] * light.size[1];
    PIXEL(1, 1);  // one thread makes all four numbers
    const double keep = params.at[0], most = params.at[1], past = params.at[2], scale = params.at[3];
    double total = 0.0;
#pragma unroll 8
    for (int i = 0; i < values; i++) total += light.at[i];
    const double now = total / values / scale, made_for = before.at[1], last = before.at[2], share = before.at[3];
    const double lag = fabs(made_for - now), jump = fabs(last - now);
    after.at[0] = after.at[3] = 0.0f;
    after.at[1] = after.at[2] = float(now);
    if (!(past > 0 && lag <= MOST && jump <= MOST && fabs(share) <= 1)) return;
    const double change = fmin(fmax(fmax(lag / LAG, jump / JUMP) - 1, 0.0), 1.0);
    const double gone = fmax(fmax(most * change, RELEASE * share), 1 - keep);
    after.at[0] = float(1 - gone);
    after.at[1] = float(now + (1 - gone) * (made_for - now));
    after.at[3] = float(gone);
}
