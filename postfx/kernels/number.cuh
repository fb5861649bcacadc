// What headers that a CPU has, too, take from its number.h: here F is float, and what number.h says
// of NaN holds as well.
#define FN __device__ inline
#define FN_MEMBER __device__
#define UNROLL _Pragma("unroll")
#define AS_IT_IS _Pragma("unroll 1")

template <class F> FN F larger(F x, F other) { return x > other ? x : other; }
template <class F> FN F smaller(F x, F other) { return x < other ? x : other; }
template <class F> FN F within(F x, float low, float high) {
    return smaller<F>(larger<F>(x, low), high);
}
template <class F> FN F known(F x) { return x == x ? x : 0.0f; }
template <class F> FN F size_of(F x) { return fabsf(x); }
template <class F> FN F exp_of(F x) { return expf(x); }
FN float root_of(float x) { return sqrtf(x); }
FN int clip(int x, int size) { return min(max(x, 0), size - 1); }
