// How Python calls rows: `int name(const Word* words, void*)`. Words are the first row and the one
// after the last, and of each array its address and its lengths.
//
//     static void half_row(Long y, View<const float, 2> image, View<float, 2> out);
//     EXPORT(half, half_row)
//
// A function of a row is called for each of them. One that makes something for all rows before is
// given the first and the last: half_rows(Long first, Long last, ...). If it needs memory of its
// own, it returns a Status. The library also tells what a name takes, so that Python compares its
// table with it.
#pragma once
#include "number.h"

typedef long long Word;
enum Status { DONE, NO_MEMORY };
#if defined(_WIN32)
#define EXPORTED extern "C" __declspec(dllexport)
#else
#define EXPORTED extern "C" __attribute__((visibility("default")))
#endif

// An array without gaps: view(i, j) is where the row j of its plane i begins.
template <class T, int AXES> struct View {
    T* at;
    Long size[AXES];

    template <class... I> __attribute__((always_inline)) T* operator()(I... index) const {
        Long place = 0;
        int axis = 0;
        ((place = place * size[axis++] + index), ...);
        for (; axis < AXES; axis++) place *= size[axis];
        return at + place;
    }
};

// Rows or columns of a picture; numbers of its pixels, one of each or several, read or written.
typedef View<const float, 1> Places;
typedef View<const float, 2> Plane;
typedef View<const float, 3> Picture;
typedef View<float, 2> NewPlane;
typedef View<float, 3> NewPicture;

// A small array of numbers that have names.
template <class T> struct Given {
    const T* at;
    const T* operator->() const { return at; }
    const T& operator*() const { return *at; }
};

// A struct of arrays that follow each other lists their types, in the order of its members:
//
//     struct Lit {
//         View<const float, 3> colour, motion;
//         typedef Arrays<View<const float, 3>, View<const float, 3>> Members;
//     };
template <class... A> struct Arrays {};

// The same array of the frame before and of the one after.
template <class T> struct Both {
    T before, after;
    typedef Arrays<T, T> Members;
};

// Memory of one call; it is false where there was none.
extern "C" void* malloc(__SIZE_TYPE__);
extern "C" void free(void*);
template <class T> struct Room {
    T* at;
    explicit Room(Long count) : at((T*)malloc(sizeof(T) * (count > 0 ? count : 1))) {}
    ~Room() { free(at); }
    Room(const Room&) = delete;
    explicit operator bool() const { return at != nullptr; }
};

// Calls use(Is) with a flag that the compiler knows: each has code of its own.
template <bool VALUE> struct Is {
    constexpr bool operator()() const { return VALUE; }
};
template <class Use> FN void with_flag(bool value, const Use& use) {
    if (value) use(Is<true>());
    else use(Is<false>());
}

// Numbers of a row from one on.
FN void fill(float* row, Long first, Long last, float value) {
    for (Long x = first; x < last; x++) row[x] = value;
}
// A row with a number more on either side: its first and its last one once more.
FN void repeat_edges(float* row, Long count) {
    row[0] = row[1];
    row[count + 1] = row[count];
}

// Calls.

template <class T, class M> struct FromMembers;
template <class T, class... A> struct FromMembers<T, Arrays<A...>>;
template <class T> struct Taken {
    static T from(const Word*& words) { return FromMembers<T, typename T::Members>::from(words); }
};
template <class T, int AXES> struct Taken<View<T, AXES>> {
    static View<T, AXES> from(const Word*& words) {
        View<T, AXES> view;
        view.at = (T*)*words++;
        for (int axis = 0; axis < AXES; axis++) view.size[axis] = *words++;
        return view;
    }
};
template <class T> struct Taken<Given<T>> {
    static Given<T> from(const Word*& words) {
        words += 2;
        return {(const T*)words[-2]};
    }
};
template <class T, class... A> struct FromMembers<T, Arrays<A...>> {
    static T from(const Word*& words) { return T{Taken<A>::from(words)...}; }  // in this order
};

template <class... A> struct Call {
    int status;
    Call(void (*rows)(Long, Long, A...), Long first, Long last, A... arrays) : status(DONE) {
        rows(first, last, arrays...);
    }
    Call(Status (*rows)(Long, Long, A...), Long first, Long last, A... arrays)
        : status(rows(first, last, arrays...)) {}
};
template <class R, class... A> int call(R (*rows)(Long, Long, A...), const Word* words) {
    const Word* rest = words + 2;
    return Call<A...>{rows, words[0], words[1], Taken<A>::from(rest)...}.status;  // in this order
}

// What is called for a kernel's rows: its function, or that of one row for each of them.
template <auto ROW, class... A> void each_row(Long first, Long last, A... arrays) {
    for (Long y = first; y < last; y++) [[clang::always_inline]] ROW(y, arrays...);
}
template <auto, class... A> constexpr auto rows_of(Status (*rows)(Long, Long, A...)) {
    return rows;
}
template <auto, class... A> constexpr auto rows_of(void (*rows)(Long, Long, A...)) { return rows; }
template <auto ROW, class... A> constexpr auto rows_of(void (*)(Long, A...)) {
    return each_row<ROW, A...>;
}

// Kinds of arguments in five letters each: type, axes, and whether they are only read.

template <class T> constexpr const char* type_name();
template <> constexpr const char* type_name<float>() { return "f4"; }
template <> constexpr const char* type_name<int>() { return "i4"; }
template <> constexpr const char* type_name<byte>() { return "u1"; }
template <> constexpr const char* type_name<sbyte>() { return "i1"; }
template <> constexpr const char* type_name<bool>() { return "b1"; }
template <> constexpr const char* type_name<unsigned short>() { return "u2"; }
template <> constexpr const char* type_name<unsigned>() { return "u4"; }
template <> constexpr const char* type_name<Long>() { return "i8"; }
template <> constexpr const char* type_name<double>() { return "f8"; }

template <class T, class M> struct KindOfMembers;
template <class T> struct Kind : KindOfMembers<T, typename T::Members> {};
struct KindOfArray {
    static constexpr int LETTERS = 5;
    static constexpr void write(char*& to, const char* type, int axes, bool is_read) {
        const char letters[] = {type[0], type[1], ':', char('0' + axes), is_read ? 'r' : 'w'};
        for (int i = 0; i < LETTERS; i++) *to++ = letters[i];
    }
};
template <class T, int AXES> struct Kind<View<T, AXES>> : KindOfArray {
    static constexpr void write(char*& to) { KindOfArray::write(to, type_name<T>(), AXES, false); }
};
template <class T, int AXES> struct Kind<View<const T, AXES>> : KindOfArray {
    static constexpr void write(char*& to) { KindOfArray::write(to, type_name<T>(), AXES, true); }
};
template <class T> struct Kind<Given<T>> : KindOfArray {
    static constexpr void write(char*& to) { KindOfArray::write(to, "f4", 1, true); }
};
template <class T, class... A> struct KindOfMembers<T, Arrays<A...>> {
    static constexpr int LETTERS = (Kind<A>::LETTERS + ... + 0);
    static constexpr void write(char*& to) { (Kind<A>::write(to), ...); }
};

template <class... A> struct Kinds {
    char text[(Kind<A>::LETTERS + ... + 1)] = {};
    constexpr Kinds() {
        char* to = text;
        (Kind<A>::write(to), ...);
    }
};
template <class R, class... A> const char* kinds_of(R (*)(Long, Long, A...)) {
    static constexpr Kinds<A...> kinds;
    return kinds.text;
}

#define EXPORT_ONE(name, rows)                                                         \
    static constexpr auto name##_called = rows_of<rows>(rows);                         \
    EXPORTED int name(const Word* words, void*) { return call(name##_called, words); } \
    EXPORTED const char* name##_takes() { return kinds_of(name##_called); }
#define EXPORT_NONE(name, rows)

// A library of a wheel has all kernels. A checkout compiles those of a file together when one of
// them is first needed, but for those that take a compiler long: each of these ALONE.
#define SECOND(first, second, ...) second
#define PICK(...) SECOND(__VA_ARGS__)
#if defined(ALONE)  // build.py says that ALONE_name is `~, EXPORT_ONE`
#define EXPORT(name, rows) EXPORT_NONE(name, rows)
#define EXPORT_ALONE(name, rows) PICK(ALONE_##name, EXPORT_NONE, )(name, rows)
#elif defined(TOGETHER)
#define EXPORT(name, rows) EXPORT_ONE(name, rows)
#define EXPORT_ALONE(name, rows) EXPORT_NONE(name, rows)
#else
#define EXPORT(name, rows) EXPORT_ONE(name, rows)
#define EXPORT_ALONE(name, rows) EXPORT_ONE(name, rows)
#endif

// Work on pixels `first` to `last` - 1 of a row. What is done to those from x on, as many as F has
// numbers, is a function of the type F and of x:
//
//     across(0, width, EACH(F, Long x) { store<F>(out + x, 0.5f * load<F>(from + x)); });
//
// Some may be made twice, so they must not be read from where they are written.
#define EACH(F, ...) [&]<class F>(F, __VA_ARGS__) __attribute__((always_inline))
// A function of some pixels that is not of a type.
#define PIXELS(...) [&](__VA_ARGS__) __attribute__((always_inline))
template <class Pixels> FN void across(Long first, Long last, const Pixels& pixels) {
    if (last - first < WIDE) {
        AS_IT_IS for (Long x = first; x < last; x++) pixels(float(), x);
        return;
    }
    for (Long x = first; x < last; x += WIDE) {
        pixels(Wide(), x <= last - WIDE ? x : last - WIDE);  // called in one place: compiled once
    }
}

// The same with each pixel made once, for those that are changed in place.
template <class Pixels> FN void across_once(Long first, Long last, const Pixels& pixels) {
    Long x = first;
    for (; x + WIDE <= last; x += WIDE) pixels(Wide(), x);
    AS_IT_IS for (; x < last; x++) pixels(float(), x);
}
