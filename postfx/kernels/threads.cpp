// How threads hand each other bands of rows without the interpreter's lock; `runtime/threads.py`
// says what a helper does. A row of the board is a helper's: its flag, which is read and written as
// one, then what it is to run.
#include "rows.h"

enum Flag { AWAY, WAITING, DOZING, BUSY };
enum Column { FLAG, ENTRY, WORDS, STATUS, TIMEOUT, LINE = 8 };
constexpr Word PYTHON = -1;  // in place of an entry: a band that is a function of Python's
constexpr Word ASLEEP = 2;   // status of a band whose helper is away and to be started
constexpr int NAPS = 5;

typedef int Entry(const Word* words, void*);

FN void pause() {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
}

FN Word flag_of(const Word* row) { return __atomic_load_n(row + FLAG, __ATOMIC_SEQ_CST); }
FN bool is_replaced(Word* row, Word known, Word next) {
    return __atomic_compare_exchange_n(row + FLAG, &known, next, false, __ATOMIC_SEQ_CST,
                                       __ATOMIC_SEQ_CST);
}

// Linux's call on the flag of a row, with the row's timeout (futex(2)); -1 at once on other
// systems.
#if defined(__linux__)
extern "C" long syscall(long number, ...);
enum { WAIT = 128, WAKE = 129 };
FN long futex(Word* row, int operation, Word value) {
#if defined(__x86_64__)
    constexpr long NUMBER = 202;
#else
    constexpr long NUMBER = 98;
#endif
    return syscall(NUMBER, row + FLAG, operation, value, row + TIMEOUT, nullptr, 0L);
}
#else
enum { WAIT, WAKE };
FN long futex(Word*, int, Word) { return -1; }
#endif

// Calls of Python's, by numbers alone.

EXPORTED Word make_pauses(Word count) {
    for (Word i = 0; i < count; i++) pause();
    return 0;
}

// Run rows; 1 if they failed.
EXPORTED Word run_entry(Entry* entry, const Word* words) { return entry(words, nullptr) != 0; }

// Hand a helper its next band; 0 if it is away.
EXPORTED Word is_taken(Word* row, Word entry, Word words) {
    row[ENTRY] = entry;
    row[WORDS] = words;
    row[STATUS] = 0;
    if (is_replaced(row, WAITING, BUSY)) return 1;
    if (is_replaced(row, DOZING, BUSY)) {
        futex(row, WAKE, 1);
        return 1;
    }
    is_replaced(row, AWAY, BUSY);
    return 0;
}

// Hand helpers the bands from the second on, each with its `size` words; whether any is away.
EXPORTED Word hand_out(Word* board, Word entry, const Word* words, Word size, Word bands) {
    Word some = 0;
    for (Word i = 0; i < bands - 1; i++) {
        Word* row = board + LINE * i;
        if (is_taken(row, entry, (Word)(words + size * (i + 1)))) continue;
        row[STATUS] = ASLEEP;
        some = 1;
    }
    return some;
}

// A helper is done with its band.
EXPORTED Word report_done(Word* row) { return is_replaced(row, BUSY, WAITING); }

// Let a helper doze until it is called; true if it is not, and away from now on.
static bool has_gone(Word* row) {
    Word last = WAITING;
    if (futex(row, WAKE, 0) == 0 && is_replaced(row, WAITING, DOZING)) {
        last = DOZING;
        for (int i = 0; i < NAPS; i++) {
            futex(row, WAIT, DOZING);
            if (flag_of(row) != DOZING) return false;
        }
    }
    return is_replaced(row, last, AWAY);
}

// Work on a helper's bands as they come. 1 if one came that is Python's, after `delay` pauses in
// which the thread that gave it can release the interpreter's lock; 0 if none came for long and the
// helper is away.
EXPORTED Word is_called(Word* row, Word looks, Word delay) {
    for (Word left = looks;;) {
        if (flag_of(row) != BUSY) {
            if (left == 0 && has_gone(row)) return 0;
            left = left > 0 ? left - 1 : 0;
            pause();
            continue;
        }
        if (row[ENTRY] == PYTHON) {
            make_pauses(delay);
            return 1;
        }
        row[STATUS] = run_entry((Entry*)row[ENTRY], (const Word*)row[WORDS]);
        report_done(row);
        left = looks;
    }
}

// Spin until the first helpers are done with their bands; 0 if that takes too long.
EXPORTED Word are_done(Word* board, Word count, Word looks) {
    for (Word i = 0; i < count; i++) {
        for (Word left = looks; flag_of(board + LINE * i) == BUSY; left--) {
            if (left <= 0) return 0;
            pause();
        }
    }
    return 1;
}

#if defined(__linux__)
extern "C" int getpid();
extern "C" unsigned sleep(unsigned seconds);
extern "C" [[noreturn]] void abort();

// The terminate handler of C++ while the program ends (compiled/library.py). A daemon thread that
// Python stops inside of a library sleeps here until the process is gone. The main thread aborts.
EXPORTED Word sleep_unless_main() {
#if defined(__x86_64__)
    constexpr long GETTID = 186;
#else
    constexpr long GETTID = 178;
#endif
    if (syscall(GETTID) == getpid()) abort();
    for (;;) sleep(60);
}
#endif
