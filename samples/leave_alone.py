"""Misses denoised, left alone, and left alone where they are free of noise, with more and more
noise put on them.

python samples/leave_alone.py [COUNT_OF_FRAMES]

Prints, for each noise (standard deviation over the sky's own light), the PSNR in dB of the sky in
the windows, exposed for the sky, and the share of the picture that 'auto' leaves alone. pip install
'.[bench]'
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import postfx
from postfx import Role
from postfx.masks import misses_of, strength_of_misses
from postfx.tools.bench.metrics import to_codes

ROOM = Path(__file__).parent / "room"
NOISE = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.3)


def noisy_sky(frame: postfx.Frame, noise: float) -> postfx.Frame:
    """As if the air in front of the sky scattered light."""
    random = np.random.default_rng(frame.number)
    colour = frame[Role.COLOUR].copy()
    missed = misses_of(frame.planes)
    colour[missed] *= np.maximum(0,
                                 1 + noise * random.standard_normal((missed.sum(), 1), np.float32))
    return replace(frame, planes={**frame.planes, Role.COLOUR: colour})


def main() -> None:
    wanted = f"1-{sys.argv[1] if len(sys.argv) > 1 else 8}"
    frames = list(postfx.read_sequence(ROOM / "noisy.####.exr", wanted))
    references = list(postfx.read_sequence(ROOM / "reference.####.exr", wanted))
    skies = [np.kron(strength_of_misses(frame.planes)[..., 0] == 0, np.ones((2, 2))) > 0
             for frame in frames]
    print("noise  denoised  left alone   auto  auto leaves")
    for noise in NOISE:
        passes = [postfx.Pipeline([postfx.DenoiseUpscale(scale=2)]) for _ in range(3)]
        errors, alone = np.zeros(3), 0.0
        for clean, reference, sky in zip(frames, references, skies, strict=True):
            frame = noisy_sky(clean, noise)
            auto = strength_of_misses(frame.planes)
            hits = 1 - misses_of(frame.planes)[..., None].astype(np.float32)
            light = reference[Role.COLOUR][sky]
            target = to_codes(light, 0.5 / light.mean())
            for i, strength in enumerate((np.ones_like(auto), hits, auto)):
                result = passes[i](replace(frame, planes={**frame.planes, Role.STRENGTH: strength}))
                found = to_codes(result[Role.COLOUR][sky], 0.5 / light.mean())
                errors[i] += np.square(found - target).mean() / len(frames)
            alone += (auto == 0).mean() / len(frames)
        denoised, left, chosen = -10 * np.log10(errors)
        print(f"{noise:5.3f}  {denoised:8.1f}  {left:10.1f}  {chosen:5.1f}  {100 * alone:9.1f} %",
              flush=True)


if __name__ == "__main__":
    main()
