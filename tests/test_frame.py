"""Frames and specs: what they hold, how they compare and print, and what they refuse."""

from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import Frame, FrameSpec, Role
from postfx.errors import FrameError, GuideError
from postfx.frame import OUTPUT_SIZE_ROLES, ROLES, GuideSpec


def plane(role: Role, height: int = 4, width: int = 5) -> np.ndarray:
    return np.zeros((height, width, ROLES[role].channels), np.float32)


def test_every_role_has_a_convention():
    assert set(ROLES) == set(Role)
    assert all(all(map(str, info)) and 1 <= info.channels <= 4 for info in ROLES.values())


def test_spec_of_a_frame():
    frame = Frame({Role.DEPTH: plane(Role.DEPTH), Role.COLOUR: plane(Role.COLOUR)})
    assert frame.spec == FrameSpec(5, 4, {Role.COLOUR: 3, Role.DEPTH: 1})
    assert frame.spec.roles == (Role.COLOUR, Role.DEPTH)
    assert frame.spec.channels(Role.DEPTH) == 1


def test_specs_compare_and_hash_by_meaning():
    by_name = FrameSpec(2, 1, ["depth", "colour"])
    by_pairs = FrameSpec(2, 1, ((Role.COLOUR, 3), (Role.DEPTH, 1)))
    assert {by_name: "same"}[by_pairs] == "same"
    assert by_name != FrameSpec(2, 1, ["colour"])


def test_scalar_planes_may_come_without_channel_axis_and_in_other_floats():
    frame = Frame({"depth": np.ones((4, 5), np.float64)})
    assert frame[Role.DEPTH].shape == (4, 5, 1)
    assert frame[Role.DEPTH].dtype == np.float32
    assert frame[Role.DEPTH].flags.c_contiguous


@pytest.mark.parametrize(
    ("planes", "message"),
    [
        ({}, "no planes"),
        ({"colour": np.zeros((4, 5, 4), np.float32)},
         r"shape \(4, 5, 4\): it needs \(height, width, 3\)"),
        ({"colour": np.zeros((0, 5, 3), np.float32)}, "shape"),
        ({"colour": np.zeros((4, 5, 3), np.uint8)}, "uint8: give a NumPy array of floats"),
        ({"colour": [[[0.0, 0.0, 0.0]]]}, "list"),
        ({"colour": plane(Role.COLOUR), "depth": plane(Role.DEPTH, 8, 10)},
         "colour 5x4, depth 10x8"),
    ],
)
def test_refused_planes(planes, message):
    with pytest.raises(FrameError, match=message):
        Frame(planes)


def test_roles_as_words():
    frame = Frame({"color": plane(Role.COLOUR), "albedo": plane(Role.DIFFUSE_ALBEDO)})
    assert (list(frame.planes) == [Role.COLOUR, Role.DIFFUSE_ALBEDO] and "color" in frame
            and "depth" not in frame)
    assert frame["color"] is frame["colour"] is frame[Role.COLOUR]
    with pytest.raises(FrameError,
                       match="plane 'colours' of frame 1 has no meaning here: did you mean colour. "
                       "roles"):
        Frame({"colours": plane(Role.COLOUR)})
    with pytest.raises(FrameError, match="name a role twice: color, colour"):
        Frame({"color": plane(Role.COLOUR), "colour": plane(Role.COLOUR)})


class OnDevice:
    """An array in a GPU's memory, as far as one may look at it."""

    def __dlpack__(self, **_: object):
        raise AssertionError("is not asked for")

    def __dlpack_device__(self) -> tuple[int, int]:
        return 2, 0


class Foreign:
    """An array of another library that shares its memory by DLPack and by nothing else."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __dlpack__(self, **how: object):
        return self.array.__dlpack__(**how)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.array.__dlpack_device__()


def test_arrays_of_other_libraries_are_not_copied():
    given = np.random.default_rng(0).random((4, 5, 3), np.float32)
    frame = Frame({"colour": Foreign(given), "depth": Foreign(given[..., 0])},
                  parts={"key": Foreign(given)})
    assert np.shares_memory(frame["colour"], given) and np.shares_memory(frame.parts["key"], given)
    assert (frame["depth"] == given[..., :1]).all()


def test_arrays_that_cannot_be_read_are_told():
    with pytest.raises(FrameError,
                       match="cannot be read from OnDevice .it lies in the memory of a device"):
        Frame({"colour": OnDevice()})
    torch = pytest.importorskip("torch")
    assert Frame({"colour": torch.ones(2, 3, 3)})["colour"].sum() == 18
    for tensor in (torch.ones(2, 3, 3, requires_grad=True),
                   torch.ones(2, 3, 3, dtype=torch.bfloat16)):
        with pytest.raises(FrameError,
                           match="plane 'colour' of frame 1 cannot be read from Tensor .*detach"):
            Frame({"colour": tensor})
    with pytest.raises(FrameError, match="is int64: give a NumPy array of floats"):
        Frame({"colour": torch.ones(2, 3, 3, dtype=torch.int64)})


def test_unknown_encoding():
    with pytest.raises(FrameError,
                       match="unknown colour encoding 'crt': use scene-linear, display-linear;"):
        FrameSpec(1, 1, ["colour"], "crt")


def test_encodings_compare_by_meaning():
    assert FrameSpec(1, 1, ["colour"], "pq").encoding == "pq,peak=1000,white=203"
    assert FrameSpec(1, 1, ["colour"], "pq") == FrameSpec(1, 1, ["colour"], "pq,white=203,peak=1e3")


def test_asking_for_what_is_not_there():
    frame = Frame({Role.COLOUR: plane(Role.COLOUR)}, number=12)
    with pytest.raises(FrameError, match="frame 12 has no plane 'depth': it has colour"):
        frame[Role.DEPTH]
    with pytest.raises(FrameError, match="no plane 'depth'"):
        frame.spec.channels(Role.DEPTH)


def guided(*roles: Role, **kept) -> Frame:
    return Frame({"colour": plane(Role.COLOUR)},
                 guides={role: plane(role, 8, 10) for role in roles}, **kept)


def test_guides_are_planes_of_another_size():
    frame = guided(Role.DEPTH, Role.DIFFUSE_ALBEDO, guide_source="guides.0001.exr")
    guides = GuideSpec(10, 8, (Role.DEPTH, Role.DIFFUSE_ALBEDO))
    assert frame.spec == FrameSpec(5, 4, ["colour"], guides=guides)
    assert frame.spec.guide_roles == (Role.DEPTH, Role.DIFFUSE_ALBEDO)
    assert frame.spec.guides.source == "guides.0001.exr"
    assert guided().spec.guides is None and guided().spec.guide_roles == ()


def test_specs_with_guides_compare_and_hash_by_meaning():
    one = GuideSpec(4, 2, ["normal", "depth"], "a.exr")
    other = GuideSpec(4, 2, (Role.DEPTH, Role.NORMAL), "b.exr")
    specs = {FrameSpec(2, 1, ["colour"], guides=guides)
             for guides in (one, other, GuideSpec(4, 2, ["depth"]), None)}
    assert len(specs) == 3


def test_scalar_guides_may_come_without_channel_axis():
    frame = Frame({"colour": plane(Role.COLOUR)}, guides={"depth": np.ones((8, 10), np.float64)})
    assert (frame.guides[Role.DEPTH].shape == (8, 10, 1)
            and frame.guides[Role.DEPTH].dtype == np.float32)


@pytest.mark.parametrize("role", [role for role in Role if role not in OUTPUT_SIZE_ROLES])
def test_other_planes_cannot_be_guides(role):
    with pytest.raises(GuideError, match=f"plane '{role}'.* cannot be a guide: "):
        guided(role)
    with pytest.raises(GuideError, match=f"plane '{role}' cannot be a guide: "):
        GuideSpec(10, 8, (role,))


def test_guides_of_several_sizes_are_refused():
    guides = {Role.DEPTH: plane(Role.DEPTH, 8, 10), Role.NORMAL: plane(Role.NORMAL, 9, 10)}
    message = r"guides of frame 3 \(g.exr\) differ in size: depth 10x8, normal 10x9"
    with pytest.raises(FrameError, match=message):
        Frame({"colour": plane(Role.COLOUR)}, 3, guides=guides, guide_source="g.exr")


def test_guides_of_a_wrong_shape_are_refused():
    with pytest.raises(FrameError, match="guide 'normal' of frame 1 has shape"):
        Frame({"colour": plane(Role.COLOUR)}, guides={"normal": np.zeros((8, 10, 2), np.float32)})


def test_frames_compare_by_their_planes():
    frame = Frame({"colour": np.full((4, 5, 3), np.nan)}, 3, world_to_camera=np.eye(4),
                  metadata={"m": np.arange(3)})
    same = replace(frame, planes={"colour": frame[Role.COLOUR].copy()},
                   metadata={"m": np.arange(3)}, source="a.exr")
    assert frame == same and not frame != same
    for other in (replace(frame, number=4), replace(frame, planes={"colour": plane(Role.COLOUR)}),
                  replace(frame, planes={**frame.planes, "depth": plane(Role.DEPTH)}),
                  replace(frame, metadata={}), replace(frame, guides={"depth": plane(Role.DEPTH)}),
                  replace(frame, world_to_camera=None),
                  replace(frame, metadata={"m": np.arange(4)}), "frame"):
        assert frame != other


def test_a_frame_prints_as_a_table():
    colour = plane(Role.COLOUR)
    colour[0, 0] = 2.5, np.nan, np.inf
    frame = Frame({"colour": colour, "depth": np.full((4, 5), np.nan)}, 12, source="a.exr",
                  guides={"normal": plane(Role.NORMAL, 8, 10)})
    assert str(frame).splitlines() == [
        "Frame 12 (a.exr): 5x4, scene-linear",
        "  plane         size    type     range",
        "  colour        5x4x3   float32  0 to 2.5, 2 not finite",
        "  depth         5x4x1   float32  nothing finite",
        "  guide normal  10x8x3  float32  0 to 0",
    ]


@pytest.mark.parametrize(("encoding", "grey"),
                         [("scene-linear", 156), ("display-linear", 188), ("srgb", 128)])
def test_a_frame_is_a_picture_in_a_notebook(encoding, grey, tmp_path):
    frame = Frame({"colour": np.full((50, 1280, 3), 0.5)}, encoding=encoding, source="<a>.exr")
    (tmp_path / "frame.png").write_bytes(frame._repr_png_())
    pixels = oiio.ImageBuf(str(tmp_path / "frame.png")).get_pixels(oiio.UINT8)
    assert pixels.shape == (25, 640, 3) and (pixels == grey).all()
    assert ("&lt;a&gt;.exr" in frame._repr_html_()
            and "data:image/png;base64,iVBORw0KGgo" in frame._repr_html_())


def test_a_frame_without_colour_is_a_table_in_a_notebook():
    frame = Frame({"depth": plane(Role.DEPTH)})
    assert (frame._repr_png_() is None and "<img" not in frame._repr_html_()
            and "<td>depth</td>" in frame._repr_html_())


@pytest.mark.parametrize(("field", "value"), [
    ("jitter", None), ("jitter", 0.5), ("jitter", (1, 2, 3)), ("jitter", "ab"),
    ("jitter", ("x", 1)), ("guide_jitter", None), ("world_to_camera", np.eye(3)),
    ("world_to_camera", "x"), ("exposure", "bright"), ("exposure", (1, 2)), ("samples", "four"),
    ("fov_x", [1, 2]), ("planes", np.ones((2, 3, 3), np.float32)), ("planes", True),
    ("planes", [("colour", np.ones((2, 3, 3), np.float32))]), ("guides", 1.0),
    ("parts", np.ones((2, 3, 3), np.float32)), ("metadata", None), ("views", ["left"]),
])
def test_fields_of_other_types_are_refused(field, value):
    with pytest.raises(FrameError, match=f"frame 1 has {field} .*: give "):
        Frame(**{"planes": {Role.COLOUR: np.ones((2, 3, 3), np.float32)}, field: value})
