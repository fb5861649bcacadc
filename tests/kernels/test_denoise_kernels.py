"""The upscaler's kernels: compiled rows against the portable ONNX definitions."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.compiled import library
from postfx.compiled.library import Rows, has_byte_products
from postfx.kernels import Kernel
from postfx.kernels.denoise import FINE, MIX
from postfx.kernels.denoise.features import FEATURE, STORED_FEATURE
from postfx.kernels.denoise.network_io import (
    LEVEL,
    OPEN_CODES,
    OPEN_FINE_CODES,
    OPEN_FINE_PRODUCTS,
    OPEN_PRODUCTS,
    OPEN_SOME_PRODUCTS,
    SOME,
    STORE,
    STORE_RINGED,
)
from postfx.kernels.denoise.prepare import ACCUMULATE
from postfx.kernels.denoise.pyramid import FILTER, FILTER_CODES, MIX_LEVELS, POOL
from postfx.kernels.denoise.upsample import (
    CODES_GUIDED,
    CODES_PLAIN,
    CODES_UNSCALED,
    UPSAMPLE,
    UPSAMPLE_GUIDED,
    UPSAMPLE_UNSCALED,
)
from postfx.kernels.image import RESAMPLE, positions
from postfx.passes.denoise.network import stored_channels
from postfx.runtime import Device
from tests.kernels.denoise_cases import CASES, KERNELS, ODD, Case, arguments, case_for, run, runs_of

pytestmark = pytest.mark.usefixtures("every_level")
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def compiled() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def portable() -> Device:
    return Device("cpu", threads=2, compiled_kernels=False)


def assert_same(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray],
                where: str = "") -> None:
    for name, value in wanted.items():
        scale = max(1.0, float(np.abs(value[np.isfinite(value)]).max(initial=0)))
        # rounded to either side
        rtol = max(TOLERANCE, float(np.finfo(np.float16).eps) * (value.dtype == np.float16))
        np.testing.assert_allclose(found[name], value, atol=TOLERANCE * scale, rtol=rtol,
                                   err_msg=f"{name} {where}")


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
def test_compiled_rows_match_the_portable_definition(kernel: Kernel, compiled: Device,
                                                     portable: Device) -> None:
    for case, bad in runs_of(kernel):
        inputs = arguments(kernel, case, bad=bad)
        found, wanted = run(kernel, compiled, inputs, case), run(kernel, portable, inputs, case)
        # kept as it comes
        finite = {name: value for name, value in wanted.items() if not name.endswith("_depth")}
        assert all(np.isfinite(value).all() for value in finite.values()), case
        assert_same(found, wanted, f"{case} {'bad' if bad else 'clean'}")


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
def test_the_number_of_threads_changes_no_bit(kernel: Kernel) -> None:
    inputs = arguments(kernel, ODD)
    alone, many = (run(kernel, Device("cpu", threads), inputs, ODD) for threads in (1, 5))
    assert all(np.array_equal(alone[name], many[name], equal_nan=True) for name in kernel.writes)


@pytest.mark.parametrize("kernel", [STORE, STORE_RINGED], ids=lambda kernel: kernel.name)
def test_what_is_no_number_is_stored_as_zero(kernel: Kernel, compiled: Device,
                                             portable: Device) -> None:
    inputs = arguments(kernel, ODD)
    inputs["planes"].reshape(-1)[::7] = np.nan
    wanted = run(kernel, compiled, {**inputs, "planes": np.nan_to_num(inputs["planes"])}, ODD)
    for device in (compiled, portable):
        np.testing.assert_array_equal(run(kernel, device, inputs, ODD)["stored"], wanted["stored"])


@pytest.mark.parametrize("ring", [0, 1])
@pytest.mark.parametrize("bad", [False, True], ids=["clean", "bad"])
def test_features_in_8_bits_are_the_codes_of_the_planes(ring: int, bad: bool,
                                                        compiled: Device) -> None:
    """To the bit, in any bands of rows."""
    for case in CASES:
        inputs = arguments(FEATURE, case, bad=bad)
        if bad:
            inputs["state"].reshape(-1)[::11] = np.nan
        wanted, (hp, wp) = run(FEATURE, compiled, inputs, case), case.window.padded_size
        codes = np.full((1, hp + 2 * ring, wp + 2 * ring, stored_channels("features")), 7, np.uint8)
        signed = np.arange(codes.shape[3]) % 2
        coding = np.stack([255 - 128 * signed, 128 * signed]).astype(np.float32)
        (STORE_RINGED if ring else STORE).rows(0, codes.shape[1], wanted["features"], coding, codes)
        past, stored = np.full_like(wanted["past"], 7), np.full_like(codes, 9)
        for rows in ((0, 5), (5, codes.shape[1])):
            STORED_FEATURE.rows(*rows, *inputs.values(), coding, past, stored)
        np.testing.assert_array_equal(stored, codes, str(case))
        np.testing.assert_array_equal(past, wanted["past"], str(case))


@pytest.mark.parametrize("importance", [1.0, 1e-8, 1e-12, 1e-35, 0.0])
def test_light_that_a_network_hardly_counts_is_not_darkened(importance: float, compiled: Device,
                                                            portable: Device) -> None:
    """Pooling gives a cell of one colour that colour, whatever its weight."""
    inputs = arguments(POOL, ODD)
    inputs["finer"][:], inputs["finer_importance"][:] = 0.5, importance
    for device in (compiled, portable):
        # beyond the frame there is no light
        found = run(POOL, device, inputs, ODD)["level"][:, 1:-1, 1:-1]
        assert found.size
        np.testing.assert_allclose(found, 0.5, rtol=1e-6)


def test_resampling_at_whole_positions_gives_the_samples_and_keeps_within_them() -> None:
    image = np.random.default_rng(0).random((7, 9, 2), np.float32)
    case = Case(7, 9, 7, 9)
    same = {"image": image, "rows": positions(7, 7), "columns": positions(9, 9)}
    np.testing.assert_array_equal(_resampled(same, case), image)
    lost = {**same, "image": np.where(image > np.median(image), np.nan, image)}
    np.testing.assert_array_equal(_resampled(lost, case), np.nan_to_num(lost["image"]))
    larger = {"image": image, "rows": positions(7, 20, 0.2), "columns": positions(9, 20, -0.3)}
    result = _resampled(larger, Case(7, 9, 20, 20))
    assert result.min() >= image.min() and result.max() <= image.max()


def test_resampling_follows_the_jitter() -> None:
    """A ramp sampled 0.25 pixels right of the pixels' centres, enlarged to twice the size, is the
    ramp again."""
    ramp = np.tile((np.arange(12, dtype=np.float32) + 0.25)[None, :, None], (4, 1, 1))
    inputs = {"image": ramp, "rows": positions(4, 8), "columns": positions(12, 24, 0.25)}
    result = _resampled(inputs, Case(4, 12, 8, 24), channels=1)
    np.testing.assert_allclose(result[3, 4:-4, 0], (np.arange(24)[4:-4] + 0.5) / 2 - 0.5, atol=1e-5)


@pytest.mark.parametrize("level", library.levels())
@pytest.mark.parametrize("columns", [5, 16, 37, 64])
def test_colours_of_twice_the_size_are_their_channels_resampled_alone(columns: int,
                                                                      level: str) -> None:
    """Vectors of pixels are stored otherwise than numbers: the same bits, at every level."""
    image = np.random.default_rng(3).random((6, columns, 3), np.float32)
    places = {"rows": positions(6, 12, 0.2), "columns": positions(columns, 2 * columns, -0.3)}
    case, rows = Case(6, columns, 12, 2 * columns), Rows(RESAMPLE.rows.name, level=level)
    wanted = [_resampled({"image": np.ascontiguousarray(image[..., one:one + 1]), **places}, case,
                         1, rows) for one in range(3)]
    found = _resampled({"image": image, **places}, case, 3, rows)
    np.testing.assert_array_equal(found, np.concatenate(wanted, 2))


def _resampled(inputs: dict[str, np.ndarray], case: Case, channels: int = 2,
               rows: Rows = RESAMPLE.rows) -> np.ndarray:
    output = np.empty((case.height, case.width, channels), np.float32)
    rows(0, case.height, *inputs.values(), output)
    return output


def test_products_are_opened_where_they_lie() -> None:
    """Some channels after the other, each in the place of products that were opened before: the
    same bits."""
    random, (h, w) = np.random.default_rng(5), (12, 20)
    store = random.integers(-4000, 4000, (FINE + SOME) * h * w, np.int32)
    scaling = random.normal(0, 1e-3, (2, 4 * FINE)).astype(np.float32)
    products = store[SOME * h * w:].reshape(1, 4 * FINE, h // 2, w // 2)
    wanted = np.empty((1, FINE, h, w), np.float32)
    OPEN_FINE_PRODUCTS.rows(0, h, products.copy(), scaling, wanted)
    fine = store.view(np.float32)[:FINE * h * w].reshape(1, FINE, h, w)
    for first in range(0, FINE, SOME):
        some, at = slice(first, first + SOME), np.full(1, first, np.float32)
        for rows in ((0, 5), (5, h)):
            OPEN_SOME_PRODUCTS.rows(*rows, products[:, 4 * first:4 * (first + SOME)], scaling, at,
                                    fine[:, some])
    np.testing.assert_array_equal(fine, wanted)


FROM_CODES = ((FILTER, FILTER_CODES), (UPSAMPLE, CODES_PLAIN), (UPSAMPLE_GUIDED, CODES_GUIDED),
              (UPSAMPLE_UNSCALED, CODES_UNSCALED))
coded = pytest.mark.skipif(not has_byte_products(), reason="needs an x86-64 processor")


def codes_of(case: Case, rows: int, channels: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Codes with factors and scaling, the largest ones among them, and their products."""
    random, sizes = np.random.default_rng(3), case_for(FILTER, case).sizes()
    codes = random.integers(0, 256,
                            (1, sizes["half_hp"], sizes["half_wp"], channels)).astype(np.uint8)
    factors = random.integers(-64, 65, (rows, channels)).astype(np.int8)
    codes[0, 0, 0], factors[1] = 255, 64
    scaling = (np.stack([random.uniform(1e-4, 3e-4, rows), random.normal(0, 1, rows)])
               .astype(np.float32))
    products = np.einsum("kc,yxc->kyx", factors.astype(np.int32), codes[0].astype(np.int32))[None]
    return {"codes": codes, "factors": factors, "scaling": scaling}, np.ascontiguousarray(products)


def opened(case: Case, products: np.ndarray, scaling: np.ndarray) -> np.ndarray:
    """The fine head of products."""
    fine = np.empty((1, FINE, 2 * products.shape[2], 2 * products.shape[3]), np.float32)
    OPEN_FINE_PRODUCTS.rows(0, fine.shape[2], products, scaling, fine)
    return fine


@coded
@pytest.mark.parametrize("channels", [32, 20])
def test_heads_of_codes_are_those_of_products(channels: int, compiled: Device) -> None:
    given, products = codes_of(ODD, 4 * FINE, channels)
    wanted = opened(ODD, products, given["scaling"])
    for first in (0, MIX):
        fine = np.empty((1, FINE - first, products.shape[2], 2, wanted.shape[3]), np.float32)
        OPEN_FINE_CODES.rows(0, products.shape[2], *given.values(), fine)
        np.testing.assert_array_equal(fine.reshape(1, FINE - first, *wanted.shape[2:]),
                                      wanted[:, first:])
    sums, scaling = products[:, :LEVEL].copy(), given["scaling"][:, :LEVEL].copy()
    coded = given["codes"], given["factors"][:28].copy(), scaling
    for level in library.levels():  # each multiplies by instructions of its own
        heads = [np.empty(sums.shape, np.float32) for _ in range(2)]
        Rows(OPEN_PRODUCTS.rows.name, level=level)(0, sums.shape[2], sums, scaling, heads[0])
        Rows(OPEN_CODES.rows.name, level=level)(0, sums.shape[2], *coded, heads[1])
        np.testing.assert_array_equal(*heads)


@coded
@pytest.mark.parametrize(("plain", "kernel"), FROM_CODES, ids=lambda kernel: kernel.name)
def test_kernels_make_the_fine_head_of_codes_by_themselves(plain: Kernel, kernel: Kernel,
                                                           compiled: Device) -> None:
    """Beside other rows and columns, in parts and at other scales: the same bits."""
    for case in CASES:
        given, products = codes_of(case_for(kernel, case), 4 * FINE, 12)
        inputs = arguments(plain, case)
        head = {"heads" if plain is FILTER else "fine": opened(case, products, given["scaling"])}
        wanted = run(plain, compiled, inputs | head, case._replace(heads=FINE))
        kept = {name: value for name, value in inputs.items() if name in kernel.reads}
        found = run(kernel, compiled, kept | given, case)
        assert all(np.array_equal(found[name], wanted[name]) for name in kernel.writes), case


@pytest.mark.parametrize("kernel", [ACCUMULATE, MIX_LEVELS], ids=lambda kernel: kernel.name)
def test_the_last_channels_of_the_fine_head_are_enough(kernel: Kernel) -> None:
    inputs, name = arguments(kernel, ODD), "fine" if kernel is ACCUMULATE else "heads"
    found = []
    for head in (inputs[name], inputs[name][:, MIX:].copy()):
        written = run(kernel, Device("cpu", threads=1), inputs | {name: head}, ODD)
        found.append(written)
    assert all(np.array_equal(found[0][key], found[1][key], equal_nan=True)
               for key in kernel.writes)
