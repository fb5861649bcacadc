// What headers that a CPU has, too, take from its number.h: here F is float.
#define FN __device__ inline
#define FN_MEMBER __device__
#define UNROLL _Pragma("unroll")

template <class F> FN F larger(F x, F other) { return x > other ? x : other; }
template <class F> FN F size_of(F x) { return fabsf(x); }
template <class F> FN F exp_of(F x) { return expf(x); }

