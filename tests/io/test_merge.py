"""Renders with different seeds become one, weighted by their samples."""

import json
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from postfx.errors import FrameError, ReadError
from postfx.frame import Role
from postfx.io.exr.merge import merge_renders
from postfx.io.image_file import ImageFile
from postfx.io.sequence import read_sequence

SIZE = (12, 16)
CYCLES = {"Software": "Blender 5.0.1"}


def write(path: Path, channels: dict[str, np.ndarray], attributes: dict | None = None, at=(0, 0),
          full=None, kinds: dict[str, str] | None = None) -> Path:
    """An EXR of one part; `at` and `full` give its place in a larger picture."""
    height, width = next(iter(channels.values())).shape
    spec = oiio.ImageSpec(width, height, len(channels), "float")
    spec.channelnames = tuple(channels)
    spec.channelformats = tuple(oiio.TypeDesc((kinds or {}).get(name, "float"))
                                for name in channels)
    spec.x, spec.y = at
    spec.full_width, spec.full_height = full or (width, height)
    for name, value in (attributes or {}).items():
        spec.attribute(name, value)
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create("exr")
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(np.stack([*channels.values()], axis=2)
                              .astype(np.float32)), output.geterror()
    output.close()
    return path


def read(path: Path) -> dict[str, np.ndarray]:
    """All channels by name, in the data window."""
    with ImageFile(path) as file:
        return {name: file.read_stored(part, [name], 0, part.data.height)[0]
                for part in file.parts for name in part.channels}


def attributes(path: Path) -> dict:
    with ImageFile(path) as file:
        return dict(file.headers[0])


def noisy(seed: int, names=("R", "G", "B"), size=SIZE) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    return {name: random.gamma(2, 0.5, size).astype(np.float32) for name in names}


def cycles(seed: int, samples: int, tmp_path: Path) -> tuple[Path, dict[str, np.ndarray]]:
    layers = ("Combined.R", "Combined.G", "Combined.B", "Combined.A", "Depth.Z", "Vector.X",
              "Vector.Y", "Diffuse Color.R", "Diffuse Color.G", "Diffuse Color.B", "IndexOB.X",
              "CryptoObject00.r",
              "CryptoObject00.g", "Denoising Depth.Z", "AO.R", "AO.G", "AO.B", "Shadow Catcher.R")
    channels = noisy(seed, tuple(f"View.{layer}" for layer in layers))
    header = {**CYCLES, "cycles.View.samples": str(samples), "cycles.View.render_time": "00:10.50",
              "cycles.View.synchronization_time": "00:02.00", "RenderTime": "59:59.75"}
    return write(tmp_path / f"seed{seed}.exr", channels, header), channels


def test_amounts_are_averaged_by_samples_and_all_else_is_from_the_first(tmp_path: Path):
    (one, first), (two, second) = cycles(1, 16, tmp_path), cycles(2, 48, tmp_path)
    merged = merge_renders([one, two], tmp_path / "out.exr")
    found = read(merged.path)
    assert set(found) == set(first) and merged.samples == 64 and not merged.notes
    for name, pixels in found.items():
        is_taken = any(word in name for word in ("Depth", "Vector", "Index", "Crypto"))
        expected = first[name] if is_taken else first[name] / 4 + second[name] * 3 / 4
        np.testing.assert_allclose(pixels, expected, rtol=0 if is_taken else 1e-6, err_msg=name)


def test_samples_and_times_in_the_header_are_added_up(tmp_path: Path):
    (one, _), (two, _) = cycles(1, 16, tmp_path), cycles(2, 48, tmp_path)
    header = attributes(merge_renders([one, two], tmp_path / "out.exr").path)
    assert header["cycles.View.samples"] == "64"
    assert header["cycles.View.render_time"] == "00:21.00"
    assert header["cycles.View.synchronization_time"] == "00:02.00"  # as Cycles' own merging has it
    assert header["RenderTime"] == "01:59:59.50"
    assert header["postfx:merged"] == "seed1.exr 16, seed2.exr 48"
    assert read_sequence(tmp_path / "out.exr").read(1).samples == 64


def test_half_floats_stay_half_and_ids_keep_every_bit(tmp_path: Path):
    kinds = {"R": "half", "G": "half", "B": "half", "id": "uint"}
    paths = []
    for seed in (1, 2):
        ids = {"id": np.full(SIZE, 5.0 + seed, np.float32)}
        paths.append(write(tmp_path / f"{seed}.exr", noisy(seed) | ids, {"postfx:spp": 4},
                           kinds=kinds))
    found, first = read(merge_renders(paths, tmp_path / "out.exr").path), read(paths[0])
    assert found["R"].dtype == np.float16 and found["id"].dtype == np.uint32
    np.testing.assert_array_equal(found["id"], first["id"])
    mean = (first["G"].astype(np.float32) + read(paths[1])["G"].astype(np.float32)) / 2
    np.testing.assert_array_equal(found["G"], mean.astype(np.float16))


@pytest.mark.parametrize("is_unit", [True, False])
def test_normals_keep_unit_length_only_if_all_files_have_it(tmp_path: Path, is_unit: bool):
    paths, vectors = [], []
    for seed in (1, 2):
        vector = np.random.default_rng(seed).normal(0.4, 0.5, (*SIZE, 3)).astype(np.float32)
        vector /= np.linalg.norm(vector, axis=2, keepdims=True)
        vector[0] = 0  # misses
        vector[3:5] *= 1 if is_unit else 0.5
        vectors.append(vector)
        planes = {f"N.{letter}": vector[:, :, axis] for axis, letter in enumerate("XYZ")}
        paths.append(write(tmp_path / f"{seed}.exr", noisy(seed) | planes, {"postfx:spp": seed}))
    found = read(merge_renders(paths, tmp_path / "out.exr").path)
    merged = np.stack([found[f"N.{letter}"] for letter in "XYZ"], axis=2)
    mean = (vectors[0] + 2 * vectors[1]) / 3
    length = np.linalg.norm(mean, axis=2, keepdims=True)
    np.testing.assert_allclose(merged, mean / np.where(length > 0, length, 1) if is_unit else mean,
                               atol=1e-6)


def test_a_region_counts_only_there_and_can_be_merged_again(tmp_path: Path):
    base = noisy(1)
    tiles = [(noisy(2, size=(4, 8)), (6, 2)), (noisy(3, size=(4, 4)), (8, 4))]
    paths = [write(tmp_path / "base.exr", base, {"postfx:spp": 8})]
    paths += [write(tmp_path / f"tile{i}.exr", tile, {"postfx:spp": 24}, at, SIZE[::-1])
              for i, (tile, at) in enumerate(tiles)]
    at_once = merge_renders(paths, tmp_path / "at_once.exr")
    merge_renders(paths[:2], tmp_path / "some.exr")
    merge_renders([tmp_path / "some.exr", paths[2]], tmp_path / "again.exr")
    found, again = read(at_once.path), read(tmp_path / "again.exr")
    count = np.full(SIZE, 8.0)
    light = base["G"] * 8.0
    for tile, (x, y) in tiles:
        rows, columns = slice(y, y + tile["G"].shape[0]), slice(x, x + tile["G"].shape[1])
        count[rows, columns] += 24
        light[rows, columns] += tile["G"] * 24
    np.testing.assert_allclose(found["G"], light / count, rtol=1e-6)
    np.testing.assert_array_equal(found["sample_count.Y"], count)
    np.testing.assert_array_equal(again["sample_count.Y"], count)
    np.testing.assert_allclose(again["G"], found["G"], rtol=1e-6)
    frame = read_sequence(at_once.path).read(1)
    np.testing.assert_array_equal(frame[Role.SAMPLE_COUNT][:, :, 0], count)


def test_windows_of_different_files_are_joined(tmp_path: Path):
    one = write(tmp_path / "one.exr", noisy(1, ("R", "G", "B", "A"), (4, 16)), {"postfx:spp": 4},
                (0, 8), SIZE[::-1])
    two = write(tmp_path / "two.exr", noisy(2, size=(3, 8)), {"postfx:spp": 4}, (8, 0), SIZE[::-1])
    merged = merge_renders([one, two], tmp_path / "out.exr")
    found = read(merged.path)
    np.testing.assert_array_equal(found["R"][8:], read(one)["R"])
    np.testing.assert_array_equal(found["R"][:3, 8:], read(two)["R"])
    assert found["R"].shape == (12, 16) and not found["R"][3:8].any() and not found["A"][:8].any()
    assert not found["sample_count.Y"][3:8].any()


def test_a_border_render_of_full_size_counts_only_where_its_light_is(tmp_path: Path):
    one, two = noisy(1), noisy(2)
    for plane in two.values():
        plane[:, :5] = plane[:3] = 0
    paths = [write(tmp_path / f"{i}.exr", planes, {"postfx:spp": 4})
             for i, planes in enumerate((one, two))]
    merged = merge_renders(paths, tmp_path / "out.exr")
    expected = one["R"].copy()
    expected[3:, 5:] = (one["R"][3:, 5:] + two["R"][3:, 5:]) / 2
    np.testing.assert_allclose(read(merged.path)["R"], expected, rtol=1e-6)
    assert merged.notes == [f"{paths[1]}: has light only in 11x9 pixels from (5, 3) on: merged "
                            "there alone"]


def test_shares_of_samples_weigh_pixels_as_in_cycles(tmp_path: Path):
    shares = [np.linspace(0.25, 1, 192, dtype=np.float32).reshape(SIZE),
              np.float32([[0.5]]).repeat(192).reshape(SIZE)]
    paths, lights = [], []
    for seed, share in enumerate(shares):
        planes = noisy(seed, ("V.Combined.R", "V.Combined.G", "V.Combined.B"))
        lights.append(planes["V.Combined.R"])
        paths.append(write(tmp_path / f"{seed}.exr", planes | {"V.Debug Sample Count.X": share},
                           {**CYCLES, "cycles.V.samples": "32"}))
    found = read(merge_renders(paths, tmp_path / "out.exr").path)
    expected = (lights[0] * shares[0] + lights[1] * shares[1]) / (shares[0] + shares[1])
    np.testing.assert_allclose(found["V.Combined.R"], expected, rtol=1e-5)
    np.testing.assert_allclose(found["V.Debug Sample Count.X"], (shares[0] + shares[1]) / 2,
                               rtol=1e-6)


def test_a_broken_pixel_is_taken_from_the_other_render(tmp_path: Path):
    one, two = noisy(1), noisy(2)
    one["R"][2, 3], two["R"][4, 5], one["R"][7, 7], two["R"][7, 7] = np.nan, np.inf, np.nan, np.nan
    paths = [write(tmp_path / f"{i}.exr", planes, {"postfx:spp": 4})
             for i, planes in enumerate((one, two))]
    found = read(merge_renders(paths, tmp_path / "out.exr").path)["R"]
    assert found[2, 3] == two["R"][2, 3] and found[4, 5] == one["R"][4, 5] and np.isnan(found[7, 7])


def test_the_variance_of_a_mean_falls_with_its_samples(tmp_path: Path):
    names = ("R", "G", "B", "mse.R", "mse.G", "mse.B")
    planes = [noisy(seed, names) for seed in (1, 2)]
    paths = [write(tmp_path / f"{samples}.exr", each, {"postfx:spp": samples})
             for each, samples in zip(planes, (4, 12), strict=True)]
    found = read(merge_renders(paths, tmp_path / "out.exr").path)["mse.G"]
    np.testing.assert_allclose(found, planes[0]["mse.G"] / 16 + planes[1]["mse.G"] * 9 / 16,
                               rtol=1e-6)


def test_what_only_one_render_has_is_kept_or_named(tmp_path: Path):
    one = write(tmp_path / "one.exr", noisy(1) | noisy(5, ("key.R", "key.G", "key.B")),
                {"postfx:spp": 4})
    two = write(tmp_path / "two.exr", noisy(2) | noisy(6, ("fill.R",)), {"postfx:spp": 4})
    merged = merge_renders([one, two], tmp_path / "out.exr")
    np.testing.assert_array_equal(read(merged.path)["key.R"], read(one)["key.R"])
    assert merged.notes == [f"{two}: fill not in {one}: left out",
                            f"{two.name}: has no key: taken from the others"]


def test_the_same_noise_twice_is_refused(tmp_path: Path, capsys):
    paths = [write(tmp_path / f"{i}.exr", noisy(seed), {"postfx:spp": 4})
             for i, seed in enumerate((1, 2, 1))]
    assert main(["merge", *map(str, paths), "-o", str(tmp_path / "out.exr")]) == 2
    assert (f"{paths[2]}: has the same noise as {paths[0]}: render it with another seed"
            in capsys.readouterr().err)
    assert not (tmp_path / "out.exr").exists()


def test_pictures_of_one_colour_have_no_noise_and_are_merged(tmp_path: Path):
    black = {name: np.zeros(SIZE, np.float32) for name in "RGB"}
    paths = [write(tmp_path / f"{i}.exr", black, {"postfx:spp": 4}) for i in range(2)]
    assert merge_renders(paths, tmp_path / "out.exr").samples == 8


def lit_from(side: str, seed: int, names=("R", "G", "B")) -> dict[str, np.ndarray]:
    """A picture that is bright at one side, and dark at the other."""
    ramp = np.linspace(0.05, 1, 96, dtype=np.float32)
    light = ramp if side == "right" else ramp[::-1]
    return {name: values * light for name, values in noisy(seed, names, (64, 96)).items()}


@pytest.mark.parametrize("fill", [0.0, np.nan])
def test_another_picture_is_refused_and_another_seed_is_not(tmp_path: Path, fill: float):
    first, second, other = (write(tmp_path / f"{name}.exr", lit_from(side, seed),
                                  {"postfx:spp": spp})
                            for name, side, seed, spp in (("first", "left", 1, 4),
                                                          ("second", "left", 2, 64),
                                                          ("other", "right", 3, 4)))
    assert merge_renders([first, second], tmp_path / "out.exr").samples == 68
    with pytest.raises(FrameError, match="other.exr: shows another picture than .*first.exr"):
        merge_renders([first, second, other], tmp_path / "no.exr")
    assert not (tmp_path / "no.exr").exists()
    # a region with nothing around it shows the same where it was rendered
    part = lit_from("left", 4)
    for plane in part.values():
        plane[:, 48:] = fill
    region = write(tmp_path / "region.exr", part, {"postfx:spp": 4})
    assert merge_renders([first, region], tmp_path / "part.exr").samples == 8


def test_what_cannot_be_merged_is_refused_in_one_line(tmp_path: Path):
    one = write(tmp_path / "one.exr", noisy(1), {"postfx:spp": 4})
    small = write(tmp_path / "small.exr", noisy(1, size=(4, 4)), {"postfx:spp": 4})
    made = write(tmp_path / "made.exr", noisy(1), {"postfx:spp": 4, "postfx:picture": "R,G,B"})
    silent = write(tmp_path / "silent.exr", noisy(2))
    for other, kind, words in ((small, FrameError, "4x4 pixels, that of .*one.exr 16x12"),
                               (made, ReadError, "is a picture that postfx made"),
                               (silent, ReadError, "give --samples with a number for each file")):
        with pytest.raises(kind, match=words) as caught:
            merge_renders([one, other], tmp_path / "out.exr")
        assert str(caught.value).startswith(str(other)) and "\n" not in str(caught.value)
    assert not (tmp_path / "out.exr").exists()
    assert merge_renders([one, silent], tmp_path / "out.exr", [4, 12]).samples == 16


NAMES = ["beachball/multipart.0001.exr", "beachball/singlepart.0001.exr", "crow/crow_zip_half.exr",
         "cryptomatte/cornellBox_CryptoWildcard.0001.exr", "gaffer/imitateProductionLayers2.exr",
         "gaffer/weirdPartNames.exr", "oiio/grid-overscan.exr", "openexr/Adjuster.exr",
         "openexr/BrightRingsNanInf.exr"]


MORE = ("beachball/singlepart.0001.exr", "crow/crow_zip_half.exr")
"""Those that are large and of a kind that others are of."""


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=pytest.mark.soak if name in MORE else []) for name in NAMES])
def test_files_of_others_merged_with_themselves_stay_as_they_are(shared_dir: Path, tmp_path: Path,
                                                                 name: str, monkeypatch):
    monkeypatch.setattr("postfx.io.exr.merge.is_same_render", lambda *_: False)
    path = shared_dir / "exr" / name
    merged = merge_renders([path, path], tmp_path / "out.exr", [4, 12])
    before, after = ImageFile(path), ImageFile(merged.path)
    with before, after:
        assert [part.name for part in after.parts] == [part.name for part in before.parts]
        for old, new in zip(before.parts, after.parts, strict=True):
            assert (new.data, new.display, new.channels, new.formats) == (old.data, old.display,
                                                                         old.channels, old.formats)
            np.testing.assert_array_equal(before.read_stored(old, old.channels, 0, old.data.height),
                                          after.read_stored(new, old.channels, 0, old.data.height))


def test_sequences_are_merged_frame_by_frame(tmp_path: Path, capsys):
    for number in (1, 2, 3):
        write(tmp_path / f"a/shot.{number:04}.exr", noisy(number), {"postfx:spp": 4})
    for number in (1, 3):
        write(tmp_path / f"b/shot.{number:04}.exr", noisy(10 + number), {"postfx:spp": 4})
    call = ["merge", f"{tmp_path}/a/shot.####.exr", f"{tmp_path}/b/shot.####.exr", "-o",
            f"{tmp_path}/out/####.exr"]
    assert main([*call, "--json"]) == 0
    printed = capsys.readouterr()
    facts = json.loads(printed.out)
    assert (facts["samples"] == [8, 4, 8] and "frame 2: " in printed.err and "does not have "
            "it" in printed.err)
    np.testing.assert_array_equal(read(tmp_path / "out/0002.exr")["R"], noisy(2)["R"])
    assert main(call) == 2 and "is already there" in capsys.readouterr().err
    assert main([*call, "--skip-existing"]) == 0 and "nothing to do" in capsys.readouterr().out


def test_the_command_line_says_what_is_wrong(tmp_path: Path, capsys):
    one, two = (str(write(tmp_path / f"{seed}.exr", noisy(seed))) for seed in (1, 2))
    out = ["-o", str(tmp_path / "out.exr")]
    for words, message in (([one, *out], "is one render: give two or more"),
                           ([one, two], "nowhere to write"),
                           ([one, two, *out], "give --samples"),
                           ([one, two, *out, "--samples", "4"],
                            "--samples has 1 numbers for 2 renders"),
                           ([one, two, "-o", two, "--samples", "4,4"], "is an input"),
                           ([one, two, "-o", str(tmp_path / "out.png"), "--samples", "4,4"],
                            "write EXR")):
        assert main(["merge", *words]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
    assert main(["merge", one, two, *out, "--samples", "4,12"]) == 0
