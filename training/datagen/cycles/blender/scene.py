"""Parts of a Blender scene: cameras, lights, materials, meshes, hair, volumes.

Runs inside Blender's Python (`bpy`), which has NumPy but not this project's other dependencies.
Lengths are metres, z is up. Every function draws its choices from the generator that it is given,
so a seed names a scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

Rng = np.random.Generator
Colour = tuple[float, float, float]
Place = Sequence[float] | np.ndarray
"""Or a direction: three numbers."""

OPEN_WATER = 0.6  # share of clear water that shadow rays pass
OPEN_GLASS = 0.25  # share of glass that shadow rays pass


def clear() -> bpy.types.Scene:
    """An empty scene that Cycles renders."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.frame_start, scene.frame_end = 0, 16
    return scene


def link(name: str, data: bpy.types.ID | None) -> bpy.types.Object:
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made


# Cameras and motion


def camera_at(eye: Place, target: Place, fov: float) -> bpy.types.Object:
    """The scene's camera; ``fov`` is the horizontal field of view in degrees."""
    data = bpy.data.cameras.new("camera")
    data.angle, data.clip_start, data.clip_end = math.radians(fov), 0.01, 10000.0
    camera = link("camera", data)
    camera.matrix_world = look(eye, target)
    bpy.context.scene.camera = camera
    return camera


def look(eye: Place, target: Place) -> Matrix:
    place = Vector(eye)
    turn = (Vector(target) - place).to_track_quat("-Z", "Y")
    return Matrix.Translation(place) @ turn.to_matrix().to_4x4()


def keyframe(item: bpy.types.Object, first: Matrix, last: Matrix, frames: int) -> None:
    """Straight motion between two poses, extrapolated beyond the clip."""
    item.rotation_mode = "QUATERNION"
    turns = [first.to_quaternion(), last.to_quaternion()]
    if turns[0].dot(turns[1]) < 0:
        turns[1].negate()
    for frame, pose, turn in zip((0, frames), (first, last), turns, strict=True):
        item.location = pose.to_translation()
        item.rotation_quaternion = turn
        item.scale = pose.to_scale()
        for path in ("location", "rotation_quaternion", "scale"):
            item.keyframe_insert(path, frame=frame)
    make_linear(item)


def make_linear(item: bpy.types.ID) -> None:
    action = item.animation_data.action
    for layer in action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                for curve in bag.fcurves:
                    curve.extrapolation = "LINEAR"
                    for point in curve.keyframe_points:
                        point.interpolation = "LINEAR"


def move_camera(camera: bpy.types.Object, target: Place, frames: int, width: int,
                rng: Rng) -> str:
    """Keyframes of a random path that moves the picture by 0.2 to 8 pixels a frame, or none;
    returns its kind."""
    kind = rng.choice(["still", "pan", "orbit", "dolly", "truck", "shake"],
                      p=[0.18, 0.17, 0.25, 0.12, 0.18, 0.1])
    if kind == "still":
        return str(kind)
    eye, target = np.array(camera.matrix_world.translation), np.array(target, float)
    distance = max(float(np.linalg.norm(target - eye)), 1e-3)
    # radians over the clip
    angle = 2 ** rng.uniform(-2.3, 2.6) * camera.data.angle / width * frames
    side = np.cross(target - eye, (0, 0, 1.0))
    side = side / max(np.linalg.norm(side), 1e-6)
    way = rng.choice([-1.0, 1.0]) * side + rng.normal(0, 0.2, 3)
    step = angle * distance * way
    if kind == "pan":
        ends = eye, target + step
    elif kind == "orbit":
        ends = eye + step, target
    elif kind == "dolly":
        ends = eye + (target - eye) * min(0.3, 2 * angle) * rng.choice([-1, 1]), target
    else:
        ends = eye + step, target + step
    if kind == "shake":
        camera.rotation_mode = "QUATERNION"
        for frame in range(-1, frames + 2):
            pose = look(eye, target + rng.normal(0, 1, 3) * angle * distance / frames)
            camera.location = pose.to_translation()
            camera.rotation_quaternion = pose.to_quaternion()
            for path in ("location", "rotation_quaternion"):
                camera.keyframe_insert(path, frame=frame)
        make_linear(camera)
    else:
        keyframe(camera, look(eye, target), look(*ends), frames)
    return str(kind)


def move_thing(item: bpy.types.Object, size: float, frames: int, rng: Rng) -> None:
    """Slide, turn or tumble an object of about ``size`` by up to half its size over the clip."""
    pose = item.matrix_world.copy()
    turn = Matrix.Rotation(rng.uniform(-1.2, 1.2), 4,
                           Vector(rng.normal(size=3)) if rng.random() < 0.4 else "Z")
    slide = Matrix.Translation(Vector(rng.normal(0, 0.35 * size, 3) * (1, 1, 0.3))
                               * float(rng.random() < 0.8))
    keyframe(item, pose, slide @ pose @ turn, frames)


# Light


def sky(strength: float, sun_elevation: float, sun_rotation: float, disc: bool) -> None:
    """Blender's physical sky."""
    tree = world_tree()
    node = tree.nodes.new("ShaderNodeTexSky")
    kinds = node.bl_rna.properties["sky_type"].enum_items.keys()
    node.sky_type = next(k
                         for k in ("MULTIPLE_SCATTERING", "NISHITA", "HOSEK_WILKIE") if k in kinds)
    node.sun_elevation, node.sun_rotation, node.sun_disc = sun_elevation, sun_rotation, disc
    background(tree, node.outputs[0], strength)


def environment(path: Path, strength: float, turn: float) -> None:
    """A panorama as the world."""
    tree = world_tree()
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.load(str(path), check_existing=True)
    place, at = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    place.inputs["Rotation"].default_value[2] = turn
    tree.links.new(at.outputs["Generated"], place.inputs[0])
    tree.links.new(place.outputs[0], node.inputs[0])
    background(tree, node.outputs[0], strength)


def plain_world(colour: Colour, strength: float) -> None:
    tree = world_tree()
    node = tree.nodes.new("ShaderNodeRGB")
    node.outputs[0].default_value = (*colour, 1)
    background(tree, node.outputs[0], strength)


def starry_world(rng: Rng) -> None:
    """A dark sky with points of light smaller than a pixel."""
    tree = world_tree()
    cells, at = tree.nodes.new("ShaderNodeTexVoronoi"), tree.nodes.new("ShaderNodeTexCoord")
    cells.inputs["Scale"].default_value = rng.uniform(30, 90)
    near = tree.nodes.new("ShaderNodeMath")
    near.operation, near.inputs[1].default_value = "LESS_THAN", rng.uniform(0.02, 0.08)
    power = tree.nodes.new("ShaderNodeMath")
    power.operation, power.inputs[1].default_value = "MULTIPLY", 2 ** rng.uniform(2, 7)
    tree.links.new(at.outputs["Generated"], cells.inputs[0])
    tree.links.new(cells.outputs["Distance"], near.inputs[0])
    tree.links.new(near.outputs[0], power.inputs[0])
    background(tree, power.outputs[0], 1.0)


def world_tree() -> bpy.types.NodeTree:
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    world.node_tree.nodes.clear()
    return world.node_tree


def background(tree: bpy.types.NodeTree, colour: bpy.types.NodeSocket, strength: float) -> None:
    shade, out = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    shade.inputs["Strength"].default_value = strength
    tree.links.new(colour, shade.inputs["Color"])
    tree.links.new(shade.outputs[0], out.inputs["Surface"])


def lamp(kind: str, pose: Matrix, power: float, size: float = 0.2, colour: Colour = (1, 1, 1),
         cone: float = 1.0) -> bpy.types.Object:
    """A light of ``kind`` POINT, SPOT, AREA or SUN; ``power`` in watts, of a SUN in watts a square
    metre."""
    data = bpy.data.lights.new(kind.lower(), kind)
    data.energy, data.color = power, colour
    if kind == "AREA":
        data.size = size
    elif kind == "SUN":
        data.angle = size
    else:
        data.shadow_soft_size = size
    if kind == "SPOT":
        data.spot_size = cone
    item = link(kind.lower(), data)
    item.matrix_world = pose
    return item


# Materials


def colour_of(rng: Rng) -> Colour:
    """Mostly pale and dull, some saturated, some nearly black or white."""
    pick = rng.random()
    if pick < 0.12:
        return (float(rng.uniform(0.7, 0.9)),) * 3
    if pick < 0.2:
        return (float(rng.uniform(0.01, 0.05)),) * 3
    value = rng.uniform(0.1, 0.85)
    dull = rng.uniform(0.3, 1) if rng.random() < 0.6 else rng.uniform(0, 0.3)
    hue = rng.random(3)
    hue = hue / hue.max()
    red, green, blue = (float(x) for x in value * (dull + (1 - dull) * hue))
    return red, green, blue


def material(rng: Rng, kind: str | None = None) -> bpy.types.Material:
    """A Principled material: plastic, rough, metal, glass, frosted, coat, sheen, skin, or any."""
    kind = (kind or str(rng.choice(["rough", "plastic", "metal", "glass", "frosted", "coat",
                                    "sheen", "skin"],
                                   p=[0.38, 0.2, 0.14, 0.05, 0.03, 0.08, 0.06, 0.06])))
    made, shader = principled(kind)
    tree, base = made.node_tree, colour_of(rng)
    shader.inputs["Base Color"].default_value = (*base, 1)
    shader.inputs["Roughness"].default_value = {"rough": rng.uniform(0.5, 1),
                                                "frosted": rng.uniform(0.15, 0.5),
                                                "glass": 0.0}.get(kind, rng.uniform(0, 1) ** 1.5)
    if kind == "metal":
        shader.inputs["Metallic"].default_value = 1.0
    if kind in ("glass", "frosted"):
        shader.inputs["Transmission Weight"].default_value = 1.0
        shader.inputs["IOR"].default_value = rng.uniform(1.3, 1.6)
        tint = 0.85 + 0.15 * rng.random(3) if rng.random() < 0.7 else rng.random(3)
        shader.inputs["Base Color"].default_value = (*tint, 1)
        if rng.random() < OPEN_GLASS:
            open_to_light(tree, shader, tint)
        return made
    if kind == "coat":
        shader.inputs["Coat Weight"].default_value = rng.uniform(0.5, 1)
        shader.inputs["Coat Roughness"].default_value = rng.uniform(0, 0.2)
    if kind == "sheen":
        shader.inputs["Sheen Weight"].default_value = rng.uniform(0.4, 1)
    if kind == "skin":
        shader.inputs["Subsurface Weight"].default_value = rng.uniform(0.5, 1)
        shader.inputs["Subsurface Radius"].default_value = rng.uniform(0.02, 1, 3)
        shader.inputs["Subsurface Scale"].default_value = rng.uniform(0.02, 0.3)
    if rng.random() < 0.55:
        paint(tree, shader, base, rng)
    return made


def principled(name: str) -> tuple[bpy.types.Material, bpy.types.Node]:
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    return made, next(n for n in made.node_tree.nodes if n.type == "BSDF_PRINCIPLED")


def paint(tree: bpy.types.NodeTree, shader: bpy.types.Node, base: Colour, rng: Rng) -> None:
    """A computed texture of one to a thousand features a metre in the colour, and at times in
    roughness or relief."""
    kind = str(rng.choice(["Noise", "Voronoi", "Wave", "Checker", "Brick", "Magic", "WhiteNoise"],
                          p=[0.3, 0.15, 0.12, 0.14, 0.14, 0.07, 0.08]))
    texture = tree.nodes.new(f"ShaderNodeTex{kind}")
    at, place = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    scale = 2 ** rng.uniform(0.5, 8)
    place.inputs["Scale"].default_value = (scale,) * 3
    place.inputs["Rotation"].default_value = rng.uniform(0, 6, 3)
    tree.links.new(at.outputs["Object"], place.inputs[0])
    socket = place.outputs[0]
    if kind == "WhiteNoise":  # cells of one colour each, else it differs at every sample
        snap = tree.nodes.new("ShaderNodeVectorMath")
        snap.operation = "FLOOR"
        tree.links.new(socket, snap.inputs[0])
        socket = snap.outputs[0]
    tree.links.new(socket, texture.inputs["Vector"])
    value = next((o for o in texture.outputs if o.name in ("Fac", "Factor", "Value", "Distance")),
                 texture.outputs[0])
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.interpolation = str(rng.choice(["LINEAR", "CONSTANT", "EASE"]))
    stops = ramp.color_ramp.elements
    stops[0].position, stops[1].position = rng.uniform(0.1, 0.45), rng.uniform(0.5, 0.9)
    contrast = rng.random() ** 0.5
    other = contrast * np.array(colour_of(rng)) + (1 - contrast) * np.array(base)
    stops[0].color, stops[1].color = (*base, 1), (*other, 1)
    tree.links.new(value, ramp.inputs[0])
    tree.links.new(ramp.outputs[0], shader.inputs["Base Color"])
    if rng.random() < 0.3:
        tree.links.new(value, shader.inputs["Roughness"])
    if rng.random() < 0.35:
        bump = tree.nodes.new("ShaderNodeBump")
        bump.inputs["Strength"].default_value = rng.uniform(0.1, 1)
        bump.inputs["Distance"].default_value = rng.uniform(0.01, 0.1)
        tree.links.new(value, bump.inputs["Height"])
        tree.links.new(bump.outputs[0], shader.inputs["Normal"])


def glow(colour: Colour, strength: float) -> bpy.types.Material:
    made, shader = principled("glow")
    shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
    shader.inputs["Emission Color"].default_value = (*colour, 1)
    shader.inputs["Emission Strength"].default_value = strength
    return made


def page_material(image: Path, ink: Colour, paper: Colour,
                  emission: float = 0.0) -> bpy.types.Material:
    """A printed page: dark parts of the picture are ink. It glows if ``emission`` is above 0."""
    made, shader = principled("page")
    tree = made.node_tree
    picture, mix = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeMix")
    picture.image = bpy.data.images.load(str(image), check_existing=True)
    mix.data_type = "RGBA"
    mix.inputs["A"].default_value, mix.inputs["B"].default_value = (*ink, 1), (*paper, 1)
    tree.links.new(picture.outputs[0], mix.inputs["Factor"])
    result = next(o for o in mix.outputs if o.type == "RGBA")
    tree.links.new(result, shader.inputs["Emission Color" if emission else "Base Color"])
    shader.inputs["Emission Strength"].default_value = emission
    return made


def halftone_material(rng: Rng) -> bpy.types.Material:
    """A print of dots in one to three inks, each at an angle of its own; dots grow where a soft
    pattern is dark."""
    made, shader = principled("halftone")
    tree = made.node_tree
    at, shade = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexNoise")
    shade.inputs["Scale"].default_value = rng.uniform(1, 6)
    tree.links.new(at.outputs["UV"], shade.inputs["Vector"])
    dots_a_side = 2 ** rng.uniform(4.5, 7)
    colour = None
    for _ in range(int(rng.integers(1, 4))):
        place, dots = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexVoronoi")
        place.inputs["Rotation"].default_value[2] = rng.uniform(0, 1.6)
        dots.voronoi_dimensions = "2D"
        dots.inputs["Randomness"].default_value = 0.0
        dots.inputs["Scale"].default_value = dots_a_side
        reach, inside = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeMath")
        reach.operation, inside.operation = "MULTIPLY", "LESS_THAN"
        reach.inputs[1].default_value = rng.uniform(0.5, 1.2)
        mix = tree.nodes.new("ShaderNodeMix")
        mix.data_type = "RGBA"
        mix.inputs["A"].default_value = (*rng.uniform(0.6, 0.9, 3), 1)
        mix.inputs["B"].default_value = (*colour_of(rng), 1)
        tree.links.new(at.outputs["UV"], place.inputs["Vector"])
        tree.links.new(place.outputs[0], dots.inputs["Vector"])
        tree.links.new(shade.outputs[0], reach.inputs[0])
        tree.links.new(dots.outputs["Distance"], inside.inputs[0])
        tree.links.new(reach.outputs[0], inside.inputs[1])
        tree.links.new(inside.outputs[0], mix.inputs["Factor"])
        if colour is not None:
            tree.links.new(colour, mix.inputs["A"])
        colour = next(o for o in mix.outputs if o.type == "RGBA")
    tree.links.new(colour, shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = rng.uniform(0.3, 0.9)
    return made


def leaf_material(rng: Rng) -> bpy.types.Material:
    """Thin leaves: diffuse, translucent and a little glossy."""
    made, shader = principled("leaf")
    green = np.array([rng.uniform(0.02, 0.3), rng.uniform(0.1, 0.4), rng.uniform(0.01, 0.08)])
    shader.inputs["Base Color"].default_value = (*green, 1)
    shader.inputs["Roughness"].default_value = rng.uniform(0.3, 0.7)
    let_light_through(made.node_tree, shader, np.minimum(green * 1.6, 1), rng.uniform(0.1, 0.5))
    return made


def let_light_through(tree: bpy.types.NodeTree, shader: bpy.types.Node, colour: np.ndarray,
                      share: float) -> None:
    """Replace a ``share`` of a surface by one that scatters light to its other side, in this
    ``colour``."""
    through = tree.nodes.new("ShaderNodeBsdfTranslucent")
    through.inputs["Color"].default_value = (*colour, 1)
    mix_surfaces(tree, shader, through).inputs[0].default_value = share


def empty_volume(name: str) -> tuple[bpy.types.Material, bpy.types.Node]:
    """A material without a surface, and the node of its volume."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    shade = tree.nodes.new("ShaderNodeVolumePrincipled")
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shade.outputs[0], out.inputs["Volume"])
    return made, shade


def volume_material(rng: Rng, density: float, wisps: float = 0.0) -> bpy.types.Material:
    """Fog or smoke of a ``density`` a metre; uneven where there are ``wisps``, features a metre."""
    made, shade = empty_volume("volume")
    tree = made.node_tree
    white = rng.uniform(0.6, 0.98)
    shade.inputs["Color"].default_value = (*np.clip(white + rng.normal(0, 0.03, 3), 0, 1), 1)
    shade.inputs["Density"].default_value = density
    shade.inputs["Anisotropy"].default_value = rng.uniform(-0.2, 0.8)
    if wisps:
        noise, at = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeTexCoord")
        noise.inputs["Scale"].default_value = wisps
        spread = tree.nodes.new("ShaderNodeMapRange")
        spread.inputs["From Min"].default_value = rng.uniform(0.4, 0.55)
        spread.inputs["From Max"].default_value = 0.75
        spread.inputs["To Max"].default_value = 3 * density
        tree.links.new(at.outputs["Object"], noise.inputs["Vector"])
        tree.links.new(noise.outputs[0], spread.inputs[0])
        tree.links.new(spread.outputs[0], shade.inputs["Density"])
    return made


def smoke_material(rng: Rng, half: np.ndarray, density: float, heat: float,
                   frames: int) -> bpy.types.Material:
    """Smoke that rises and changes in a box of sides 2 ``half``; it glows by ``heat`` where it is
    thick."""
    made, shade = empty_volume("smoke")
    tree = made.node_tree
    dark = rng.uniform(0.02, 0.95)
    shade.inputs["Color"].default_value = (dark, dark, dark, 1)
    shade.inputs["Anisotropy"].default_value = rng.uniform(-0.1, 0.6)
    metres, at = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    at.inputs["Scale"].default_value = tuple(1 / half)  # the box reaches from -1 to 1
    tree.links.new(metres.outputs["Object"], at.inputs[0])
    place, noise = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexNoise")
    noise.noise_dimensions = "4D"
    noise.inputs["Scale"].default_value = rng.uniform(1.5, 5)
    noise.inputs["Detail"].default_value = rng.uniform(1, 6)
    rise = rng.uniform(0.02, 0.4)
    for frame, share in ((0, 0.0), (frames, 1.0)):
        place.inputs["Location"].default_value[2] = -rise * share
        place.inputs["Location"].keyframe_insert("default_value", frame=frame)
        noise.inputs["W"].default_value = 0.3 * rise * share
        noise.inputs["W"].keyframe_insert("default_value", frame=frame)
    make_linear(tree)
    tree.links.new(at.outputs[0], place.inputs[0])
    tree.links.new(place.outputs[0], noise.inputs["Vector"])
    # Thick in the middle, nothing at the walls of its box.
    distance, inner = tree.nodes.new("ShaderNodeVectorMath"), tree.nodes.new("ShaderNodeMapRange")
    distance.operation = "LENGTH"
    tree.links.new(at.outputs[0], distance.inputs[0])
    inner.inputs["From Min"].default_value, inner.inputs["From Max"].default_value = 1.0, 0.2
    tree.links.new(distance.outputs["Value"], inner.inputs[0])
    both, spread = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeMapRange")
    both.operation = "MULTIPLY"
    tree.links.new(noise.outputs[0], both.inputs[0])
    tree.links.new(inner.outputs[0], both.inputs[1])
    spread.inputs["From Min"].default_value = rng.uniform(0.15, 0.4)
    spread.inputs["From Max"].default_value = 0.7
    spread.inputs["To Max"].default_value = density
    tree.links.new(both.outputs[0], spread.inputs[0])
    tree.links.new(spread.outputs[0], shade.inputs["Density"])
    if heat:
        hot = tree.nodes.new("ShaderNodeMapRange")
        hot.inputs["From Min"].default_value = rng.uniform(0.35, 0.5)
        hot.inputs["From Max"].default_value = 0.7
        hot.inputs["To Max"].default_value = heat
        tree.links.new(both.outputs[0], hot.inputs[0])
        tree.links.new(hot.outputs[0], shade.inputs["Emission Strength"])
        shade.inputs["Emission Color"].default_value = (1, rng.uniform(0.2, 0.5),
                                                        rng.uniform(0.01, 0.1), 1)
    return made


def water_material(rng: Rng) -> bpy.types.Material:
    """Clear or coloured water, now and then as an opaque sea."""
    made, shader = principled("water")
    shader.inputs["Roughness"].default_value = float(rng.choice([0.0, rng.uniform(0.01, 0.15)]))
    shader.inputs["IOR"].default_value = 1.33
    if rng.random() < 0.25:
        shader.inputs["Base Color"].default_value = (*(rng.uniform(0.005, 0.1, 3)), 1)
        return made
    shader.inputs["Transmission Weight"].default_value = 1.0
    tint = 1 - rng.uniform(0, 0.35) * rng.random(3)
    shader.inputs["Base Color"].default_value = (*tint, 1)
    if rng.random() < OPEN_WATER:
        open_to_light(made.node_tree, shader, tint)
    return made


def open_to_light(tree: bpy.types.NodeTree, shader: bpy.types.Node, tint: np.ndarray) -> None:
    """Let shadow rays pass, in the colour ``tint`` (3,), as artists do: a path tracer hardly finds
    lamps through refraction."""
    path = tree.nodes.new("ShaderNodeLightPath")
    clear = tree.nodes.new("ShaderNodeBsdfTransparent")
    clear.inputs["Color"].default_value = (*tint, 1)
    mix = mix_surfaces(tree, shader, clear)
    tree.links.new(path.outputs["Is Shadow Ray"], mix.inputs[0])


def mix_surfaces(tree: bpy.types.NodeTree, shader: bpy.types.Node,
                 other: bpy.types.Node) -> bpy.types.Node:
    """Mix another surface into a material; the first input of the node is its share."""
    mix = tree.nodes.new("ShaderNodeMixShader")
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(shader.outputs[0], mix.inputs[1])
    tree.links.new(other.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return mix


def thin_material(rng: Rng) -> bpy.types.Material:
    """Cloth that scatters light to both sides; it may have a weave or stripes."""
    made, shader = principled("cloth")
    base = np.array(colour_of(rng))
    shader.inputs["Base Color"].default_value = (*base, 1)
    shader.inputs["Roughness"].default_value = rng.uniform(0.6, 1)
    if rng.random() < 0.6:
        paint(made.node_tree, shader, tuple(base), rng)
    other_side = np.clip(base * rng.uniform(0.6, 1.1), 0, 1)
    let_light_through(made.node_tree, shader, other_side, rng.uniform(0.2, 0.7))
    return made


# Shapes


def grid(count: int, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ((count + 1)^2, 3) of a flat square of ``side`` metres, and its faces (count^2,
    4)."""
    line = np.linspace(-side / 2, side / 2, count + 1)
    x, y = np.meshgrid(line, line)
    i = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    return (np.stack((x, y, np.zeros_like(x)), -1).reshape(-1, 3),
            np.stack((i, i + 1, i + count + 2, i + count + 1), -1))


def waves(rng: Rng, side: float, frames: int) -> bpy.types.Object:
    """A water surface of running sines, one shape key a frame, so that vectors show how it
    moves."""
    points, faces = grid(280, side)
    item = mesh("water", points, faces, None, smooth=True)
    item.shape_key_add(name="flat")
    height, speed = rng.uniform(0.01, 0.12), rng.uniform(0.1, 1.2)
    sines = [(2 ** rng.uniform(-1, 3.3), rng.uniform(0, 6.3), rng.uniform(0, 6.3))
             for _ in range(12)]
    for frame in range(-1, frames + 2):
        z = sum(height / k**1.1 * np.sin(k
                                         * (points[:, 0] * math.cos(a) + points[:, 1] * math.sin(a))
                                         + p + speed * math.sqrt(k) * frame / 3)
                for k, a, p in sines)
        key = item.shape_key_add(name=f"frame {frame}")
        key.data.foreach_set("co", (points + np.stack((0 * z, 0 * z, z), -1)).ravel())
        for at, value in ((frame - 1, 0.0), (frame, 1.0), (frame + 1, 0.0)):
            key.value = value
            key.keyframe_insert("value", frame=at)
    make_linear(item.data.shape_keys)
    return item


def flakes(rng: Rng, centres: np.ndarray, size: float,
           made: bpy.types.Material) -> bpy.types.Object:
    """Small tetrahedra in one mesh."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.6
    scale = size * rng.uniform(0.5, 1.5, (len(centres), 1, 1))
    points = (centres[:, None] + corners * scale).reshape(-1, 3)
    sides = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    faces = (4 * np.arange(len(centres))[:, None, None] + sides).reshape(-1, 3)
    return mesh("flakes", points, faces, made)


def sheet(rng: Rng, side: float, made: bpy.types.Material) -> bpy.types.Object:
    """A hanging cloth with folds."""
    points, faces = grid(90, side)
    depth = sum(rng.normal(0, 0.02 * side) * np.sin(points[:, 0] * k / side
                                                    + points[:, 1] * q / side + p)
                for k, q, p in ((rng.uniform(4, 50), rng.normal(0, 4), rng.uniform(0, 6.3))
                                for _ in range(5)))
    return mesh("sheet", np.stack((points[:, 0], depth, points[:, 1]), -1), faces, made,
                smooth=True)


def mesh(name: str, vertices: np.ndarray, faces: np.ndarray, made: bpy.types.Material | None,
         smooth: bool = False, uv: np.ndarray | None = None) -> bpy.types.Object:
    """Vertices (N, 3), faces (M, 3 or 4), uv (M * sides, 2)."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(vertices.tolist(), [], faces.tolist())
    if uv is not None:
        data.uv_layers.new().data.foreach_set("uv", np.asarray(uv, np.float32).ravel())
    if made:
        data.materials.append(made)
    if smooth:
        data.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
    data.update()
    return link(name, data)


def quad(centre: Place, u: Place, v: Place,
         made: bpy.types.Material | None) -> bpy.types.Object:
    """A rectangle with half sides ``u`` and ``v``, and texture coordinates over it."""
    c, u, v = (np.array(x, float) for x in (centre, u, v))
    corners = np.array([c - u - v, c + u - v, c + u + v, c - u + v])
    return mesh("quad", corners, np.array([[0, 1, 2, 3]]), made,
                uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))


def box(low: Place, high: Place,
        made: bpy.types.Material | None) -> bpy.types.Object:
    low, high = np.array(low, float), np.array(high, float)
    corners = (np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * (high - low)
               / 1.0)
    faces = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2],
                      [1, 3, 7, 5]])
    item = mesh("box", corners - (high - low) / 2, faces, made)
    item.location = (low + high) / 2
    return item


def solid(rng: Rng, at: Place, size: float, made: bpy.types.Material) -> bpy.types.Object:
    """A random body that stands on ``at``: ball, box, torus, cone, cylinder, monkey or a lump."""
    kind = str(rng.choice(["ball", "box", "torus", "cone", "cylinder", "monkey", "lump"]))
    calls = {
        "ball": lambda: bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24,
                                                             radius=0.5),
             "box": lambda: bpy.ops.mesh.primitive_cube_add(size=0.9),
        "torus": lambda: bpy.ops.mesh.primitive_torus_add(major_radius=0.38,
                                                          minor_radius=rng.uniform(0.05, 0.16)),
             "cone": lambda: bpy.ops.mesh.primitive_cone_add(vertices=48, radius1=0.5, depth=1),
        "cylinder": lambda: bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=0.4, depth=1),
             "monkey": lambda: bpy.ops.mesh.primitive_monkey_add(size=0.9),
             "lump": lambda: bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, radius=0.5)}
    calls[kind]()
    item = bpy.context.object
    item.data.materials.append(made)
    if kind not in ("box",):
        bpy.ops.object.shade_smooth_by_angle() if kind in (
            "cone", "cylinder"
        ) else bpy.ops.object.shade_smooth()
    if kind == "monkey":
        item.modifiers.new("smooth", "SUBSURF").render_levels = 2
    if kind == "lump":
        bend = item.modifiers.new("lump", "DISPLACE")
        bend.texture = bpy.data.textures.new("lump", "CLOUDS")
        bend.texture.noise_scale, bend.strength = rng.uniform(0.1, 0.6), rng.uniform(0.1, 0.5)
    item.scale = (size,) * 3
    item.rotation_euler[2] = rng.uniform(0, 6.3)
    item.location = np.array(at) + (0, 0, size * 0.5)
    bpy.context.view_layer.update()
    return item


def terrain(rng: Rng, side: float, height: float, made: bpy.types.Material,
            count: int = 96) -> np.ndarray:
    """Hills as a grid (count + 1, count + 1) of heights, ``side`` metres long; returns the vertices
    (N, 3)."""
    line = np.linspace(-side / 2, side / 2, count + 1)
    x, y = np.meshgrid(line, line)
    z = sum(rng.normal(0, 1) / k * np.sin(k * (x * a + y * b) * 3 / side + p)
            for k in (1, 2, 4, 8, 16)
            for a, b, p in [(rng.normal(), rng.normal(), rng.uniform(0, 6.3))])
    points = np.stack((x, y, height * z), -1).reshape(-1, 3)
    i = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    mesh("terrain", points, np.stack((i, i + 1, i + count + 2, i + count + 1), -1), made,
         smooth=True)
    return points


def leaves(rng: Rng, centres: np.ndarray, length: float, width: float, made: bpy.types.Material,
           upright: float = 0.0) -> bpy.types.Object:
    """Thousands of bent leaves or blades, each of two quads, one mesh; ``upright`` 1 makes
    grass."""
    n = len(centres)
    along = (rng.normal(size=(n, 3)) * (1, 1, 1 - 0.5 * upright) * (1 - 0.8 * upright)
             + np.array([0, 0, upright]))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, rng.normal(size=(n, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    droop = np.cross(side, along) * rng.uniform(0, 0.5, (n, 1))
    size = length * rng.uniform(0.5, 1.3, (n, 1))
    half = side * width * rng.uniform(0.6, 1.2, (n, 1)) / 2
    middle, tip = centres + along * size * 0.5, centres + (along + droop) * size
    points = np.stack((centres - half * 0.3, centres + half * 0.3, middle + half, middle - half,
                       tip), 1).reshape(-1, 3)
    first = 5 * np.arange(n)[:, None]
    data = bpy.data.meshes.new("leaves")
    faces = [*(first + [0, 1, 2, 3]).tolist(), *(first + [3, 2, 4]).tolist()]
    data.from_pydata(points.tolist(), [], faces)
    data.materials.append(made)
    return link("leaves", data)


def tree_crown(rng: Rng, at: np.ndarray, height: float, made: bpy.types.Material,
               bark: bpy.types.Material) -> None:
    """A trunk with some branches and a crown of leaves."""
    top = at + np.array([rng.normal(0, 0.08), rng.normal(0, 0.08), 0.55]) * height
    segments = [(at, top, 0.03 * height)]
    for _ in range(int(rng.integers(3, 9))):
        start = at + (top - at) * rng.uniform(0.5, 1)
        segments.append((start, start + rng.normal(0, 0.22, 3) * height + (0, 0, 0.2 * height),
                         0.012 * height))
    for a, b, r in segments:
        rod(a, b, r, bark)
    puffs = np.array([b for _, b, _ in segments])
    count = int(rng.integers(1500, 5000))
    centres = puffs[rng.integers(len(puffs), size=count)] + rng.normal(0, 0.11 * height, (count, 3))
    leaves(rng, centres, 0.05 * height, 0.03 * height, made)


def rod(start: np.ndarray, end: np.ndarray, radius: float,
        made: bpy.types.Material) -> bpy.types.Object:
    """A thin cylinder between two points."""
    way = Vector(end) - Vector(start)
    bpy.ops.mesh.primitive_cylinder_add(vertices=12, radius=radius, depth=way.length,
                                        end_fill_type="NOTHING")
    item = bpy.context.object
    item.data.materials.append(made)
    turn = way.to_track_quat("Z", "Y").to_matrix().to_4x4()
    item.matrix_world = Matrix.Translation((Vector(start) + Vector(end)) / 2) @ turn
    return item


def fur(rng: Rng, item: bpy.types.Object, count: int, length: float) -> None:
    """Hair on a mesh."""
    made = bpy.data.materials.new("hair")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    shade = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    shade.parametrization = "COLOR"
    shade.inputs["Color"].default_value = (*np.clip(np.array(colour_of(rng)), 0.02, 0.9), 1)
    tree.links.new(shade.outputs[0], out.inputs["Surface"])
    item.data.materials.append(made)
    system = item.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system.settings
    system.type, system.count, system.hair_length = "HAIR", count, length
    system.material = len(item.data.materials)
    system.brownian_factor = rng.uniform(0, 0.05)
    system.factor_random = rng.uniform(0, 0.3) * length
    system.child_type = "INTERPOLATED"
    system.rendered_child_count = int(rng.integers(4, 12))
    system.clump_factor = rng.uniform(-0.2, 0.6)
    system.root_radius = rng.uniform(0.3, 1.2)
    system.radius_scale = 0.01 * length
