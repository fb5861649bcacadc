// What the network's last layer means: filter weights, gates and a hidden state.
#pragma once
#include "../number.h"
#include "denoise.h"

enum Meaning { WEIGHT, GATE, HIDDEN_STATE };

// Of a channel of the fine head, and of a level's.
FN Meaning fine_meaning(Long channel) {
    return channel < BLEND ? WEIGHT : channel < MEMORY ? GATE : HIDDEN_STATE;
}
FN Meaning level_meaning(Long channel) { return channel < KERNEL ? WEIGHT : GATE; }

// NaN stays NaN: what the network made of a broken history is not taken for an answer.
template <class F, Meaning MEANING> FN F opened(F logit) {
    if constexpr (MEANING == WEIGHT) {
        return exp_of<F>(bounded<F>(logit, -STEEPEST, STEEPEST));
    } else if constexpr (MEANING == GATE) {
        return 1.0f / (1.0f + exp_of<F>(bounded<F>(-logit, -80.0f, 80.0f)));
    } else {
        return 1.0f - 2.0f / (1.0f + exp_of<F>(bounded<F>(2.0f * logit, -80.0f, 80.0f)));
    }
}

// Calls use(Constant) with a meaning that the compiler knows.
template <Meaning MEANING> struct Constant {
    static constexpr Meaning is = MEANING;
};
template <class Use> FN void with_meaning(Meaning meaning, const Use& use) {
    if (meaning == WEIGHT) use(Constant<WEIGHT>());
    else if (meaning == GATE) use(Constant<GATE>());
    else use(Constant<HIDDEN_STATE>());
}

struct Scale {
    float factor, offset;
};
template <class F> FN F logit_of(typename Of<F>::Int sum, Scale scale) {
    return number(sum) * scale.factor + scale.offset;
}
