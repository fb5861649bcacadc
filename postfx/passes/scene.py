"""Passes by networks that know the light of scenes: ambient occlusion of any scene, irradiance and
shading of one scene.

Networks of points in `scene_shading` have kernels around them. All other work around the networks
is done by the host (`Device.host_state`), so that the passes run on every device; on a GPU planes
are copied to the host and back for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, NamedTuple, Never

import numpy as np

from postfx.errors import FrameError, ModelError, PassOptionError
from postfx.frame import DEPTH_MISS, TOLD, Frame, FrameSpec, Role
from postfx.kernels.occlusion import (
    CAMERA,
    FIND_SURFACE,
    HORIZONS,
    RADIUS,
    SMOOTH_OCCLUSION,
    TANGENTS,
)
from postfx.kernels.scene import (
    BOX_NUMBERS,
    CAMERA_NUMBERS,
    FIND_POINTS,
    LIGHT_OF_POINTS,
    POINT,
)
from postfx.passes import Pass, Reflection, ResidentFrame
from postfx.passes.scene_points import SceneBox
from postfx.runtime import (
    ArgumentTable,
    CommandBuffer,
    Device,
    Library,
    PipelineState,
    Tensor,
    has_networks,
)
from postfx.runtime.model_file import parse_model
from postfx.system import in_bands

# Shared by all ------------------------------------------------------------------------------------

class _ScenePass(Pass):
    """A pass on scene-linear light and planes of the render."""

    reads_render: ClassVar[bool] = True

    def skip(self, spec: FrameSpec) -> str | None:
        if spec.encoding != "scene-linear":
            return f"colour is {spec.encoding}, and '{self.name}' works on light of the scene"
        return self._missing(spec)

    def _missing(self, spec: FrameSpec) -> str | None:
        """Why it would change nothing for frames with these planes."""
        raise NotImplementedError

    def _dispatch(self, commands: CommandBuffer, label: str, table: ArgumentTable) -> None:
        if isinstance(table.state, PipelineState):
            with commands.machine_learning_encoder(label) as encoder:
                encoder.dispatch_network(table.state, table)
            return
        with commands.compute_encoder(label) as kernels:
            kernels.dispatch(table.state, table)


def _missing_planes(spec: FrameSpec, roles: tuple[Role, ...]) -> str | None:
    lacking = [str(role) for role in roles if not spec.has(role)]
    if not lacking:
        return None
    return (f"no plane {', '.join(lacking)} here: render it, and let the pass run "
            "before=denoise_upscale")


POINTS_INPUT = "points"
"""The input of networks that see each pixel alone."""


class _Model(NamedTuple):
    """A model file by its library and name; `inputs` are the names of what it reads, `point` the
    numbers of a point if it sees each pixel alone, else 0."""

    library: Library
    name: str
    inputs: tuple[str, ...]
    point: int


def _find_model(pass_name: str, model: str) -> _Model:
    """The model of a file.

    Raises PassOptionError when there is no such file, ModelError when it is damaged.
    """
    path = Path(model).expanduser()
    if path.suffix != ".onnx" or not path.is_file():
        raise PassOptionError(f"pass '{pass_name}' finds no model '{model}': give an ONNX file")
    library = Library(path.parent)
    shapes = {value.name: value.shape for value in parse_model(library.load(path.stem)).inputs}
    width = (shapes.get(POINTS_INPUT) or (0,))[-1] if len(shapes) == 1 else 0
    return _Model(library, path.stem, tuple(shapes), width if isinstance(width, int) else 0)


def _described(found: _Model) -> str:
    """A model's inputs in words."""
    return f"points of {found.point} numbers" if found.point else ", ".join(found.inputs)


# Ambient occlusion --------------------------------------------------------------------------------

SIDE_MULTIPLE_PX = 16
"""Sides of what the network sees are multiples of this."""
SETTINGS = np.array([0.9, 0.0], np.float32)
"""Settings of GTAO: share of the radius from which on surfaces count less, and how thin they
are."""
USUAL_RADIUS = 0.125
"""Radius as a share of the median depth, unless the option gives one."""
USUAL_FOV = 45.0
"""Horizontal field of view in degrees, if the file tells none."""
TO_KERNEL_AXES = np.array([-1.0, 1.0, -1.0])
"""Signs that turn the axes of frames' cameras (left, up, forward) into the kernels' (right, up,
back)."""
MODEL = "occlusion"


class Occlusion(_ScenePass):
    """Darkens what little light of the surroundings can reach: ambient occlusion, for renders
    without indirect light.

    GTAO (Jimenez 2016) looks at depth and normals; a network (1.09 million parameters) corrects it.
    Where no network can run, GTAO alone is used. Without normals, or a camera in the file that
    turns them, they come from depth.

    Options:
        radius: how far surfaces occlude, in scene units; None: an eighth of the median depth.
        strength: from 0, nothing, to 1, colour times visibility.
        network: False for GTAO alone.

    Raises PassOptionError for a radius or strength out of range.
    """

    name: ClassVar[str] = "occlusion"

    def __init__(self, *, radius: float | None = None, strength: float = 1.0, network: bool = True,
                 **unknown: Never) -> None:
        super().__init__(radius=radius, strength=strength, network=network, **unknown)
        if radius is not None and not 0 < radius < np.inf:
            raise PassOptionError(f"pass 'occlusion' has the radius {radius:g}: give one above 0")
        if not 0 <= strength <= 1:
            raise PassOptionError(f"pass 'occlusion' has the strength {strength:g}: give 0 to 1")
        self._told = False

    def reflect(self, spec: FrameSpec) -> Reflection:
        return Reflection(reads=(Role.COLOUR, Role.DEPTH), may_read=(Role.NORMAL,),
                          writes=(Role.COLOUR,), output=spec)

    def _missing(self, spec: FrameSpec) -> str | None:
        if self.options["strength"] == 0:
            return "its strength is 0"
        return _missing_planes(spec, (Role.COLOUR, Role.DEPTH))

    def compile(self, device: Device, spec: FrameSpec) -> None:
        rows, columns = (-(-side // SIDE_MULTIPLE_PX) * SIDE_MULTIPLE_PX
                         for side in (spec.height, spec.width))
        state = self._find_network(device, rows, columns) if self.options["network"] else None
        self.choice = "gtao" if state is None else "network"
        self._reads = ("depth", "normal") if spec.has(Role.NORMAL) else ("depth",)
        shapes = {"normal": (rows, columns, 3), "depth": (rows, columns, 1), "camera": (CAMERA,),
                  "raw": (rows, columns), "smooth": (rows, columns)}
        made = {name: device.heap.transient(f"occlusion {name}", shape)
                for name, shape in shapes.items()}
        self._turn = device.heap.tensor("camera", (CAMERA,))
        given = ("turn", *(f"seen {name}" for name in self._reads))
        looks = device.host_state("occlusion", given, tuple(shapes), self._look)
        self._looks = ArgumentTable(looks, made | {"turn": self._turn})
        visible = made["smooth"]
        self._network: ArgumentTable | None = None
        if state is not None:
            visible = device.heap.transient("visible", (rows, columns))
            self._network = ArgumentTable(state, made | {"visible": visible})
        darkens = device.host_state("occlusion of colour", ("colour", "visible"), ("output",),
                                    self._darken)
        output = device.heap.transient("occluded", (spec.height, spec.width, 3))
        self._darkens = ArgumentTable(darkens, {"visible": visible, "output": output})
        super().compile(device, spec)

    def _find_network(self, device: Device, rows: int, columns: int) -> PipelineState | None:
        if not has_networks():
            return None
        try:
            return device.pipeline_state(Library(), MODEL, {"height": rows, "width": columns})
        except ModelError as error:
            TOLD.warning("pass 'occlusion' takes GTAO alone: %s", error)
            return None

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        if frame.world_to_camera is None and not self._told:
            TOLD.warning("frame %s has no camera in its file: occlusion takes normals from depth",
                         frame.number)
            self._told = True
        self._turn.put(_turn_of(frame))
        for name in self._reads:
            self._looks[f"seen {name}"] = frame[Role(name)]
        self._dispatch(commands, "surroundings", self._looks)
        if self._network:
            self._dispatch(commands, "visibility", self._network)
        self._darkens["colour"] = frame[Role.COLOUR]
        self._dispatch(commands, "darkening", self._darkens)
        frame.set(Role.COLOUR, self._darkens["output"])

    def _look(self, turn: np.ndarray, depth: np.ndarray, *others: np.ndarray) -> None:
        """The network's inputs: planes with sides that it takes, the camera, and GTAO's visibility,
        raw and smooth."""
        *normals, normal, far, camera, raw, smooth = others
        middle = _middle(depth.shape, raw.shape)
        normal[...], far[...] = 0, DEPTH_MISS
        far[middle] = depth
        camera[:] = turn
        # the network has learnt from normals that are turned
        camera[:RADIUS] = np.eye(3, dtype=np.float32).ravel()
        axes = turn[:RADIUS].reshape(3, 3)
        normal[middle] = (normals[0] @ axes if normals and axes.any()
                          else _normals_of(depth[..., 0], turn[TANGENTS:]))
        camera[RADIUS] = self.options["radius"] or _usual_radius(depth)
        larger = np.divide(raw.shape[1::-1], depth.shape[1::-1])
        camera[TANGENTS:] *= larger.astype(np.float32)  # a larger picture shows more
        surface = np.empty((*raw.shape, 4), np.float32)
        height = len(raw)
        in_bands(height, FIND_SURFACE.rows, normal, far, camera, surface)
        in_bands(height, HORIZONS.rows, surface, camera, SETTINGS, raw)
        in_bands(height, SMOOTH_OCCLUSION.rows, surface, raw, smooth)

    def _darken(self, colour: np.ndarray, visible: np.ndarray, output: np.ndarray) -> None:
        seen = np.clip(visible[_middle(colour.shape, visible.shape)][..., None], 0, 1)
        np.multiply(colour, 1 - np.float32(self.options["strength"]) * (1 - seen), out=output)


def _middle(inner: tuple[int, ...], outer: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns in the middle of a larger picture, so that both have one view axis."""
    firsts = [(large - small) // 2 for small, large in zip(inner[:2], outer, strict=True)]
    rows, columns = (slice(first, first + side) for first, side in zip(firsts, inner, strict=False))
    return rows, columns


def _turn_of(frame: ResidentFrame) -> np.ndarray:
    """Numbers of a frame's camera as kernels want them, without a radius; a turn of zeros where it
    is not known."""
    height, width = frame.spec.height, frame.spec.width
    tangent = np.tan(np.radians(frame.fov_x or USUAL_FOV) / 2)
    turn = np.zeros(9)
    if frame.world_to_camera is not None:
        turn = (np.asarray(frame.world_to_camera)[:3, :3] * TO_KERNEL_AXES).ravel()
    return np.array([*turn, 0, tangent, tangent * height / width], np.float32)


def _usual_radius(depth: np.ndarray) -> np.float32:
    hit = depth[(depth > 0) & (depth < DEPTH_MISS)]
    return np.float32(USUAL_RADIUS * np.median(hit) if hit.size else 1)


def _normals_of(depth: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Normals (h, w, 3) in camera space of the surface that depth draws. To each side the nearer
    neighbour counts, so that edges stay sharp."""
    height, width = depth.shape
    across = ((np.arange(width) + 0.5) / width * 2 - 1) * tangents[0]
    down = (1 - (np.arange(height) + 0.5) / height * 2) * tangents[1]
    known = np.where((depth > 0) & (depth < DEPTH_MISS), depth, 0).astype(np.float64)
    place = np.stack([across * known, down[:, None] * known, -known], -1)
    slopes = [_slope(place, axis) for axis in (1, 0)]
    normal = np.cross(slopes[1], slopes[0])  # rows go down
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    there = (length > 0) & (known > 0)[..., None]
    found: np.ndarray = np.divide(normal, length, out=np.zeros_like(normal), where=there)
    return found.astype(np.float32, copy=False)


def _slope(place: np.ndarray, axis: int) -> np.ndarray:
    """From pixel to pixel along an axis, to the neighbour whose depth is nearer."""
    if place.shape[axis] == 1:
        return np.zeros_like(place)
    steps = np.diff(place, axis=axis)
    first, last = steps.take([0], axis), steps.take([-1], axis)
    before, after = np.concatenate([first, steps], axis), np.concatenate([steps, last], axis)
    nearer: np.ndarray = np.where(np.abs(before[..., 2:]) < np.abs(after[..., 2:]), before, after)
    return nearer


# Networks of one scene ----------------------------------------------------------------------------

NORMAL = 3
"""Numbers of a point that is a normal."""
MOST_IRRADIANCE = 1e6
"""Irradiance that a network may give at most."""


class Irradiance(_ScenePass):
    """Lights surfaces by a network of one scene: colour becomes diffuse albedo times the irradiance
    of the normal / pi.

    `python -m training.train_scene irradiance` trains it. Misses, and what reflects nothing
    diffusely, keep their colour.

    Options:
        model: ONNX file; without one the pass does nothing.

    Raises PassOptionError when there is no such file, ModelError when it is none of such a network.
    """

    name: ClassVar[str] = "irradiance"

    def __init__(self, *, model: str | None = None, **unknown: Never) -> None:
        super().__init__(model=model, **unknown)
        self._found = None if model is None else _find_model(self.name, model)
        if self._found and self._found.point != NORMAL:
            raise ModelError(f"model '{model}' reads {_described(self._found)}, where pass "
                             f"'irradiance' has points of {NORMAL}: train one by python -m "
                             "training.train_scene irradiance")

    def reflect(self, spec: FrameSpec) -> Reflection:
        reads = (Role.COLOUR, Role.NORMAL, Role.DIFFUSE_ALBEDO)
        return Reflection(reads=reads, writes=(Role.COLOUR,), output=spec)

    def _missing(self, spec: FrameSpec) -> str | None:
        if self._found is None:
            return "no model is given"
        return _missing_planes(spec, (Role.COLOUR, Role.NORMAL, Role.DIFFUSE_ALBEDO))

    def compile(self, device: Device, spec: FrameSpec) -> None:
        assert self._found is not None  # or it is skipped
        library, name = self._found.library, self._found.name
        count, new = spec.height * spec.width, device.heap.transient
        points, values = new("points", (count, 3)), new("irradiance", (count, 3))
        directions = device.host_state("directions", ("normal",), ("points",), _directions)
        self._directions = ArgumentTable(directions, {"points": points})
        network = device.pipeline_state(library, name, {"points": count})
        self._network = ArgumentTable(network, {"points": points, "values": values})
        lights = device.host_state("light of surfaces", ("colour", "normal", "albedo", "values"),
                                   ("output",), _lit)
        output = new("lit", (spec.height, spec.width, 3))
        self._lights = ArgumentTable(lights, {"values": values, "output": output})
        super().compile(device, spec)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._directions["normal"] = self._lights["normal"] = frame[Role.NORMAL]
        self._lights["colour"] = frame[Role.COLOUR]
        self._lights["albedo"] = frame[Role.DIFFUSE_ALBEDO]
        for table in (self._directions, self._network, self._lights):
            self._dispatch(commands, "irradiance", table)
        frame.set(Role.COLOUR, self._lights["output"])


def _directions(normal: np.ndarray, points: np.ndarray) -> None:
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    np.divide(normal, np.maximum(length, 1e-6), out=points.reshape(normal.shape))


def _lit(colour: np.ndarray, normal: np.ndarray, albedo: np.ndarray, values: np.ndarray,
         output: np.ndarray) -> None:
    shines = ((normal ** 2).sum(-1) > 0.01) & (albedo.max(-1) > 0)
    light = np.exp(np.minimum(values.reshape(colour.shape), np.float32(np.log(MOST_IRRADIANCE))))
    output[...] = np.where(shines[..., None], albedo * light / np.float32(np.pi), colour)


SCENE_PLANES = {"diffuse_albedo": 3, "specular_albedo": 3, "normal": 3, "roughness": 1, "depth": 1,
                "motion": 2, "colour": 3}
"""Planes that a network of a scene may read, with their channels."""
POINT_PLANES = ("depth", "normal", "diffuse_albedo", "specular_albedo", "colour")
"""Planes that are read around a network of points."""


class SceneShading(_ScenePass):
    """Shades frames by a network that knows one scene, from their planes.

    A network of points sees each pixel alone; a U-Net sees its neighbours, and some kinds also read
    what they made of the frame before, or a noisy colour. `python -m training.train_scene` trains
    all of them. Frames need the camera and its field of view.

    Options:
        model: ONNX file; without one the pass does nothing.

    Raises PassOptionError when there is no such file, ModelError when it is none of such a network.
    """

    name: ClassVar[str] = "scene_shading"

    def __init__(self, *, model: str | None = None, **unknown: Never) -> None:
        super().__init__(model=model, **unknown)
        self._found = None if model is None else _find_model(self.name, model)
        self._inputs = self._found.inputs if self._found else ()
        self._box: SceneBox | None = None
        if self._found and self._found.point == POINT:
            self._box = SceneBox.of_card(self._found.library.card(self._found.name), str(model))
            self._inputs = (*POINT_PLANES, "camera")
        strange = [name for name in self._inputs if name not in (*SCENE_PLANES, "camera", "before")]
        if self._found and (strange or "camera" not in self._inputs):
            raise ModelError(f"model '{model}' reads {_described(self._found)}, which is no "
                             "network for pass 'scene_shading': train one by python -m "
                             "training.train_scene points, or unet")
        self._states: list[Tensor] = []
        self._fresh = True

    def reflect(self, spec: FrameSpec) -> Reflection:
        reads = tuple(dict.fromkeys((Role.COLOUR, *map(Role, self._planes()))))
        return Reflection(reads=reads, writes=(Role.COLOUR,), output=spec)

    def _planes(self) -> list[str]:
        return [name for name in self._inputs if name in SCENE_PLANES]

    def _missing(self, spec: FrameSpec) -> str | None:
        if self._found is None:
            return "no model is given"
        return _missing_planes(spec, (Role.COLOUR, *map(Role, self._planes())))

    def accumulates(self, spec: FrameSpec) -> bool:
        return "before" in self._inputs

    def compile(self, device: Device, spec: FrameSpec) -> None:
        assert self._found is not None  # or it is skipped
        library, name = self._found.library, self._found.name
        size = spec.height, spec.width
        self._camera = device.heap.tensor("camera", (CAMERA_NUMBERS,))
        self._shaded = device.heap.transient("shaded", (*size, 3))
        if self._box is not None:
            self._compile_points(device, spec, self._box)
            super().compile(device, spec)
            return
        network = device.pipeline_state(library, name, {"height": spec.height, "width": spec.width})
        self._network = ArgumentTable(network, {"camera": self._camera, "shaded": self._shaded})
        self._states = []
        if "before" in self._inputs:
            state = network.shapes["before"]
            self._states = [device.heap.tensor(word, state) for word in ("before", "after")]
            self._nothing = device.heap.tensor("no history", state)
            self._nothing.fill(0)
        super().compile(device, spec)

    def _compile_points(self, device: Device, spec: FrameSpec, box: SceneBox) -> None:
        """Tables of the commands around a network that sees each pixel alone."""
        assert self._found is not None
        library, name = self._found.library, self._found.name
        count, new = spec.height * spec.width, device.heap.transient
        points, values = new("points", (count, POINT)), new("light", (count, 3))
        scene = device.heap.tensor("box", (BOX_NUMBERS,))
        scene.put(box.numbers())
        self._looks = ArgumentTable(device.compute_state(FIND_POINTS),
                                    {"camera": self._camera, "box": scene, "points": points})
        network = device.pipeline_state(library, name, {"points": count})
        self._network = ArgumentTable(network, {"points": points, "values": values})
        self._lights = ArgumentTable(device.compute_state(LIGHT_OF_POINTS),
                                     {"values": values, "output": self._shaded})

    def _encode_points(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        self._looks["depth"] = frame[Role.DEPTH]
        self._looks["normal"] = frame[Role.NORMAL]
        self._lights["diffuse"] = frame[Role.DIFFUSE_ALBEDO]
        self._lights["specular"] = frame[Role.SPECULAR_ALBEDO]
        self._lights["colour"] = frame[Role.COLOUR]
        for table in (self._looks, self._network, self._lights):
            self._dispatch(commands, "scene", table)
        frame.set(Role.COLOUR, self._shaded)

    def encode(self, commands: CommandBuffer, frame: ResidentFrame) -> None:
        super().encode(commands, frame)
        self._camera.put(camera_of(frame))
        if self._box is not None:
            self._encode_points(commands, frame)
            return
        for name in self._planes():
            self._network[name] = frame[Role(name)]
        if self._states:
            fresh = self._fresh or frame.reset
            self._network["before"] = self._nothing if fresh else self._states[1]
            self._states.reverse()
            self._network["after"] = self._states[1]
            self._fresh = False
        self._dispatch(commands, "scene", self._network)
        frame.set(Role.COLOUR, self._shaded)

    def reset(self) -> None:
        self._fresh = True

    def history(self) -> dict[str, np.ndarray]:
        return {} if self._fresh or not self._states else {"state": self._states[1].content()}

    def recall(self, history: Mapping[str, np.ndarray]) -> None:
        self._fresh = not history
        if history:
            self._states[1].upload(history["state"])


def camera_of(frame: Frame | ResidentFrame) -> np.ndarray:
    """A frame's camera for networks of a scene, (16,): axes and place, tangents and jitter.

    Raises FrameError where the file does not tell them.
    """
    if frame.world_to_camera is None or not frame.fov_x:
        lacking = "field of view" if frame.world_to_camera is not None else "camera"
        raise FrameError(f"frame {frame.number} has no {lacking} in its file, which pass "
                         "'scene_shading' needs: render with the camera's matrix and field of "
                         "view in the header")
    to_world = np.linalg.inv(np.asarray(frame.world_to_camera).T)
    tangent = np.tan(np.radians(frame.fov_x) / 2)
    height, width = (frame[Role.DEPTH].shape[:2] if isinstance(frame, Frame)
                     else (frame.spec.height, frame.spec.width))
    ratio = height / width
    return np.array([*to_world[:3, :4].T.ravel(), tangent, tangent * ratio, *frame.jitter],
                    np.float32)
