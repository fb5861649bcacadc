"""Frame after frame: no new memory, and no more time."""

from __future__ import annotations

import os
import sys
import time
import weakref

import numpy as np
import pytest

import postfx
from postfx.frame import ROLES, Frame, Role
from postfx.runtime import CommandBuffer, Device
from postfx.runtime.hazards import Footprint

PLANES = (Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.DIFFUSE_ALBEDO,
          Role.SPECULAR_ALBEDO, Role.ROUGHNESS)
HEIGHT, WIDTH = 72, 128
WARM = 10
TAGS = "aces2", "local"


def frame(number: int) -> Frame:
    random = np.random.default_rng(number % 4)
    planes = {role: random.random((HEIGHT, WIDTH, ROLES[role].channels), np.float32)
              for role in PLANES}
    return Frame(planes, number=number, jitter=(0.1, -0.2))


def resident_bytes() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def timed(chain: postfx.Pipeline, picture: Frame) -> float:
    """Seconds of processor time that a frame takes."""
    began = time.process_time()
    chain(picture)
    return time.process_time() - began


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(("count", "threads"), [(150, 2), *(
    pytest.param(*values, marks=pytest.mark.soak) for values in ((150, 1), (1000, 1), (1000, 2)))])
def test_many_frames_take_no_more_memory_than_ten_and_no_more_time(count: int,
                                                                   threads: int) -> None:
    """Memory within 1 % and a MiB. Processor time of the fastest frames is that of a new chain, in
    turn with the old one: a machine that grows slower meanwhile slows both."""
    device, new = (Device("cpu", threads=threads) for _ in range(2))
    chain, fresh = (postfx.Pipeline([postfx.DenoiseUpscale(model="s"), postfx.ToneMap()], one)
                    for one in (device, new))
    frames, heaps, process = [frame(number) for number in range(4)], set(), []
    for number in range(count):
        chain(frames[number % 4])
        if number >= WARM:
            heaps.add((device.heap.size, device.heap.used, device.heap.peak))
            process.append(resident_bytes())
    assert len(heaps) == 1
    assert max(process) <= 1.01 * process[0] + (1 << 20)
    turns = [(timed(fresh, seen), timed(chain, seen)) for seen in 10 * frames]
    before, after = (np.quantile(part, 0.1) for part in zip(*turns[WARM:], strict=True))
    assert after < 1.25 * before
    print(f"{count} frames, {threads} threads: {process[0] / 1e6:.1f} MB at frame {WARM + 1}, "
          f"{max(process) / 1e6:.1f} MB at most; processor time a frame {1e3 * before:.1f} and "
          f"{1e3 * after:.1f} ms")


@pytest.mark.parametrize("small", [False, True])
def test_planes_in_the_same_memory_are_known_again(small: bool,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands are searched for hazards once, and results are those of planes that lie elsewhere in
    each frame, which nothing keeps in memory. Small ones are copied from the second frame on."""
    monkeypatch.setattr("postfx.runtime.heap.CHUNK_BYTES", 1)
    monkeypatch.setattr("postfx.flow.SMALL_COPY_BYTES", 1 << 20 if small else 0)
    made: list[int] = []
    same, other = (postfx.Pipeline([postfx.DenoiseUpscale(model="s"), postfx.ToneMap()],
                                   Device("cpu", threads=1))
                   for _ in range(2))
    lasting, gone = frame(0), []
    for number in range(8):
        new = frame(number)
        for role, plane in lasting.planes.items():
            plane[...] = new[role]
        before = len(made)
        with monkeypatch.context() as patch:
            patch.setattr("postfx.runtime.commands.Footprint",
                          lambda records: made.append(1) or Footprint(records))
            found = same(lasting)
        assert len(made) == before + (number < 1)
        # the first frame's memory went when the second came
        heap = same.device.heap
        assert heap.size - heap.networks < 1.2 * heap.used
        np.testing.assert_array_equal(found[Role.COLOUR], other(new)[Role.COLOUR])
        gone.append(weakref.ref(new[Role.COLOUR]))
        del new
        assert [held() is None for held in gone] == number * [True] + [small and number > 0]


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("away", [False, True])
def test_commands_of_a_steady_frame_are_recorded_once(
    masked: bool, away: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From then on no pass begins an encoder, and results are those of a pipeline that records
    every frame: also where two masks come in turn, whose rows lie in the same transient memory."""
    begun: list[str] = []
    start = CommandBuffer._start
    monkeypatch.setattr(CommandBuffer, "_start", lambda self, encoder: begun.append(encoder.label)
                        or start(self, encoder))
    device = Device("cpu", threads=1)
    again, anew = (postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model="s"),
                                    postfx.ToneMap(look=TAGS[masked])],
                                   device, 0.5, cuts="none") for _ in range(2))
    for known in (anew._flow._recordings.passages, anew._flow._recordings.commands):
        monkeypatch.setattr(known, "find", lambda key: None)
    lasting = frame(1)
    masks = np.zeros((2, HEIGHT, WIDTH, 1), np.float32)
    masks[0, :20], masks[1, 8:12] = 1, 0.5
    strength = np.zeros((HEIGHT, WIDTH, 1), np.float32)
    shown = Frame({**lasting.planes, **({Role.STRENGTH: strength} if masked else {})})
    for number in range(12):
        strength[...] = masks[number // 2 % 2]
        expected, before = run(anew, shown, away), len(begun)
        found = run(again, shown, away)
        assert len(begun) == before or number < 8
        np.testing.assert_array_equal(found, expected)


def run(chain: postfx.Pipeline, shown: Frame, away: bool) -> np.ndarray:
    """The colour that comes out, of planes that stay in the device's memory or not."""
    if not away:
        return chain(shown)[Role.COLOUR]
    return chain.on_device(shown.planes, exposure=0.5)[Role.COLOUR].download()
