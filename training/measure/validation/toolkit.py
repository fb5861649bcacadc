"""Shapes, materials and motion for scenes that are built inside Blender; needs `bpy` and NumPy.

A shape is a pair of arrays: vertices (N, 3) and faces of four corners (F, 4).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import bpy
import numpy as np

Shape = tuple[np.ndarray, np.ndarray]
Point = Sequence[float] | np.ndarray
"""Three numbers: a place, a way or angles."""
Colour = tuple[float, ...]
Tree: TypeAlias = bpy.types.NodeTree
Value: TypeAlias = Any
"""What an input takes: a number, a colour, or another node's socket."""
Shade = Callable[[Tree], Value]
"""Gives a socket of a tree."""
FIRST, LAST = 0, 4  # frames 1 to 3 are shown: each has a neighbour on both sides
AXIS = 1e-3  # least radius of a turned shape, so that all its faces have four corners


# Shapes -------------------------------------------------------------------------------------------


def grid(columns: int, rows: int, width: float, depth: float) -> Shape:
    """A flat net around the origin, in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, columns), np.linspace(-0.5, 0.5, rows))
    vertices = np.stack([x.ravel() * width, y.ravel() * depth, np.zeros(x.size)], -1)
    return vertices, net_faces(columns, rows)


def net_faces(columns: int, rows: int) -> np.ndarray:
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    return np.stack([first, first + 1, first + columns + 1, first + columns], -1)


def lathe(profile: list[tuple[float, float]], segments: int = 32) -> Shape:
    """A profile of (radius, height) turned about the z axis."""
    radius, height = np.array(profile, float).T
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    radius = np.maximum(radius, AXIS)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    x, y = (radius[:, None, None] * ring).reshape(-1, 2).T
    vertices = np.stack([x, y, np.repeat(height, segments)], -1)
    row = np.arange(len(radius) - 1)[:, None] * segments
    here = np.arange(segments)
    following = (here + 1) % segments
    faces = np.stack([row + here, row + following, row + segments + following,
                      row + segments + here], -1)
    return vertices, faces.reshape(-1, 4)


def sphere(radius: float = 1.0, rings: int = 12, segments: int = 20) -> Shape:
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings)
    profile = list(zip(radius * np.cos(angle), radius * np.sin(angle), strict=True))
    return lathe(profile, segments)


def rod(radius: float, height: float, segments: int = 12) -> Shape:
    """A closed cylinder that stands on the origin."""
    return lathe([(0, 0), (radius, 0), (radius, height), (0, height)], segments)


def torus(large: float, small: float, segments: int = 48, sides: int = 16) -> Shape:
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = zip(large + small * np.cos(angle), small * np.sin(angle), strict=True)
    return lathe(list(ring), segments)


def box(x: float, y: float, z: float) -> Shape:
    """A block around the origin."""
    corners = np.array([[i, j, k] for k in (-1, 1) for j in (-1, 1) for i in (-1, 1)], float) / 2
    faces = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2],
                      [1, 3, 7, 5]])
    return corners * (x, y, z), faces


def turn(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """A rotation matrix: about x first, then y, then z; radians."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([x, y, z]), np.sin([x, y, z])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def place(shape: Shape, at: Point = (0.0, 0.0, 0.0),
          matrix: np.ndarray | None = None) -> Shape:
    vertices = shape[0] if matrix is None else shape[0] @ matrix.T
    return vertices + np.asarray(at, float), shape[1]


def join(shapes: list[Shape]) -> Shape:
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in shapes[:-1]])
    faces = [each + offset for (_, each), offset in zip(shapes, offsets, strict=True)]
    return np.concatenate([vertices for vertices, _ in shapes]), np.concatenate(faces)


def copies(shape: Shape, places: np.ndarray, matrices: np.ndarray) -> Shape:
    """A copy at each of `places` (N, 3), turned and scaled by `matrices` (N, 3, 3)."""
    vertices, faces = shape
    moved = np.einsum("nij,vj->nvi", matrices, vertices) + places[:, None]
    shifted = faces[None] + np.arange(len(places))[:, None, None] * len(vertices)
    return moved.reshape(-1, 3), shifted.reshape(-1, 4)


def random_turns(rng: np.random.Generator, count: int, sizes: np.ndarray) -> np.ndarray:
    """Uniform rotations times sizes (N,)."""
    q = rng.normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    return np.moveaxis(np.array(rows), -1, 0) * sizes[:, None, None]


def about_z(angles: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Rotations about the vertical times sizes (N,) or (N, 3)."""
    c, s, o = np.cos(angles), np.sin(angles), np.zeros(len(angles))
    matrices = np.moveaxis(np.array([[c, -s, o], [s, c, o], [o, o, o + 1]]), -1, 0)
    return matrices * np.broadcast_to(np.reshape(sizes, (len(angles), 1, -1)), (len(angles), 1, 3))


def tube(points: np.ndarray, radii: np.ndarray, sides: int = 8) -> Shape:
    """A bent rod through points (N, 3)."""
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    helper = np.where(np.abs(along[:, 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    first = np.cross(along, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = first[:, None] * np.cos(angle)[:, None] + second[:, None] * np.sin(angle)[:, None]
    vertices = points[:, None] + ring * np.reshape(radii, (-1, 1, 1))
    return vertices.reshape(-1, 3), net_faces(sides + 1, len(points))


def tints(rng: np.random.Generator, count: int, faces: int, low: float = 0.4,
          high: float = 1.0, hue: float = 0.15) -> np.ndarray:
    """A colour for each of `count` copies, repeated for its faces."""
    colours = rng.uniform(low, high, (count, 1)) * (1 + rng.uniform(-hue, hue, (count, 3)))
    return np.repeat(colours.clip(0, 1), faces, 0)


# Scene --------------------------------------------------------------------------------------------


def empty_scene() -> bpy.types.Scene:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.frame_start, scene.frame_end = FIRST, LAST
    scene.world = bpy.data.worlds.new("World")
    return scene


def add(shape: Shape, material: bpy.types.Material, smooth: bool = False,
        tint: np.ndarray | None = None) -> bpy.types.Object:
    """An object; `tint` (F, 3): a colour a face, which `material(..., tinted=True)` shows."""
    mesh = bpy.data.meshes.new("mesh")
    vertices, faces = shape
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    if smooth:
        mesh.shade_smooth()
    if tint is not None:
        attribute = mesh.attributes.new("tint", "FLOAT_COLOR", "FACE")
        colours = np.concatenate([tint, np.ones((len(tint), 1))], 1).astype(np.float32)
        attribute.data.foreach_set("color", colours.ravel())
    mesh.materials.append(material)
    return link(bpy.data.objects.new("object", mesh))


def link(item: bpy.types.Object) -> bpy.types.Object:
    bpy.context.scene.collection.objects.link(item)
    return item


def deform(item: bpy.types.Object, shapes: list[np.ndarray]) -> None:
    """Vertices (N, 3) of each frame from FIRST on; in between they run straight."""
    item.shape_key_add(name="basis")
    for frame, vertices in enumerate(shapes, FIRST):
        key = item.shape_key_add(name=str(frame))
        key.data.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
        for other in (frame - 1, frame, frame + 1):
            key.value = float(other == frame)
            key.keyframe_insert("value", frame=other)


def deform_straight(item: bpy.types.Object, first: np.ndarray, last: np.ndarray) -> None:
    """Every vertex runs straight from its first to its last place."""
    item.data.vertices.foreach_set("co", np.ascontiguousarray(first, np.float32).ravel())
    item.shape_key_add(name="basis")
    key = item.shape_key_add(name="last")
    key.data.foreach_set("co", np.ascontiguousarray(last, np.float32).ravel())
    for frame, value in ((FIRST, 0.0), (LAST, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)


def move(item: bpy.types.Object, start: Point, step: Point,
         spin: Point = (0.0, 0.0, 0.0)) -> None:
    """At `start` in frame 2, `step` and `spin` (radians) a frame."""
    angles = np.array(item.rotation_euler)
    for frame in (FIRST, LAST):
        item.location = np.add(start, np.multiply(step, frame - 2))
        item.rotation_euler = angles + np.multiply(spin, frame - 2)
        item.keyframe_insert("location", frame=frame)
        item.keyframe_insert("rotation_euler", frame=frame)


def camera(at: Point, target: Point, lens: float, step: Point,
           drift: Point = (0.0, 0.0, 0.0)) -> bpy.types.Object:
    """A camera that travels by `step` a frame, and whose aim travels by `drift`."""
    from mathutils import Vector
    data = bpy.data.cameras.new("camera")
    data.lens = lens
    data.clip_start = 0.01
    item = link(bpy.data.objects.new("camera", data))
    item.rotation_mode = "QUATERNION"
    for frame in (FIRST, LAST):
        item.location = np.add(at, np.multiply(step, frame - 2))
        aim = Vector(np.add(target, np.multiply(drift, frame - 2))) - item.location
        item.rotation_quaternion = aim.to_track_quat("-Z", "Y")
        item.keyframe_insert("location", frame=frame)
        item.keyframe_insert("rotation_quaternion", frame=frame)
    bpy.context.scene.camera = item
    return item


def lamp(kind: str, at: Point, energy: float, colour: Colour = (1.0, 1.0, 1.0),
         size: float = 0.1, target: Point | None = None) -> bpy.types.Object:
    """A lamp of Blender's kind POINT, SUN (size: radians), SPOT or AREA that shines at `target`."""
    from mathutils import Vector
    data = bpy.data.lights.new("lamp", kind)
    data.energy, data.color = energy, colour
    if kind == "SUN":
        data.angle = size
    elif kind == "AREA":
        data.size = size
    else:
        data.shadow_soft_size = size
    item = link(bpy.data.objects.new("lamp", data))
    item.location = at
    if target is not None:
        item.rotation_euler = (Vector(target) - item.location).to_track_quat("-Z", "Y").to_euler()
    return item


# Materials ----------------------------------------------------------------------------------------


def node(tree: Tree, kind: str, inputs: Mapping[Any, Value] | None = None,
         **settings: Any) -> bpy.types.Node:
    """A node; a value of `inputs` is a number, a colour, or another node's socket."""
    item = tree.nodes.new(kind)
    for name, value in settings.items():
        setattr(item, name, value)
    for name, value in (inputs or {}).items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, item.inputs[name])
        elif isinstance(value, tuple) and len(value) == 3 and item.inputs[name].type == "RGBA":
            item.inputs[name].default_value = (*value, 1.0)
        else:
            item.inputs[name].default_value = value
    return item


def new_material(name: str) -> tuple[bpy.types.Material, Tree, bpy.types.Node]:
    """A material, its nodes, and its output node."""
    result = bpy.data.materials.new(name)
    result.use_nodes = True
    result.node_tree.nodes.clear()
    return result, result.node_tree, result.node_tree.nodes.new("ShaderNodeOutputMaterial")


def coordinates(tree: Tree, scale: Point = (1.0, 1.0, 1.0), rotation: Point = (0.0, 0.0, 0.0),
                source: str = "Object") -> Value:
    place_of = node(tree, "ShaderNodeTexCoord").outputs[source]
    return node(tree, "ShaderNodeMapping", {"Vector": place_of, "Scale": scale,
                                            "Rotation": rotation}).outputs["Vector"]


def ramp(tree: Tree, factor: Value, stops: list[tuple[float, Colour]]) -> Value:
    """A socket: colours at places 0 to 1 of `factor`."""
    item = node(tree, "ShaderNodeValToRGB", {0: factor})
    elements = item.color_ramp.elements
    while len(elements) < len(stops):
        elements.new(0.5)
    for element, (position, colour) in zip(elements, stops, strict=True):
        element.position, element.color = position, (*colour, 1.0)
    return item.outputs["Color"]


def mixed(tree: Tree, factor: Value, first: Value, second: Value, how: str = "MIX") -> Value:
    """A socket: two colours, mixed."""
    return node(tree, "ShaderNodeMix", {0: factor, 6: first, 7: second}, data_type="RGBA",
                blend_type=how).outputs[2]


def noise(tree: Tree, scale: float, vector: Value = None, detail: float = 5.0,
          **inputs: Value) -> Value:
    values = {"Scale": scale, "Detail": detail, "Vector": vector or coordinates(tree), **inputs}
    return node(tree, "ShaderNodeTexNoise", values).outputs[0]


def material(name: str, colour: Colour | Shade, roughness: float = 0.5, tinted: bool = False,
             grain: tuple[float, float] = (8.0, 0.3), bump: float = 0.0,
             **inputs: Value) -> bpy.types.Material:
    """A plain surface. `colour`: a colour, or a function of the tree that gives a socket.
    `grain`: scale and strength of its stains; `bump`: depth of its unevenness."""
    result, tree, output = new_material(name)
    base = colour(tree) if callable(colour) else node(
        tree, "ShaderNodeRGB").outputs[0]
    if not callable(colour):
        base.default_value = (*colour, 1.0)
    if tinted:
        tint = node(tree, "ShaderNodeAttribute", attribute_name="tint").outputs["Color"]
        base = mixed(tree, 1.0, base, tint, "MULTIPLY")
    scale, strength = grain
    stains = noise(tree, scale)
    dark = ramp(tree, stains, [(0.3, (1 - strength,) * 3), (0.7, (1.0,) * 3)])
    base = mixed(tree, 1.0, base, dark, "MULTIPLY")
    values = {"Base Color": base, "Roughness": roughness}
    values |= {key.replace("_", " ").title(): value for key, value in inputs.items()}
    if bump:
        fine = noise(tree, scale * 4)
        values["Normal"] = node(tree, "ShaderNodeBump",
                                {"Height": fine, "Strength": bump, "Distance": 0.05}).outputs[0]
    shader = node(tree, "ShaderNodeBsdfPrincipled", {
        ("IOR" if key == "Ior" else key): value for key, value in values.items()})
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return result


def glow(name: str, colour: Value, strength: float, tinted: bool = False) -> bpy.types.Material:
    result, tree, output = new_material(name)
    shade = colour
    if tinted:
        tint = node(tree, "ShaderNodeAttribute", attribute_name="tint").outputs["Color"]
        shade = mixed(tree, 1.0, (*colour, 1.0), tint, "MULTIPLY")
    shader = node(tree, "ShaderNodeEmission", {"Color": shade, "Strength": strength})
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return result


def glass(name: str, colour: Colour = (1.0, 1.0, 1.0), ior: float = 1.5, roughness: float = 0.0,
          open_to_light: bool = False) -> bpy.types.Material:
    """Clear glass or water; `open_to_light`: shadow rays pass it, as artists set it up for
    water."""
    result, tree, output = new_material(name)
    shader = node(tree, "ShaderNodeBsdfPrincipled", {
        "Base Color": colour, "Roughness": roughness, "IOR": ior, "Transmission Weight": 1.0})
    surface = shader.outputs[0]
    if open_to_light:
        shadow = node(tree, "ShaderNodeLightPath").outputs["Is Shadow Ray"]
        clear = node(tree, "ShaderNodeBsdfTransparent", {"Color": colour}).outputs[0]
        surface = node(tree, "ShaderNodeMixShader", {0: shadow, 1: surface, 2: clear}).outputs[0]
    tree.links.new(surface, output.inputs["Surface"])
    return result


def thin(name: str, colour: Colour | Shade, through: Colour, share: float = 0.5,
         alpha: Shade | None = None, tinted: bool = False) -> bpy.types.Material:
    """Leaf or cloth: diffuse light on both sides. `colour` and `alpha` may be functions of the
    tree; `through`: the colour of what shines through."""
    result, tree, output = new_material(name)
    base = colour(tree) if callable(colour) else (*colour, 1.0)
    beyond = (*through, 1.0)
    if tinted:
        tint = node(tree, "ShaderNodeAttribute", attribute_name="tint").outputs["Color"]
        base = mixed(tree, 1.0, base, tint, "MULTIPLY")
        beyond = mixed(tree, 1.0, beyond, tint, "MULTIPLY")
    if callable(colour):
        beyond = mixed(tree, 1.0, beyond, base, "MULTIPLY")
    front = node(tree, "ShaderNodeBsdfPrincipled",
                 {"Base Color": base, "Roughness": 0.5}).outputs[0]
    back = node(tree, "ShaderNodeBsdfTranslucent", {"Color": beyond}).outputs[0]
    surface = node(tree, "ShaderNodeMixShader", {0: share, 1: front, 2: back}).outputs[0]
    if alpha:
        clear = node(tree, "ShaderNodeBsdfTransparent").outputs[0]
        surface = node(tree, "ShaderNodeMixShader",
                       {0: alpha(tree), 1: clear, 2: surface}).outputs[0]
    tree.links.new(surface, output.inputs["Surface"])
    return result


def tiles(tree: Tree, size: float, colours: tuple[Colour, Colour], grout: Colour,
          rotation: Point = (0.0, 0.0, 0.0), flat: float = 1.0) -> Value:
    """A socket: tiles of two colours with grout; `flat`: width of a tile by its height."""
    vector = coordinates(tree, rotation=rotation)
    return node(tree, "ShaderNodeTexBrick", {
        "Vector": vector, "Color1": colours[0], "Color2": colours[1], "Mortar": grout,
        "Scale": 1.0, "Mortar Size": 0.03 * size, "Brick Width": size * flat,
        "Row Height": size}, offset=0.0 if flat == 1.0 else 0.5).outputs["Color"]


def wood(tree: Tree, scale: float, light: Colour, dark: Colour,
         rotation: Point = (0.0, 0.0, 0.0)) -> Value:
    """A socket: grain along y."""
    vector = coordinates(tree, scale=(scale, scale * 0.08, scale), rotation=rotation)
    return ramp(tree, noise(tree, 3.0, vector, 8.0, Distortion=1.5), [(0.3, dark), (0.7, light)])


def sky(strength: float, elevation: float, azimuth: float, sun: bool = True) -> None:
    """Daylight; `elevation` and `azimuth` of the sun in degrees."""
    tree = background_tree()
    texture = node(tree, "ShaderNodeTexSky", sun_elevation=np.radians(elevation),
                   sun_rotation=np.radians(azimuth), sun_disc=sun)
    finish_background(tree, texture.outputs[0], strength)


def gradient_sky(stops: list[tuple[float, Colour]], strength: float = 1.0) -> None:
    """Colours from straight down (0) to straight up (1), with faint clouds."""
    tree = background_tree()
    direction = node(tree, "ShaderNodeTexCoord").outputs["Generated"]
    height = node(tree, "ShaderNodeSeparateXYZ", {0: direction}).outputs["Z"]
    share = node(tree, "ShaderNodeMapRange", {"Value": height, "From Min": -1.0}).outputs[0]
    clouds = noise(tree, 3.0, direction, 6.0)
    thick = ramp(tree, clouds, [(0.35, (0.7,) * 3), (0.75, (1.25,) * 3)])
    colour = mixed(tree, 1.0, ramp(tree, share, stops), thick, "MULTIPLY")
    finish_background(tree, colour, strength)


def background_tree() -> Tree:
    world = bpy.context.scene.world
    world.use_nodes = True
    world.node_tree.nodes.clear()
    return world.node_tree


def finish_background(tree: Tree, colour: Value, strength: float) -> None:
    shader = node(tree, "ShaderNodeBackground", {"Color": colour, "Strength": strength})
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])


def volume(name: str, density: float | Shade, colour: Colour = (1.0, 1.0, 1.0),
           anisotropy: float = 0.0,
           fire: Callable[[Tree], tuple[Value, Value]] | None = None) -> bpy.types.Material:
    """A volume. `density`: a number, or a function of the tree that gives a socket; `fire`: a
    function of the tree that gives the sockets of emitted colour and strength."""
    result, tree, output = new_material(name)
    thick = density(tree) if callable(density) else density
    values = {"Color": colour, "Density": thick, "Anisotropy": anisotropy}
    if fire:
        values["Emission Color"], values["Emission Strength"] = fire(tree)
    shader = node(tree, "ShaderNodeVolumePrincipled", values)
    tree.links.new(shader.outputs[0], output.inputs["Volume"])
    return result


def calculate(tree: Tree, how: str, first: Value, second: Value = 0.0, third: Value = 0.0) -> Value:
    return node(tree, "ShaderNodeMath", {0: first, 1: second, 2: third},
                operation=how).outputs[0]


def animated(tree: Tree, values: tuple[float, float]) -> Value:
    """A socket: a number that runs from the first value to the second over the frames."""
    item = node(tree, "ShaderNodeValue")
    for frame, value in zip((FIRST, LAST), values, strict=True):
        item.outputs[0].default_value = value
        item.outputs[0].keyframe_insert("default_value", frame=frame)
    return item.outputs[0]
