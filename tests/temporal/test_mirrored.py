"""Frames with left and right exchanged."""

from dataclasses import replace

import numpy as np

from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.temporal.mirrored import mirror, mirror_plane


def moving(seed: int, number: int = 1) -> Frame:
    """A noisy wall that moves to the right, seen by a camera, with a part."""
    rng = np.random.default_rng(seed)
    motion = np.zeros((32, 48, 2), np.float32)
    motion[..., 0] = -2
    return Frame({Role.COLOUR: rng.exponential(size=(32, 48, 3)).astype(np.float32),
                  Role.DEPTH: np.full((32, 48, 1), 3, np.float32),
                  Role.MOTION: motion},
                 number, jitter=(0.25, -0.125), world_to_camera=np.diag([2.0, 3.0, 4.0, 1.0]),
                 parts={"key": rng.random((32, 48, 3), np.float32)})


def test_mirrored_twice_it_is_the_same_frame():
    guides = {Role.DEPTH: np.random.default_rng(2).random((64, 96, 1), np.float32)}
    frame = replace(moving(1), guides=guides)
    once = mirror(frame)
    assert mirror(once) == frame
    np.testing.assert_array_equal(once[Role.COLOUR][:, 0], frame[Role.COLOUR][:, -1])
    np.testing.assert_array_equal(once.parts["key"][:, 0], frame.parts["key"][:, -1])
    np.testing.assert_array_equal(once.guides[Role.DEPTH][:, 0], frame.guides[Role.DEPTH][:, -1])
    assert once.jitter == (-0.25, -0.125)
    assert (once[Role.MOTION][..., 0] == 2).all() and not once[Role.MOTION][..., 1].any()
    assert (once.world_to_camera == np.diag([-2.0, 3.0, 4.0, 1.0])).all()


def test_the_history_follows_mirrored_motion(device):
    """A mirrored sequence is denoised as well as the other one: its noise is not smeared."""
    spreads = []
    for turn in (lambda frame: frame, mirror):
        passes = Pipeline([DenoiseUpscale(scale=1, model="s")], device, 0.0)
        for number in range(1, 7):
            found = passes(turn(moving(number, number)))[Role.COLOUR]
        spreads.append(float(found.std()))
    assert abs(spreads[1] / spreads[0] - 1) < 0.15
    assert mirror_plane(found).flags.c_contiguous
