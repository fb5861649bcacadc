// Numbers that several kernels of the denoiser use. A test compares them with those in Python.
#pragma once

constexpr float TINY = 1e-8f;
constexpr float STEEPEST = 8.0f;
constexpr int KERNEL = 25;
constexpr int TAP_WEIGHTS = KERNEL;
constexpr int BLEND = 61;
constexpr int SHARPEN = 65;
constexpr int MIX = 69;
constexpr int MEMORY = 72;
constexpr int FINE = 80;
