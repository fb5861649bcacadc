"""Written files: contents, metadata, completeness."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest
from PIL import Image

from postfx.colour import REC709
from postfx.colour.displays import parse_display, srgb_decode, srgb_encode
from postfx.errors import OutputExistsError, WriteError
from postfx.frame import Frame, PartSource, Role
from postfx.io import writer
from postfx.io.exr.container import can_compress
from postfx.io.sequence import read_sequence
from postfx.io.writer import ExistingFiles, OutputFiles, is_complete, write_frame


@pytest.fixture
def frame() -> Frame:
    rng = np.random.default_rng(1)
    colour = rng.random((12, 16, 3), np.float32)
    return Frame({Role.COLOUR: colour, Role.ALPHA: np.ones((12, 16, 1), np.float32)})


def pixels_of(path: Path) -> np.ndarray:
    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image(oiio.FLOAT)
    image.close()
    return pixels


def test_srgb_is_inverted_and_has_the_standards_values():
    codes = np.linspace(0, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(srgb_encode(srgb_decode(codes)), codes, atol=2e-6)
    assert srgb_encode(np.float32(0.18)) == pytest.approx(0.46135613, abs=1e-6)


def test_exr_holds_linear_half_floats(frame, tmp_path):
    path = write_frame(tmp_path / "new" / "a.exr", frame)
    np.testing.assert_array_equal(pixels_of(path)[:, :, :3],
                                  frame[Role.COLOUR].astype(np.float16).astype(np.float32))
    assert str(oiio.ImageInput.open(str(path)).spec().format) == "half"


def test_values_beyond_half_stay_finite(frame, tmp_path):
    frame.planes[Role.COLOUR][0, 0] = [1e9, np.inf, -np.inf]
    assert pixels_of(write_frame(tmp_path / "a.exr",
                                 frame))[0, 0, :3].tolist() == [65504, 65504, -65504]


def test_display_frames_are_decoded_for_exr(frame, tmp_path):
    frame.encoding = "srgb"
    written = pixels_of(write_frame(tmp_path / "a.exr", frame, bits=32))
    np.testing.assert_allclose(written[:, :, :3], srgb_decode(frame[Role.COLOUR]), atol=1e-6)


def test_compressions_hold_the_picture(tmp_path):
    """Decoded by another library; 300 rows, so that each has several chunks; windows as they are
    given."""
    rows, columns = np.mgrid[:300, :40].astype(np.float32)
    light = np.stack([1 + np.sin(rows / 30), 1 + np.cos(columns / 9), rows / 300], 2)
    frame = Frame({Role.COLOUR: light, Role.ALPHA: np.ones((300, 40, 1), np.float32)})
    wanted = {bits: pixels_of(write_frame(tmp_path / "zip.exr", frame, bits=bits))
              for bits in (16, 32)}
    np.testing.assert_array_equal(wanted[32][..., :3], light)
    for compression in ("none", "rle", "zips", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab:200"):
        for bits, expected in wanted.items():
            path = write_frame(tmp_path / "a.exr", frame, compression=compression, bits=bits)
            spec, found = oiio.ImageBuf(str(path)).spec(), pixels_of(path)
            assert spec.getattribute("compression") == compression.partition(":")[0]
            assert str(spec.format) == {16: "half",
                                        32: "float"}[bits] and is_complete(path, 40, 300)
            lost = {"b44": 0.05, "dwa": 0.05, "pxr": 1e-4}.get(compression[:3], 0)
            np.testing.assert_allclose(found, expected, atol=lost, err_msg=f"{compression} {bits}")
    fine, coarse = (write_frame(tmp_path / f"{level}.exr", frame, compression=f"dwaa:{level}")
                    for level in (5, 900))
    assert coarse.stat().st_size < fine.stat().st_size


def test_bits_of_pictures_and_what_cannot_be(frame, tmp_path):
    for name, bits, kind in (("a.png", 16, "uint16"), ("a.png", 8, "uint8"), ("a.tif", 8, "uint8"),
                             ("a.jpg", 8, "uint8")):
        path = write_frame(tmp_path / name, frame, bits=bits)
        assert str(oiio.ImageBuf(str(path)).spec().format) == kind
    deep = pixels_of(write_frame(tmp_path / "a.png", frame, bits=16))[..., :3]
    np.testing.assert_allclose(deep, srgb_encode(frame[Role.COLOUR]), atol=1 / 65535)
    hdr = Frame(frame.planes, encoding=str(parse_display("pq")))
    for name, given, options, told in (
        ("a.exr", frame, {"bits": 8}, "EXR has 16 or 32"),
        ("a.jpg", frame, {"bits": 16}, "JPG has 8"),
        ("a.png", hdr, {"bits": 8}, "8 bits are too few for"),
        ("a.png", frame, {"compression": "piz"}, "is for EXR"),
        ("a.exr", frame, {"compression": "zop"}, "use one of none"),
        ("a.exr", frame, {"compression": "piz:9"}, "dwaa:45"),
    ):
        with pytest.raises(WriteError, match=told):
            write_frame(tmp_path / name, given, **options)


@pytest.mark.parametrize("suffix", [".exr", ".png", ".tif", ".jpg"])
def test_any_number_of_threads_encodes_the_same(frame, tmp_path, suffix):
    frame = Frame({Role.COLOUR: np.tile(frame[Role.COLOUR], (20, 20, 1))}, encoding="srgb")
    pixels, used = [], oiio.get_int_attribute("threads")
    try:
        for threads in (1, 2, 8):
            oiio.attribute("threads", threads)
            pixels.append(pixels_of(write_frame(tmp_path / f"{threads}{suffix}", frame)))
    finally:
        oiio.attribute("threads", used)
    for other in pixels[1:]:
        np.testing.assert_array_equal(other, pixels[0])


@pytest.mark.parametrize(("suffix", "bits"), [(".png", 8), (".tif", 16)])
def test_display_files_hold_codes(frame, tmp_path, suffix, bits):
    frame.encoding = "srgb"
    path = write_frame(tmp_path / f"a{suffix}", frame, dither="none")
    assert pixels_of(path).shape == (12, 16, 3)
    np.testing.assert_allclose(pixels_of(path), frame[Role.COLOUR], atol=0.51 / (2**bits - 1))


def test_jpeg_is_close(frame, tmp_path):
    frame.encoding = "srgb"
    frame.planes[Role.COLOUR][:] = 0.5
    np.testing.assert_allclose(pixels_of(write_frame(tmp_path / "a.jpg", frame)), 0.5, atol=0.02)


def test_jpeg_has_quality_95(frame, tmp_path):
    """Its first step is 16 in the standard's table of brightness (K.1), of which quality 95 leaves
    a tenth."""
    table = Image.open(write_frame(tmp_path / "a.jpg", frame)).quantization[0]
    assert (table[0], max(table)) == (2, 12)


def test_transparent_pictures_keep_alpha(frame, tmp_path):
    frame.planes[Role.ALPHA][:] = 0.5
    frame.planes[Role.COLOUR][:] = 0.25
    frame.encoding = "srgb"
    with_alpha = pixels_of(write_frame(tmp_path / "a.tif", frame))
    np.testing.assert_allclose(with_alpha[0, 0], [0.25, 0.25, 0.25, 0.5], atol=0.005)


@pytest.mark.parametrize("bits", [8, 16])
def test_png_shows_no_noise_where_alpha_is_next_to_nothing(frame, tmp_path, bits):
    """Programs that ignore alpha, as those that make videos, would show it as bright dots."""
    frame.planes[Role.ALPHA][:, :8] = 0.4 / (2**bits - 1)
    frame.planes[Role.COLOUR][:, :8] = 0.05 * frame[Role.ALPHA][:, :8]
    config = oiio.ImageSpec()
    config["oiio:UnassociatedAlpha"] = 1
    name = str(write_frame(tmp_path / "a.png", frame, bits=bits, dither="none"))
    stored = oiio.ImageInput.open(name, config).read_image("float")
    assert not stored[:, :8].any() and stored[:, 8:].all()


@pytest.mark.parametrize("encoding", ["scene-linear", "srgb", "rec709", "pq"])
def test_png_holds_light_without_alpha_in_it(frame, tmp_path, encoding):
    frame.planes[Role.ALPHA][:] = np.linspace(0, 1, 16, dtype=np.float32)[:, None]
    frame.planes[Role.COLOUR][:] = 0.1 * frame[Role.ALPHA]
    display = parse_display("srgb" if encoding == "scene-linear" else encoding)
    if encoding != "scene-linear":
        frame.planes[Role.COLOUR][:], frame.encoding = display.encode(frame[Role.COLOUR]), encoding
    config = oiio.ImageSpec()
    config["oiio:UnassociatedAlpha"] = 1
    image = oiio.ImageInput.open(str(write_frame(tmp_path / "a.png", frame, dither="none")), config)
    stored = image.read_image("float")
    np.testing.assert_allclose(stored[..., 3], frame[Role.ALPHA][..., 0], atol=0.003)
    np.testing.assert_allclose(stored[:, 1:, :3], display.encode(np.full((12, 15, 3), 0.1)),
                               atol=0.003)
    assert not stored[:, 0, :3].any()


def test_header_is_kept_and_windows_are_scaled(write_exr, tmp_path, ramp):
    header = {"postfx__jitter": (0.25, -0.5), "postfx__fovX": 40.0,
              "worldToCamera": np.eye(4).ravel()}
    window = {"origin": (10, 20), "display": (10, 20, 8, 6)}
    source = write_exr("in.exr", ramp("R", "G", "B"), Software="farm", **window, **header)
    with_header = next(iter(read_sequence(source, planes=[Role.COLOUR])))
    assert with_header.jitter == (0.25, -0.5)
    double = np.repeat(np.repeat(with_header[Role.COLOUR], 2, axis=0), 2, axis=1)
    path = write_frame(tmp_path / "out.exr",
                       Frame({Role.COLOUR: double}, metadata=with_header.metadata))
    spec = oiio.ImageInput.open(str(path)).spec()
    assert (spec.full_x, spec.full_y, spec.full_width, spec.full_height) == (20, 40, 16, 12)
    assert spec.get_string_attribute("Software") == "farm"
    assert spec.get_float_attribute("postfx:fovX") == 40
    assert spec.getattribute("worldToCamera") == tuple(np.eye(4).ravel())
    assert spec.getattribute("postfx:jitter") is None


def test_jitter_is_told_as_long_as_the_samples_have_it(write_exr, tmp_path, ramp):
    names = ("R", "G", "B", *(f"albedo.{letter}" for letter in "RGB"))
    source = write_exr("in.exr", ramp(*names), postfx__jitter=(0.25, -0.5))
    frame = next(iter(read_sequence(source)))
    own = Frame({Role.COLOUR: frame[Role.COLOUR]}, jitter=(0.125, 0.375))
    for name, given, told in (("copied", frame, (0.25, -0.5)), ("made", own, (0.125, 0.375)),
                              ("centred", replace(frame, jitter=(0.0, 0.0)), None),
                              ("moved", replace(frame, jitter=(0.5, 0.0)), (0.5, 0.0))):
        path = write_frame(tmp_path / f"{name}.exr", given)
        assert oiio.ImageInput.open(str(path)).spec().getattribute("postfx:jitter") == told, name
        assert next(iter(read_sequence(path))).jitter == (told or (0.0, 0.0))


def test_standard_attributes_survive(frame, tmp_path):
    primaries = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    frame.metadata = {"timeCode": (16909060, 0), "chromaticities": primaries,
                      "framesPerSecond": 24000 / 1001}
    sequence = read_sequence(write_frame(tmp_path / "a.exr", frame), colourspace="native")
    again = next(iter(sequence)).metadata
    assert sequence.warnings == ["colours are acescg: kept as they are"]
    assert again["timeCode"] == (16909060, 0)
    assert again["framesPerSecond"] == pytest.approx(23.976, abs=1e-3)
    assert again["chromaticities"] == pytest.approx(primaries)


def test_display_pictures_have_the_displays_colour_space(frame, tmp_path):
    frame.metadata = {"chromaticities": (0.7, 0.3, 0.2, 0.8, 0.1, 0.0, 0.3, 0.3), "owner": "me"}
    frame.encoding = "srgb"
    again = next(iter(read_sequence(write_frame(tmp_path / "b.exr", frame)))).metadata
    assert again["chromaticities"] == pytest.approx(REC709)
    assert again["owner"] == "me"


def test_failing_to_write_leaves_nothing(frame, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match=r"a\.exr: cannot be written"):
        write_frame(tmp_path / "file" / "a.exr", frame)
    (tmp_path / "a.exr").mkdir()
    with pytest.raises(WriteError, match=r"a\.exr: cannot be written"):
        write_frame(tmp_path / "a.exr", frame)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "file"]


def test_unknown_format(frame, tmp_path):
    with pytest.raises(WriteError, match=r"unknown format '\.webp': use \.exr"):
        write_frame(tmp_path / "a.webp", frame)


@pytest.mark.parametrize("suffix", [".exr", ".png", ".tif", ".jpg"])
def test_shortened_outputs_are_not_complete(frame, tmp_path, suffix):
    path = write_frame(tmp_path / f"a{suffix}", frame)
    assert is_complete(path, 16, 12)
    assert not is_complete(path, 32, 24)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert not is_complete(path, 16, 12)


@pytest.fixture
def sequence(write_exr, ramp):
    first = write_exr("in/shot.0001.exr", ramp("R", "G", "B"))
    write_exr("in/shot.0002.exr", ramp("R", "G", "B"))
    return read_sequence(first.parent)


def test_output_names(sequence, tmp_path):
    assert OutputFiles(f"{tmp_path}/out.@@@@.png", sequence).path(2) == tmp_path / "out.0002.png"
    assert OutputFiles(f"{tmp_path}/new", sequence).path(2) == tmp_path / "new/shot.0002.exr"


def test_one_output_for_many_frames_is_refused(sequence, tmp_path):
    with pytest.raises(WriteError,
                       match=r"one file for 2 frames, 1-2: write it like out\.####\.exr"):
        OutputFiles(f"{tmp_path}/out.exr", sequence)


def test_outputs_over_inputs_are_refused(sequence, tmp_path):
    with pytest.raises(WriteError, match="is an input"):
        OutputFiles(f"{tmp_path}/in/", sequence)


def test_existing_outputs(sequence, frame, tmp_path):
    write_frame(tmp_path / "out.0002.exr", frame)
    with pytest.raises(OutputExistsError,
                       match=r"out\.0002\.exr: is already there: give --overwrite"):
        OutputFiles(f"{tmp_path}/out.####.exr", sequence).check((1, 2))
    for existing in (ExistingFiles.OVERWRITE, ExistingFiles.SKIP):
        OutputFiles(f"{tmp_path}/out.####.exr", sequence, existing).check((1, 2))


@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("size", [(1, 1), (17, 3), (33, 40)], ids=str)
@pytest.mark.parametrize("noisy", [False, True])
def test_every_reader_of_exr_finds_the_pixels(tmp_path, half, size, noisy):
    """Also where a chunk does not get smaller by compression and is stored as it is."""
    random = np.random.default_rng(0)
    bits = random.integers(0, 0x7BFF, (*size, 4), np.uint16).view(np.float16).astype(np.float32)
    pixels = bits if noisy else np.float32(0.25) + np.zeros_like(bits)
    frame = Frame({Role.COLOUR: pixels[:, :, :3], Role.ALPHA: pixels[:, :, 3:]})
    path = write_frame(tmp_path / "a.exr", frame, bits=16 if half else 32)
    np.testing.assert_array_equal(pixels_of(path), pixels)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for place, name in enumerate("RGBA"):
            np.testing.assert_array_equal(file.channels()[name].pixels, pixels[:, :, place])
        assert file.header()["compression"] == OpenEXR.ZIP_COMPRESSION


def test_exr_headers_are_those_of_openimageio(tmp_path):
    metadata = {"displayWindow": (-3, 5, 12, 16), "dataWindow": (-4, 2, 14, 20),
                "postfx:area": (-4, 2, 14, 20),
                "owner": "us", "pixelAspectRatio": 2.0, "timeCode": (1, 2),
                "cameraMatrix": tuple(map(float, range(16))),
                "a name of more than thirty-one bytes": 7}
    planes = {Role.COLOUR: np.full((19, 19, 3), 0.5, np.float32)}
    path = write_frame(tmp_path / "a.exr", Frame(planes, metadata=metadata))
    file = oiio.ImageInput.open(str(path))
    spec, pixels = file.spec(), file.read_image(oiio.HALF)
    file.close()
    spec.attribute("compression", "zip")
    again = oiio.ImageOutput.create(str(path))
    assert again.open(str(tmp_path / "b.exr"), spec) and again.write_image(pixels) and again.close()
    ours, theirs = (OpenEXR.File(str(tmp_path / name), header_only=True).header()
                    for name in ("a.exr", "b.exr"))
    assert ours.keys() == theirs.keys() and len(ours) > 14
    for name, value in ours.items():
        assert np.array_equal(value, theirs[name]) or str(value) == str(theirs[name]), name


@pytest.mark.parametrize(("compression", "loses"), [
    ("htj2k256", False), ("htj2k32", False), ("zstd", False), ("lj2k", True),
])
@pytest.mark.parametrize("half", [True, False])
def test_the_newest_compressions_are_written(tmp_path, compression, loses, half):
    if not can_compress(compression):
        pytest.skip(f"OpenImageIO {oiio.__version__} does not write {compression}")
    ramp = np.linspace(0.1, 4, 300 * 70 * 3, dtype=np.float32).reshape(300, 70, 3)
    light = ramp.astype(np.float16).astype(np.float32) if half else ramp
    bits = 16 if half else 32
    write_frame(
        tmp_path / "a.exr", Frame({Role.COLOUR: light}), bits=bits, compression=compression
    )
    image = oiio.ImageBuf(str(tmp_path / "a.exr"))
    assert image.spec()["compression"] == compression
    difference = np.abs(image.get_pixels(oiio.FLOAT) - light).max()
    assert difference < 0.05 if loses else difference == 0
    assert OpenEXR.File(str(tmp_path / "a.exr")).channels()["RGB"].pixels.shape == (300, 70, 3)


def test_a_compression_that_openimageio_cannot_write_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "can_compress", lambda name: name != "zstd")
    with pytest.raises(WriteError,
                       match=r"--compression zstd: OpenImageIO .* does not write it: install"):
        write_frame(tmp_path / "a.exr", Frame({Role.COLOUR: np.zeros((2, 2, 3), np.float32)}),
                    compression="zstd")


@pytest.mark.parametrize("compression", ["dwaa", "dwab", "dwaa:200"])
@pytest.mark.parametrize("half", [True, False])
def test_light_near_the_largest_half_stays_finite_in_lossy_compression(tmp_path, caplog,
                                                                       compression, half):
    rng = np.random.default_rng(6)
    light = np.full((64, 96, 3), 0.2, np.float32)
    light[rng.random((64, 96)) < 0.1] = 65504
    light[20:40, 20:40] = 60000 + 5500 * rng.random((20, 20, 3))
    depth = np.full((64, 96, 1), 1e6, np.float32)
    frame = Frame({Role.COLOUR: light}, parts={"Depth": depth, "key": light, "shadow": -light},
                  part_sources={"Depth": PartSource(("Depth.Z",))})
    write_frame(tmp_path / "a.exr", frame, bits=16 if half else 32, compression=compression)
    image = oiio.ImageBuf(str(tmp_path / "a.exr"))
    found = dict(zip(image.spec().channelnames, np.moveaxis(image.get_pixels(oiio.FLOAT), 2, 0),
                     strict=True))
    assert all(np.isfinite(plane).all() for plane in found.values())
    for name in ("R", "key.G", "shadow.B"):
        assert np.abs(found[name][20:40, 20:40]).min() > 40000
    assert half or (found["Depth.Z"] == 1e6).all()
    assert "as " + compression + " compression would make it infinite" in caplog.text


@pytest.mark.parametrize("compression", ["b44", "b44a", "lj2k"])
def test_other_lossy_compressions_make_nothing_infinite_and_say_what_they_lose(tmp_path, caplog,
                                                                               compression):
    """B44 rounds the largest half floats of any channel up, and JPEG 2000 made light of 43264 of
    NaN."""
    rng = np.random.default_rng(6)
    light = np.full((64, 96, 3), 0.2, np.float32)
    light[rng.random((64, 96)) < 0.1] = 65504
    light[20:40, 20:40] = 60000 + 5500 * rng.random((20, 20, 3))
    light[50, 50] = np.nan
    if not writer.can_compress(compression):
        pytest.skip("OpenImageIO does not write it")
    write_frame(tmp_path / "a.exr", Frame({Role.COLOUR: light}, parts={"sky": -light}),
                compression=compression)
    found = oiio.ImageBuf(str(tmp_path / "a.exr")).get_pixels(oiio.FLOAT)
    assert np.isfinite(found).all() and np.abs(found[50, 50]).max() < 0.3
    assert np.abs(found[20:40, 20:40]).min() > 40000
    assert "NaN become black by " + compression in caplog.text


@pytest.mark.parametrize("compression", ["zip", "none", "pxr24"])
@pytest.mark.parametrize(("most", "half", "said"), [
    (1e6, True,
     "light and sky above 65504 is cut there, as half floats hold no more: give 32 bits"),
    (np.inf, True, "light and sky above 65504 is cut"),
    (65520.0, True, "light and sky above 65504 is cut"),
    (65519.0, True, ""), (65504.0, True, ""), (1e6, False, ""),
])
def test_light_that_half_floats_cannot_hold_is_said(tmp_path, caplog, compression, most, half,
                                                    said):
    light = np.full((32, 48, 3), 0.5, np.float32)
    light[3, 4, 1], light[5, 6] = most, np.nan
    frame = Frame({Role.COLOUR: light}, parts={"sky": -light})
    write_frame(tmp_path / "a.exr", frame, bits=16 if half else 32, compression=compression)
    assert caplog.text.count("above") == bool(said) and said in caplog.text
    found = oiio.ImageBuf(str(tmp_path / "a.exr")).get_pixels(oiio.FLOAT)[3, 4]
    kept = min(most, 65504.0) if half else most
    np.testing.assert_array_equal(found[[1, 4]], [kept, -kept])


def test_light_that_survives_lossy_compression_is_not_cut(tmp_path, caplog):
    light = np.full((32, 32, 3), 30000, np.float32)
    write_frame(tmp_path / "a.exr", Frame({Role.COLOUR: light}), compression="dwaa")
    assert not caplog.text


def test_a_warning_says_that_lossy_compression_loses_nan(tmp_path, caplog):
    light = np.full((32, 32, 3), 0.5, np.float32)
    light[3, 4] = np.nan
    write_frame(tmp_path / "a.exr", Frame({Role.COLOUR: light}), compression="dwab")
    assert "NaN become black" in caplog.text
