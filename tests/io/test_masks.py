"""What `leave` finds in files: Cryptomattes, planes of ids, misses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from postfx.errors import PostfxError
from postfx.frame import Role
from postfx.io.frame_reader import FrameFiles
from postfx.io.read_options import ReadOptions
from postfx.io.sequence import read_sequence
from postfx.masks import StrengthError, id_of_name
from postfx.system import Scratch

NAMES = ("sky_dome", "sky_sun", "logo")
SIZE = 6, 8
Channels = dict[str, np.ndarray]


def colours() -> Channels:
    return {name: np.full(SIZE, 0.5, np.float32) for name in "RGB"}


def ranks(layer: str, letters: tuple[str, ...] = tuple("RGBA")) -> Channels:
    """Rows 0 and 1 are sky_dome, row 2 half of it and half sky_sun, row 3 a third of each, the rest
    nothing."""
    dome, sun, logo = (np.array([id_of_name(name)], np.uint32).view(np.float32)[0]
                       for name in NAMES)
    planes = np.zeros((2, 4, *SIZE), np.float32)
    planes[0, 0, :4], planes[0, 1, :4] = dome, np.array([1, 1, 0.5, 1 / 3])[:, None]
    planes[0, 2, 2:4], planes[0, 3, 2:4] = sun, np.array([0.5, 1 / 3])[:, None]
    planes[1, 0, 3], planes[1, 1, 3] = logo, 1 / 3
    return {f"{layer}{level:02d}.{letter}": planes[level, i] for level in (0, 1)
            for i, letter in enumerate(letters)}


def header(layer: str = "CryptoObject", key: str = "abc1234", **fields: str) -> dict[str, str]:
    names = {name: f"{id_of_name(name):08x}" for name in NAMES}
    usual = {"name": layer, "hash": "MurmurHash3_32", "conversion": "uint32_to_float32",
             "manifest": json.dumps(names)}
    return {f"cryptomatte/{key}/{field}": text
            for field, text in {**usual, **fields}.items() if text}


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes a file of one part, channels keeping their data types."""

    def make(channels: Channels, name: str = "shot.0001.exr", **attributes: str) -> Path:
        OpenEXR.File({"type": OpenEXR.scanlineimage, **attributes},
                     channels).write(str(tmp_path / name))
        return tmp_path / name

    return make


def strength(path: Path, leave: str, **options) -> np.ndarray:
    (frame,) = read_sequence(path, leave=leave, **options)
    return frame[Role.STRENGTH][:, 3, 0]


@pytest.mark.parametrize(("leave", "rows"), [
    ("*,logo=1", [0, 0, 0, 1 / 3, 1, 1]),
    ("sky_sun=0.5", [1, 1, 0.75, 5 / 6, 1, 1]),
    ("sky_sun@CryptoAsset=0.5", [1, 1, 0.75, 5 / 6, 1, 1]),
    ("sky_dome@CryptoAsset,sky_sun=0.5", [0, 0, 0.25, 1 / 2, 1, 1]),
    ("sky_sun@CryptoObject=0.5,*@CryptoAsset,logo@CryptoObject=1", [0, 0, 0, 1 / 3, 1, 1]),
])
def test_the_last_entry_counts_across_cryptomattes(write: Callable[..., Path], leave: str,
                                                   rows: list[float]) -> None:
    """Of objects and of materials, which are called alike here: no entry is applied twice, none to
    what a later one is for."""
    path = write(colours() | ranks("CryptoObject") | ranks("CryptoAsset"), **header(),
                 **header("CryptoAsset", "abc5678"))
    np.testing.assert_allclose(strength(path, leave), rows, atol=1e-6)


@pytest.mark.parametrize(("leave", "rows"), [
    ("sky_dome", [0, 0, 0.5, 2 / 3, 1, 1]),
    ("sky_*", [0, 0, 0, 1 / 3, 1, 1]),
    ("sky_*,logo=0.5", [0, 0, 0, 1 / 6, 1, 1]),
    ("sky_*,sky_sun=0.5", [0, 0, 0.25, 1 / 2, 1, 1]),
    ("sky_*@cryptoobject,logo@CryptoObject", [0, 0, 0, 0, 1, 1]),
    (f"0x{id_of_name('logo'):x}", [1, 1, 1, 2 / 3, 1, 1]),
])
def test_names_of_a_cryptomatte_by_their_shares(write: Callable[..., Path], leave: str,
                                                rows: list[float]) -> None:
    path = write(colours() | ranks("CryptoObject"), **header())
    np.testing.assert_allclose(strength(path, leave), rows, atol=1e-6)


def test_names_are_written_in_many_ways(write: Callable[..., Path], tmp_path: Path) -> None:
    """Names of a view layer, other letters, a manifest in a file, none at all, and two
    Cryptomattes."""
    wanted = [0, 0, 0, 1 / 3, 1, 1]
    blender = write(colours() | ranks("ViewLayer.CryptoObject", tuple("rgba")),
                    **header("ViewLayer.CryptoObject"))
    np.testing.assert_allclose(strength(blender, "sky_*@CryptoObject"), wanted, atol=1e-6)
    nuke = write(colours() | ranks("CryptoObject", ("red", "green", "blue", "alpha")), **header())
    np.testing.assert_allclose(strength(nuke, "sky_*"), wanted, atol=1e-6)
    (tmp_path / "names.json").write_text(header()["cryptomatte/abc1234/manifest"])
    beside = write(colours() | ranks("CryptoObject"),
                   **header(manifest="", manif_file="names.json"))
    np.testing.assert_allclose(strength(beside, "sky_*"), wanted, atol=1e-6)
    bare = write(colours() | ranks("CryptoObject"), **header(manifest=""))
    np.testing.assert_allclose(strength(bare, "sky_dome,sky_sun"), wanted, atol=1e-6)
    two = write(colours() | ranks("CryptoObject") | ranks("CryptoMaterial"), **header(),
                **header("CryptoMaterial", "def5678",
                         manifest=json.dumps({"chrome": f"{id_of_name('chrome'):08x}"})))
    np.testing.assert_allclose(strength(two, "sky_*"), wanted, atol=1e-6)
    np.testing.assert_allclose(strength(two, "chrome"), 1, atol=1e-6)


def test_parts_and_a_file_for_each_plane(tmp_path: Path) -> None:
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": name, **attributes}, channels)
             for name, attributes, channels in (("rgba", {}, colours()),
                                                ("crypto", header(), ranks("CryptoObject")))]
    OpenEXR.File(parts).write(str(tmp_path / "parts.0001.exr"))
    wanted = [0, 0, 0, 1 / 3, 1, 1]
    np.testing.assert_allclose(strength(tmp_path / "parts.0001.exr", "sky_*"), wanted, atol=1e-6)
    for part, name in zip(parts, ("beauty", "crypto"), strict=True):
        OpenEXR.File([part]).write(str(tmp_path / f"shot_{name}.0001.exr"))
    with FrameFiles({word: tmp_path / f"shot_{word}.0001.exr" for word in ("beauty", "crypto")},
                    ReadOptions(leave="sky_*")) as files:
        np.testing.assert_allclose(files.read(1)[Role.STRENGTH][:, 3, 0], wanted, atol=1e-6)


@pytest.mark.parametrize("kind", [np.uint32, np.float32, np.float16])
@pytest.mark.parametrize("name", ["id.Y", "ViewLayer.IndexOB.X", "objectid"])
def test_planes_of_ids(write: Callable[..., Path], kind: type, name: str) -> None:
    ids = np.broadcast_to(np.array([0, 7, 8, 9, 10, 2000], kind)[:, None], SIZE).copy()
    path = write(colours() | {name: ids})
    plane = name.removeprefix("ViewLayer.").removesuffix(".Y").removesuffix(".X")
    leave = f"7-9@{plane},8@{name}=0.5,2000@{plane}=0.25"
    np.testing.assert_array_equal(strength(path, leave), [1, 0, 0.5, 0, 1, 0.25])


def test_ids_keep_all_their_bits_and_are_empty_outside_of_the_data(tmp_path: Path) -> None:
    ids = np.full((4, 8), 4000000007, np.uint32)
    ids[1] = 4000000008
    window = {"displayWindow": (np.zeros(2, np.int32), np.array([7, 5], np.int32)),
              "dataWindow": (np.array([0, 1], np.int32), np.array([7, 4], np.int32))}
    channels = {name: np.ones((4, 8), np.float32) for name in "RGB"} | {"id.Y": ids}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **window},
                 channels).write(str(tmp_path / "a.0001.exr"))
    for scratch in (None, Scratch(4096)):
        frame = read_sequence(tmp_path / "a.0001.exr", leave="4000000007@id",
                              scratch=scratch).read(1)
        np.testing.assert_array_equal(frame[Role.STRENGTH][:, 3, 0], [1, 0, 1, 0, 0, 1])


def test_a_plane_of_the_file_counts_too(write: Callable[..., Path]) -> None:
    own = np.full(SIZE, 0.5, np.float32)
    path = write(colours() | ranks("CryptoObject") | {"strength.Y": own}, **header())
    sequence = read_sequence(path, leave="sky_dome")
    np.testing.assert_allclose(sequence.read(1)[Role.STRENGTH][:, 3, 0],
                               [0, 0, 0.25, 1 / 3, 0.5, 0.5], atol=1e-6)
    np.testing.assert_allclose(strength(path, "sky_dome", planes=["strength"])[:3], [0, 0, 0.25])
    with FrameFiles({"": path}, ReadOptions(leave="sky_dome")) as files:
        assert files.spec().roles == (Role.COLOUR, Role.STRENGTH)


def test_misses_are_found_by_planes_that_are_not_asked_for(write: Callable[..., Path]) -> None:
    path = write({**{name: np.ones((40, 30), np.float32) for name in "RGB"},
                  "depth.Z": np.full((40, 30), 1e10, np.float32)})
    frame = read_sequence(path, leave="auto=0.5", planes=["colour", "strength"]).read(1)
    assert set(frame.planes) == {Role.COLOUR, Role.STRENGTH}
    np.testing.assert_array_equal(frame[Role.STRENGTH], 0.5)


def test_in_pieces_all_is_the_same(write: Callable[..., Path]) -> None:
    path = write(colours() | ranks("CryptoObject") | {"depth.Z": np.full(SIZE, 1e10, np.float32)},
                 **header())
    whole, pieces = (read_sequence(path, leave="logo,sky_sun=0.5,auto=0.2", scratch=scratch)
                     for scratch in (None, Scratch(4096)))
    np.testing.assert_array_equal(pieces.read(1)[Role.STRENGTH], whole.read(1)[Role.STRENGTH])
    assert str(pieces.coverage) == str(whole.coverage)


def test_what_is_left_alone_is_counted(write: Callable[..., Path]) -> None:
    path = write(colours() | ranks("CryptoObject"), **header())
    sequence = read_sequence(path, leave="sky_*,logo=0.5")
    assert sequence.coverage_of(1).as_dict() == {
        "frames": 1, "share": 0.5,
        "covered": {"sky_*": round((3 + 2 / 3) / 6, 4), "logo=0.5": round(1 / 18, 4)}}
    sequence.read(1), sequence.read(1, [Role.COLOUR])
    assert (str(sequence.coverage) == "50.0 % of the pixels are not denoised at all: sky_* covers "
                                       "61.1 %, logo=0.5 covers 5.6 %")


def test_a_thing_need_not_be_in_every_frame(write: Callable[..., Path]) -> None:
    """A manifest may name only what is seen; the first frame tells whether the name was
    mistyped."""
    path = write(colours() | ranks("CryptoObject"), **header())
    write(colours() | ranks("CryptoObject"), "shot.0002.exr",
          **header(manifest='{"other": "00000000"}'))
    sequence = read_sequence(path.with_name("shot.####.exr"), leave="logo")
    assert sequence.read(1)[Role.STRENGTH].min() < 1
    np.testing.assert_array_equal(sequence.read(2)[Role.STRENGTH], 1)


@pytest.mark.parametrize(("leave", "fields", "message"), [
    ("sky", {}, "no 'sky' in Cryptomatte CryptoObject: nearest: 'sky_sun', 'sky_dome'"),
    ("LOGO", {}, "no 'LOGO' in Cryptomatte CryptoObject: nearest: 'logo'"),
    ("q", {},
     "no 'q' in Cryptomatte CryptoObject: some of its names: 'sky_dome', 'sky_sun', 'logo'"),
    ("q", {"manifest": "{}"}, "some of its names: none, the manifest is empty"),
    ("7@id", {}, "AOV 'id' of '7@id' is not there: name a channel of ids, or a Cryptomatte "
     "\\(here: CryptoObject\\)"),
    ("7@crypto*", {},
     "AOV 'crypto\\*' of '7@crypto\\*' has several channels \\(CryptoObject00.R, "),
    ("seven@R", {}, "'seven' of AOV R: give an id, or first and last, such as 7-9"),
    ("9-7@R", {}, "'9-7' of AOV R: write the smaller id first, 7-9"),
    ("logo", {"manifest": '{"logo": "12345678"}'},
     "the manifest gives 'logo' the id 12345678, its hash is"),
    ("logo", {"manifest": "nonsense"}, "the manifest is not JSON of names and ids"),
    ("logo", {"manifest": '["logo"]'}, "the manifest is not JSON of names and ids"),
    ("logo", {"manifest": "", "manif_file": "gone.json"},
     "its manifest .*gone.json cannot be read: copy it beside"),
    ("logo", {"hash": "SHA1"},
     "Cryptomatte CryptoObject: hash SHA1 is not known: render it with MurmurHash3_32"),
    ("logo", {"conversion": "none"},
     "conversion none is not known: render it with uint32_to_float32"),
    ("logo", {"name": "CryptoAsset"},
     "Cryptomatte CryptoAsset: no channels CryptoAsset00.R, G, B, A"),
    ("auto", {}, "'auto' has no AOV to look at: render depth, normals or alpha, too"),
])
def test_what_is_wrong_is_told_in_one_line(
    write: Callable[..., Path], leave: str, fields: dict[str, str], message: str
) -> None:
    path = write(colours() | ranks("CryptoObject"), **header(**fields))
    with pytest.raises(StrengthError, match=message) as error:
        strength(path, leave)
    assert "\n" not in str(error.value) and (str(path) in str(error.value) or leave.endswith("@R"))


def test_files_that_no_name_can_be_found_in(write: Callable[..., Path]) -> None:
    with pytest.raises(StrengthError,
                       match="no Cryptomatte to find 'logo' in: render one, or give ids of an AOV"):
        strength(write(colours()), "logo")
    halves = {name: plane.clip(0, 1).astype(np.float16)
              for name, plane in ranks("CryptoObject").items()}
    with pytest.raises(StrengthError,
                       match="channel CryptoObject00.R has ids that are not whole: write 32-bit "
                       "floats"):
        strength(write(colours() | halves, **header()), "logo")


def test_planes_of_another_size(tmp_path: Path) -> None:
    larger = {name: np.kron(plane, np.ones((2, 2), np.float32))
              for name, plane in ranks("CryptoObject").items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, colours()).write(str(tmp_path / "beauty.exr"))
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header()},
                 larger).write(str(tmp_path / "crypto.exr"))
    with pytest.raises(StrengthError,
                       match="CryptoObject is 16x12, the colour is 8x6: render both at one size"):
        FrameFiles({word: tmp_path / f"{word}.exr" for word in ("beauty", "crypto")},
                   ReadOptions(leave="logo"))


def test_a_real_cryptomatte_with_names_like_wildcards(shared_dir: Path) -> None:
    """Psyop's test file, V-Ray: against shares that are added up pixel by pixel."""
    path = shared_dir / "exr/cryptomatte/cornellBox_CryptoWildcard.0001.exr"
    pixels = OpenEXR.File(str(path), separate_channels=True)
    channels, attributes = pixels.channels(), pixels.header()
    manifest = json.loads(attributes["cryptomatte/2ae4678/manifest"])
    assert {name: f"{id_of_name(name):08x}" for name in manifest} == manifest
    (frame,) = read_sequence(path, leave="has_*_asterisk,sphere*=0.5")
    weights = {int(manifest["has_*_asterisk"], 16): 1.0, int(manifest["sphere_?_2"], 16): 0.5}
    lost = np.zeros((540, 626))
    for level in range(3):
        for name, share in ("RG", "BA"):
            ids = channels[f"uCryptoWildcard{level:02d}.{name}"].pixels.view(np.uint32)
            factor = np.vectorize(lambda key: weights.get(int(key), 0.0))(ids)
            lost += (factor
                     * channels[f"uCryptoWildcard{level:02d}.{share}"].pixels.astype(np.float64))
    found = frame[Role.STRENGTH][:, 167:167 + 626, 0]
    np.testing.assert_allclose(found, 1 - lost, atol=1.1e-3)
    assert 0.03 < (found == 0).mean() < 0.2 and ((found > 0.1) & (found < 0.4)).any()
    assert (frame[Role.STRENGTH][:, :167] == 1).all()
    with pytest.raises(PostfxError, match="nearest: 'Rect_]_left'"):
        read_sequence(path, leave="rect_left").read(1)


def converged(name: str, letters: str, value: float) -> Channels:
    """A plane that is 0 in the upper part of a larger picture, colours, and that value below."""
    planes = {letter: np.full((64, 48), 0.5, np.float32) for letter in "RGB"}
    for letter in letters:
        planes[f"{name}{letter}"] = np.full((64, 48), value, np.float32)
        planes[f"{name}{letter}"][:32] = 0
    return planes


@pytest.mark.parametrize(("channels", "header", "basis"), [
    (converged("mse.", "RGB", 1e-3), {}, "AOV 'variance_of_mean'"),
    (converged("sample_variance.", "RGB", 0.1), {"postfx:spp": 64},
     "AOV 'sample_variance' and 64 samples a pixel"),
    (converged("Variance.", "RGB", 0.1) | {name: np.ones((64, 48), np.float32) for name in (
        "Albedo.R", "Albedo.G", "Albedo.B", "Ns.X", "Ns.Y", "Ns.Z", "P.Z", "dzdx")},
     {"samplesPerPixel": 32}, "AOV 'sample_variance' and 32 samples a pixel"),
    (converged("m2_image.", "XYZ", 0.5), {"generatedBy": "Mitsuba version 3.6.0", "postfx:spp": 16},
     "AOV 'second_moment' and 16 samples a pixel"),
])
def test_what_renderers_tell_of_their_error(
    write: Callable[..., Path], channels: Channels, header: dict[str, int | str], basis: str
) -> None:
    sequence = read_sequence(write(channels, **header), leave="converged:0.01")
    found = sequence.read(1)[Role.STRENGTH][:, :, 0]
    assert (found[:26] == 0).all() and (found[32:] == 1).all()
    assert str(sequence.coverage).endswith(f"converged:0.01 covers 43.8 % by {basis}")
    assert sequence.coverage.as_dict()["basis"] == {"converged:0.01": basis}


def test_counts_of_cycles_are_numbers_or_shares(write: Callable[..., Path]) -> None:
    colour = {f"ViewLayer.Combined.{letter}": np.full((64, 48), 0.5, np.float32)
              for letter in "RGBA"}
    for unit in (1, 512):
        count = np.full((64, 48), 512 / unit, np.float32)
        count[32:] = 64 / unit
        path = write(colour | {"ViewLayer.Debug Sample Count.X": count},
                     **{"cycles.ViewLayer.samples": "512"})
        sequence = read_sequence(path, leave="converged:256spp=0.5")
        found = sequence.read(1)[Role.STRENGTH][:, :, 0]
        assert (found[:28] == 0.5).all() and (found[32:] == 1).all()
        assert "by AOV 'sample_count'" in str(sequence.coverage)


def test_what_cannot_tell_that_it_has_converged(write: Callable[..., Path], tmp_path: Path) -> None:
    path = write(converged("m2_image.", "XYZ", 0.5), generatedBy="Mitsuba version 3.6.0")
    for leave, message in (
        ("converged:0.01", "'converged:0.01': AOV 'second_moment' gives the error only with the"),
        ("converged:64spp", "'converged:64spp': the number of samples is unknown: render the"),
        ("converged", "'converged': give a relative error, such as converged:0.01, or a number")
    ):
        with pytest.raises(StrengthError, match=message):
            read_sequence(path, leave=leave).read(1)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, colours()).write(str(tmp_path / "beauty.exr"))
    OpenEXR.File({"type": OpenEXR.scanlineimage},
                 converged("mse.", "RGB", 1.0)).write(str(tmp_path / "noise.exr"))
    with pytest.raises(StrengthError,
                       match="AOV 'variance_of_mean' is 48x64, the colour is 8x6: render both"):
        FrameFiles({word: tmp_path / f"{word}.exr" for word in ("beauty", "noise")},
                   ReadOptions(leave="converged:0.01"))
