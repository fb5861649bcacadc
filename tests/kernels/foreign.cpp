// Runs kernels on another machine than Python's: what an emulator, wine or Node starts.
//
// It reads calls until there are none: a kernel's name, its rows and its arrays. It writes the
// arrays of each as the kernel left them. No library of C is linked: to compile one takes a minute
// of a core, and kernels call seven functions of it.
//
// On Windows it opens the kernels' library, whose path comes first. Elsewhere the kernels are
// linked to it, and `kernels.h` has their names.

typedef long long Word;
typedef __SIZE_TYPE__ Size;
typedef int Kernel(const Word*, void*);
enum { IN, OUT };
enum Status { NO_MEMORY = 2, NO_KERNEL = 3, NO_INPUT = 4 };
enum { NAME = 256, WORDS = 200, ARRAYS = 20 };

// What a system does: ends the program, and reads or writes as much as it can at once.
[[noreturn]] static void leave(int status);
static Word move_some(int file, char* at, Size count);

#if defined(__aarch64__)

enum { READ = 63, WRITE = 64, EXIT = 93 };

static Word ask(Word number, Word first, Word second, Word third) {
    register Word x8 asm("x8") = number, x0 asm("x0") = first;
    register Word x1 asm("x1") = second, x2 asm("x2") = third;
    asm volatile("svc 0" : "+r"(x0) : "r"(x8), "r"(x1), "r"(x2) : "memory");
    return x0;
}

[[noreturn]] static void leave(int status) {
    for (;;) ask(EXIT, status, 0, 0);
}

static Word move_some(int file, char* at, Size count) {
    return ask(file == IN ? READ : WRITE, file, (Word)at, (Word)count);
}

#elif defined(__wasm__)

#define FROM_SYSTEM(name) \
    extern "C" __attribute__((import_module("wasi_snapshot_preview1"), import_name(#name))) int name
struct Piece {
    char* at;
    Size count;
};
FROM_SYSTEM(fd_read)(int file, const Piece* pieces, Size count, Size* moved);
FROM_SYSTEM(fd_write)(int file, const Piece* pieces, Size count, Size* moved);
FROM_SYSTEM(proc_exit)(int status);

[[noreturn]] static void leave(int status) {
    for (;;) proc_exit(status);
}

static Word move_some(int file, char* at, Size count) {
    const Piece piece = {at, count};
    Size moved = 0;
    const int failed = file == IN ? fd_read(file, &piece, 1, &moved)
                                  : fd_write(file, &piece, 1, &moved);
    return failed ? -1 : (Word)moved;
}

#elif defined(_WIN32)

#define FROM_SYSTEM(result) extern "C" __declspec(dllimport) result
FROM_SYSTEM(void*) GetStdHandle(unsigned which);
FROM_SYSTEM(int) ReadFile(void* file, void* at, unsigned count, unsigned* moved, void*);
FROM_SYSTEM(int) WriteFile(void* file, const void* at, unsigned count, unsigned* moved, void*);
FROM_SYSTEM(void) ExitProcess(unsigned status);
FROM_SYSTEM(void*) LoadLibraryA(const char* path);
FROM_SYSTEM(Kernel*) GetProcAddress(void* library, const char* name);

[[noreturn]] static void leave(int status) {
    for (;;) ExitProcess((unsigned)status);
}

static Word move_some(int file, char* at, Size count) {
    constexpr Size MOST = 1 << 20;
    const unsigned asked = unsigned(count < MOST ? count : MOST);
    void* const handle = GetStdHandle(file == IN ? -10u : -11u);
    unsigned moved = 0;
    const int done = file == IN ? ReadFile(handle, at, asked, &moved, nullptr)
                                : WriteFile(handle, at, asked, &moved, nullptr);
    return done ? moved : 0;
}

#endif

static char heap[1 << 29];
static Size used;

static void* take(Size size) {
    used = (used + 63) & ~(Size)63;
    if (size > sizeof heap - used) leave(NO_MEMORY);
    used += size;
    return heap + used - size;
}

// Whether all was read; the end of the input is allowed where a call would begin.
static bool is_moved(int file, char* at, Size count) {
    const Size wanted = count;
    while (count) {
        const Word moved = move_some(file, at, count);
        if (moved <= 0) {
            if (count == wanted) return false;
            leave(NO_INPUT);
        }
        at += moved;
        count -= (Size)moved;
    }
    return true;
}

static void move(int file, char* at, Size count) {
    if (!is_moved(file, at, count)) leave(NO_INPUT);
}

static Word number() {
    Word word = 0;
    move(IN, (char*)&word, sizeof word);
    return word;
}

#if defined(_WIN32)

static void* library;

static void open_kernels() {
    char path[NAME];
    move(IN, path, sizeof path);
    library = LoadLibraryA(path);
    if (!library) leave(NO_KERNEL);
}

static Kernel* find_kernel(const char* name) { return GetProcAddress(library, name); }

#else

#include "kernels.h"

static void open_kernels() {}

static bool is_same(const char* one, const char* other) {
    while (*one && *one == *other) one++, other++;
    return *one == *other;
}

static Kernel* find_kernel(const char* name) {
    for (const Named& one : kernels)
        if (is_same(one.name, name)) return one.kernel;
    return nullptr;
}

extern "C" {
void* malloc(Size size) { return take(size); }
void free(void*) {}
float fminf(float x, float other) { return x < other || other != other ? x : other; }
float fmaxf(float x, float other) { return x > other || other != other ? x : other; }
void* memcpy(void* to, const void* from, Size count) {
    for (Size i = 0; i < count; i++) ((char*)to)[i] = ((const char*)from)[i];
    return to;
}
void* memset(void* to, int value, Size count) {
    for (Size i = 0; i < count; i++) ((char*)to)[i] = (char)value;
    return to;
}
}

#endif

static void run(const char* name) {
    Kernel* const kernel = find_kernel(name);
    if (!kernel) leave(NO_KERNEL);
    Word words[WORDS];
    char* memory[ARRAYS];
    Size bytes[ARRAYS];
    int count = 0;
    used = 0;
    words[count++] = number();
    words[count++] = number();
    const Word arrays = number();
    for (Word i = 0; i < arrays; i++) {
        const Word axes = number();
        bytes[i] = (Size)number();
        memory[i] = (char*)take(bytes[i] + 1);
        words[count++] = (Word)memory[i];
        for (Word axis = 0; axis < axes; axis++) words[count++] = number();
        if (bytes[i]) move(IN, memory[i], bytes[i]);
    }
    const int status = kernel(words, nullptr);
    if (status) leave(status);
    for (Word i = 0; i < arrays; i++)
        if (bytes[i]) move(OUT, memory[i], bytes[i]);
}

extern "C" [[noreturn]] void START() {
    open_kernels();
    char name[NAME];
    while (is_moved(IN, name, sizeof name)) run(name);
    leave(0);
}
