"""`postfx inspect` as people run it: exit codes, JSON, pictures, and mistakes that only the files
show."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from postfx.frame import Role

ROOM = str(Path(__file__).parent.parent.parent / "samples" / "room" / "noisy.####.exr")


@pytest.fixture
def inspect(capsys):
    """Runs `postfx inspect ARGUMENTS --json`; gives exit code and object."""

    def run(*arguments):
        code = main(["inspect", *map(str, arguments), "--json"])
        return code, json.loads(capsys.readouterr().out)

    return run


@pytest.fixture
def broken_room(tmp_path):
    """Copies three frames of the sample with channels changed: name -> function of its values."""

    def write(**changes):
        for number in (2, 3, 4):
            image = oiio.ImageBuf(ROOM.replace("####", f"{number:04d}"))
            pixels, names = image.get_pixels(oiio.FLOAT), image.spec().channelnames
            for name, change in changes.items():
                index = names.index(name.replace("_", "."))
                pixels[..., index] = change(pixels[..., index])
            image.set_pixels(oiio.ROI.All, pixels)
            assert image.write(str(tmp_path / f"noisy.{number:04d}.exr"))
        return tmp_path / "noisy.####.exr"

    return write


def codes(found, level):
    return {finding["code"] for finding in found["findings"] if finding["level"] == level}


def test_nothing_wrong_is_0(inspect):
    code, found = inspect(ROOM)
    assert code == 0 and found["findings"] == []
    assert found["examined"] == list(range(1, 9))


def test_where_the_names_of_a_renderer_are_from(inspect, write_exr, capsys):
    names = (*"RGB", *(f"DiffuseFilter.{letter}" for letter in "RGB"), "MotionVectors.R",
             "MotionVectors.G")
    path = write_exr("a.exr", {name: np.full((16, 16), 0.5) for name in names})
    _, found = inspect(path)
    assert found["profile"] == {"name": "redshift", "title": "Redshift", "source": "listing"}
    assert {plane["role"]: plane["source"] for plane in found["planes"]} == {
        "colour": "", "diffuse_albedo": "listing", "motion": "manual"}
    main(["inspect", str(path)])
    text = capsys.readouterr().out
    assert "names are from lists of channels that others published\n" in text
    assert text.count("name from its maker's documents, not seen in a file") == 1


def test_only_aovs_that_every_result_needs_are_called_missing(shot, tmp_path, capsys):
    shot(1, 2, 3)
    (tmp_path / "in/shot.0002.exr").unlink()
    main(["inspect", str(tmp_path / "in"), "--frames", "1-3"])
    text = capsys.readouterr().out
    assert ": 3 frames, 1 to 3, 1 of them without a file" in text
    assert "missing  roughness" in text
    (optional,) = [line for line in text.splitlines() if line.startswith("optional ")]
    assert {"strength,", "reactive,", "overlay:"} <= {*optional.split()}
    assert "missing  overlay" not in text


def test_roles_say_which_planes_and_why(inspect):
    _, found = inspect(ROOM, "--frames", "2")
    assert set(found["roles"]) == set(Role)
    assert found["roles"]["diffuse_albedo"]["planes"] == ["albedo.R", "albedo.G", "albedo.B"]
    assert "'albedo'" in found["roles"]["diffuse_albedo"]["why"]
    assert (found["roles"]["overlay"]["planes"] == []
            and "'overlay.R" in found["roles"]["overlay"]["why"])
    assert all({"planes", "why"} <= set(role) for role in found["roles"].values())


def test_warnings_only_are_1(inspect, shot):
    code, found = inspect(shot(1, 2) / "shot.####.exr")
    assert (code == 1 and not codes(found, "error")
            and "missing-diffuse-albedo" in codes(found, "warning"))


def test_an_error_is_2_and_has_evidence_cause_and_fix(inspect, broken_room):
    code, found = inspect(broken_room(motion_Y=lambda y: -y))
    assert code == 2 and codes(found, "error") == {"motion-sign-y"}
    (finding,) = found["findings"]
    assert set(finding) == {"level", "role", "code", "evidence", "cause", "fix"}
    assert finding["role"] == "motion" and "negated in y" in finding["evidence"]


def test_values_above_1_are_seen_though_reading_cuts_them_off(inspect, broken_room):
    _, found = inspect(broken_room(albedo_R=lambda r: 2 * r))
    assert codes(found, "error") == {"albedo-above-one"}
    (plane,) = [plane for plane in found["planes"] if plane["role"] == "diffuse_albedo"]
    assert plane["max"] > 1.3


def test_ranges_are_of_the_whole_sequence(inspect, write_exr):
    """Eight frames are examined; ranges and odd values are also of frames spread over the rest."""
    for number in range(1, 21):
        value = np.full((8, 8), np.nan if number == 20 else number, np.float32)
        value[0, 0] = number
        folder = write_exr(f"s.{number:04d}.exr", dict.fromkeys("RGB", value)).parent
    _, found = inspect(folder / "s.####.exr")
    (plane,) = found["planes"]
    assert (found["examined"] == list(range(1, 9)) and found["measured"][-1] == 20
            and len(found["measured"]) <= 16)
    assert (plane["min"], plane["max"], plane["nan"]) == (1, 20, 63 * 3)


def test_nan_in_motion_is_seen_in_all_frames_though_reading_repairs_it(inspect, broken_room):
    _, found = inspect(broken_room(motion_X=lambda x: np.where(np.arange(x.shape[1]) == 7, np.nan,
                                                               x)))
    assert codes(found, "warning") == {"not-finite"}
    (plane,) = [plane for plane in found["planes"] if plane["role"] == "motion"]
    assert plane["nan"] == 3 * 180 and plane["infinite"] == 0


def test_a_broken_later_frame_is_a_finding(inspect, broken_room):
    pattern = broken_room()
    (pattern.parent / "noisy.0003.exr").write_bytes(b"v/1\x01nothing")
    code, found = inspect(pattern)
    assert code == 2 and codes(found, "error") == {"unreadable"} and found["examined"] == [2]


def test_a_broken_first_frame_is_an_error_line_and_no_output(postfx, broken_room):
    pattern = broken_room()
    (pattern.parent / "noisy.0002.exr").write_bytes(b"v/1\x01nothing")
    done = postfx("inspect", str(pattern), "--json")
    assert (done.code == 2 and done.out == "" and done.err.startswith("error: ")
            and done.err.count("\n") == 1)


def test_left_out_frames_are_not_neighbours(inspect):
    assert inspect(ROOM, "--frames", "1-7x2")[1]["examined"] == [1]


def test_normals_below_0_are_nothing_to_be_told(write_exr, capsys):
    names = (*(f"ViewLayer.Combined.{one}" for one in "RGB"),
             *(f"ViewLayer.{kind}Normal.{one}" for kind in ("", "Denoising ") for one in "XYZ"))
    path = write_exr("a.exr", {name: np.full((16, 16), -0.5 if "Normal" in name else 0.5)
                               for name in names})
    main(["inspect", str(path)])
    lines = [line for line in capsys.readouterr().out.splitlines()
             if line.startswith(("normal", "denoising_normal"))]
    assert len(lines) == 2 and all(line.endswith("-0.5 .. -0.5") for line in lines)


def test_pictures_of_every_plane(inspect, tmp_path):
    code, found = inspect(ROOM, "--frames", "2", "--pictures", tmp_path / "look")
    written = {Path(path).stem for path in found["pictures"]}
    assert code == 0 and written == {plane["role"] for plane in found["planes"]}
    picture = oiio.ImageBuf(str(tmp_path / "look" / "normal.png")).get_pixels(oiio.UINT8)
    assert picture.shape == (180, 320, 3) and picture.std() > 20


def test_pictures_that_cannot_be_written(postfx, tmp_path):
    (tmp_path / "look").write_text("a file")
    done = postfx("inspect", ROOM, "--frames", "2", "--pictures", "look")
    assert done.code == 2 and done.err.startswith("error: look: pictures cannot be written")


def test_text_has_the_worst_first_and_no_colour_in_a_pipe(postfx, broken_room):
    done = postfx("inspect", str(broken_room(motion_Y=lambda y: -y, albedo_R=lambda r: r * 1.1)))
    lines = done.out.splitlines()
    assert "there are errors" in lines[0] and "\x1b" not in done.out
    heads = [line.split()[0] for line in lines if line.startswith(("error ", "warning ", "info "))]
    assert heads[0] == "error" and heads == sorted(heads, key=["error", "warning", "info"].index)
    assert any(line.strip().startswith("fix:    in a profile") for line in lines)


def test_depth_is_checked_as_it_would_be_read(inspect, broken_room):
    """A reversed buffer is found; what --depth says mends it, and what it says wrongly is found as
    well."""
    reversed_buffer = broken_room(depth_Z=lambda z: np.where(z < 1e9, 0.1 / z, 0))
    assert "depth-reversed" in codes(inspect(reversed_buffer)[1], "error")
    code, found = inspect(reversed_buffer, "--depth", "reversed,near=0.1")
    assert code == 0 and "a depth buffer, 1 at the near plane" in found["roles"]["depth"]["why"]
    assert "depth-reversed" in codes(inspect(broken_room(), "--depth", "reversed,near=0.1")[1],
                                     "error")


def test_depth_that_cannot_be_understood_is_an_error_line(postfx):
    done = postfx("inspect", ROOM, "--depth", "z")
    assert (done.code == 2 and done.out == ""
            and done.err.startswith("error: depth 'z': begin with planar, ray, device"))


def test_layers_that_are_not_read_are_listed_and_may_be_what_is_missing(inspect, write_exr, capsys):
    names = (*"RGB", "zDepth.Z", *(f"normals.{letter}" for letter in "XYZ"),
             *(f"AO.{letter}" for letter in "RGB"))
    path = write_exr("a.exr", {name: np.random.default_rng(1).random((16, 16)) for name in names})
    _, found = inspect(path)
    assert sorted(found["unread"]) == ["AO.R,G,B", "normals.X,Y,Z", "zDepth.Z"]
    missing = {finding["role"]: finding["evidence"]
               for finding in found["findings"] if "missing" in finding["code"]}
    assert missing["normal"].startswith("in the file, but not read: normals.X,Y,Z; ")
    assert missing["depth"].startswith("in the file, but not read: zDepth.Z; ")
    assert "not read" not in missing["diffuse_albedo"]
    main(["inspect", str(path)])
    assert "unread   AO.R,G,B; normals.X,Y,Z; zDepth.Z\n" in capsys.readouterr().out


@pytest.mark.parametrize("view", ["left", "right"])
def test_layers_of_the_view_that_is_not_read_are_not_listed(inspect, tmp_path, view):
    pixels = np.random.default_rng(1).random((16, 16), np.float32)
    OpenEXR.File([OpenEXR.Part(
        {"type": OpenEXR.scanlineimage, "view": own},
        {f"VL.{layer}.{own}.{letter}": pixels for letter in letters}, f"VL.{layer}.{own}")
        for own in ("left", "right") for layer, letters in (("Combined", "RGBA"), ("Mist", "Z"))
    ]).write(str(tmp_path / "a.exr"))
    _, found = inspect(tmp_path / "a.exr", "--view", view)
    assert [name.startswith("VL.Mist") for name in found["unread"]] == [True]
    assert found["unread"][0].endswith(f"{view}.Z")


def test_a_run_tells_before_its_first_frame_what_is_plainly_wrong(broken_room, tmp_path, capsys):
    wrong = {"depth_Z": np.negative, "normal_X": lambda x: (x + 1) / 2,
             "normal_Y": lambda y: (y + 1) / 2, "normal_Z": lambda z: (z + 1) / 2,
             "motion_X": lambda x: x / 64 + 0.5, "motion_Y": lambda y: y / 64 + 0.5}
    run = ["run", str(broken_room(**wrong)), "-o", str(tmp_path / "out.####.exr"),
           "--model=classic", "--frames=2"]
    assert main([*run, "--json"]) == 0
    done = capsys.readouterr()
    told = [text for text in json.loads(done.out)["warnings"] if text.startswith("AOV ")]
    assert [text.partition(":")[0] for text in told] == [
        "AOV depth (depth.Z), frame 2", "AOV normal (normal.X,Y,Z), frame 2",
        "AOV motion (motion.X,Y), frame 2"]
    assert all("; likely: " in text and "; fix: " in text for text in told)
    assert done.err.index("negative, least") < done.err.index("1/1 "), "at once, not at the end"
    run[1] = ROOM
    assert main([*run, "--overwrite", "--json"]) == 0
    assert not any(text.startswith("AOV ")
                   for text in json.loads(capsys.readouterr().out)["warnings"])


def test_motion_stored_as_colours_is_found_whatever_signs_the_profile_has(inspect, broken_room,
                                                                          tmp_path):
    coded = broken_room(motion_X=lambda x: 0.5 - x / 128, motion_Y=lambda y: y / 128 + 0.5)
    signs = tmp_path / "signs.toml"
    signs.write_text('extends = "generic"\n[[plane]]\nrole = "motion"\nnames = ["motion"]\n'
                     'channels = ["XY"]\n' "scale = [-1, 1]\n")
    code, found = inspect(coded, "--profile", signs)
    assert (code > 0 and {"motion-coded", "motion-encoded"}
            & (codes(found, "error") | codes(found, "warning")))
    assert not {"motion-coded"} & codes(inspect(ROOM)[1], "warning")


@pytest.mark.parametrize(("number", "level"), [(1, "warning"), (2, "error")])
def test_a_plane_that_some_frames_lack(inspect, shot, write_exr, number, level):
    folder = shot(1, 2, 3)
    picture = {name: np.random.default_rng(number).random((32, 48)) for name in "RGB"}
    still = {f"motion.{axis}": np.zeros((32, 48)) for axis in "XY"}
    write_exr(f"in/shot.{number:04d}.exr", {**picture, **still})
    _, found = inspect(folder)
    (told,) = [finding for finding in found["findings"] if finding["code"] == "not-in-all-frames"]
    assert (told["role"], told["level"], told["evidence"]) == ("depth", level,
                                                               f"not in frame {number}")
