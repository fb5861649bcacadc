"""What belongs together comes from one part: kinds of multi-part, layered and stereo files as
software writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postfx.errors import MissingPlaneError, ReadError
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence

GREY = (0.1, 0.2, 0.3, 0.4)


def flat(names: str | list[str], *values: float) -> dict[str, np.ndarray]:
    """Channels of one value each."""
    return {name: np.full((4, 6), value, np.float32)
            for name, value in zip(names, values, strict=True)}


def read(path: Path, **options) -> Frame:
    (frame,) = read_sequence(path, **options)
    return frame


def means(frame: Frame) -> dict[str, list[float]]:
    """Role -> value of each channel."""
    return {str(role): plane[0, 0].astype(float).round(4).tolist()
            for role, plane in frame.planes.items()}


RGBA = flat("RGBA", *GREY)
RGB = {name: RGBA[name] for name in "RGB"}
COLOUR = {"colour": [0.1, 0.2, 0.3]}
WITH_ALPHA = COLOUR | {"alpha": [0.4]}
CRYPTO = {"CryptoObject00": flat("RGBA", 7, 7, 7, 7)}
VECTOR = flat("XYZ", 1, 2, 3)

PARTS = {
    "a Cryptomatte's A is no alpha": ({"beauty": RGB, **CRYPTO}, COLOUR),
    "a Cryptomatte that comes first is no colour": ({**CRYPTO, "main": RGBA}, WITH_ALPHA),
    "a mask that comes first is no "
    "red": ({"sky": flat("R", 9), "matteA": flat("R", 8), "picture": RGB}, COLOUR),
    "alpha in a grey part of its own": ({"rgb": RGB, "alpha": flat("Y", 0.4)}, WITH_ALPHA),
    "alpha in a part of its own": ({"rgb": RGB, "alpha": flat("A", 0.4)}, WITH_ALPHA),
    "position is no depth": ({"rgba": RGBA, "P": VECTOR, "Z": flat("Z", 5)},
                             WITH_ALPHA | {"depth": [5]}),
    "position without a name that tells is no depth": ({"rgba": RGBA, "where": VECTOR}, WITH_ALPHA),
    "normals are no depth": ({"rgba": RGBA, "N": VECTOR, "foo": VECTOR, "Z": flat("Z", 5)},
                             WITH_ALPHA | {"normal": [1, 2, 3], "depth": [5]}),
    "a depth beside the colour": ({"rgba": RGBA | flat("Z", 5), "other": flat("Z", 6)},
                                  WITH_ALPHA | {"depth": [5]}),
    "parts of layer and view": (
        {"rgba.main": RGBA, "normal.main": VECTOR, "depth.main": flat("Z", 4),
         "albedo.main": flat("RGB", 5, 6, 7)},
        WITH_ALPHA | {"normal": [1, 2, 3], "depth": [4], "diffuse_albedo": [1, 1, 1]}),
    "parts of layer and any view": ({"albedo.cam2": flat("RGB", 0, 0, 0), "rgba.cam2": RGBA},
                                    WITH_ALPHA | {"diffuse_albedo": [0, 0, 0]}),
    "albedo first": ({"albedo": flat("RGB", 0, 0, 0), "rgba": RGBA},
                     WITH_ALPHA | {"diffuse_albedo": [0, 0, 0]}),
    "parts with full names": ({"rgba": RGBA, "depth": flat(["depth.Z"], 4)},
                              WITH_ALPHA | {"depth": [4]}),
    "a channel a part": ({f"part{name}": {name: plane} for name, plane in RGBA.items()},
                         WITH_ALPHA),
}


@pytest.mark.parametrize("kind", PARTS)
def test_parts_and_views_of_each_kind_are_read(write_parts, kind: str) -> None:
    parts, wanted = PARTS[kind]
    assert means(read(write_parts("a.exr", parts))) == wanted


LAYERS = {
    "red, green, blue": (flat(["red", "green", "blue", "alpha"], *GREY), WITH_ALPHA),
    "rgba.red": (flat(["rgba.red", "rgba.green", "rgba.blue", "rgba.alpha"], *GREY), WITH_ALPHA),
    "layers with words for letters": (
        RGB | flat(["albedo.red", "albedo.green", "albedo.blue", "normal.red", "normal.green",
                    "normal.blue"],
                   0, 0, 0, 1, 2, 3), COLOUR | {"diffuse_albedo": [0, 0, 0], "normal": [1, 2, 3]}),
    "alpha of the colour's "
    "layer": (flat(["beauty.R", "beauty.G", "beauty.B", "beauty.A", "A"], *GREY, 0.9), WITH_ALPHA),
    "grey": (flat("YA", 0.5, 0.4), {"colour": [0.5] * 3, "alpha": [0.4]}),
    "Blender's File Output": (flat(
        ["Image.R", "Image.G", "Image.B", "Image.A", "Denoising Albedo.R",
         "Denoising Albedo.G", "Denoising Albedo.B", "Vector.X", "Vector.Y"], *GREY, 0, 0, 0, 2, 3
    ), WITH_ALPHA | {"diffuse_albedo": [0] * 3, "denoising_albedo": [0] * 3, "motion": [2, -3]}),
    "a layer called image": (flat(
        ["Image.R", "Image.G", "Image.B", "normal.X", "normal.Y", "normal.Z"], *GREY[:3], 1, 2, 3
    ), COLOUR | {"normal": [1, 2, 3]}),
}


@pytest.mark.parametrize("kind", LAYERS)
def test_layers_of_each_kind_are_read(write_exr, kind: str) -> None:
    channels, wanted = LAYERS[kind]
    assert means(read(write_exr("a.exr", channels))) == wanted


def view_layers() -> dict[str, np.ndarray]:
    names = ["BG.Combined.R", "BG.Combined.G", "BG.Combined.B", "FG.Combined.R", "FG.Combined.G",
             "FG.Combined.B", "FG.Depth.Z", "Overlay.Combined.R", "Overlay.Combined.G",
             "Overlay.Combined.B", "Overlay.Combined.A"]
    return flat(names, 9, 9, 9, *GREY[:3], 5, 0, 0, 0, 0)


def test_of_several_view_layers_that_with_the_most_planes_is_read_or_the_one_that_is_named(
    write_exr
) -> None:
    path = write_exr("a.exr", view_layers(), Software="Blender 4.5.0")
    sequence = read_sequence(path, without=[Role.OVERLAY])
    assert means(next(iter(sequence))) == COLOUR | {"depth": [5]}
    (warning,) = sequence.warnings
    assert (warning == "view layer FG is read, as it has the most AOVs, not BG, Overlay: --layer "
            "NAME chooses")
    named = read_sequence(path, layer="bg", without=[Role.OVERLAY])
    assert means(next(iter(named))) == {"colour": [9, 9, 9]} and not named.warnings
    with pytest.raises(MissingPlaneError,
                       match=r"a\.exr: no layer 'sky': it holds BG, FG, Overlay"):
        read(path, layer="sky")


def test_the_name_of_a_lone_part_makes_no_other_view_layers(write_parts) -> None:
    for name in ("rgba", "x"):
        sequence = read_sequence(write_parts("a.exr", {name: view_layers()}))
        next(iter(sequence))
        assert sequence.warnings[0].startswith("view layer FG is read, as it has the most AOVs, "
                                               "not BG, Overlay: ")


def test_the_view_layer_of_the_first_frame_is_that_of_all(write_exr) -> None:
    more = view_layers() | flat(["BG.Depth.Z", "BG.Vector.X", "BG.Vector.Y"], 1, 1, 1)
    for number, channels in enumerate((view_layers(), more), 1):
        write_exr(f"s.{number:04d}.exr", channels)
    first, second = read_sequence(write_exr("s.0003.exr", more).with_name("s.####.exr"),
                                  frames="1-2")
    np.testing.assert_array_equal(first[Role.COLOUR], second[Role.COLOUR])


def test_any_layer_may_be_chosen(write_exr, write_parts) -> None:
    channels = flat(["char.R", "char.G", "char.B", "env.R", "env.G", "env.B", "depth.Z"], *GREY[:3],
                    9, 9, 9, 5)
    message = r"no AOV 'colour': .*\(--layer NAME\).*it holds char\.R,G,B; depth\.Z; env\.R,G,B"
    with pytest.raises(MissingPlaneError, match=message):
        read(write_exr("a.exr", channels), planes=[Role.COLOUR])
    assert means(read(write_exr("a.exr", channels), layer="char")) == COLOUR | {"depth": [5]}
    parts = {"rgba": flat("RGBA", 9, 9, 9, 9), "sss": RGBA}
    assert means(read(write_parts("b.exr", parts), layer="sss")) == WITH_ALPHA


STEREO = {
    "view in the parts' names": {
        "rgba.left": RGBA, "rgba.right": flat("RGBA", 9, 9, 9, 9), "depth.right": flat("Z", 8),
        "depth.left": flat("Z", 5)},
    "names with a line": {"rgba_left": RGBA, "depth_left": flat("Z", 5),
                          "depth_right": flat("Z", 8), "rgba_right": flat("RGBA", 9, 9, 9, 9)},
    "parts named after views": {"left": RGBA | flat("Z", 5), "right": flat("RGBAZ", 9, 9, 9, 9, 8)},
    "Blender's": {"VL.Combined.left": flat([f"VL.Combined.left.{name}" for name in "RGBA"], *GREY),
                  "VL.Combined.right": flat([f"VL.Combined.right.{name}" for name in "RGBA"], 9, 9,
                                            9, 9),
                  "VL.Depth.left": flat(["VL.Depth.left.Z"], 5),
                  "VL.Depth.right": flat(["VL.Depth.right.Z"], 8)},
}


@pytest.mark.parametrize("kind", STEREO)
def test_stereo_parts(write_parts, kind: str) -> None:
    sequence = read_sequence(write_parts("a.exr", STEREO[kind]))
    assert means(next(iter(sequence))) == WITH_ALPHA | {"depth": [5]}
    assert sequence.warnings == [
        "only view left is read, not right: --view all reads all of them"]
    other = read(write_parts("a.exr", STEREO[kind]), view="right")
    assert means(other) == {"colour": [9] * 3, "alpha": [9], "depth": [8]}
    with pytest.raises(MissingPlaneError, match="no view 'centre': it holds left, right"):
        read(write_parts("a.exr", STEREO[kind]), view="centre")


def test_view_layers_in_parts(write_parts) -> None:
    """Blender 5 writes a part a pass."""
    parts = {f"{layer}.{name}": flat([f"{layer}.{name}.{letter}" for letter in letters], *values)
             for layer, name, letters, values in (
                 ("View Layer", "Combined", "RGBA", (9, 9, 9, 9)),
                 ("Set", "Combined", "RGBA", GREY), ("View Layer", "Depth", "Z", (8,)),
                 ("Set", "Depth", "Z", (5,)), ("Set", "Normal", "XYZ", (1, 2, 3)))}
    path = write_parts("a.exr", parts, Software="Blender 5.1.0")
    assert means(read(path)) == WITH_ALPHA | {"depth": [5], "normal": [1, 2, 3]}
    assert means(read(path, layer="View Layer")) == {"colour": [9] * 3, "alpha": [9], "depth": [8]}


def test_views_in_channel_names(shared_dir: Path) -> None:
    path = shared_dir / "exr/beachball/singlepart.0001.exr"
    views = {}
    for view in ("right", "left"):
        with read_sequence(path, view=view).open(1) as files:
            views[view] = [files.match(role).names
                           for role in (Role.COLOUR, Role.ALPHA, Role.DEPTH)]
    assert views == {"right": ["R,G,B", "A", "Z"], "left": ["left.R,G,B", "left.A", "left.Z"]}


def test_camera_space_normals_are_not_read_under_the_base_profiles_name(write_exr) -> None:
    channels = RGB | flat(["Albedo.R", "Albedo.G", "Albedo.B", "Ns.X", "Ns.Y", "Ns.Z", "N.X", "N.Y",
                           "N.Z", "P.X", "P.Y", "P.Z", "dzdx"],
                          0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 5, 0)
    frame = read(write_exr("a.exr", channels))
    assert means(frame) == COLOUR | {"diffuse_albedo": [0, 0, 0], "depth": [5]}


def test_luminance_and_chroma_are_no_grey(write_exr) -> None:
    # OpenImageIO before 3.2 decodes such channels, and refuses these, which are as many as Y
    with pytest.raises((MissingPlaneError, ReadError),
                       match="no AOV 'colour'.*it holds Y,BY,RY|subsampling"):
        read(write_exr("a.exr", flat(["Y", "RY", "BY"], 1, 1, 1)))


@pytest.mark.parametrize("more", [{}, {"Maske.Y": 0.5}, {"depth.Z": 5.0, "albedo.R": 0.1,
                                                         "albedo.G": 0.2, "albedo.B": 0.3}])
def test_the_only_layer_with_colours_is_the_picture_whatever_its_name(write_exr, more) -> None:
    layer = flat([f"Layer 1.{letter}" for letter in "RGBA"], *GREY[:3], 0.5)
    sequence = read_sequence(write_exr("a.exr", layer | flat(list(more), *more.values())))
    (frame,) = sequence
    assert means(frame).items() >= {"colour": list(GREY[:3]), "alpha": [0.5]}.items()
    assert sequence.warnings[-1] == "layer Layer 1 is read as the picture: no other holds colours"
    assert ("diffuse_albedo" in frame.planes) == ("albedo.R" in more)


def test_the_only_layer_may_be_grey(write_exr) -> None:
    (frame,) = read_sequence(write_exr("a.exr", flat(["Ebene.Y"], 0.25)))
    assert frame["colour"].shape[2] == 3 and (frame["colour"] == 0.25).all()


def test_of_two_layers_with_colours_none_is_guessed(write_exr) -> None:
    names = [f"{layer}.{letter}" for layer in ("one", "two") for letter in "RGB"]
    with pytest.raises(MissingPlaneError, match=r"no AOV 'colour'.*--layer NAME"):
        read(write_exr("a.exr", flat(names, *range(6))))


NINES = flat("RGBA", 9, 9, 9, 9)
PICTURES = {
    "of two cameras": ({"camA": RGBA, "camB": NINES}, "camA", "camB"),
    "with a word after a dot": ({"rgba.camA": RGBA, "rgba.camB": NINES}, "rgba.camA", "rgba.camB"),
    "numbered": ({"rgba1": RGBA, "rgba2": NINES}, "rgba1", "rgba2"),
    "one numbered": ({"beauty": RGBA, "beauty 2": NINES}, "beauty", "beauty 2"),
    "by two words": ({"beauty": RGBA, "rgba": NINES}, "beauty", "rgba"),
    "of which one is a normal": ({"x": RGBA, "N": flat("RGB", 0, 0, 1), "y": NINES}, "x", "y"),
    "in layers": ({"all": flat([f"rgba.{name}" for name in "RGBA"], *GREY)
                          | flat([f"beauty.{name}" for name in "RGBA"], 9, 9, 9, 9)},
                  "rgba", "beauty"),
    "in a layer and none": ({"all": RGBA | flat([f"beauty.{name}" for name in "RGBA"], 9, 9, 9, 9)},
                            "R,G,B", "beauty"),
}


@pytest.mark.parametrize("kind", PICTURES)
def test_which_of_several_pictures_is_read_is_told_and_another_can_be_chosen(write_parts,
                                                                             kind: str) -> None:
    parts, chosen, other = PICTURES[kind]
    path = write_parts("a.exr", parts)
    sequence = read_sequence(path)
    (frame,) = sequence
    assert means(frame).items() >= WITH_ALPHA.items()
    assert sequence.warnings == [f"of several pictures {chosen} is read, not {other}: --layer NAME "
                                 "chooses"]
    named = read_sequence(path, layer=other)
    (frame,) = named
    assert means(frame).items() >= {"colour": [9] * 3, "alpha": [9]}.items()
    assert not named.warnings


def test_aovs_beside_another_picture_are_not_of_the_one_that_is_read(write_parts) -> None:
    parts = {"camA": RGBA, "camB": NINES | flat("Z", 5), "Z": flat("Z", 4)}
    sequence = read_sequence(write_parts("a.exr", parts))
    assert means(next(iter(sequence))) == WITH_ALPHA | {"depth": [4]}
    del parts["Z"]
    sequence = read_sequence(write_parts("b.exr", parts))
    assert means(next(iter(sequence))) == WITH_ALPHA
    assert sequence.warnings[0].endswith("not camB: --layer NAME chooses; depth beside these is "
                                         "not read")
    assert means(read(write_parts("b.exr", parts), layer="camB"))["depth"] == [5]


ONE_PICTURE = {
    "light groups of Arnold": {"RGBA": RGBA, "RGBA_key": NINES, "diffuse": NINES},
    "a picture by its name": {"other": NINES, "beauty": RGBA},
    "planes in R, G and B": {"main": RGBA, "N": flat("RGB", 0, 0, 1), "albedo": NINES},
}


@pytest.mark.parametrize("kind", ONE_PICTURE)
def test_parts_that_are_no_other_picture_are_not_told(write_parts, kind: str) -> None:
    sequence = read_sequence(write_parts("a.exr", ONE_PICTURE[kind]))
    (frame,) = sequence
    assert means(frame).items() >= WITH_ALPHA.items() and not sequence.warnings


def test_light_groups_that_are_named_are_no_other_pictures(write_parts) -> None:
    parts = {"all": RGBA, "key": flat("RGB", 0.1, 0.1, 0.1), "fill": flat("RGB", 0, 0.1, 0.2)}
    path = write_parts("a.exr", parts)
    sequence = read_sequence(path, aov="key,fill")
    next(iter(sequence))
    assert not any("several pictures" in warning for warning in sequence.warnings)
    sequence = read_sequence(path)
    next(iter(sequence))
    assert "all is read, not key, fill" in sequence.warnings[0]


def test_the_picture_of_the_first_frame_is_that_of_all(write_parts) -> None:
    write_parts("s.0001.exr", {"camA": RGBA, "camB": NINES | flat("Z", 5)})
    path = write_parts("s.0002.exr", {"camB": NINES | flat("Z", 5), "camA": RGBA})
    for frame in read_sequence(path.with_name("s.####.exr"), frames="1-2"):
        assert means(frame) == WITH_ALPHA
