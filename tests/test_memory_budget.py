"""Memory budgets: sizes as people write them, arrays in files, frames in tiles."""

from __future__ import annotations

import errno
import mmap
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from postfx import Device, Frame, Pipeline, Role
from postfx.errors import MemoryBudgetError
from postfx.frame import ROLES
from postfx.kernels.statistics import block_means, half_means, light_outside
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.geometry import Size, Sizes
from postfx.passes.denoise.models import seamless
from postfx.passes.denoise.planes import ABSENT, absent_plane
from postfx.passes.denoise.tiling import bands_within
from postfx.passes.tonemap import ToneMap
from postfx.planes import largest_bits_of, lend, sampled
from postfx.runtime import DeviceError, device
from postfx.system import Scratch, parse_size
from tests.passes.denoise_frames import noisy


@pytest.mark.parametrize(("text", "size"), [("4G", 4 << 30), ("1.5 GB", 3 << 29),
                                            ("512m", 512 << 20), ("2KiB", 2048),
                                            (1 << 20, 1 << 20)])
def test_sizes_as_people_write_them(text: str | int, size: int) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "lots", "-4G", "0", "4 X", "4GG"])
def test_other_sizes_are_errors(text: str) -> None:
    with pytest.raises(MemoryBudgetError,
                       match="is not a size: give bytes, or a number with K, M, G or T"):
        parse_size(text)


def test_large_arrays_keep_their_content_when_let_go_of() -> None:
    scratch = Scratch("16M")
    small, large = scratch.empty((8, 8)), scratch.empty((1024, 512))
    small[:], large[:] = 1, np.arange(512)
    scratch.relax()
    np.testing.assert_array_equal(large, np.tile(np.arange(512), (1024, 1)))
    assert small.base is None and large.base is not None


def test_pieces_cover_everything_once() -> None:
    pieces = list(Scratch("1M").pieces(1000, 4096))
    assert [row for first, last in pieces for row in range(first, last)] == list(range(1000))
    assert len(pieces) > 10


def resident() -> int:
    """Bytes of this process in memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def test_tensors_beyond_the_budget_take_no_memory() -> None:
    place = Device("cpu", memory="256M")
    before = resident()
    tensors = [place.heap.tensor(f"tensor {i}", (64 << 20,), "uint8") for i in range(6)]
    for i, tensor in enumerate(tensors):
        tensor.fill(i)
    place.memory.relax()
    assert resident() - before < 32 << 20
    assert [int(tensor.array[-1]) for tensor in tensors] == list(range(6))


@pytest.mark.parametrize("can_clear", [True, False])
def test_tensors_of_zeros_are_not_written(can_clear: bool,
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture of 15360x8640 wrote 20 GB of them before its first tile."""
    if not can_clear:
        monkeypatch.delattr(mmap, "MADV_REMOVE")
    place = Device("cpu", memory="64M")
    tensors = [place.heap.tensor(f"tensor {i}", (1234, 999)) for i in range(3)]
    for tensor, value in zip(tensors, (1, 2, 3), strict=True):
        tensor.fill(value)
    written: list[tuple[int, int]] = []
    pieces = place.scratch.pieces
    monkeypatch.setattr(place.scratch, "pieces",
                        lambda *args: written.append(args) or pieces(*args))
    tensors[1].fill(0)
    assert (not written) == can_clear
    for tensor, value in zip(tensors, (1, 0, 3), strict=True):
        assert tensor.array.min() == value == tensor.array.max()


@pytest.mark.parametrize("look", [
    lambda plane: half_means(plane, 16), lambda plane: block_means(plane, 16), largest_bits_of,
    lambda plane: sampled(plane, 16, 16, 8), light_outside,
])
def test_looking_at_a_whole_plane_takes_no_memory(look: Callable[[np.ndarray], object]) -> None:
    """Finding cuts and metering held all of a picture of 15360x8640 at once, 1.5 GiB of it."""
    place = Device("cpu", memory="256M")
    plane = place.scratch.empty((2048, 4096, 3))
    for first, last in place.scratch.pieces(len(plane), plane[0].nbytes):
        plane[first:last] = np.arange(first, last)[:, None, None]
    wanted, before = look(plane), resident()
    place.memory.relax()
    with lend(place.divide_planes):
        found = look(plane)
    assert resident() < before - plane.nbytes // 2
    np.testing.assert_array_equal(found, wanted)


def test_planes_that_a_frame_lacks_take_no_memory() -> None:
    """A picture of 15360x8640 without planes took 7 GiB for them, whatever the budget."""
    place, size = Device("cpu", memory="256M"), Size(2048, 4096)
    before = resident()
    planes = {role: absent_plane(place, role, size) for role in (*ABSENT, *ABSENT)}
    place.memory.relax()
    assert resident() - before < 32 << 20
    for role, plane in planes.items():
        assert plane.shape == (*size, ROLES[role].channels)
        np.testing.assert_array_equal(plane.array[::500, -1],
                                      np.float32(ABSENT[role]) + 0 * plane.array[::500, -1])


def test_a_budget_is_for_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    remote = SimpleNamespace(host_visible=False)
    with monkeypatch.context() as patch:
        patch.setattr(device, "choose", lambda *rest: (None, remote))
        with pytest.raises(DeviceError,
                           match="a memory budget is for the CPU, not for 'cuda': leave one of "
                           "them out"):
            Device("cuda", memory="4G")
    assert Device("auto", memory="4G").memory.host_visible


@pytest.mark.parametrize("model", ["s", "m.fp32"])
def test_frames_in_tiles_have_no_seams(model: str) -> None:
    """Against whole ones, tone-mapped, over frames of motion."""
    whole = Pipeline([DenoiseUpscale(model=model), ToneMap()], Device("cpu", threads=2))
    tiled = Pipeline([DenoiseUpscale(model=model), ToneMap()],
                     Device("cpu", threads=2, memory="560M"))
    for number in (1, 2):
        frame = noisy(number, 300, 330)
        wanted, found = whole(frame)[Role.COLOUR], tiled(frame)[Role.COLOUR]
        assert np.abs(found - wanted).max() < 1e-3
    bands = tiled.passes[0]._ready.networks._bands
    assert len(bands) * len(bands[0].tiles) > 1


def test_too_many_open_files_are_no_full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(MemoryBudgetError,
                       match="too many open files, .* keep fewer frames, or raise 'ulimit -n'"):
        Scratch("1M").map_file(1 << 20)


def test_a_budget_that_is_too_small_names_the_smallest_that_would_do() -> None:
    frame = noisy(1, 300, 330)
    with pytest.raises(MemoryBudgetError,
                       match="330x300 cannot be denoised within 320M: give a memory") as error:
        Pipeline([DenoiseUpscale(model="s")], Device("cpu", memory="320M"))(frame)
    least, sizes = str(error.value).split()[-3], Sizes(Size(300, 330), Size(600, 660))
    assert len(bands_within(Scratch(least), sizes, seamless(["denoise_upscale.s.int8"]))) > 1
    with pytest.raises(MemoryBudgetError):
        bands_within(Scratch(parse_size(least) - (2 << 20)), sizes,
                     seamless(["denoise_upscale.s.int8"]))


@pytest.mark.parametrize(("side", "budget"),
                         [(1024, "600M"), (4096, "800M"), (4096, "4G"), (8192, "1100M")])
def test_the_commands_of_all_tiles_fit_in(side: int, budget: str) -> None:
    """Each takes some 0.2 MB, whatever the size of its window."""
    bands = bands_within(Scratch(budget), Sizes(Size(side, side), Size(2 * side, 2 * side)),
                         seamless(["denoise_upscale.m.int8"]))
    tiles = [tile for band in bands for tile in band.tiles]
    windows = max(tile.window.rows * tile.window.columns for tile in tiles)
    assert 200_000 * len(tiles) + 2400 * windows < parse_size(budget) - (300 << 20)


def test_a_mask_within_a_budget() -> None:
    frame = noisy(1, 300, 330)
    plane = np.zeros((300, 330, 1), np.float32)
    plane[200:230, 40:80] = 1
    frame = Frame({**frame.planes, Role.STRENGTH: plane}, jitter=frame.jitter)
    wanted, found = (Pipeline([DenoiseUpscale(model="s")],
                              Device("cpu", memory=memory))(frame)[Role.COLOUR]
                     for memory in (None, "560M"))
    np.testing.assert_allclose(found, wanted, atol=1e-3, rtol=1e-3)
