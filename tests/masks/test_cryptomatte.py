"""Strength from Cryptomattes and ids, as functions of planes."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.masks import (
    Cryptomatte,
    Entry,
    StrengthError,
    id_of_name,
    parse_leave,
    strength_from_cryptomatte,
    strength_from_ids,
)


def as_floats(*ids: int) -> np.ndarray:
    return np.array(ids, np.uint32).view(np.float32)


@pytest.mark.parametrize(("name", "expected"), [
    ("", 0x00800000), ("hello", 0x248BFA47), ("hello, world", 0x149BBB7F),
    ("rect_][_bot", 0xC2F7D6C0), ("The quick brown fox jumps over the lazy dog", 0x2E4FF723),
])
def test_ids_are_murmur_hashes_that_are_ordinary_floats(name: str, expected: int) -> None:
    """Values of the reference implementation, seed 0; the empty name's hash, 0, has the exponent of
    a denormal."""
    assert id_of_name(name) == expected


def test_ids_are_never_infinite_nor_denormal() -> None:
    ids = np.array([id_of_name(f"object_{i}") for i in range(20000)], np.uint32)
    exponents = ids >> 23 & 255
    assert np.unique(ids).size > 19990 and exponents.min() >= 1 and exponents.max() <= 254


def test_strength_is_what_the_shares_leave() -> None:
    """Against a sum in float64 over every rank."""
    random = np.random.default_rng(5)
    names = ["sky", "logo", "hero"]
    ids = as_floats(*map(id_of_name, [*names, "other"]))
    shares = random.dirichlet([1, 1, 1], (9, 11)).astype(np.float32)
    which = random.integers(0, 4, (9, 11, 3))
    ranks = np.stack([ids[which], shares], -1).reshape(9, 11, 6)
    found = strength_from_cryptomatte(ranks, {"sky": 0.0, id_of_name("logo"): 0.25})
    weights = np.array([1.0, 0.75, 0.0, 0.0])
    wanted = 1 - (weights[which] * shares.astype(np.float64)).sum(-1)
    assert found.shape == (9, 11, 1) and found.dtype == np.float32
    np.testing.assert_allclose(found[..., 0], np.where(wanted < 1e-3, 0, wanted), atol=1e-6)
    np.testing.assert_array_equal(found, strength_from_cryptomatte(
        list(np.moveaxis(ranks, 2, 0)), {"logo": 0.25, "sky": 0.0, "hero": 1.0}
    ))


def test_a_pixel_that_is_all_one_thing_is_exactly_0_or_1() -> None:
    sky = as_floats(id_of_name("sky"))[0]
    ranks = np.zeros((1, 3, 4), np.float32)
    ranks[0, 0] = sky, 0.33333, sky, 0.66666
    ranks[0, 1] = sky, 2e-4, 0, 0.9998
    ranks[0, 2] = sky, np.nan, sky, 7.0
    np.testing.assert_array_equal(strength_from_cryptomatte(ranks, {"sky": 0})[0, :, 0], [0, 1, 0])


def test_what_the_functions_refuse() -> None:
    ranks = np.zeros((2, 2, 4), np.float32)
    with pytest.raises(StrengthError,
                       match="3 AOVs of a Cryptomatte: give an id and its coverage for each rank"):
        strength_from_cryptomatte(ranks[..., :3], {"sky": 0})
    for function, planes in ((strength_from_cryptomatte, ranks),
                             (strength_from_ids, ranks[..., 0])):
        with pytest.raises(StrengthError, match="strengths -1 to 2: give 0 to 1"):
            function(planes, {1: -1.0, 2: 2.0})


@pytest.mark.parametrize("kind", ["uint32", "int32", "float32", "float16"])
def test_strength_of_ids_of_any_kind(kind: str) -> None:
    ids = np.array([[1, 7, 8], [9, 10, 2000]], kind)
    found = strength_from_ids(ids, {(7, 9): 0.0, 8: 0.5, 2000: 0.25})
    np.testing.assert_array_equal(found[..., 0], [[1, 0, 0.5], [0, 1, 0.25]])


def test_large_and_averaged_ids() -> None:
    large = np.array([[4000000007, 4000000008]], np.uint32)
    np.testing.assert_array_equal(strength_from_ids(large, {4000000007: 0})[..., 0], [[0, 1]])
    averaged = np.array([[7.0, 7.5, np.nan]], np.float32)
    np.testing.assert_array_equal(strength_from_ids(averaged, {(7, 8): 0})[..., 0], [[0, 1, 1]])


def test_entries_of_a_text() -> None:
    assert parse_leave("auto, sky_*,logo = 0.5,7-9@id,a=b=0.25,CryptoObject?x@ViewLayer.Mat=1") == (
        Entry("auto"), Entry("sky_*"), Entry("logo", None, 0.5), Entry("7-9", "id"),
        Entry("a=b", None, 0.25), Entry("CryptoObject?x", "ViewLayer.Mat", 1.0))
    assert [str(entry) for entry in parse_leave("sky,7@id=0.5")] == ["sky", "7@id=0.5"]
    assert [entry.is_auto for entry in parse_leave("auto,auto@id")] == [True, False]


@pytest.mark.parametrize(("text", "message"), [
    ("sky,,logo", "a name is missing"), ("", "a name is missing"), ("=0.5", "a name is missing"),
    ("sky=1.5", "strength 1.5 of 'sky': give 0"), ("sky=nan", "strength nan of 'sky'"),
])
def test_texts_that_say_nothing(text: str, message: str) -> None:
    with pytest.raises(StrengthError, match=message):
        parse_leave(text)


def test_names_count_as_they_are_before_they_count_as_patterns() -> None:
    manifest = {name: id_of_name(name) for name in ("has_*", "has_n", "Sky")}
    layer = Cryptomatte("CryptoObject", manifest, "frame.exr")
    assert layer.ids_of(Entry("has_*")) == [manifest["has_*"]]
    assert layer.ids_of(Entry("has_?")) == [manifest["has_*"], manifest["has_n"]]
    assert layer.ids_of(Entry("sky")) == [] and layer.nearest(Entry("sky")) == ["Sky"]
    assert layer.ids_of(Entry("0x1234abcd")) == [0x1234ABCD]
    with pytest.raises(StrengthError, match="'0xlogo' is not an id of a Cryptomatte"):
        layer.ids_of(Entry("0xlogo"))
    with pytest.raises(StrengthError, match="'0x1ffffffff' is not an id of a Cryptomatte"):
        layer.ids_of(Entry("0x1ffffffff"))


def test_a_manifest_of_other_hashes_is_told() -> None:
    layer = Cryptomatte("CryptoObject", {"sky": 0x1234ABCD}, "frame.exr")
    with pytest.raises(StrengthError,
                       match=f"gives 'sky' the id 1234abcd, its hash is {id_of_name('sky'):08x}"):
        layer.ids_of(Entry("s*"))


def test_without_a_manifest_whole_names_are_hashed() -> None:
    layer = Cryptomatte("CryptoObject", None, "frame.exr")
    assert layer.ids_of(Entry("sky")) == [id_of_name("sky")]
    with pytest.raises(StrengthError,
                       match="CryptoObject has no manifest, so nothing tells which names match "
                       "'s\\*'"):
        layer.ids_of(Entry("s*"))
