"""Scenes for validation that stand indoors or close before the lens; see `scenes`."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import bpy
import numpy as np

from training.measure.validation import toolkit as tk
from training.measure.validation.toolkit import add, camera, lamp, material, move, place, tints

FRAMES = range(tk.FIRST, tk.LAST + 1)
OAK = ((0.5, 0.31, 0.16), (0.27, 0.15, 0.07))


def wooden(name: str, scale: float = 5.0, shades: tuple[tk.Colour, tk.Colour] = OAK,
           roughness: float = 0.4) -> bpy.types.Material:
    return material(name, lambda tree: tk.wood(tree, scale, *shades), roughness, grain=(4, 0.2))


def books(rng: np.random.Generator, start: tk.Point, length: float, name: str = "books") -> None:
    """A row of books along x on a board."""
    shapes = []
    x = 0.0
    while x < length:
        wide, tall, deep = rng.uniform(0.02, 0.055), rng.uniform(0.18, 0.29), rng.uniform(0.13, 0.2)
        tilt = rng.normal(0, 0.1) if rng.random() < 0.2 else 0.0
        shapes.append(place(tk.box(wide * 0.94, deep, tall),
                            np.add(start, (x + wide / 2, 0, tall / 2)), tk.turn(y=tilt)))
        band = place(tk.box(wide * 0.96, deep * 1.01, 0.02),
                     np.add(start, (x + wide / 2, -0.002, tall * 0.8)), tk.turn(y=tilt))
        shapes.append(band)
        x += wide
    colours = rng.uniform(0.03, 0.9, (len(shapes), 3)) * rng.uniform(0.3, 1, (len(shapes), 1))
    add(tk.join(shapes), material(name, (0.9, 0.9, 0.9), 0.6, tinted=True, grain=(30, 0.3)),
        tint=np.repeat(colours, 6, 0))


# Glass --------------------------------------------------------------------------------------------


def glass(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.0, (0.1, 0.09, 0.08)), (0.5, (0.3, 0.3, 0.32)), (1.0, (0.5, 0.6, 0.8))],
                    0.25)
    lamp("AREA", (-1.9, 0.9, 1.7), 60.0, (0.9, 0.95, 1.0), 1.1, target=(0, 0.4, 0.2))
    lamp("SPOT", (1.7, 1.9, 1.5), 90.0, (1.0, 0.8, 0.55), 0.03, target=(0.1, 0.35, 0.1))
    add(place(tk.box(2.6, 1.5, 0.05), (0, 0.5, -0.026)), wooden("table", 7.0))
    wall = material("wall", lambda tree: tk.tiles(tree, 0.12, (
        (0.35, 0.5, 0.42), (0.5, 0.6, 0.5)), (0.7, 0.68, 0.62), (np.pi / 2, 0, 0), 2.0), 0.3)
    add(place(tk.box(4, 0.1, 3), (0, 1.6, 0.5)), wall)
    add(place(tk.box(3, 0.3, 0.03), (0, 1.35, 0.42)), wooden("shelf"))
    books(rng, (-1.3, 1.35, 0.44), 2.5)
    clear = tk.glass("clear")
    bowl = [(0, 0), (0.038, 0), (0.04, 0.004), (0.008, 0.012), (0.005, 0.03), (0.005, 0.1),
            (0.02, 0.115), (0.042, 0.15), (0.047, 0.19), (0.04, 0.24), (0.0385, 0.24),
            (0.0455, 0.19), (0.0405, 0.151), (0.019, 0.118), (0, 0.114)]
    wine_shape = tk.lathe([(0, 0.1145), (0.0188, 0.1185), (0.0403, 0.1515), (0.0445, 0.178),
                           (0, 0.178)], 48)
    red = tk.glass("wine", (0.5, 0.01, 0.03), 1.33)
    amber = tk.glass("amber", (0.9, 0.5, 0.1), 1.36)
    tumbler = [(0, 0), (0.035, 0), (0.038, 0.01), (0.041, 0.1), (0.0385, 0.1), (0.035, 0.016),
               (0, 0.014)]
    for x, y, liquid in ((-0.15, 0.25, red), (0.14, 0.42, None), (-0.3, 0.55, amber)):
        add(place(tk.lathe(bowl, 64), (x, y, 0)), clear, True)
        if liquid:
            add(place(wine_shape, (x, y, 0)), liquid, True)
    for x, y in ((0.03, 0.12), (0.3, 0.2), (-0.02, 0.62)):
        add(place(tk.lathe(tumbler, 48), (x, y, 0)), clear, True)
    add(place(tk.lathe([(0, 0.0143), (0.0348, 0.0165), (0.0372, 0.07), (0, 0.07)], 48),
              (0.03, 0.12, 0)), tk.glass("juice", (1.0, 0.45, 0.02), 1.34), True)
    bottle = [(0, 0), (0.04, 0), (0.043, 0.01), (0.043, 0.19), (0.035, 0.225), (0.015, 0.255),
              (0.014, 0.31), (0.016, 0.312), (0.016, 0.325), (0.011, 0.325), (0.0105, 0.255),
              (0.032, 0.222), (0.039, 0.19), (0.039, 0.012), (0, 0.009)]
    for x, y, colour in ((0.27, 0.68, (0.25, 0.6, 0.3)), (-0.14, 0.78, (0.6, 0.3, 0.08)),
                         (0.42, 0.5, (0.35, 0.55, 0.9))):
        add(place(tk.lathe(bottle, 48), (x, y, 0)), tk.glass("bottle", colour), True)
    label = tk.lathe([(0.0435, 0.06), (0.0435, 0.14)], 48)
    paper = material("label", lambda tree: tk.tiles(tree, 0.014, (
        (0.85, 0.8, 0.66), (0.6, 0.12, 0.08)), (0.1, 0.08, 0.07), flat=2.3), 0.8)
    add(place(label, (-0.14, 0.78, 0)), paper, True)
    ball = add(tk.sphere(0.045, 32, 48), clear, True)
    move(ball, (0.16, 0.16, 0.045), (0.006, -0.002, 0.0), (0.05, 0.12, 0))
    cube = add(tk.box(0.05, 0.05, 0.05), tk.glass("frosted", (0.8, 0.9, 1.0), 1.5, 0.15))
    move(cube, (-0.07, 0.06, 0.0255), (0.0, 0.0, 0.0), (0, 0, 0.06))
    fruit = material("orange", (0.85, 0.3, 0.03), 0.4, grain=(40, 0.2), bump=0.3,
                     subsurface_weight=0.2, subsurface_scale=0.01)
    for x, y, z in ((-0.4, 0.3, 0.036), (-0.46, 0.38, 0.036), (-0.37, 0.39, 0.036)):
        add(place(tk.sphere(0.038, 20, 28), (x, y, z)), fruit, True)
    brass = material("brass", (0.85, 0.6, 0.25), 0.18, metallic=1.0, grain=(20, 0.2))
    for k in range(3):
        add(place(tk.lathe([(0, 0), (0.04, 0), (0.02, 0.015), (0.009, 0.05), (0.009, 0.14),
                            (0.02, 0.15), (0.012, 0.16), (0, 0.16)]), (0.44 + 0.1 * k, 0.34, 0)),
            brass, True)
    cloth = tk.grid(80, 80, 0.6, 0.5)
    across, along = cloth[0][:, 0], cloth[0][:, 1]
    cloth[0][:, 2] = (0.004 * np.sin(25 * across + 9 * along) + 0.004 * np.sin(31 * along)
                      + 0.009)
    check = material("napkin", lambda tree: tk.tiles(tree, 0.02, (
        (0.75, 0.73, 0.7), (0.55, 0.1, 0.1)), (0.8, 0.78, 0.75)), 0.9)
    add(place(cloth, (-0.22, 0.1, 0), tk.turn(z=0.4)), check, True)
    camera((0.02, -0.75, 0.42), (0.01, 0.38, 0.105), 46, (0.006, 0.003, 0.002))


# Skin and hair ------------------------------------------------------------------------------------


def bump(vertices: np.ndarray, at: np.ndarray, size: np.ndarray, push: np.ndarray) -> None:
    """Push vertices near a place."""
    distance = (vertices - at) / size
    vertices += np.exp(-(distance ** 2).sum(1))[:, None] * push


def head_shape() -> tk.Shape:
    """A head that looks along -y."""
    vertices, faces = tk.sphere(1.0, 180, 240)
    v = vertices * (0.078, 0.098, 0.118)
    chin = np.clip(-v[:, 2] / 0.118, 0, 1)[:, None]
    v *= 1 - chin * (0.28, 0.12, 0.0)
    v[:, 1] -= 0.018 * chin[:, 0] ** 1.5
    for at, size, push in (
            ((0, -0.098, -0.012), (0.013, 0.03, 0.03), (0, -0.014, 0)),
            ((0, -0.105, -0.032), (0.013, 0.03, 0.013), (0, -0.024, 0)),
            ((0.014, -0.1, -0.036), (0.008, 0.02, 0.008), (0.003, -0.008, 0)),
            ((-0.014, -0.1, -0.036), (0.008, 0.02, 0.008), (-0.003, -0.008, 0)),
            ((0.031, -0.09, 0.008), (0.018, 0.03, 0.012), (0, 0.016, 0)),
            ((-0.031, -0.09, 0.008), (0.018, 0.03, 0.012), (0, 0.016, 0)),
            ((0.03, -0.09, 0.032), (0.026, 0.03, 0.008), (0, -0.008, 0)),
            ((-0.03, -0.09, 0.032), (0.026, 0.03, 0.008), (0, -0.008, 0)),
            ((0.045, -0.07, -0.022), (0.02, 0.03, 0.02), (0.003, -0.007, 0)),
            ((-0.045, -0.07, -0.022), (0.02, 0.03, 0.02), (-0.003, -0.007, 0)),
            ((0, -0.11, -0.057), (0.024, 0.03, 0.005), (0, -0.01, 0)),
            ((0, -0.11, -0.071), (0.02, 0.03, 0.006), (0, -0.011, 0)),
            ((0, -0.11, -0.064), (0.026, 0.03, 0.0025), (0, 0.007, 0)),
            ((0, -0.1, -0.1), (0.022, 0.03, 0.014), (0, -0.012, 0))):
        bump(v, np.array(at), np.array(size), np.array(push))
    return v, faces


def skin_material(name: str, colour: tk.Colour, lips: bool) -> bpy.types.Material:
    def shade(tree: tk.Tree) -> tk.Value:
        blotches = tk.ramp(tree, tk.noise(tree, 35.0), [
            (0.35, tuple(0.8 * np.array(colour) * (1, 0.85, 0.8))), (0.65, colour)])
        freckles = tk.ramp(tree, tk.noise(tree, 420.0, detail=1.0), [
            (0.28, (0.45, 0.3, 0.22)), (0.36, (1.0, 1.0, 1.0))])
        base = tk.mixed(tree, 0.5, blotches, freckles, "MULTIPLY")
        if not lips:
            return base
        where = tk.node(tree, "ShaderNodeTexCoord").outputs["Object"]
        away = tk.node(tree, "ShaderNodeVectorMath", {0: where, 1: (0, -0.118, -0.064)},
                       operation="SUBTRACT").outputs[0]
        flat = tk.node(tree, "ShaderNodeVectorMath", {0: away, 1: (1.0, 0.5, 2.4)},
                       operation="MULTIPLY").outputs[0]
        far = tk.node(tree, "ShaderNodeVectorMath", {0: flat}, operation="LENGTH").outputs["Value"]
        red = tk.ramp(tree, tk.calculate(tree, "MULTIPLY", far, 20.0),
                      [(0.38, (0.5, 0.14, 0.12)), (0.56, (1.0, 1.0, 1.0))])
        return tk.mixed(tree, 1.0, base, red, "MULTIPLY")
    return material(name, shade, 0.42, grain=(60, 0.1), bump=0.12, subsurface_weight=1.0,
                    subsurface_radius=(1.0, 0.35, 0.18), subsurface_scale=0.006)


def strands(roots: np.ndarray, ways: np.ndarray, length: np.ndarray, droop: float,
            rng: np.random.Generator, radius: float, points: int = 9) -> bpy.types.Object:
    """Hair curves from roots (N, 3) along ways (N, 3)."""
    data = bpy.data.hair_curves.new("hair")
    data.add_curves([points] * len(roots))
    t = np.linspace(0, 1, points)[None, :, None]
    clump = rng.normal(0, 0.05, (len(roots), 1, 3)) * t
    wave = 0.03 * np.sin(7 * t + rng.uniform(0, 6, (len(roots), 1, 1))) * rng.normal(
        0, 0.3, (len(roots), 1, 3)) * t
    fall = np.array([0, 0, -droop]) * t ** 2
    places = roots[:, None] + length[:, None, None] * (ways[:, None] * t + fall + clump + wave)
    data.attributes["position"].data.foreach_set("vector", places.astype(np.float32).ravel())
    thickness = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    taper = np.tile(radius * (1 - 0.7 * t[0, :, 0]), len(roots)).astype(np.float32)
    thickness.data.foreach_set("value", taper)
    return tk.link(bpy.data.objects.new("hair", data))


def hair_material(melanin: float, redness: float) -> bpy.types.Material:
    result, tree, output = tk.new_material("hair")
    shader = tk.node(tree, "ShaderNodeBsdfHairPrincipled", {
        "Melanin": melanin, "Melanin Redness": redness, "Roughness": 0.25,
        "Radial Roughness": 0.35, "Random Color": 0.3}, parametrization="MELANIN")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return result


def skin(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.0, (0.05, 0.04, 0.04)), (0.5, (0.2, 0.2, 0.24)), (1.0, (0.3, 0.36, 0.5))],
                    0.2)
    lamp("AREA", (-0.8, -0.9, 0.7), 10.0, (1.0, 0.9, 0.8), 0.5, target=(0, 0, 0))
    lamp("SPOT", (0.6, 0.9, 0.5), 22.0, (1.0, 0.75, 0.55), 0.05, target=(0, 0, 0.02))
    parts = []
    head = head_shape()
    parts.append(add(head, skin_material("skin", (0.72, 0.43, 0.31), True), True))
    normals = head[0] / (0.078, 0.098, 0.118) ** np.array(2.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scalp = np.flatnonzero((head[0][:, 2] > 0.055 + 0.5 * (head[0][:, 1] + 0.05).clip(-1, 0)
                            - 0.9 * head[0][:, 1].clip(0, 1)) & (head[0][:, 2] > -0.06))
    # A net of a sphere is denser at its poles: choose evenly by area.
    share = np.cos(np.arcsin((head[0][scalp, 2] / 0.118).clip(-1, 1))) + 1e-3
    chosen = rng.choice(scalp, 9000, p=share / share.sum())
    ways = normals[chosen] * 0.55 + (0.25, 0.25, 0.1) + rng.normal(0, 0.12, (9000, 3))
    roots = head[0][chosen] + rng.normal(0, 0.0008, (9000, 3))
    hair = strands(roots, ways, rng.uniform(0.05, 0.085, 9000), 1.1, rng, 0.00022)
    hair.data.materials.append(hair_material(0.55, 0.7))
    parts.append(hair)
    brown = hair_material(0.8, 0.4)
    for side in (-1, 1):
        t = rng.uniform(0, 1, 220)
        brow = np.column_stack([side * (0.012 + 0.038 * t), -0.104 + 0.03 * t ** 2,
                                0.036 + 0.009 * np.sin(2.4 * t) + rng.normal(0, 0.0013, 220)])
        brow[:, 1] = nearest_front(head[0], brow) + 0.0005
        direction = np.column_stack([side * np.ones(220), -0.35 * np.ones(220),
                                     rng.normal(0.25, 0.2, 220)])
        lashes = strands(brow, direction, np.full(220, 0.009), 0.2, rng, 0.00018, 5)
        lashes.data.materials.append(brown)
        parts.append(lashes)
        eye = place(tk.sphere(0.0125, 24, 32), (side * 0.031, -0.0735, 0.008))
        parts.append(add(eye, material("eye", (0.85, 0.83, 0.8), 0.1, grain=(80, 0.1)), True))
        iris = place(tk.lathe([(0, 0), (0.0058, 0.0002)], 32), (side * 0.031, -0.0861, 0.008),
                     tk.turn(x=np.pi / 2))
        parts.append(add(iris, material("iris", (0.08, 0.16, 0.2), 0.1, grain=(900, 0.7))))
        pupil = place(tk.lathe([(0, 0), (0.0025, 0)], 24), (side * 0.031, -0.0864, 0.008),
                      tk.turn(x=np.pi / 2))
        parts.append(add(pupil, material("pupil", (0.005, 0.005, 0.005), 0.05)))
        lid = tk.sphere(0.0142, 20, 32)
        upper = lid[0][:, 2] > 0.0045
        lid[0][~upper] = lid[0][~upper] * (0.6, 0.6, 0.6)
        parts.append(add(place(lid, (side * 0.031, -0.0735, 0.008)), parts[0].data.materials[0],
                         True))
        ear = place(tk.torus(0.021, 0.008, 40, 14), (side * 0.074, 0.012, 0.0),
                    tk.turn(y=np.pi / 2 - side * 0.3) @ np.diag([1.4, 0.9, 1.0]))
        parts.append(add(ear, parts[0].data.materials[0], True))
        ring = place(tk.torus(0.009, 0.0009, 32, 8), (side * 0.079, 0.006, -0.042),
                     tk.turn(y=np.pi / 2))
        parts.append(add(ring, material("gold", (0.95, 0.7, 0.3), 0.1, metallic=1.0), True))
    neck = tk.lathe([(0.05, -0.25), (0.056, -0.12), (0.06, -0.05)], 64)
    parts.append(add(place(neck, (0, 0.02, 0)), parts[0].data.materials[0], True))
    for part in parts:
        part.rotation_euler = (0, 0, -0.3)
        move(part, (0, 0, 0), (0.0012, 0, 0.0004), (0.003, 0.002, -0.014))
    knit = material("knit", lambda tree: tk.tiles(tree, 0.006, (
        (0.12, 0.2, 0.3), (0.18, 0.28, 0.38)), (0.05, 0.08, 0.12), flat=1.6), 0.95, bump=0.6)
    add(place(tk.lathe([(0.32, -0.45), (0.25, -0.27), (0.12, -0.19), (0.072, -0.165),
                        (0.07, -0.135), (0.06, -0.14)], 96), (0, 0.03, 0),
              np.diag([1.0, 0.7, 1.0])), knit, True)
    fuzz = rng.normal(size=(3000, 3)) * (0.2, 0.14, 0.0)
    radius = np.hypot(fuzz[:, 0], fuzz[:, 1] / 0.7)
    fuzz[:, 2] = np.interp(radius, [0.07, 0.12, 0.25, 0.32], [-0.16, -0.19, -0.27, -0.45])
    wool = strands(fuzz[radius > 0.075] + (0, 0.03, 0),
                   rng.normal(size=((radius > 0.075).sum(), 3)),
                   np.full((radius > 0.075).sum(), 0.008), 0.0, rng, 0.00012, 5)
    wool.data.materials.append(material("wool", (0.2, 0.3, 0.42), 0.9))
    add(place(tk.box(4, 0.1, 3), (0, 1.5, 0)), material("wall", (0.3, 0.26, 0.22), 0.9,
                                                        grain=(3, 0.4)))
    books(rng, (-0.9, 1.2, -0.28), 1.8)
    books(rng, (-0.9, 1.2, 0.1), 1.8)
    shelf = wooden("shelf")
    for z in (-0.3, 0.08):
        add(place(tk.box(2.4, 0.3, 0.03), (0, 1.25, z)), shelf)
    camera((0.03, -0.8, 0.0), (0.0, 0, -0.005), 44, (0.003, 0.0, 0.001))


def nearest_front(vertices: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The y of the head's front before each place."""
    front = vertices[vertices[:, 1] < -0.02]
    gap = ((front[None, :, [0, 2]] - places[:, None, [0, 2]]) ** 2).sum(-1)
    return front[gap.argmin(1), 1]


# Print on white -----------------------------------------------------------------------------------

STROKES = {
    "a": "00-04-26-44-40 12-32", "b": "00-06-36-45-34-03 34-43-42-30-00",
    "c": "45-36-16-05-01-10-30-41",
    "d": "00-06-26-44-42-20-00", "e": "40-00-06-46 03-33", "f": "00-06-46 03-33",
    "g": "45-36-16-05-01-10-30-41-43-23", "h": "00-06 40-46 03-43", "i": "10-30 20-26 16-36",
    "k": "00-06 46-03-40", "l": "06-00-40", "m": "00-06-23-46-40", "n": "00-06-40-46",
    "o": "10-30-41-45-36-16-05-01-10", "p": "00-06-36-45-44-33-03",
    "r": "00-06-36-45-44-33-03 23-40",
    "s": "01-10-30-41-42-33-13-04-05-16-36-45", "t": "06-46 26-20", "u": "06-01-10-30-41-46",
    "v": "06-20-46", "w": "06-10-24-30-46", "x": "00-46 06-40", "y": "06-23-46 23-20",
    "z": "06-46-00-40",
}
"""Letters of straight strokes on a net of 5 by 7: points as column and row, rows from below."""


def letter(strokes: str, weight: float, slant: float) -> tk.Shape:
    shapes = []
    for line in strokes.split():
        points = np.array([[int(c) for c in point] for point in line.split("-")], float) / 6
        points[:, 0] += slant * points[:, 1]
        for first, last in zip(points[:-1], points[1:], strict=True):
            along = (last - first) / np.linalg.norm(last - first)
            across = np.array([-along[1], along[0]]) * weight
            first, last = first - along * weight, last + along * weight
            corners = np.array([first - across, last - across, last + across, first + across])
            shapes.append((np.column_stack([corners, np.zeros(4)]), np.array([[0, 1, 2, 3]])))
    return tk.join(shapes)


def text_block(rng: np.random.Generator, corner: tuple[float, float], size: float, width: float,
               lines: int, weight: float = 0.06, slant: float = 0.0) -> tk.Shape:
    """Lines of made-up words from the top left corner on."""
    shapes = []
    letters = {name: letter(strokes, weight, slant) for name, strokes in STROKES.items()}
    names, often = list(STROKES), np.array([8.0 if c in "aeiostnr" else 2.0 for c in STROKES])
    for line in range(lines):
        x, end = 0.0, width * (rng.uniform(0.3, 0.8) if line % 7 == 6 else 1.0)
        while x < end:
            for _ in range(rng.integers(2, 10)):
                name = rng.choice(names, p=often / often.sum())
                vertices, faces = letters[name]
                shapes.append((vertices * size + (corner[0] + x, corner[1] - line * size * 1.75,
                                                  0), faces))
                x += size * 0.92
                if x > end:
                    break
            x += size * 0.55
    return tk.join(shapes)


def printed(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.0, (0.3, 0.3, 0.3)), (0.5, (0.7, 0.72, 0.75)), (1.0, (0.6, 0.75, 1.0))],
                    0.5)
    lamp("AREA", (-0.7, 0.5, 0.7), 6.0, (1.0, 0.97, 0.92), 0.35, target=(0, 0, 0))
    lamp("SPOT", (0.5, 0.35, 0.45), 3.0, (1.0, 0.85, 0.65), 0.02, target=(0.05, 0, 0))
    add(place(tk.box(1.6, 1.2, 0.04), (0, 0, -0.0205)), wooden("desk", 12.0))
    paper = material("paper", (0.86, 0.85, 0.82), 0.75, grain=(90, 0.05), bump=0.05)
    ink = material("ink", (0.02, 0.02, 0.025), 0.55)
    red = material("red", (0.65, 0.04, 0.03), 0.55)
    blue = material("blue", (0.03, 0.08, 0.4), 0.5)

    def sheet(at: tk.Point, angle: float,
              make: Callable[[], Iterator[bpy.types.Object]]) -> None:
        item = add(tk.box(0.21, 0.297, 0.0004), paper)
        for other in (item, *make()):
            other.location = at
            other.rotation_euler = (0, 0, angle)

    def lay(shape: tk.Shape, shade: bpy.types.Material) -> bpy.types.Object:
        return add(place(shape, (0, 0, 0.00035)), shade)

    def article() -> Iterator[bpy.types.Object]:
        yield lay(text_block(rng, (-0.092, 0.112), 0.013, 0.17, 1, 0.11), ink)
        yield lay(text_block(rng, (-0.092, 0.096), 0.0045, 0.18, 1, 0.07, 0.2), red)
        columns = [text_block(rng, (-0.092 + 0.0645 * k, 0.083), 0.0021, 0.055, 46, 0.055)
                   for k in range(2)]
        columns.append(text_block(rng, (0.037, -0.0), 0.0021, 0.055, 24, 0.055))
        yield lay(tk.join(columns), ink)
        x, y = np.meshgrid(np.arange(44), np.arange(54))
        shade = 0.5 + 0.3 * np.sin(x * 0.22 + 1.5 * np.sin(y * 0.13)) + 0.2 * np.cos(y * 0.3)
        places = np.column_stack([0.038 + x.ravel() * 0.00126, 0.015 + y.ravel() * 0.00126,
                                  np.zeros(x.size)])
        dots = tk.copies(tk.lathe([(0, 0), (1, 0)], 8), places, tk.about_z(
            np.zeros(x.size), 0.00068 * np.sqrt(shade.ravel().clip(0.02, 1))))
        yield lay(dots, ink)
        rules = [place(tk.box(0.0003, 0.19, 0.0001), (-0.033 + 0.0645 * k, -0.015, 0))
                 for k in range(2)]
        yield lay(tk.join(rules), ink)

    def numbers() -> Iterator[bpy.types.Object]:
        lines = [place(tk.box(0.18, 0.0004, 0.0001), (0, 0.11 - 0.008 * k, 0)) for k in range(28)]
        lines += [place(tk.box(0.0004, 0.216, 0.0001), (-0.09 + 0.03 * k, 0.002, 0))
                  for k in range(7)]
        yield lay(tk.join(lines), blue)
        cells = [text_block(rng, (-0.088 + 0.03 * i, 0.1045 - 0.008 * k), 0.0032, 0.018, 1, 0.07)
                 for i in range(6) for k in range(27)]
        yield lay(tk.join(cells), ink)
        yield lay(text_block(rng, (-0.09, 0.122), 0.009, 0.1, 1, 0.1), red)
    sheet((-0.045, 0.01, 0.0005), 0.06, article)
    sheet((0.165, 0.03, 0.0010), -0.12, numbers)
    sheet((-0.25, -0.05, 0.0003), 0.3, numbers)

    cup = tk.lathe([(0, 0), (0.03, 0), (0.04, 0.02), (0.043, 0.09), (0.04, 0.09), (0.037, 0.02),
                    (0, 0.006)], 48)
    china = material("china", (0.85, 0.85, 0.82), 0.12, grain=(5, 0.03))
    add(place(cup, (0.085, 0.13, 0.001)), china, True)
    add(place(tk.torus(0.024, 0.0055), (0.138, 0.13, 0.048), tk.turn(x=np.pi / 2)), china, True)
    coffee = tk.lathe([(0.0415, 0.075), (0, 0.075)], 48)
    add(place(coffee, (0.085, 0.13, 0.001)), material("coffee", (0.03, 0.012, 0.005), 0.05))
    pencil = tk.join([tk.rod(0.0036, 0.13, 6), place(tk.lathe([(0.0036, 0), (0, 0.018)], 6),
                                                    (0, 0, 0.13))])
    item = add(place(pencil, (0, 0, 0), tk.turn(y=np.pi / 2)),
               material("pencil", (0.85, 0.55, 0.03), 0.3))
    item.rotation_euler = (0, 0, 0.7)
    move(item, (-0.06, -0.062, 0.0052), (0.003, 0.002, 0.0), (0.1, 0, 0.03))
    rim = material("rim", (0.75, 0.75, 0.78), 0.15, metallic=1.0)
    lens_at, lens_step = (0.045, -0.015, 0.026), (-0.002, 0.002, 0.0)
    curve = np.linspace(-1, 1, 17)
    lens = tk.lathe([(0.028 * np.sqrt(1 - c * c), 0.0045 * c) for c in curve], 64)
    move(add(lens, tk.glass("lens"), True), lens_at, lens_step)
    move(add(tk.torus(0.0285, 0.0022, 64), rim, True), lens_at, lens_step)
    handle = place(tk.rod(0.005, 0.09), (0.03, -0.01, 0), tk.turn(y=np.pi / 2 + 0.2))
    move(add(handle, rim, True), lens_at, lens_step)
    clips = [tk.tube(np.array([[0, 0, 0], [0.02, 0, 0], [0.024, 0.003, 0], [0.02, 0.006, 0],
                               [-0.006, 0.006, 0], [-0.009, 0.003, 0], [-0.006, 0.0, 0.0006],
                               [0.014, 0.0012, 0.0012], [0.014, 0.0045, 0.0012]]),
                     np.full(9, 0.0005), 6)]
    for x, y, angle in ((-0.1, 0.075, 0.5), (0.08, -0.07, 2.0), (-0.02, 0.1, 1.1)):
        add(place(clips[0], (x, y, 0.0018), tk.turn(z=angle)), rim, True)
    camera((0.03, -0.30, 0.33), (0.0, 0.025, 0.0), 42, (0.0025, 0.001, 0.0), (0.0012, 0, 0))


# Hard indirect light ------------------------------------------------------------------------------


def indirect(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.5, (0.5, 0.45, 0.4)), (1.0, (0.4, 0.6, 1.0))], 1.2)
    lamp("SUN", (0, 0, 5), 20.0, (1.0, 0.9, 0.75), 0.009, target=(2.6, 0.7, 3.4))
    plaster = material("plaster", (0.62, 0.55, 0.46), 0.9, grain=(2.5, 0.3), bump=0.3)
    boards = wooden("boards", 4.0)
    add(place(tk.box(5, 6, 0.1), (0, 1.6, -0.05)), boards)
    add(place(tk.box(5, 6, 0.1), (0, 1.6, 2.75)), plaster)
    add(place(tk.box(5, 0.15, 2.8), (0, 4.3, 1.35)), plaster)
    add(place(tk.box(5, 0.15, 2.8), (0, -1.3, 1.35)), plaster)
    add(place(tk.box(0.15, 6, 2.8), (2.3, 1.6, 1.35)), plaster)
    # The wall on the left has a slit between two shutters.
    add(place(tk.box(0.15, 2.9, 2.8), (-2.3, 0.05, 1.35)), plaster)
    add(place(tk.box(0.15, 2.0, 2.8), (-2.3, 3.3, 1.35)), plaster)
    add(place(tk.box(0.15, 0.9, 0.3), (-2.3, 1.9, 0.15)), plaster)
    add(place(tk.box(0.15, 0.9, 0.3), (-2.3, 1.9, 2.6)), plaster)
    shelf = wooden("case", 6.0, ((0.33, 0.18, 0.09), (0.18, 0.09, 0.04)))
    for z in (0.1, 0.5, 0.9, 1.3, 1.7, 2.1):
        add(place(tk.box(2.0, 0.3, 0.03), (-0.65, 4.05, z)), shelf)
        books(rng, (-1.6, 4.05, z + 0.016), rng.uniform(1.2, 1.85))
    for x in (-1.66, 0.36):
        add(place(tk.box(0.04, 0.32, 2.3), (x, 4.05, 1.15)), shelf)
    table = [place(tk.box(1.3, 0.8, 0.04), (0.2, 2.2, 0.74))]
    table += [place(tk.box(0.06, 0.06, 0.72), (0.2 + x, 2.2 + y, 0.36))
              for x in (-0.58, 0.58) for y in (-0.34, 0.34)]
    add(tk.join(table), wooden("table", 6.0))
    for x, y, angle in ((-0.45, 1.7, 0.4), (0.9, 1.75, -0.5), (0.2, 3.0, 3.0)):
        chair = [place(tk.box(0.42, 0.42, 0.04), (0, 0, 0.45)),
                 place(tk.box(0.42, 0.03, 0.12), (0, -0.2, 0.85)),
                 place(tk.box(0.42, 0.03, 0.06), (0, -0.2, 0.65))]
        chair += [place(tk.box(0.04, 0.04, 0.45), (i, j, 0.22)) for i in (-0.18, 0.18)
                  for j in (-0.18, 0.18)]
        chair += [place(tk.box(0.04, 0.04, 0.5), (i, -0.2, 0.7)) for i in (-0.18, 0.18)]
        add(place(tk.join(chair), (x, y, 0), tk.turn(z=angle)), shelf)
    china = material("china", (0.8, 0.8, 0.78), 0.1)
    jug = tk.lathe([(0, 0), (0.06, 0), (0.09, 0.08), (0.05, 0.2), (0.06, 0.26), (0.053, 0.26),
                    (0.043, 0.2), (0.08, 0.08), (0, 0.01)], 48)
    add(place(jug, (-0.05, 2.25, 0.76)), china, True)
    for x, y in ((0.15, 2.0), (0.45, 2.1), (0.5, 2.4)):
        add(place(tk.lathe([(0, 0), (0.05, 0), (0.12, 0.02), (0.12, 0.024), (0, 0.008)], 40),
                  (x, y, 0.76)), china, True)
    brass = material("brass", (0.85, 0.6, 0.28), 0.2, metallic=1.0)
    add(place(tk.lathe([(0, 0), (0.07, 0), (0.02, 0.03), (0.015, 0.3), (0.03, 0.31), (0, 0.33)]),
              (0.62, 2.25, 0.76)), brass, True)
    orange = material("orange", (0.8, 0.25, 0.02), 0.5, grain=(40, 0.2))
    fruit = add(tk.sphere(0.045), orange, True)
    move(fruit, (0.28, 2.2, 0.805), (0.012, -0.006, 0), (0.1, 0.25, 0))
    rug = material("rug", lambda tree: tk.tiles(tree, 0.09, (
        (0.45, 0.08, 0.06), (0.1, 0.12, 0.3)), (0.6, 0.5, 0.35), flat=1.7), 0.95, bump=0.6)
    add(place(tk.box(2.3, 1.7, 0.012), (0.2, 2.2, 0.006)), rug)
    for x, z, tone in ((0.9, 1.6, (0.2, 0.35, 0.4)), (1.5, 1.45, (0.6, 0.4, 0.2)),
                       (1.45, 1.95, (0.3, 0.2, 0.35))):
        add(place(tk.box(0.5, 0.04, 0.4), (x, 4.2, z)), shelf)

        def painted(tree: tk.Tree, tone: tk.Colour = tone) -> tk.Value:
            return tk.ramp(tree, tk.noise(tree, 7.0), [
                (0.35, tone), (0.55, (0.8, 0.75, 0.6)), (0.7, (0.1, 0.1, 0.15))])

        picture = material("picture", painted, 0.6)
        add(place(tk.box(0.42, 0.05, 0.32), (x, 4.19, z)), picture)
    door = wooden("door", 4.0, ((0.4, 0.42, 0.4), (0.3, 0.33, 0.32)))
    swing = add(place(tk.box(0.8, 0.04, 2.0), (0.4, 0, 1.0)), door)
    swing.rotation_euler = (0, 0, -2.2)
    move(swing, (2.15, 3.3, 0), (0, 0, 0), (0, 0, 0.015))
    scene = bpy.context.scene
    scene.cycles.max_bounces = 16
    scene.cycles.diffuse_bounces = 12
    camera((0.5, -0.9, 1.4), (0.1, 2.6, 1.02), 28, (0.012, 0.015, 0.003))


# Thin cloth against the sun -----------------------------------------------------------------------


def cloth(rng: np.random.Generator) -> None:
    tk.sky(0.09, 22, 180, sun=False)
    lamp("SUN", (0, 0, 9), 7.0, (1.0, 0.86, 0.66), 0.009, target=(-1.2, -5.0, 7.2))
    ground = tk.grid(200, 200, 40, 40)
    ground[0][:, 2] = rng.normal(0, 0.015, len(ground[0])) - 0.02
    add(ground, material("lawn", (0.1, 0.2, 0.03), 0.9, grain=(3, 0.5)), True)
    count = 26000
    grass = np.column_stack([rng.uniform(-4, 4, count), rng.uniform(-0.5, 9, count),
                             np.zeros(count)])
    blade = (np.array([[-0.006, 0, 0], [0.006, 0, 0], [0.004, 0.02, 0.09], [0, 0.04, 0.14]]),
             np.array([[0, 1, 2, 3]]))
    green = tk.thin("grass", (0.08, 0.17, 0.02), (0.3, 0.45, 0.05), 0.4, tinted=True)
    add(tk.copies(blade, grass, tk.about_z(rng.uniform(0, 7, count), rng.uniform(0.5, 1.3, count))),
        green, tint=tints(rng, count, 1, 0.5, 1.0, 0.3))

    def weave(size: float, first: tk.Colour, second: tk.Colour) -> tk.Shade:
        def shade(tree: tk.Tree) -> tk.Value:
            check = tk.tiles(tree, size, (first, second), tuple(0.8 * np.array(first)),
                             (np.pi / 2, 0, 0))
            threads = tk.node(tree, "ShaderNodeTexWave", {
                "Vector": tk.coordinates(tree), "Scale": 60.0, "Distortion": 1.0})
            fine = tk.ramp(tree, threads.outputs["Fac"], [(0.2, (0.82,) * 3), (0.8, (1.0,) * 3)])
            return tk.mixed(tree, 1.0, check, fine, "MULTIPLY")
        return shade
    rope = material("rope", (0.5, 0.42, 0.3), 0.9)
    fabrics = [weave(0.16, (0.85, 0.83, 0.78), (0.85, 0.83, 0.78)),
               weave(0.07, (0.8, 0.75, 0.7), (0.75, 0.12, 0.1)),
               weave(0.12, (0.3, 0.5, 0.75), (0.75, 0.8, 0.85)),
               weave(0.05, (0.85, 0.65, 0.2), (0.8, 0.5, 0.15)),
               weave(0.2, (0.5, 0.7, 0.5), (0.82, 0.82, 0.76))]
    pegs: list[tk.Shape] = []
    for row, (y, offset) in enumerate(((2.3, -1.6), (3.4, -2.0), (4.7, -2.3))):
        line = np.column_stack([np.linspace(-5, 5, 30), np.full(30, y), 1.95 + 0.012 * np.linspace(
            -5, 5, 30) ** 2])
        add(tk.tube(line, np.full(30, 0.006), 6), rope)
        x = offset
        while x < 2.6:
            wide, tall = rng.uniform(0.7, 1.25), rng.uniform(0.7, 1.35)
            phase, billow = rng.uniform(0, 6), rng.uniform(0.06, 0.14)
            net = tk.grid(70, 70, wide, tall)
            u, v = net[0][:, 0] / wide + 0.5, 0.5 - net[0][:, 1] / tall
            shapes = []
            for frame in FRAMES:
                t = 0.28 * frame + phase
                fold = billow * v * np.sin(5 * u + 2.2 * v + t) + 0.05 * v ** 2 * np.sin(11 * u - t)
                fold += 0.018 * np.sin(26 * u + phase) * (0.3 + v)
                fold += 0.1 * v ** 1.5 * np.sin(t)
                drop = tall * v - 0.1 * fold ** 2 + 0.03 * np.sin(np.pi * u) * (1 - v)
                shapes.append(np.column_stack([x + wide * u + 0.02 * v * np.sin(t + 3 * u),
                                               y + fold,
                                               1.95 + 0.012 * (x + wide * u) ** 2 - drop]))
            fabric = fabrics[(row * 2 + len(pegs)) % len(fabrics)]
            item = add((shapes[0], net[1]), tk.thin("cloth", fabric, (0.95, 0.93, 0.9), 0.5), True)
            tk.deform(item, shapes)
            pegs += [place(tk.box(0.014, 0.03, 0.09), (x + wide * s, y, 1.96 + 0.012 * (
                x + wide * s) ** 2)) for s in (0.06, 0.5, 0.94)]
            x += wide + rng.uniform(0.04, 0.25)
    add(tk.join(pegs), wooden("pegs", 20.0))
    post = wooden("post", 8.0)
    for x in (-2.75, 2.75):
        for y in (2.3, 3.4, 4.7):
            add(place(tk.rod(0.045, 2.2), (x, y, 0)), post, True)
    basket = material("basket", lambda tree: tk.tiles(tree, 0.03, (
        (0.45, 0.28, 0.13), (0.35, 0.2, 0.09)), (0.12, 0.07, 0.03), (np.pi / 2, 0, 0), 1.8), 0.8)
    add(place(tk.lathe([(0, 0), (0.25, 0), (0.33, 0.3), (0.3, 0.3), (0.23, 0.03), (0, 0.03)], 48),
              (0.5, 1.75, 0)), basket, True)
    trunk = material("trunk", (0.12, 0.09, 0.06), 0.9, grain=(10, 0.6), bump=0.8)
    for x, y in ((-3.3, 8.0), (1.2, 9.5), (4.0, 8.5)):
        add(place(tk.lathe([(0.25, 0), (0.15, 0.6), (0.12, 3)], 16), (x, y, 0)), trunk, True)
        spots = rng.normal(size=(2600, 3)) * (1.0, 0.9, 0.8) + (x, y, 3.1)
        leaf = (np.array([[-1, 0, 0], [0, -0.5, 0.1], [1, 0, 0], [0, 0.5, 0.1]]),
                np.array([[0, 1, 2, 3]]))
        add(tk.copies(leaf, spots, tk.random_turns(rng, 2600, rng.uniform(0.05, 0.09, 2600))),
            green, tint=tints(rng, 2600, 1, 0.5, 1.0, 0.3))
    camera((0.2, -2.0, 1.25), (0.1, 3, 1.45), 30, (0.015, 0.02, 0.003))


# Depth of field -----------------------------------------------------------------------------------


def depth_of_field(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.3, (0.03, 0.025, 0.03)), (0.55, (0.12, 0.09, 0.12)),
                     (1, (0.04, 0.06, 0.12))],
                    0.6)
    lamp("AREA", (-0.6, -0.1, 0.7), 5.0, (1.0, 0.9, 0.78), 0.4, target=(0, 0.1, 0))
    add(place(tk.box(4, 3.2, 0.05), (0, 1.3, -0.026)), wooden("bench", 14.0))
    bead = tk.sphere(1.0, 14, 20)
    count = 520
    spots = np.column_stack([rng.uniform(-0.32, 0.32, count), rng.uniform(-0.25, 0.75, count),
                             np.zeros(count)])
    sizes = rng.uniform(0.004, 0.011, count)
    spots[:, 2] = sizes
    colours = np.array([[0.9, 0.1, 0.1], [0.1, 0.4, 0.8], [0.95, 0.7, 0.1], [0.1, 0.6, 0.3],
                        [0.85, 0.85, 0.8], [0.5, 0.15, 0.6]])[rng.integers(0, 6, count)]
    shiny = material("beads", (1, 1, 1), 0.12, tinted=True, grain=(100, 0.1), coat_weight=0.5)
    add(tk.copies(bead, spots, tk.random_turns(rng, count, sizes)), shiny, True,
        np.repeat(colours, len(bead[1]), 0))
    metal = material("metal", (0.85, 0.83, 0.8), 0.15, metallic=1.0, grain=(30, 0.2))
    gear = [tk.lathe([(0.012, 0), (0.03, 0), (0.03, 0.006), (0.012, 0.006), (0.012, 0)], 64)]
    gear += [place(tk.box(0.006, 0.006, 0.006), (0.0325 * np.cos(a), 0.0325 * np.sin(a), 0.003),
                   tk.turn(z=a)) for a in np.linspace(0, 2 * np.pi, 25)[:-1]]
    wheel = tk.join(gear)
    for x, y, spin in ((-0.04, 0.12, 0.06), (0.028, 0.145, -0.06), (0.1, 0.3, 0.03),
                       (-0.12, 0.36, 0.05), (0.03, 0.02, 0.02)):
        move(add(wheel, metal), (x, y, 0.001), (0, 0, 0), (0, 0, spin))
    brass = material("brass", (0.85, 0.58, 0.22), 0.2, metallic=1.0)
    for k in range(9):
        x, y = -0.15 + 0.045 * k, 0.05 + 0.09 * (k % 4)
        add(place(tk.join([tk.rod(0.0022, 0.03), place(tk.lathe(
            [(0, 0), (0.0055, 0), (0.0055, 0.003), (0, 0.0045)], 6), (0, 0, 0.03))]), (x, y, 0)),
            brass)
    figure = tk.lathe([(0, 0), (0.02, 0), (0.021, 0.006), (0.009, 0.018), (0.007, 0.04),
                       (0.013, 0.043), (0.008, 0.047), (0.013, 0.06), (0.008, 0.07), (0, 0.072)],
                      40)
    for x, y, tone in ((-0.075, 0.2, (0.75, 0.65, 0.5)), (0.075, 0.17, (0.08, 0.05, 0.04)),
                       (0.0, 0.3, (0.75, 0.65, 0.5)), (0.15, 0.5, (0.08, 0.05, 0.04)),
                       (-0.2, 0.55, (0.75, 0.65, 0.5))):
        add(place(figure, (x, y, 0)), material("piece", tone, 0.25, grain=(60, 0.2)), True)
    roll = add(bead, material("marble", lambda tree: tk.ramp(tree,
                              tk.noise(tree, 2.0, Distortion=3),
                              [(0.4, (0.1, 0.3, 0.6)), (0.55, (0.9, 0.85, 0.7)),
                               (0.65, (0.5, 0.05, 0.1))]), 0.08), True)
    roll.scale = (0.017, 0.017, 0.017)
    move(roll, (0.035, 0.09, 0.017), (-0.004, 0.002, 0), (0, 0.25, 0.1))
    bulbs = np.column_stack([rng.uniform(-1.6, 1.6, 70), rng.uniform(1.6, 2.7, 70),
                             rng.uniform(-0.0, 0.9, 70)])
    colours = np.array([[1, 0.6, 0.25], [1, 0.25, 0.12], [0.3, 0.6, 1.0], [1, 0.85, 0.6]])
    lights = tk.copies(tk.sphere(0.014, 6, 8), bulbs, tk.random_turns(rng, 70, np.ones(70)))
    faces = len(tk.sphere(1, 6, 8)[1])
    add(lights, tk.glow("bulbs", (1, 1, 1), 14.0, True), True,
        np.repeat(colours[rng.integers(0, 4, 70)], faces, 0))
    green = tk.thin("green", (0.05, 0.12, 0.03), (0.1, 0.25, 0.05), 0.3, tinted=True)
    spots = rng.normal(size=(2500, 3)) * (0.8, 0.15, 0.3) + (0, 1.9, 0.4)
    add(tk.copies(tk.box(0.07, 0.02, 0.001), spots, tk.random_turns(rng, 2500, np.ones(2500))),
        green, tint=tints(rng, 2500, 6))
    books(rng, (-0.7, 0.95, 0.0), 0.55)
    eye = camera((0.01, -0.24, 0.1), (0.0, 0.17, 0.018), 46, (0.002, 0.001, 0.0004))
    eye.data.dof.use_dof = True
    eye.data.dof.focus_distance = 0.405
    eye.data.dof.aperture_fstop = 1.4
    eye.data.dof.aperture_blades = 7


# Motion blur --------------------------------------------------------------------------------------


def motion_blur(rng: np.random.Generator) -> None:
    tk.sky(0.09, 38, 60, sun=False)
    lamp("SUN", (0, 0, 5), 4.5, (1, 0.93, 0.82), 0.01, target=(2.5, 2.0, 1.6))
    ground = material("ground", lambda tree: tk.tiles(tree, 0.5, (
        (0.4, 0.37, 0.33), (0.32, 0.3, 0.28)), (0.15, 0.14, 0.13), flat=1.9), 0.8, bump=0.4)
    add(place(tk.grid(2, 2, 60, 60), (0, 20, 0)), ground)
    brick = material("brick", lambda tree: tk.tiles(tree, 0.09, (
        (0.45, 0.17, 0.1), (0.55, 0.25, 0.16)), (0.6, 0.57, 0.5), (np.pi / 2, 0, 0), 2.6), 0.9)
    add(place(tk.box(24, 0.4, 5), (0, 7, 2.5)), brick)
    frame = material("frame", (0.8, 0.78, 0.72), 0.5)
    pane = material("pane", (0.03, 0.05, 0.07), 0.05)
    for x in np.arange(-8, 9, 1.9):
        add(place(tk.box(1.0, 0.1, 1.4), (x, 6.78, 2.2)), frame)
        for i in (-0.23, 0.23):
            for k in (-0.32, 0.32):
                add(place(tk.box(0.4, 0.1, 0.58), (x + i, 6.75, 2.2 + k)), pane)
    steel = material("steel", (0.75, 0.76, 0.78), 0.2, metallic=1.0)
    red = material("red", (0.6, 0.03, 0.02), 0.25, coat_weight=1.0)
    tyre = material("tyre", (0.03, 0.03, 0.03), 0.8)

    def cycle(at: tk.Point, step: float) -> None:
        """A bicycle with a rider that travels along x."""
        spokes = [place(tk.rod(0.0035, 0.62, 5), (0, 0, -0.31), tk.turn(y=a))
                  for a in np.linspace(0, np.pi, 11)[:-1]]
        rim = place(tk.torus(0.31, 0.011, 64, 8), (0, 0, 0), tk.turn(x=np.pi / 2))
        rubber = place(tk.torus(0.335, 0.022, 64, 10), (0, 0, 0), tk.turn(x=np.pi / 2))
        for x in (-0.52, 0.52):
            for shape, shade in ((tk.join([rim, *[place(s) for s in spokes]]), steel),
                                 (rubber, tyre)):
                move(add(shape, shade, True), np.add(at, (x, 0, 0.36)), (step, 0, 0),
                     (0, step / 0.36, 0))
        corners = {"rear": (-0.52, 0, 0.36), "seat": (-0.2, 0, 0.9), "pedal": (-0.05, 0, 0.3),
                   "head": (0.38, 0, 0.85), "front": (0.52, 0, 0.36), "bar": (0.36, 0, 1.0)}
        bars = [("rear", "seat"), ("rear", "pedal"), ("seat", "pedal"), ("seat", "head"),
                ("pedal", "head"), ("head", "front"), ("head", "bar")]
        tubes = [tk.tube(np.linspace(corners[a], corners[b], 3), np.full(3, 0.017), 10)
                 for a, b in bars]
        move(add(tk.join(tubes), red, True), at, (step, 0, 0))
        body = [tk.tube(np.array([(-0.2, 0, 0.95), (-0.05, 0, 1.2), (0.12, 0, 1.42)]),
                        np.array([0.13, 0.16, 0.12]), 16),
                tk.tube(np.array([(0.12, 0, 1.38), (0.28, 0, 1.2), (0.36, 0, 1.03)]),
                        np.array([0.05, 0.045, 0.04]), 10)]
        shirt = material("shirt", lambda tree: tk.tiles(tree, 0.07, (
            (0.1, 0.25, 0.6), (0.8, 0.78, 0.7)), (0.1, 0.2, 0.5)), 0.9)
        move(add(tk.join(body), shirt, True), at, (step, 0, 0))
        skin_tone = material("face", (0.6, 0.36, 0.26), 0.5)
        move(add(place(tk.sphere(0.11, 16, 20), (0.2, 0, 1.6)), skin_tone, True), at, (step, 0, 0))
        move(add(place(tk.lathe([(0.135, 0), (0.12, 0.08), (0, 0.14)]), (0.19, 0, 1.63)), red,
                 True), at, (step, 0, 0))
        legs = [tk.tube(np.array([(-0.2, y, 0.95), (0.08, y, 0.75), (-0.05, y, low)]),
                        np.array([0.08, 0.065, 0.045]), 12) for y, low in ((0.09, 0.35),
                                                                           (-0.09, 0.5))]
        move(add(tk.join(legs), tyre, True), at, (step, 0, 0))
    cycle((0.05, 3.1, 0), 0.11)
    cycle((1.9, 4.4, 0), -0.17)
    blades = tk.join([place(tk.box(0.5, 0.12, 0.01), (0.32, 0, 0), tk.turn(x=0.5))
                      if a == 0 else place(place(tk.box(0.5, 0.12, 0.01), (0.32, 0, 0),
                                                 tk.turn(x=0.5)), (0, 0, 0), tk.turn(z=a))
                      for a in np.linspace(0, 2 * np.pi, 6)[:-1]])
    mill = add(blades, frame)
    mill.rotation_euler = (np.pi / 2, 0, 0)
    move(mill, (-0.75, 4.9, 1.6), (0, 0, 0), (0, 0.32, 0))
    add(place(tk.rod(0.03, 1.6), (-0.75, 5.0, 0)), steel, True)
    ball_shade = material("ball", lambda tree: tk.ramp(tree, tk.noise(tree, 5.0, detail=0.0), [
        (0.48, (0.9, 0.88, 0.8)), (0.5, (0.05, 0.05, 0.06))]), 0.4)
    ball = add(tk.sphere(0.14, 24, 32), ball_shade, True)
    move(ball, (0.65, 2.6, 1.05), (-0.1, 0.03, 0.06), (0.2, 0.4, 0))
    green = tk.thin("green", (0.07, 0.18, 0.03), (0.2, 0.4, 0.05), 0.3, tinted=True)
    pot = material("pot", (0.5, 0.22, 0.12), 0.8, grain=(10, 0.4))
    for x in (-1.5, -0.15, 1.1, 2.2):
        add(place(tk.lathe([(0, 0), (0.2, 0), (0.28, 0.4), (0.24, 0.4), (0, 0.36)]), (x, 6.2, 0)),
            pot, True)
        spots = rng.normal(size=(700, 3)) * (0.18, 0.18, 0.2) + (x, 6.2, 0.75)
        first = tk.copies(tk.box(0.1, 0.04, 0.002), spots, tk.random_turns(rng, 700, np.ones(700)))
        add(first, green, tint=tints(rng, 700, 6, 0.4, 1.0, 0.3))
    scene = bpy.context.scene
    scene.render.motion_blur_shutter = 0.5
    camera((-0.2, -1.5, 1.3), (0.1, 4, 1.2), 30, (0.03, 0.0, 0.0), (0.06, 0.0, 0.0))
