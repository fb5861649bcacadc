"""Layouts of renderers: files as each of them writes them, with known values, come out in the one
convention.

Stored values are made from the wanted ones by what the renderer documents, not by the profiles' own
rules.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from postfx.frame import DEPTH_MISS, Role
from postfx.io import layout as layout_module
from postfx.io.frame_reader import FrameFiles
from postfx.io.profile import NAME_SOURCES, load_profile, profile_names
from postfx.io.read_options import ReadOptions
from postfx.io.sequence import read_sequence

HEIGHT, WIDTH, FOV = 4, 6, 60.0
VIEW = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [1, 2, 3, 1]], np.float64)
"""A world-to-camera matrix for row vectors: a rotation and a shift."""
FORWARD = VIEW * [1, 1, -1, 1]
"""Of the camera of a right-handed world that `VIEW` looks along -z in, with z forwards."""
SIZE = np.array([WIDTH, HEIGHT])


def _truth() -> dict[Role, np.ndarray]:
    rng = np.random.default_rng(7)
    planes = {role: rng.random((HEIGHT, WIDTH, count)) for role, count in (
        (Role.COLOUR, 3), (Role.ALPHA, 1), (Role.DEPTH, 1), (Role.MOTION, 2), (Role.NORMAL, 3),
        (Role.DIFFUSE_ALBEDO, 3), (Role.SPECULAR_ALBEDO, 3), (Role.ROUGHNESS, 1),
        (Role.SAMPLE_COUNT, 1), (Role.VARIANCE_OF_MEAN, 3))}
    planes[Role.COLOUR] = planes[Role.COLOUR] * 4
    planes[Role.DEPTH] = 1 + 9 * planes[Role.DEPTH]
    planes[Role.MOTION] = 8 * planes[Role.MOTION] - 4
    planes[Role.NORMAL] = planes[Role.NORMAL] * 2 - 1
    planes[Role.NORMAL] /= np.linalg.norm(planes[Role.NORMAL], axis=2, keepdims=True)
    planes[Role.DEPTH][0, 0], planes[Role.NORMAL][0, 0] = DEPTH_MISS, 0  # the sky
    planes[Role.DENOISING_ALBEDO] = planes[Role.DIFFUSE_ALBEDO]
    return planes


TRUTH = _truth()
COLOUR, ALPHA, DEPTH, MOTION, NORMAL = (TRUTH[role] for role in tuple(Role)[:5])
DIFFUSE, SPECULAR = TRUTH[Role.DIFFUSE_ALBEDO], TRUTH[Role.SPECULAR_ALBEDO]
ROUGHNESS = TRUTH[Role.ROUGHNESS]
COUNT = TRUTH[Role.SAMPLE_COUNT]
ERROR = TRUTH[Role.VARIANCE_OF_MEAN]
PICTURE = {Role.COLOUR, Role.ALPHA}
ALBEDOS = {Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO}
OTHER = np.full((HEIGHT, WIDTH, 3), 0.123)
"""What belongs to no role, such as lit colour."""

Channels = dict[str, np.ndarray]


def store(name: str, letters: str | tuple[str, ...], plane: np.ndarray) -> Channels:
    """Channels 'name.X', or 'X' without a name, of a plane."""
    keys = [f"{name}.{letter}" if name and letter else name + letter for letter in letters or ("",)]
    return {key: plane[:, :, index] for index, key in enumerate(keys)}


def picture(name: str = "", letters: str = "RGBA") -> Channels:
    return store(name, letters, np.concatenate([COLOUR, ALPHA], axis=2))


def depth_with(miss: float) -> np.ndarray:
    return np.where(DEPTH < DEPTH_MISS, DEPTH, miss)


def ray_lengths(miss: float) -> np.ndarray:
    """Distance from the eye: depth over the cosine to the view axis."""
    step = 2 * np.tan(np.radians(FOV) / 2) / WIDTH
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5 - np.array([HEIGHT, WIDTH])[:, None, None] / 2
    lengths = DEPTH[:, :, 0] * np.sqrt(1 + (x * step) ** 2 + (y * step) ** 2)
    return np.where(DEPTH[:, :, 0] < DEPTH_MISS, lengths, miss)[:, :, None]


IN_CAMERA = NORMAL @ VIEW[:3, :3]
"""Normals along the camera's axes."""
TRUTH[Role.DENOISING_NORMAL] = IN_CAMERA * [1, 1, -1]  # Cycles looks along z


def to_next(per_frame: float = 1.0) -> np.ndarray:
    """Steady motion to the next frame, y up, in pixels: previous minus current is minus next minus
    current."""
    return MOTION * [-1, 1] * per_frame


def as_colour(plane: np.ndarray, most: float = 1.0) -> np.ndarray:
    """0..1 for -most..most."""
    return plane / most / 2 + 0.5


@dataclass(frozen=True)
class Layout:
    """A renderer's file.

    Attributes:
        profile: what must be found.
        stored: channels of a file, or part (file with `apart`) -> channels.
        roles: planes that must be there, besides the picture's own, with the values of `TRUTH`; no
            other may be.
        camera: lines of a user's profile that say what the file does not.
    """

    profile: str
    stored: Mapping[str, Any]
    roles: set[Role]
    header: Mapping[str, Any] = field(default_factory=dict)
    camera: str = ""
    depth: str | None = None
    apart: bool = False


CAMERA, CAMERA_FORWARD = {"worldToCamera": VIEW.ravel()}, {"worldToCamera": FORWARD.ravel()}
LENS = {"postfx__fovX": FOV}
BLENDER_VECTOR = np.concatenate([MOTION * [1, -1], OTHER[:, :, :2]], axis=2)


def blender(layer: str, diffuse: str, glossy: str) -> Channels:
    return (store(f"{layer}.Combined", "RGBA", np.concatenate([COLOUR, ALPHA], axis=2))
            | store(f"{layer}.Depth", "Z", DEPTH) | store(f"{layer}.Vector", "XYZW", BLENDER_VECTOR)
            | store(f"{layer}.Normal", "XYZ", NORMAL) | store(f"{layer}.{diffuse}", "RGB", DIFFUSE)
            | store(f"{layer}.{glossy}", "RGB", SPECULAR) | store(f"{layer}.AO", "RGB", OTHER))


def denoising_data(depth: np.ndarray) -> Channels:
    return (store("ViewLayer.Noisy Image", "RGBA", np.concatenate([COLOUR, ALPHA], axis=2))
            | store("ViewLayer.Combined", "RGBA", np.concatenate([OTHER, ALPHA], axis=2))
            | store("ViewLayer.Denoising Albedo", "RGB", DIFFUSE)
            | store("ViewLayer.Denoising Normal", "XYZ", IN_CAMERA * [1, 1, -1])
            | store("ViewLayer.Denoising Depth", "Z", depth))


BLENDER_5 = blender("ViewLayer", "Diffuse Color", "Glossy Color")
BLENDER_52 = denoising_data(ray_lengths(np.finfo(np.float32).max)) | (
    store("ViewLayer.Denoising Specular Albedo", "RGB", SPECULAR)
    # the root of alpha, roughness squared
    | store("ViewLayer.Denoising Roughness", "X", np.sqrt(ROUGHNESS ** 2)))
ALL_BUT_ROUGHNESS = ALBEDOS | {Role.DEPTH, Role.MOTION, Role.NORMAL}
SURFACE = {Role.DIFFUSE_ALBEDO, Role.NORMAL, Role.DEPTH}
DENOISING_DATA = SURFACE | {Role.DENOISING_NORMAL}
ARNOLD = (picture() | store("N", "XYZ", NORMAL) | store("Z", "", depth_with(np.inf))
          | store("diffuse_albedo", "RGB", DIFFUSE) | store("specular_albedo", "RGB", SPECULAR)
          | store("albedo", "RGB", OTHER) | store("motionvector", "RGB",
                                                  np.concatenate([to_next(0.5), DEPTH], axis=2)))
V_RAY_MAX = (picture() | store("VRayDiffuseFilter", "RGB", DIFFUSE)
             | store("VRayReflectionFilter", "RGB", SPECULAR)
             | store("VRayDiffuse", "RGB", OTHER) | store("VRayNormals", "XYZ", OTHER)
             | store("VRayVelocity", "RGB",
                     np.concatenate([as_colour(to_next(), 20), OTHER[:, :, :1]], axis=2)))
V_RAY_MAYA = (picture() | store("diffuse", "RGB", DIFFUSE) | store(
    "reflectionFilter", "RGB", SPECULAR
) | store("rawLighting", "RGB", OTHER) | store("normals", "XYZ", OTHER) | store("zdepth", "", DEPTH)
              | store("velocity", "XYZ",
                      np.concatenate([as_colour(to_next(), 20), OTHER[:, :, :1]], axis=2)))
RENDERMAN = (store("albedo", "rgb", DIFFUSE) | store("normal", "xyz", NORMAL)
             | store("mse", "rgb", ERROR) | store("zfiltered", "", DEPTH)
             | store("sampleCount", "", COUNT) | store("albedo_var", "rgb", OTHER)
             | store("normal_var", "xyz", OTHER)
             | store("forward", "xyz", np.concatenate([-MOTION, DEPTH], axis=2))
             | store("backward", "xyz", np.concatenate([MOTION, DEPTH], axis=2))
             | store("diffuse", "rgb", OTHER))
RENDERMAN_ROLES = SURFACE | {Role.MOTION, Role.VARIANCE_OF_MEAN, Role.SAMPLE_COUNT}
REDSHIFT = (picture() | store("Z", "", depth_with(0)) | store("DiffuseFilter", "RGB", DIFFUSE)
            | store("ReflectionsFilter", "RGB", SPECULAR) | store("BumpNormals", "RGB", NORMAL)
            | store("DiffuseLighting", "RGB", OTHER) | store("P", "RGB", OTHER))
UNREAL = "FinalImageMovieRenderQueue_"
UNREAL_MOTION = as_colour(-MOTION * [1, -1] / (SIZE / 2), 2)
"""Current minus previous, -2..2 in -1..1 of the image, y up."""
HUSK = {"husk__render_stats": "{}"}

LAYOUTS = {
    "Blender 5, one part": Layout("cycles-5", BLENDER_5, ALL_BUT_ROUGHNESS,
                                  {"Software": "Blender 5.0.1"}),
    "Blender 5, a part a pass": Layout("cycles-5", {
        name: {key: plane for key, plane in BLENDER_5.items() if key.startswith(name)}
        for name in dict.fromkeys(key.rpartition(".")[0] for key in BLENDER_5)}, ALL_BUT_ROUGHNESS),
    "Blender 5.2, Denoising Data alone": Layout(
        "cycles-5", BLENDER_52, DENOISING_DATA | ALBEDOS | {Role.ROUGHNESS}, CAMERA,
        depth=f"ray,fov={FOV}"),
    "Blender 5.2, Denoising Data and Diffuse Color": Layout(
        "cycles-5", BLENDER_52 | store("ViewLayer.Diffuse Color", "RGB", OTHER),
        DENOISING_DATA | ALBEDOS | {Role.ROUGHNESS}, CAMERA, depth=f"ray,fov={FOV}"),
    "Blender 5.2, Denoising Data and both colours": Layout(
        "cycles-5", BLENDER_5 | BLENDER_52 | {
            f"ViewLayer.{name}.{letter}": OTHER[:, :, 0] for letter in "RGB"
            for name in ("Combined", "Denoising Albedo", "Denoising Specular Albedo")},
        ALL_BUT_ROUGHNESS | {Role.ROUGHNESS, Role.DENOISING_NORMAL}),
    "Blender 4": Layout(
        "cycles-4", blender("View Layer", "DiffCol", "GlossCol"), ALL_BUT_ROUGHNESS,
        {"Software": "Blender 4.5.3"}),
    "Blender 2.8 to 4 without its header": Layout(
        "cycles-4", blender("RenderLayer", "DiffCol", "GlossCol"), ALL_BUT_ROUGHNESS),
    "Blender 4, Denoising Data": Layout(
        "cycles-4", denoising_data(ray_lengths(0)), DENOISING_DATA | {Role.DENOISING_ALBEDO},
        {"Software": "Blender 4.2.1", **CAMERA_FORWARD}, depth=f"ray,fov={FOV},miss=0"),
    "Cycles in Gaffer, a file an AOV": Layout("cycles-hosts", {
        "beauty": picture(), "diffuse_color": store("", "RGB", DIFFUSE),
        "glossy_color": store("", "RGB", SPECULAR), "normal": store("", "RGB", NORMAL),
        "depth": store("", "Z", DEPTH), "roughness": store("", "R", ROUGHNESS),
        "motion": store("", "RGBA", BLENDER_VECTOR), "ao": store("", "RGB", OTHER),
    }, ALL_BUT_ROUGHNESS | {Role.ROUGHNESS}, apart=True),
    "Cycles in Gaffer, layers": Layout(
        "cycles-hosts",
        picture() | store("diffuse_color", "RGB", DIFFUSE) | store("glossy_color", "RGB", SPECULAR)
        | store("normal", "RGB", NORMAL) | store("depth", "R", DEPTH)
        | store("motion", "RGBA", BLENDER_VECTOR) | store("sample_count", "R", COUNT),
        ALL_BUT_ROUGHNESS | {Role.SAMPLE_COUNT}),
    "Cycles in Houdini": Layout(
        "cycles-hosts", picture("C") | store("DiffCol", "RGB", DIFFUSE)
        | store("GlossCol", "RGB", SPECULAR) | store("Depth", "Z", DEPTH)
        | store("Normal", "XYZ", NORMAL) | store("Vector", "XYZW", BLENDER_VECTOR),
        ALL_BUT_ROUGHNESS, HUSK),
    "Cycles in other hosts, Blender's names": Layout(
        "cycles-hosts", picture() | store("Diffuse Color", "RGB", DIFFUSE)
        | store("Glossy Color", "RGB", SPECULAR) | store("Depth", "Z", DEPTH)
        | store("Normal", "XYZ", NORMAL) | store("Vector", "XYZW", BLENDER_VECTOR),
        ALL_BUT_ROUGHNESS),
    "Cycles in other hosts, denoising passes": Layout(
        "cycles-hosts", picture() | store("denoising_albedo", "RGB", DIFFUSE)
        | store("normal", "XYZ", NORMAL) | store("depth", "Z", DEPTH), SURFACE),
    "Arnold": Layout("arnold", ARNOLD, ALL_BUT_ROUGHNESS, {"arnold/version": "7.3.2.1"}),
    "Arnold without its header": Layout("arnold", ARNOLD, ALL_BUT_ROUGHNESS),
    "Arnold, denoiser's AOVs": Layout(
        "arnold", picture() | store("N", "RGB", NORMAL) | store("Z", "", DEPTH)
        | store("denoise_albedo", "RGB", DIFFUSE) | store("variance", "RGB", OTHER), SURFACE,
        {"arnold/version": "7.1"}),
    "V-Ray, 3ds Max": Layout("v-ray", V_RAY_MAX, ALBEDOS,
                             {"vrayInfo/vrayversion": "Version of V-Ray for 3dsmax 6"}),
    "V-Ray, 3ds Max, without its header": Layout("v-ray", V_RAY_MAX, ALBEDOS),
    "V-Ray, Maya": Layout("v-ray", V_RAY_MAYA, ALBEDOS,
                          {"vrayInfo/vrayversion": "Version of V-Ray for Maya 3.60.05"}),
    "V-Ray, Maya, without its header": Layout("v-ray", V_RAY_MAYA, ALBEDOS),
    "V-Ray, its denoiser's elements, without its header": Layout(
        "v-ray",
        picture() | store("effectsResult", "RGB", OTHER) | store("diffuseFilter", "RGB", DIFFUSE)
        | store("bumpNormals", "XYZ", IN_CAMERA) | store("noiseLevel", "RGB", OTHER),
        {Role.DIFFUSE_ALBEDO}),
    "V-Ray, Max Velocity known": Layout("v-ray", V_RAY_MAX, ALBEDOS | {Role.MOTION},
                                        camera="max_velocity = 20"),
    "RenderMan": Layout("renderman", picture("Ci", "rgb") | store("a", "", ALPHA) | RENDERMAN,
                        RENDERMAN_ROLES),
    "RenderMan, asrgba": Layout("renderman", picture() | RENDERMAN, RENDERMAN_ROLES),
    "RenderMan, Nn and z": Layout(
        "renderman", picture() | store("Nn", "xyz", NORMAL) | store("z", "", DEPTH)
        | store("albedo", "rgb", DIFFUSE), SURFACE),
    "RenderMan, AOVs of PxrDefault": Layout(
        "renderman", picture("Ci", "rgb") | store("a", "", ALPHA) | store("__Nworld", "rgb", NORMAL)
        | store("__depth", "rgb", np.concatenate([DEPTH, OTHER], axis=2))
        | store("__st", "rgb", OTHER), {Role.NORMAL, Role.DEPTH}),
    "Redshift, raw vectors": Layout(
        "redshift", REDSHIFT | store("MotionVectors", "RG", to_next()), ALL_BUT_ROUGHNESS),
    "Redshift, remapped vectors, Max Motion known": Layout(
        "redshift", REDSHIFT | store("MotionVectors", "RG", as_colour(to_next(), 64)),
        ALL_BUT_ROUGHNESS, camera="max_velocity = 64"),
    "Redshift, a part an AOV": Layout("redshift", {
        "rgba": picture(), "Z": store("", "Z", depth_with(0)),
        "DiffuseFilter": store("DiffuseFilter", "RGB", DIFFUSE),
        "Normals": store("Normals", "RGB", NORMAL), "GI": store("GI", "RGB", OTHER)}, SURFACE),
    "Unreal": Layout(
        "unreal", picture() | store(UNREAL + "WorldDepth", "RGB",
                                    np.concatenate([DEPTH, OTHER[:, :, :2]], axis=2))
        | store(UNREAL + "MotionVectors", "RGBA",
                np.concatenate([UNREAL_MOTION, OTHER[:, :, :2]], axis=2))
        | store("ActorHitProxyMask00", "RGB", OTHER), {Role.DEPTH, Role.MOTION},
        {"unreal/jobName": "shot"}),
    "Unreal without its header, own materials": Layout(
        "unreal", picture("FinalImage") | store("FinalImageWorldNormal", "RGBA",
                                                np.concatenate([NORMAL, ALPHA], axis=2))
        | store("FinalImageBaseColor", "RGB", DIFFUSE) | store(
            "FinalImageRoughness", "RGB", np.tile(ROUGHNESS, 3)
        ) | store("FinalImageSceneDepth", "RGB", np.tile(DEPTH, 3)), SURFACE | {Role.ROUGHNESS}),
    "Karma": Layout(
        "karma", picture("C") | store("N", "XYZ", NORMAL) | store("albedo", "RGB", DIFFUSE) | store(
            "hitPz", "", DEPTH
        ) | store("motionvectors", "RG", OTHER) | store("directdiffuse", "RGB", OTHER), SURFACE,
        HUSK),
    "Karma, the picture as RGBA": Layout(
        "karma", picture() | store("N", "XYZ", NORMAL) | store("albedo", "RGB", DIFFUSE)
        | store("hitPz", "Z", depth_with(0)) | store("directdiffuse", "RGB", OTHER), SURFACE),
    "Mantra": Layout(
        "mantra",
        picture() | store("N", "XYZ", IN_CAMERA) | store("Pz", "", DEPTH) | store("P", "XYZ", OTHER)
        | store("basecolor", "RGB", DIFFUSE) | store("all_comp", "RGB", OTHER), SURFACE, CAMERA),
    "MoonRay": Layout(
        "moonray", picture() | store("material_albedo", "RGB", DIFFUSE) | store(
            "material_normal", "RGB", IN_CAMERA
        ) | store("depth", "", depth_with(0)) | store("motionvec", "RG", to_next() / (SIZE / 2)),
        SURFACE | {Role.MOTION}, CAMERA_FORWARD),
    "Iray for Maya": Layout(
        "iray", picture() | store("normal", "XYZ", IN_CAMERA) | store("depth", "Z", DEPTH)
        | store("albedo", "RGB", DIFFUSE) | store("material_id", "RGBA", np.tile(ALPHA, 4)),
        SURFACE, {"IFM_camera": "camera_MEShape3", **CAMERA}),
    "LuxCore in Blender": Layout(
        "luxcore", picture("ViewLayer.Combined") | store("ViewLayer.ALBEDO", "RGB", DIFFUSE)
        | store("ViewLayer.AVG_SHADING_NORMAL", "XYZ", NORMAL)
        | store("ViewLayer.Depth", "Z", ray_lengths(np.inf)),
        SURFACE, {"Software": "Blender 4.2.0"}, depth=f"ray,fov={FOV}"),
    "LuxCore, a file an output": Layout("luxcore", {
        "RGBA": picture(), "ALBEDO": store("", "RGB", DIFFUSE),
        "AVG_SHADING_NORMAL": store("", "RGB", NORMAL),
    }, {Role.DIFFUSE_ALBEDO, Role.NORMAL}, apart=True),
    "appleseed, a part an AOV": Layout("appleseed", {
        "beauty": picture(), "albedo": store("", "RGB", DIFFUSE),
        "normal": store("", "XYZ", as_colour(NORMAL)),
        "depth": store("", "Z", ray_lengths(0)), "screen_space_velocity": store("", "RGB", OTHER)},
        SURFACE, {"Software": "appleseed 2.1.0-beta", **LENS}),
    "3Delight": Layout(
        "3delight", picture("Ci.000", "rgba") | store("albedo.000", "rgb", DIFFUSE) | store(
            "N.world.000", "xyz", NORMAL
        ) | store("z.000", "", DEPTH) | store("diffuse.000", "rgb", OTHER), SURFACE),
    "3Delight in Gaffer": Layout(
        "3delight", picture("Ci", "rgb") | store("a", "", ALPHA) | store("N.world", "rgb", NORMAL)
        | store("z", "", DEPTH) | store("albedo", "rgb", DIFFUSE)
        | store("motionvector", "rgb", OTHER), SURFACE),
    "Guerilla": Layout(
        "guerilla",
        picture("Beauty") | store("Albedo", "RGB", DIFFUSE) | store("Normal", "RGB", NORMAL)
        | store("Z", "", DEPTH) | store("IndDiffuse", "RGB", OTHER), SURFACE),
    "Clarisse": Layout(
        "clarisse",
        store("rgba", ("red", "green", "blue", "alpha"), np.concatenate([COLOUR, ALPHA], axis=2))
        | store("depth", "z", DEPTH) | store("albedo", ("red", "green", "blue"), DIFFUSE)
        | store("normal", ("red", "green", "blue"), NORMAL), SURFACE),
    "KeyShot": Layout(
        "keyshot", picture() | store("Diffuse", "RGB", DIFFUSE) | store("Clown", "RGB", OTHER)
        | store("Depth", "Z", DEPTH), {Role.DIFFUSE_ALBEDO, Role.DEPTH}),
    "Maxwell": Layout(
        "maxwell", picture() | store("Reflectance", "RGB", DIFFUSE) | store("Fresnel", "RGB", OTHER)
        | store("Roughness", "RGB", np.tile(ROUGHNESS, 3)), {Role.DIFFUSE_ALBEDO, Role.ROUGHNESS}),
    "Corona": Layout(
        "corona", picture() | store("CShading_Albedo", "RGB", DIFFUSE)
        | store("CESSENTIAL_Direct", "RGB", OTHER) | store("CGeometry_ZDepth", "RGB", OTHER),
        {Role.DIFFUSE_ALBEDO}),
    "Octane": Layout(
        "octane", picture("Beauty") | store("Diffuse Filter", "RGB", DIFFUSE)
        | store("Reflection Filter", "RGB", SPECULAR)
        | store("Shading Normal", "RGB", NORMAL) | store("Roughness", "RGB", np.tile(ROUGHNESS, 3))
        | store("Z-Depth", "RGB", OTHER), ALBEDOS | {Role.NORMAL, Role.ROUGHNESS}),
    "Octane, shutter known": Layout(
        "octane", picture("Beauty") | store("Diffuse Filter", "RGB", DIFFUSE) | store(
            "Reflection Filter", "RGB", SPECULAR
        ) | store("Motion Vector", "RG", to_next(0.2) / WIDTH),
        ALBEDOS | {Role.MOTION}, camera="shutter = 0.2"),
    "Mitsuba 3": Layout(
        "mitsuba-3", picture() | store("albedo", "RGB", DIFFUSE) | store("nn", "XYZ", NORMAL)
        | store("dd", "T", ray_lengths(0)), SURFACE,
        {"generatedBy": "Mitsuba version 3.9.1", **LENS}),
    "pbrt-v4": Layout(
        "pbrt-4", picture("", "RGB") | store("Albedo", "RGB", DIFFUSE)
        | store("Ns", "XYZ", IN_CAMERA) | store("N", "XYZ", OTHER) | store(
            "P", "XYZ", np.concatenate([OTHER[:, :, :2], depth_with(0)], axis=2)
        ) | store("dzdx", "", OTHER), SURFACE, {"worldToCamera": VIEW.T.ravel()}),
    "plain names": Layout(
        "generic",
        picture() | store("albedo", "RGB", DIFFUSE) | store("specular_albedo", "RGB", SPECULAR)
        | store("normal", "XYZ", NORMAL) | store("depth", "Z", DEPTH)
        | store("motion", "XY", MOTION) | store("roughness", "Y", ROUGHNESS),
        ALL_BUT_ROUGHNESS | {Role.ROUGHNESS}),
}
"""What a renderer and its settings are called in docs/reference/renderers.md -> its layout."""


@cache
def documented_layouts() -> dict[str, list[str]]:
    """Rows of the table in docs/reference/renderers.md by their first cell."""
    page = (Path(__file__).resolve()
            .parents[2] / "docs" / "reference" / "renderers.md").read_text("utf-8")
    rows = (line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| "))
    return {cells[0]: cells for cells in rows if len(cells) == 5}


@pytest.fixture
def open_layout(write_exr, write_parts, tmp_path):
    """Writes a layout's files and opens them, by detection or by a profile."""

    def write(layout: Layout) -> dict[str, Path]:
        groups = layout.stored
        if layout.apart:
            return {name: write_exr(f"{name}.exr", planes, **layout.header)
                    for name, planes in groups.items()}
        if isinstance(next(iter(groups.values())), Mapping):
            header = {key.replace("__", ":"): value for key, value in layout.header.items()}
            return {"": write_parts("a.exr", groups, **header)}
        return {"": write_exr("a.exr", groups, **layout.header)}

    def open_files(layout: Layout, profile: str | None = None) -> FrameFiles:
        return FrameFiles(write(layout), ReadOptions(profile=profile, depth=layout.depth))

    return open_files


@pytest.mark.parametrize("name", LAYOUTS)
def test_planes_of_each_renderers_layout_are_right(open_layout, tmp_path, name):
    layout = LAYOUTS[name]
    with open_layout(layout) as files:
        assert files.layout.profile.name == layout.profile
        frame = files.read(1)
    if layout.camera:
        own = tmp_path / "own.toml"
        own.write_text(f'extends = "{layout.profile}"\n[camera]\n{layout.camera}\n')
        with open_layout(layout, str(own)) as files:
            frame = files.read(1)
    assert set(frame.planes) - {Role.ALPHA} == layout.roles | {Role.COLOUR}
    for role in frame.planes:
        np.testing.assert_allclose(frame[role], TRUTH[role], rtol=2e-5, atol=2e-5, err_msg=role)
    _, profile, planes, sources, _ = documented_layouts()[name]
    used = {files.layout.planes[role].rule.source or "plain" for role in layout.roles}
    assert (profile == f"`{layout.profile}`"
            and {Role(role) for role in planes.split(", ")} == layout.roles)
    assert set(sources.replace(" and", ",").split(", ")) == used


RIGHT, UP = 3, 2
"""Pixels that a surface moves in a frame, so that it was further left and lower before."""
STORED_MOTION = {
    "Blender 5, one part": ("ViewLayer.Vector", "XY", -RIGHT, -UP),  # previous minus current, y up
    "Cycles in Gaffer, layers": ("motion", "RG", -RIGHT, -UP),
    # -1..1 of the image, to the next frame
    "MoonRay": ("motionvec", "RG", RIGHT / (WIDTH / 2), UP / (HEIGHT / 2)),
    # -2..2 of half of it
    "Unreal": (UNREAL + "MotionVectors", "RG", 0.5 + RIGHT / WIDTH / 2, 0.5 + UP / HEIGHT / 2),
    # 0..1 for -20..20 pixels
    "V-Ray, Max Velocity known": ("VRayVelocity", "RG", 0.5 + RIGHT / 40, 0.5 + UP / 40),
    # parts of the width
    "Octane, shutter known": ("Motion Vector", "RG", RIGHT * 0.2 / WIDTH, UP * 0.2 / WIDTH),
    # half a frame's: the frame before is at x - 2 dx, y + 2 dy
    "Arnold": ("motionvector", "RG", RIGHT / 2, UP / 2),
    "RenderMan": ("backward", "xy", -RIGHT, UP),  # raster space counts from the top
    "RenderMan, asrgba": ("motionBack", "xy", -RIGHT, UP),
    "Redshift, raw vectors": ("MotionVectors", "RG", RIGHT, UP),
    "Redshift, remapped vectors, Max Motion "
    "known": ("MotionVectors", "RG", 0.5 + RIGHT / 128, 0.5 + UP / 128),
    "plain names": ("motion", "XY", -RIGHT, UP),
}
"""Layout -> layer, letters and values of motion, written out from docs/reference/renderers.md and
its sources."""


@pytest.mark.parametrize("name", STORED_MOTION)
def test_a_surface_that_moves_right_and_up(open_layout, tmp_path, name):
    layout, (layer, letters, x, y) = LAYOUTS[name], STORED_MOTION[name]
    stored = {key: plane for key, plane in layout.stored.items() if not key.startswith("backward")}
    stored |= store(layer, letters, np.full((HEIGHT, WIDTH, 2), (x, y), np.float64))
    own = tmp_path / "own.toml"
    own.write_text(f'extends = "{layout.profile}"\n[camera]\n{layout.camera}\n')
    with open_layout(replace(layout, stored=stored), str(own) if layout.camera else None) as files:
        motion = files.read(1, [Role.MOTION])[Role.MOTION]
    np.testing.assert_allclose(motion, np.broadcast_to((-RIGHT, UP), motion.shape), rtol=1e-4)


def test_every_renderer_whose_motion_is_read_is_among_them():
    read = {layout.profile for layout in LAYOUTS.values() if Role.MOTION in layout.roles}
    # which is a kind of cycles-5
    assert {LAYOUTS[name].profile for name in STORED_MOTION} == read - {"cycles-4"}


def in_words(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Channels as Nuke writes them again: red, green, blue and alpha instead of letters."""
    words = dict(zip("rgba", ("red", "green", "blue", "alpha"), strict=True))
    parted = {name: name.rpartition(".") for name in stored}
    return {f"{layer}.{words.get(letter.lower(), letter)}" if layer else name: stored[name]
            for name, (layer, _, letter) in parted.items()}


def test_no_two_profiles_fit_and_nuke_may_rewrite_the_files(open_layout, monkeypatch):
    """What is found does not depend on which profile is tried first; Blender 4's are a kind of
    Blender 5's."""
    order = sorted(profile_names(), reverse=True)
    order = ["cycles-4", *(name for name in order if name not in ("cycles-4", "generic")),
             "generic"]
    monkeypatch.setattr(layout_module, "profile_names", lambda: order)
    for name, layout in LAYOUTS.items():
        is_flat = not isinstance(next(iter(layout.stored.values())), Mapping)
        with open_layout(replace(layout, stored=in_words(layout.stored) if is_flat
                                                else layout.stored)) as files:
            assert files.layout.profile.name == layout.profile, name
            assert layout.camera or set(files.layout.planes) - PICTURE == layout.roles, name


@pytest.mark.parametrize("name",
                         ["Arnold without its header", "Redshift, raw vectors", "Karma", "MoonRay"])
def test_a_part_for_each_layer(open_layout, name):
    layout, parts = LAYOUTS[name], {}
    for channel, plane in layout.stored.items():
        layer, _, letter = channel.rpartition(".")
        part = layer or ("rgba" if channel in "RGBA" else channel)
        parts.setdefault(part, {})[letter] = plane
    header = {key: np.float32(value).reshape(4, 4) if key == "worldToCamera" else value
              for key, value in layout.header.items()}
    with open_layout(replace(layout, stored=parts, header=header)) as files:
        frame = files.read(1)
    assert (files.layout.profile.name == layout.profile
            and set(frame.planes) == layout.roles | PICTURE)
    for role in frame.planes:
        np.testing.assert_allclose(frame[role], TRUTH[role], rtol=2e-5, atol=2e-5, err_msg=role)


def test_a_folder_with_a_file_for_each_plane(write_exr, tmp_path):
    layout = LAYOUTS["Cycles in Gaffer, a file an AOV"]
    for name in ("beauty", "diffuse_color", "glossy_color", "motion"):
        write_exr(f"shot/{name}.0001.exr", layout.stored[name])
    (frame,) = read_sequence(tmp_path / "shot")
    assert set(frame.planes) == PICTURE | ALBEDOS | {Role.MOTION}


def test_the_colour_is_no_part_that_a_renderer_names_otherwise(write_parts):
    parts = {"VRayDiffuseFilter": store("", "RGB", DIFFUSE), "RGB_color": picture("", "RGB")}
    with FrameFiles({"": write_parts("a.exr", parts)}) as files:
        frame = files.read(1)
    np.testing.assert_allclose(frame[Role.COLOUR], COLOUR, rtol=1e-6)
    np.testing.assert_allclose(frame[Role.DIFFUSE_ALBEDO], DIFFUSE, rtol=1e-6)


def test_no_profile_takes_a_picture_for_something_else(write_exr):
    path = write_exr("a.exr", picture())
    for name in profile_names():
        with FrameFiles({"": path}, ReadOptions(profile=name)) as files:
            assert set(files.layout.planes) - PICTURE == set(), name


def test_every_renderer_says_where_its_names_are_from():
    for name in profile_names():
        text = (Path(layout_module.__file__)
                .parent / "profiles" / f"{name}.toml").read_text("utf-8")
        profile = load_profile(name)
        assert (profile.source in NAME_SOURCES) == (name != "generic"), name
        assert (profile.source == "file" or name == "generic" or "# http" in text
                or ", http" in text), name
        assert {rule.source for rule in profile.planes} <= {"", *NAME_SOURCES}


def test_the_skys_light_in_the_albedo_is_cut_off(write_exr):
    """Cycles writes it there; depth says that nothing was hit."""
    stored = {name: plane.copy() for name, plane in BLENDER_52.items()}
    stored["ViewLayer.Denoising Albedo.R"][0, 0] = 25
    path = write_exr("a.exr", {name: plane.astype(np.float32) for name, plane in stored.items()})
    with FrameFiles({"": path}, ReadOptions(depth=f"ray,fov={FOV}")) as files:
        frame = files.read(1)
    assert frame[Role.DIFFUSE_ALBEDO][0, 0, 0] == 1 and frame[Role.DEPTH][0, 0, 0] == DEPTH_MISS


@pytest.mark.parametrize(("name", "role", "message"), [
    ("V-Ray, Maya", Role.MOTION,
                                 "motion velocity.X,Y is scaled by a largest velocity that the "
                                 "file does not hold: not used; give max_velocity, in pixels, "
                                 "under [camera] in a profile"),
    ("Iray for Maya", Role.NORMAL,
     "normals normal.X,Y,Z are in camera space and no worldToCamera header: not used"),
    ("pbrt-v4", Role.NORMAL,
     "normals Ns.X,Y,Z are in camera space and no worldToCamera header: not used"),
])
def test_planes_that_cannot_be_used_are_named(write_exr, name, role, message):
    layout = LAYOUTS[name]
    header = {key: value for key, value in layout.header.items() if key != "worldToCamera"}
    with FrameFiles({"": write_exr("a.exr", layout.stored, **header)}) as files:
        assert message in files.layout.warnings
        assert role not in files.layout.planes


def test_raw_vectors_are_taken_without_a_warning(open_layout):
    with open_layout(LAYOUTS["Redshift, raw vectors"]) as files:
        assert files.layout.warnings == []
