// Numbers that several kernels of the denoiser use. A test compares them with those in Python.
#pragma once

constexpr float TINY = 1e-8f;
constexpr float LEAST_IMPORTANCE = 1e-30f;
constexpr float STEEPEST = 8.0f;
constexpr float LEAST_LOG_ERROR = -14.0f;
constexpr float MOST_LOG_ERROR = 0.0f;
constexpr float MAX_COLOUR = 1e4f;
constexpr float MAX_LIGHT = 1e30f;
constexpr float MAX_FLOAT = 3e38f;
constexpr float MOST_LOG = 20.0f;
constexpr float MOST_REFLECTANCE = 4.0f;
constexpr float EMITTER = 0.005f;
constexpr float LEAST_TINT = 0.15f;
constexpr float ADDED = 0.01f;
constexpr float MOST_STATE = 3e5f;
constexpr float MAX_COUNT = 32.0f;
constexpr float NEAREST = 1e-6f;
constexpr float FARTHEST = 1e9f;
constexpr float MAX_DEPTH = 1e10f;
constexpr float UNKNOWN = 1e-3f;
constexpr int STATE = 12;
constexpr int HIDDEN = 8;
constexpr int TRUST_CELL = 8;
constexpr int NEAR_CELL = 4;
constexpr int KERNEL = 25;
constexpr int TAP_WEIGHTS = KERNEL;
constexpr int BLEND = 61;
constexpr int SHARPEN = 65;
constexpr int MIX = 69;
constexpr int DISTRUST = 70;
constexpr int IMPORTANCE = 71;
constexpr int MEMORY = 72;
constexpr int FINE = 80;
constexpr int PLANE_TRUST = FINE - 1;
