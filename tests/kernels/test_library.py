"""Kernels in C++: the same bits at every level of a processor, NaN and infinity in every form, and
the library itself: found, compiled once, compiled again where it is damaged, and one clear line
where it cannot be had."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from postfx.compiled import build, library
from postfx.compiled.library import Rows
from postfx.errors import BindingError, DeviceError
from postfx.kernels import Kernel, constants_of, find_source
from postfx.kernels.denoise import FINE
from postfx.kernels.denoise.alpha import CORRECT, FIT, GATHER
from postfx.kernels.denoise.features import FEATURE
from postfx.kernels.denoise.history import HISTORY, KEEP
from postfx.kernels.denoise.network_io import OPEN_PHASED
from postfx.kernels.denoise.parts import (
    ACCUMULATE_PART,
    BALANCE,
    DECODE,
    DECODE_ONE,
    UPSAMPLE_LIGHT,
)
from postfx.kernels.denoise.pyramid import ENLARGE_ALPHA, FILTER, MIX_LEVELS, POOL, REMODULATE
from postfx.kernels.denoise.upsample import UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED
from postfx.kernels.occlusion import FIND_SURFACE, LOOK
from postfx.kernels.scene import POINT
from postfx.runtime import ArgumentTable, Device
from tests.conftest import REPOSITORY
from tests.kernels import denoise_cases, foreign, host_cuda, recorded_calls
from tests.kernels.denoise_cases import ODD, arguments, case_for, run, shape
from tests.kernels.test_denoise_kernels import FROM_CODES, codes_of

IN_CPP = [kernel for kernel in (*denoise_cases.KERNELS, *denoise_cases.IN_ROWS_ALONE,
                                *(coded for _, coded in FROM_CODES))
          if isinstance(kernel.rows, Rows)]
FUSED = [level for level in library.levels() if level != "baseline"] or ["baseline"]
"""Levels that multiply and add in one instruction."""
pytestmark = pytest.mark.usefixtures("every_level")
needs_compiler = pytest.mark.skipif(importlib.util.find_spec("ziglang") is None,
                                    reason="needs ziglang")
HEADER = """
#include "rows.h"

static void scale_rows(Long first, Long last, View<const float, 2> image, Given<float> by,
                       View<float, 2> scaled) {
    for (Long y = first; y < last; y++) {
        across(0, image.size[1], EACH(F, Long x) {
            store<F>(scaled(y) + x, load<F>(image(y) + x) * *by);
        });
    }
}
EXPORT(scale, scale_rows)
"""


def at_level(kernel: Kernel, level: str, inputs: dict[str, np.ndarray],
             case: denoise_cases.Case) -> list[np.ndarray]:
    """What a kernel writes, given all rows at once."""
    found = {name: np.zeros(shape(kernel, name, case), kernel.types.get(name, "float32"))
             for name in kernel.writes}
    name, axis = kernel.row_axis
    Rows(kernel.rows.name, level=level)(0, found[name].shape[axis], *inputs.values(),
                                        *found.values())
    return list(found.values())


def inputs_of(kernel: Kernel,
              most: int = 100) -> Iterator[tuple[denoise_cases.Case, dict[str, np.ndarray]]]:
    """Cases and what a kernel reads there."""
    plain = {coded: plain for plain, coded in FROM_CODES}.get(kernel)
    for case, bad in denoise_cases.runs_of(kernel)[:most]:
        inputs = arguments(plain or kernel, case, bad=bad)
        codes = codes_of(case_for(kernel, case), 4 * FINE, 12)[0] if plain else {}
        yield case, {name: codes.get(name, inputs.get(name)) for name in kernel.reads}


@pytest.mark.parametrize("kernel", IN_CPP, ids=lambda kernel: kernel.name)
def test_every_level_gives_the_same_bits(kernel: Kernel) -> None:
    for case, inputs in inputs_of(kernel):
        wanted = at_level(kernel, FUSED[0], inputs, case)
        for level in FUSED[1:]:
            for one, other in zip(at_level(kernel, level, inputs, case), wanted, strict=True):
                np.testing.assert_array_equal(one, other, f"{case} {level}")
        for one, other in zip(at_level(kernel, "baseline", inputs, case), wanted, strict=True):
            scale = np.abs(other[np.isfinite(other)]).max(initial=1)
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * scale, err_msg=str(case))


def other_rows() -> Iterator[tuple[str, list[np.ndarray], list[np.ndarray]]]:
    """Names of rows that are no denoiser's, with what they read and write; planes hold NaN and
    infinity."""
    random, (h, w) = np.random.default_rng(4), (19, 77)
    light = np.exp2(random.normal(-2, 8, (h * w * 3))).astype(np.float32)
    light[::13], light[1::17], light[2::19] = np.nan, np.inf, -light[2::19]
    plain = random.integers(0, 256, 2 * h * w * 8, np.uint8)
    words = random.integers(0, 1 << 16, (h, 3 * w))
    byte_rows, channels = plain[:h * w].reshape(h, w), np.array([(1, 0), (2, w)])
    yield "halve_pixels", [light], [np.zeros((3, h * w), np.uint16)]
    yield "widen_rows", [words.astype(np.uint16), channels], [np.zeros((h, w, 2), np.float32)]
    yield "look_up", [light, np.linspace(0, 2, 100, dtype=np.float32)], [np.zeros_like(light),
                                                                         np.zeros(1, bool)]
    yield ("dither_rows",
           [light.reshape(h, -1), np.float32([255]), random.random((7, 48), np.float32)],
           [np.zeros((h, 3 * w), np.uint8)])
    yield ("filter_rows", [byte_rows, byte_rows[3].copy(), np.array([3])],
           [np.zeros((h, w + 1), np.uint8)])
    yield "predict_bytes", [plain], [np.zeros_like(plain)]
    yield "unpredict_bytes", [plain], [np.zeros(plain.size // 2, np.uint16)]
    normal = random.normal(0, 1, (h, w, 3)).astype(np.float32)
    depth = 1 + random.random((h, w, 1), np.float32)
    normal[2, 3], depth[4, 5], depth[6, 7] = np.nan, np.inf, np.nan
    camera, settings = np.float32([*np.eye(3).ravel(), 0.4, 0.5, 0.3]), np.float32([0.6, 0.3])
    surface, visible = np.zeros((h, w, 4), np.float32), np.zeros((h, w), np.float32)
    yield "occlusion_surface", [normal, depth, camera], [surface]
    FIND_SURFACE.rows(0, h, normal, depth, camera, surface)
    yield "occlusion_horizons", [surface, camera, settings], [visible]
    noisy = random.random((h, w), np.float32)
    yield "occlusion_smooth", [surface, noisy], [visible]
    points = np.zeros((5 * w, LOOK), np.float32)
    yield "occlusion_looks", [surface, camera, noisy, noisy, np.float32([3])], [points]
    camera, box = np.float32([*camera, 1, 0.6, 0.2, -0.1]), np.float32([0, 1, 2, 3])
    near = np.nan_to_num(normal, posinf=1)
    yield "scene_points", [camera, box, depth, near], [np.zeros((h * w, POINT), np.float32)]
    planes = [random.random((h, w, 3), np.float32) for _ in range(3)]
    yield "scene_light", [light.reshape(h * w, 3), *planes], [np.zeros((h, w, 3), np.float32)]


UNFUSED = {"occlusion_looks": 1e-6, "scene_points": 1e-5, "scene_light": 1e-5}
"""How far rows are off without fused products, whose sums round otherwise."""


def rows_of(name: str, written: list[np.ndarray]) -> int:
    """How many rows are asked for."""
    return (len(written[0]) if written[0].ndim > 1 and name != "halve_pixels"
            else written[0].shape[-1])


@pytest.mark.parametrize(("name", "read", "written"), [*other_rows()],
                         ids=lambda value: value if isinstance(value, str) else "")
def test_other_rows_give_the_same_bits_at_every_level(name: str, read: list[np.ndarray],
                                                      written: list[np.ndarray]) -> None:
    """Without fused products, too, but where sums have them; what is no number stays where it
    is."""
    rows, found = rows_of(name, written), {}
    for level in library.levels():
        found[level] = [np.zeros_like(array) for array in written]
        Rows(name, level=level)(0, rows, *read, *found[level])
    for level, arrays in found.items():
        for one, other in zip(arrays, found[FUSED[0]], strict=True):
            off = UNFUSED.get(name, 0) if level == "baseline" else 0
            np.testing.assert_allclose(one, other, off, off, err_msg=level)
            assert name == "widen_rows" or one.dtype != np.float32 or np.isfinite(one).all()


@needs_compiler
def test_a_checkout_compiles_only_what_is_used(plug_in: Path, monkeypatch: pytest.MonkeyPatch,
                                               tmp_path: Path) -> None:
    """A kernel alone, or the rest of its file; a whole library, where there is one, is taken for
    both."""
    packaged = tmp_path / "packaged"
    monkeypatch.setattr(build, "PACKAGED", packaged)
    for made in (library._whole_library, library.open_library, library._form):
        made.cache_clear()
    library._compiled_parts.clear()
    parts = build.our_parts()
    assert parts["denoise_strength"].alone and not parts["enlarge_motion"].alone
    assert {kernel.rows.name for kernel in IN_CPP} <= {*parts}
    strength, motion = (library.open_library(name)
                        for name in ("denoise_strength", "enlarge_motion"))
    assert len([*packaged.glob("*/objects/*.o")]) == 2
    assert strength.denoise_strength_takes and motion.mix_partner_takes
    for missing in ("denoise_restore", "denoise_judge"):
        assert not hasattr(strength, missing)
    for made in (library._whole_library, library.open_library, library._form):
        made.cache_clear()
    library._compiled_parts.clear()


def calls_elsewhere(most: int) -> list[foreign.Call]:
    """Calls of kernels in C++: on cases, and as frames make them."""
    calls = []
    for kernel in IN_CPP:
        for case, inputs in inputs_of(kernel, most):
            made = {name: np.zeros(shape(kernel, name, case), kernel.types.get(name, "float32"))
                    for name in kernel.writes}
            name, axis = kernel.row_axis
            rows = (0, made[name].shape[axis])
            calls.append(foreign.Call(kernel.rows.name, rows, [*inputs.values(), *made.values()]))
    calls += [foreign.Call(name, (0, rows_of(name, made)), [*read, *made])
              for name, read, made in other_rows()]
    return calls + recorded_calls.of_frames()


def names_of(calls: list[foreign.Call]) -> list[str]:
    """Of the kernels that are called."""
    return sorted({call.name for call in calls})


def check_same_bits(calls: list[foreign.Call], found: list[list[np.ndarray]],
                    level: str) -> None:
    """As those of a level here."""
    for call, arrays in zip(calls, found, strict=True):
        wanted = [array.copy() for array in call.arrays]
        Rows(call.name, level=level)(*call.rows, *wanted)
        for one, other in zip(arrays, wanted, strict=True):
            np.testing.assert_array_equal(one, other, call.name)


elsewhere = pytest.mark.parametrize("most", [2, pytest.param(6, marks=pytest.mark.soak)])


@needs_compiler
@pytest.mark.skipif(foreign.QEMU is None, reason="needs qemu-aarch64")
@elsewhere
def test_arm64_gives_the_same_bits_too(tmp_path: Path, most: int) -> None:
    """An emulator runs the kernels compiled for it."""
    calls = calls_elsewhere(most)
    program = foreign.with_kernels(names_of(calls), "aarch64-linux-musl", "generic", tmp_path)
    check_same_bits(calls, foreign.run_in_qemu(program, calls), FUSED[-1])


@needs_compiler
@pytest.mark.skipif(foreign.NODE is None, reason=f"needs Node.js {foreign.OLDEST_NODE}")
@elsewhere
def test_wasm_gives_the_bits_of_a_processor_without_fused_products(tmp_path: Path,
                                                                   most: int) -> None:
    calls = calls_elsewhere(most)
    program = foreign.with_kernels(names_of(calls), "wasm32-wasi", "generic+simd128", tmp_path)
    check_same_bits(calls, foreign.run_in_node(program, calls), "baseline")


@needs_compiler
@pytest.mark.skipif(foreign.WINE is None, reason="needs wine64")
@pytest.mark.parametrize("level", [
    FUSED[-1],
    *(pytest.param(level, marks=pytest.mark.soak) for level in library.levels()[:-1])])
def test_the_library_for_windows_gives_the_same_bits(tmp_path: Path, level: str) -> None:
    calls = calls_elsewhere(2)
    _, made = foreign.windows_libraries(tmp_path, level)
    check_same_bits(calls, foreign.run_in_wine(made, calls, tmp_path), level)


CODED = {coded for _, coded in FROM_CODES}
OTHERWISE = {FEATURE, UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED, UPSAMPLE_LIGHT, ACCUMULATE_PART,
             BALANCE, DECODE, DECODE_ONE, KEEP, GATHER, FIT, CORRECT, ENLARGE_ALPHA}
"""Kernels whose portable definition has other answers: the first multiply what they leave out by 0,
so that NaN and infinity get into neighbours, as alpha's work on pixels where nothing is near; the
others hold NaN within bounds, where ONNX's Clip, Min and Max leave it."""
MOST_CHANGED = 330
"""Numbers that three bad ones may change: 6x6 output pixels of three each."""


def forms(kernel: Kernel, inputs: dict[str, np.ndarray],
          case: denoise_cases.Case) -> dict[str, dict[str, np.ndarray]]:
    """What every form of a kernel makes of the same arguments."""
    found = {level: dict(zip(kernel.writes, at_level(kernel, level, inputs, case), strict=True))
             for level in library.levels()}
    if kernel not in CODED | OTHERWISE | {*denoise_cases.IN_ROWS_ALONE}:
        found["portable"] = run(kernel, Device("cpu", 1, compiled_kernels=False), inputs, case)
    if host_cuda.COMPILER and find_source(kernel) and kernel not in CODED:
        found["cuda"] = {name: np.zeros(shape(kernel, name, case),
                                        kernel.types.get(name, "float32"))
                         for name in kernel.writes}
        host_cuda.run(kernel, inputs | found["cuda"])
    return found


def planes_of(kernel: Kernel, inputs: dict[str, np.ndarray]) -> list[str]:
    """Bindings that may hold NaN: those with a number for every pixel, but for what other kernels
    made finite."""
    return [name for name, array in inputs.items() if array.dtype in (np.float32, np.float16)
            and array.size >= 1000 and name not in ("moved", "keep")]


BAD = (np.nan, np.inf, -np.inf)


@pytest.mark.parametrize("kernel", IN_CPP, ids=lambda kernel: kernel.name)
@pytest.mark.parametrize("values", [
    pytest.param(BAD, id="all three"),
    *(pytest.param((value,) * 3, marks=pytest.mark.soak, id=str(value)) for value in BAD)])
def test_nan_and_infinity_go_into_what_is_made_of_them_and_into_nothing_else(
    kernel: Kernel, values: tuple[float, ...]
) -> None:
    """In every form: at the same places, while all other pixels keep their bits."""
    case, inputs = next(inputs_of(kernel))
    clean = forms(kernel, inputs, case)
    for binding in planes_of(kernel, inputs):
        broken = {name: array.copy() for name, array in inputs.items()}
        flat = broken[binding].reshape(-1)
        flat[np.random.default_rng(1).integers(0, flat.size, len(values))] = values
        found = forms(kernel, broken, case)
        for name in kernel.writes:
            wanted = found[FUSED[0]][name]
            kept = wanted == clean[FUSED[0]][name]
            finite = np.isfinite(wanted)
            where = f"{binding} {name}"
            assert (~kept).sum() <= MOST_CHANGED, where
            for form, arrays in found.items():
                # others may round a change that these do not see
                bits = 0 if form in FUSED else 1e-6
                np.testing.assert_allclose(arrays[name][kept], clean[form][name][kept], bits, bits,
                                           err_msg=where)
                np.testing.assert_array_equal(np.isfinite(arrays[name]), finite, f"{where} {form}")
                if form in FUSED:
                    np.testing.assert_array_equal(arrays[name], wanted, f"{where} {form}")
                else:
                    scale = np.abs(wanted[finite]).max(initial=1)
                    np.testing.assert_allclose(arrays[name][finite], wanted[finite], 1e-4,
                                               1e-4 * scale, err_msg=where)


@pytest.mark.parametrize(("kernel", "binding"), [
    (FILTER, "mixed"), (FILTER, "heads"), (MIX_LEVELS, "coarse"), (MIX_LEVELS, "level"),
    (POOL, "finer"), (REMODULATE, "filtered"), (HISTORY, "history"), (OPEN_PHASED, "phased_fine")],
    ids=lambda value: getattr(value, "name", value))
def test_nan_is_carried_on_and_recognised_by_the_kernel_that_keeps_it_out(kernel: Kernel,
                                                                          binding: str) -> None:
    case, inputs = next(inputs_of(kernel))
    inputs[binding] = np.full_like(inputs[binding], np.nan)
    for form, arrays in forms(kernel, inputs, case).items():
        assert np.isnan(arrays[kernel.writes[0]]).mean() > 0.5, form


def test_constants_of_the_headers_are_those_of_python() -> None:
    checked = 0
    for header in sorted(build.KERNELS.rglob("*.h")):
        text = header.read_text("utf-8")
        beside = header.with_suffix(".py")
        known = constants_of(beside if beside.exists() else build.KERNELS / "image.py", text)
        for name, value in re.findall(r"^constexpr (?:float|int) ([A-Z][A-Z\d_]+) = "
                                      r"(-?[\d.e+-]+)f?;", text, re.M):
            if name in known:
                assert np.float32(value) == np.float32(known[name]), f"{header}: {name}"
                checked += 1
    assert checked >= 8


def test_the_compiler_is_pinned_where_it_is_asked_for() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))
    wanted = f"ziglang=={build.ZIG}"
    assert wanted in project["build-system"]["requires"]
    assert wanted in project["project"]["optional-dependencies"]["test"]


@pytest.fixture
def plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A header of a plug-in, and an empty cache."""
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setattr(library, "private_folder", lambda name: folder)
    header = tmp_path / "scale.h"
    header.write_text(HEADER)
    return header


def scaled(header: Path) -> np.ndarray:
    image, found = np.arange(60, dtype=np.float32).reshape(3, 20), np.zeros((3, 20), np.float32)
    library._form.cache_clear()
    library.open_library.cache_clear()
    Rows("scale", header)(0, 3, image, np.float32([2]), found)
    return found


@needs_compiler
def test_a_plug_in_brings_one_header(plug_in: Path) -> None:
    kernel = Kernel("scale", ("image", "by"), ("scaled",), Rows("scale", plug_in), ("scaled", 0),
                    {"image": ("h", "w"), "by": (1,), "scaled": ("h", "w")})
    assert kernel.home == plug_in.parent
    device, told = Device("cpu", threads=2), []
    image = np.random.default_rng(0).random((9, 33), np.float32)
    bound = {"image": device.wrap("image", image), "by": device.wrap("by", np.float32([3])),
             "scaled": device.heap.tensor("scaled", (9, 33))}
    library.levels()
    with library.CompileWatch(told.append) as watch:
        state = device.compute_state(kernel)  # before its first frame
        assert watch.count == 1 and told == [0] and 0 < watch.seconds == watch.seconds
        device.compute_state(kernel)
    assert watch.count == 1
    commands = device.command_buffer("any")
    with commands.compute_encoder("any") as encoder:
        encoder.dispatch(state, ArgumentTable(state, bound))
    commands.commit()
    commands.wait(timeout=60)
    np.testing.assert_array_equal(bound["scaled"].array, 3 * image)


@needs_compiler
def test_the_header_of_the_documentation(plug_in: Path) -> None:
    text = (REPOSITORY / "docs" / "howto" / "passes.md").read_text("utf-8")
    (code,) = re.findall(r"^```cpp\n(.*?)^```", text, re.M | re.S)
    plug_in.write_text(code)
    colour = np.random.default_rng(0).random((9, 37, 3), np.float32)
    found = np.zeros_like(colour)
    Rows("vignette", plug_in)(0, 9, colour, np.float32([0.5]), found)
    v, u = ((2 * np.arange(size) + 1) / size - 1 for size in colour.shape[:2])
    wanted = colour * (1 - 0.5 * (u[None, :] ** 2 + v[:, None] ** 2) / 2)[..., None]
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


@needs_compiler
def test_it_is_compiled_again_when_it_changes_or_is_damaged(plug_in: Path) -> None:
    folder = plug_in.parent / "cache"
    assert scaled(plug_in)[1, 1] == 42
    first = {path: path.stat().st_ino for path in folder.glob("*-*.*")}
    assert len(first) == 1  # this processor's level alone
    scaled(plug_in)
    assert {path: path.stat().st_ino for path in folder.glob("*-*.*")} == first
    for damage in (lambda path: path.write_bytes(path.read_bytes()[:100]), Path.unlink):
        for path in first:
            copy = path.read_bytes()
            path.unlink()  # the process has it open
            path.write_bytes(copy)
            damage(path)
        assert scaled(plug_in)[1, 1] == 42
    for index in folder.glob("*.json"):
        index.write_text("{")
    assert scaled(plug_in)[1, 1] == 42
    plug_in.write_text(HEADER.replace("* *by", "* *by + 1.0f"))
    assert scaled(plug_in)[1, 1] == 43


@needs_compiler
def test_several_processes_at_once_compile_it_once(plug_in: Path) -> None:
    code = ("import sys; from pathlib import Path; from postfx.compiled import build; "
            "build.build([Path(sys.argv[1])], build.this_target(), Path(sys.argv[2]))")
    folder = plug_in.parent / "cache"
    many = [subprocess.Popen([sys.executable, "-c", code, plug_in, folder], cwd=REPOSITORY)
            for _ in range(3)]
    assert [one.wait(timeout=120) for one in many] == [0, 0, 0]
    assert len([*folder.glob("*.json")]) == 1
    assert len([*folder.glob("*-*.*")]) == len(build.TARGETS[build.this_target()].levels)
    assert scaled(plug_in)[1, 1] == 42


@needs_compiler
def test_a_change_compiles_the_files_that_it_touches(tmp_path: Path) -> None:
    """A header of one file; the other's object is taken as it is."""
    one, other = tmp_path / "one.cpp", tmp_path / "other.cpp"
    one.write_text('#include "own.h"\n' + HEADER)
    (tmp_path / "own.h").write_text("enum { OWN = 1 };\n")
    other.write_text(HEADER.replace("scale", "others"))
    target, folder = build.this_target(), tmp_path / "made"
    lowest = next(iter(build.TARGETS[target].levels))

    def objects() -> set[str]:
        assert set(build.build([one, other], target, folder, [lowest])) == {lowest}
        return {path.name for path in folder.glob("objects/*.o")}

    first = objects()
    assert len(first) == 2
    (tmp_path / "own.h").write_text("enum { OWN = 2 };\n")
    second = objects()
    assert len(second) == 3 and first < second
    assert {name.split("-")[1] for name in second - first} == {"one"}


@needs_compiler
@pytest.mark.parametrize("damage", [
    pytest.param(lambda path: path.write_bytes(b""), id="empty"),
    pytest.param(lambda path: path.write_text("[" * 100_000), id="nested"),
    pytest.param(lambda path: (path.unlink(), os.mkfifo(path)), id="pipe"),
    pytest.param(lambda path: (path.unlink(), path.mkdir()), id="folder"),
    pytest.param(lambda path: (path.unlink(), path.symlink_to("nowhere/else")), id="dangling")])
@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes with names")
def test_whatever_lies_in_its_folder_it_is_made_again(tmp_path: Path,
                                                      damage: Callable[[Path], object]) -> None:
    """An object without content links, into a library without kernels."""
    unit, folder, target = tmp_path / "one.cpp", tmp_path / "made", build.this_target()
    unit.write_text(HEADER)
    lowest = next(iter(build.TARGETS[target].levels))
    made = build.build([unit], target, folder, [lowest])
    for path in [path for path in folder.rglob("*") if path.is_file()]:
        damage(path)
    assert not build.find(folder, build.digest_of([unit], target))
    assert build.build([unit], target, folder, [lowest]) == made
    assert ctypes.CDLL(str(made[lowest])).scale_takes


def test_without_a_compiler_there_is_one_line_with_the_fix(plug_in: Path,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DeviceError,
                       match=f"there is no compiler: pip install ziglang=={re.escape(build.ZIG)}$"):
        scaled(plug_in)


@needs_compiler
def test_a_fault_in_a_header_is_one_line(plug_in: Path) -> None:
    plug_in.write_text(HEADER.replace("* *by", "* nothing"))
    with pytest.raises(DeviceError,
                       match=r"scale.h:8:\d+: error: use of undeclared identifier 'nothing'"):
        scaled(plug_in)


def test_arrays_that_a_kernel_does_not_take_are_an_error() -> None:
    inputs = [*arguments(FILTER, ODD).values()]
    out = np.zeros_like(inputs[0])
    with pytest.raises(BindingError,
                       match="'denoise_filter' takes arrays f4:3r f4:4r f4:1r f4:3w .*, not f8:3w"):
        FILTER.rows(0, 1, inputs[0].astype(float), *inputs[1:], out)
    with pytest.raises(BindingError, match="with-gaps"):
        FILTER.rows(0, 1, inputs[0][:, ::2], *inputs[1:], out)
    out.flags.writeable = False
    with pytest.raises(BindingError, match="not .* f4:3r$"):
        FILTER.rows(0, 1, *inputs, out)
    with pytest.raises(BindingError,
                       match=r"exports no kernel 'nothing': write EXPORT\(nothing, rows\) there"):
        Rows("nothing")(0, 1)


WITHOUT_OTHER_COMPILERS = """
import sys
sys.modules.update(numba=None, llvmlite=None)  # to import them fails
import numpy as np
import postfx
from postfx.frame import Frame, Role
from postfx.interpolate import Between
from postfx.passes.scene import Occlusion
random, size = np.random.default_rng(0), (48, 64)
def frame(number):
    planes = {Role.COLOUR: random.random((*size, 3), np.float32),
              Role.DEPTH: np.full((*size, 1), 4, np.float32),
              Role.NORMAL: np.full((*size, 3), (0, 0, 1), np.float32),
              Role.MOTION: np.ones((*size, 2), np.float32)}
    return Frame(planes, number=number)
first, second = frame(1), frame(2)
pipeline = postfx.Pipeline([postfx.DenoiseUpscale(model="s"), postfx.ToneMap(look="aces2")])
shown = [pipeline(one)[Role.COLOUR] for one in (first, second)][-1]
between = Between(first, second).frame(0.5)[Role.COLOUR]
open_to_light = postfx.Pipeline([Occlusion(radius=1.0)], exposure=1.0)(first)[Role.COLOUR]
for made in (shown, between, open_to_light):
    assert made.shape == (*size, 3) and np.isfinite(made).all() and made.std() > 0
"""


def test_a_frame_needs_no_compiler_of_python() -> None:
    """Denoised, tone-mapped, between two others, and its occlusion."""
    subprocess.run([sys.executable, "-c", WITHOUT_OTHER_COMPILERS], cwd=REPOSITORY, check=True,
                   timeout=300)
