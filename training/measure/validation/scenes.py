"""Scenes for validation, one for each kind of content, built by hand; runs inside Blender.

Nothing here is shared with the generator of the training clips: a network that does well on what it
was trained on has to show it on these. Only the middle of each picture is rendered, so that is
where things are. Units are metres; frame 2 is the middle of the shot.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from training.measure.validation import indoor_scenes as indoors
from training.measure.validation import toolkit as tk
from training.measure.validation.toolkit import add, camera, lamp, material, move, place, tints

FRAMES = range(tk.FIRST, tk.LAST + 1)
WHITE = (0.8, 0.8, 0.8)


# Water over tiles ---------------------------------------------------------------------------------


def waves(places: np.ndarray, frame: float, rng: np.random.Generator) -> np.ndarray:
    """Heights of a pool's surface: many small waves that run in all directions."""
    height = np.zeros(len(places))
    for length in (1.3, 0.9, 0.62, 0.45, 0.33, 0.24, 0.17, 0.12, 0.085):
        for _ in range(3):
            angle = rng.normal(0.6, 0.9)
            direction = np.array([np.cos(angle), np.sin(angle)])
            phase = rng.uniform(0, 2 * np.pi)
            speed = np.sqrt(9.81 * 2 * np.pi / length) / 24
            height += 0.0055 * length * np.sin(2 * np.pi / length * (places @ direction)
                                              - speed * frame + phase)
    return height


def water(rng: np.random.Generator) -> None:
    tk.sky(0.08, 42, 215, sun=False)
    lamp("SUN", (0, 0, 5), 4.0, (1.0, 0.93, 0.82), 0.01, target=(1.6, 2.6, 0.6))

    def blue_tiles(rotation: tk.Point = (0.0, 0.0, 0.0)) -> tk.Shade:
        return lambda tree: tk.tiles(tree, 0.16, ((0.08, 0.42, 0.55), (0.16, 0.58, 0.66)),
                                     (0.75, 0.78, 0.74), rotation)
    floor = material("floor", blue_tiles(), 0.25, grain=(3.0, 0.25))
    wall = material("wall", blue_tiles((np.pi / 2, 0, 0)), 0.25, grain=(3.0, 0.25))
    add(place(tk.grid(2, 2, 14, 12), (0, 3, -1.15)), floor)
    add(place(tk.box(14, 0.3, 1.5), (0, 4.2, -0.62)), wall)
    steps = [place(tk.box(2.2, 0.4, 0.28 * k), (-2.4, 4.2 - 0.4 * k, -1.15 + 0.14 * k))
             for k in range(1, 4)]
    add(tk.join(steps), floor)
    stone = material("stone", (0.55, 0.46, 0.36), 0.75, grain=(5.0, 0.5), bump=0.5, tinted=True)
    x, y = np.meshgrid(np.arange(-8, 9) * 0.62, 4.4 + np.arange(8) * 0.62)
    spots = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.10)], -1)
    spots[:, 2] += rng.normal(0, 0.004, x.size)
    slabs = tk.copies(tk.box(0.6, 0.6, 0.08), spots, tk.about_z(rng.normal(0, 0.01, x.size),
                                                                 np.ones(x.size)))
    add(slabs, stone, tint=tints(rng, x.size, 6, 0.6))

    surface = tk.grid(360, 300, 9, 7.2)
    surface = place(surface, (0, 0.45, 0))
    clear = tk.glass("water", (0.86, 0.97, 1.0), 1.33, open_to_light=True)
    item = add(surface, clear, smooth=True)
    seed = int(rng.integers(1 << 30))
    shapes = []
    for frame in FRAMES:
        vertices = surface[0].copy()
        vertices[:, 2] = waves(vertices[:, :2], frame, np.random.default_rng(seed))
        shapes.append(vertices)
    tk.deform(item, shapes)

    def stripes(tree: tk.Tree) -> tk.Value:
        where = tk.node(tree, "ShaderNodeSeparateXYZ", {0: tk.coordinates(tree)})
        angle = tk.calculate(tree, "ARCTAN2", where.outputs[0], where.outputs[1])
        wave = tk.calculate(tree, "SINE", tk.calculate(tree, "MULTIPLY", angle, 3.0))
        pick = tk.calculate(tree, "GREATER_THAN", wave, 0.0)
        return tk.mixed(tree, pick, (0.85, 0.08, 0.06, 1), (0.9, 0.9, 0.85, 1))
    ball = add(tk.sphere(0.24, 24, 36), material("ball", stripes, 0.3, grain=(6, 0.05)), True)
    ball.rotation_euler = (0.7, 0.4, 0)
    move(ball, (0.42, 1.45, 0.14), (0.035, -0.012, 0.006), (0.05, 0.08, 0.02))
    ring = add(tk.torus(0.38, 0.11), material("ring", (0.95, 0.62, 0.05), 0.25, grain=(4, 0.1)),
               True)
    move(ring, (-0.75, 1.95, 0.03), (-0.02, 0.015, 0.004), (0.01, 0.02, 0.03))
    chrome = material("chrome", (0.8, 0.82, 0.85), 0.08, metallic=1.0, grain=(9, 0.05))
    for side in (0.95, 1.45):
        bend = np.linspace(0, np.pi, 24)
        curve = np.stack([np.full(24, side), 3.95 - 0.28 * np.cos(bend),
                          0.35 + 0.4 * np.sin(bend)], -1)
        legs = np.concatenate([[[side, 3.67, -1.0]], curve, [[side, 4.23, 0.1]]])
        add(tk.tube(legs, np.full(len(legs), 0.022), 12), chrome, True)
    add(tk.join([place(tk.box(0.5, 0.1, 0.03), (1.2, 3.67, -0.2 - 0.3 * k)) for k in range(3)]),
        chrome)
    spots = np.stack([rng.uniform(-1.6, 1.6, 60), rng.uniform(0, 3.6, 60)], -1)
    heights = waves(spots, 2, np.random.default_rng(seed)) + 0.004
    leaf = tk.copies(tk.box(0.05, 0.025, 0.002), np.column_stack([spots, heights]),
                     tk.about_z(rng.uniform(0, 6, 60), rng.uniform(0.5, 1.3, 60)))
    move(add(leaf, material("leaf", (0.5, 0.32, 0.08), tinted=True), tint=tints(rng, 60, 6)),
         (0, 0, 0), (0.008, -0.006, 0.0))
    terracotta = material("pot", (0.5, 0.2, 0.1), 0.8, grain=(10, 0.4), bump=0.3)
    green = tk.thin("green", (0.07, 0.2, 0.03), (0.2, 0.4, 0.05), 0.3, tinted=True)
    for x in (-1.5, -0.6, 0.2, 2.1):
        add(place(tk.lathe([(0, 0), (0.16, 0), (0.22, 0.34), (0.25, 0.34), (0.25, 0.4), (0.2, 0.38),
                            (0, 0.36)]), (x, 5.2, 0.14)), terracotta, True)
        directions = rng.normal(size=(260, 3)) * (0.2, 0.2, 0.22)
        blades = tk.copies(tk.box(0.16, 0.035, 0.002), directions + (x, 5.2, 0.78),
                           tk.random_turns(rng, 260, rng.uniform(0.5, 1.2, 260)))
        add(blades, green, tint=tints(rng, 260, 6, 0.4, 1.0, 0.3))
    camera((0.1, -1.9, 1.5), (0.05, 2.25, -0.1), 28, (0.02, 0.012, 0.0), (0.01, 0.0, 0.0))


# Smoke and fire -----------------------------------------------------------------------------------


def plume(tree: tk.Tree, width: float, scale: float, rise: float,
          threshold: float) -> tuple[tk.Value, tk.Value]:
    """A socket: 0 to 1 within a column of smoke around the z axis that widens and leans."""
    place_of = tk.node(tree, "ShaderNodeTexCoord").outputs["Object"]
    parts = tk.node(tree, "ShaderNodeSeparateXYZ", {0: place_of})
    x, y, z = parts.outputs
    climbing = tk.calculate(tree, "SUBTRACT", z, tk.animated(tree, (0.0, rise)))
    joined = tk.node(tree, "ShaderNodeCombineXYZ", {0: x, 1: y, 2: climbing}).outputs[0]
    cloud = tk.noise(tree, scale, joined, 2.0)
    lean = tk.calculate(tree, "MULTIPLY", tk.calculate(tree, "MULTIPLY", z, z), 0.1)
    beside = tk.calculate(tree, "SUBTRACT", x, lean)
    radius = tk.calculate(tree, "SQRT", tk.calculate(
        tree, "ADD", tk.calculate(tree, "MULTIPLY", beside, beside),
        tk.calculate(tree, "MULTIPLY", y, y)))
    wide = tk.calculate(tree, "MULTIPLY_ADD", z, 0.32, width)
    inside = tk.calculate(tree, "SUBTRACT", 1.0, tk.calculate(tree, "DIVIDE", radius, wide))
    amount = tk.calculate(tree, "ADD", cloud, tk.calculate(
        tree, "MULTIPLY", tk.calculate(tree, "MINIMUM", inside, 0.55), 0.5))
    share = tk.node(tree, "ShaderNodeMapRange", {
        "Value": amount, "From Min": threshold, "From Max": threshold + 0.25}).outputs[0]
    return share, z


def smoke(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.45, (0.02, 0.025, 0.04)), (0.52, (0.28, 0.15, 0.1)),
                     (0.6, (0.07, 0.09, 0.17)), (1.0, (0.02, 0.03, 0.08))], 0.9)
    lamp("SUN", (0, 0, 4), 0.8, (1.0, 0.7, 0.5), 0.05, target=(-2.5, 2.0, 2.6))

    def smoke_density(tree: tk.Tree) -> tk.Value:
        share, z = plume(tree, 0.3, 2.6, 0.5, 0.68)
        start = tk.node(tree, "ShaderNodeMapRange", {
            "Value": z, "From Min": 0.15, "From Max": 0.9}).outputs[0]
        return tk.calculate(tree, "MULTIPLY", tk.calculate(tree, "MULTIPLY", share, start), 7.0)
    smoke_box = tk.volume("smoke", smoke_density, (0.55, 0.53, 0.5), 0.2)
    add(place(tk.box(2.6, 2.0, 2.8), (0.4, 0, 1.6)), smoke_box)

    def flame_density(tree: tk.Tree) -> tk.Value:
        return tk.calculate(tree, "MULTIPLY", plume(tree, 0.16, 3.4, 0.9, 0.74)[0], 1.0)

    def flame(tree: tk.Tree) -> tuple[tk.Value, tk.Value]:
        share, z = plume(tree, 0.22, 3.4, 0.9, 0.64)
        low = tk.node(tree, "ShaderNodeMapRange", {
            "Value": z, "From Min": 0.15, "From Max": 1.25, "To Min": 1.0, "To Max": 0.0})
        heat = tk.calculate(tree, "MULTIPLY", share, low.outputs[0])
        colour = tk.ramp(tree, heat, [(0.0, (0.8, 0.06, 0.004)), (0.35, (1.0, 0.2, 0.02)),
                                      (0.8, (1.0, 0.5, 0.12)), (1.0, (1.0, 0.75, 0.35))])
        return colour, tk.calculate(tree, "MULTIPLY", tk.calculate(tree, "POWER", heat, 1.5), 38.0)
    add(place(tk.box(1.1, 0.9, 1.2), (0, 0, 0.7)),
        tk.volume("fire", flame_density, WHITE, 0, flame))

    ground = tk.grid(200, 200, 14, 14)
    ground[0][:, 2] = 0.05 * np.sin(ground[0][:, 0] * 1.7) * np.cos(ground[0][:, 1] * 1.3)
    ground[0][:, 2] += rng.normal(0, 0.008, len(ground[0]))
    add(ground, material("earth", (0.16, 0.11, 0.07), 0.9, grain=(4, 0.6), bump=0.9), True)
    pebble = tk.sphere(1.0, 7, 9)
    count = 900
    spots = np.column_stack([rng.uniform(-4, 4, count), rng.uniform(-3, 5, count),
                             rng.uniform(-0.02, 0.03, count)])
    stones = tk.copies(pebble, spots, tk.random_turns(rng, count, rng.gamma(2, 0.02, count)))
    grey = material("stones", (0.4, 0.38, 0.36), 0.8, tinted=True, grain=(20, 0.5), bump=0.5)
    add(stones, grey, True, tints(rng, count, len(pebble[1])))
    angle = np.linspace(0, 2 * np.pi, 15)[:-1]
    ring = np.column_stack([0.62 * np.cos(angle), 0.62 * np.sin(angle), np.full(14, 0.06)])
    rocks = tk.copies(pebble, ring, tk.random_turns(rng, 14, rng.uniform(0.1, 0.15, 14))
                      * [[1.0], [0.85], [0.8]])
    add(rocks, grey, True, tints(rng, 14, len(pebble[1]), 0.4, 0.8))
    bark = material("bark", (0.13, 0.075, 0.04), 0.9, grain=(14, 0.6), bump=0.9)
    for turn in np.linspace(0, 2 * np.pi, 8)[:-1]:
        foot = np.array([0.5 * np.cos(turn), 0.5 * np.sin(turn), 0.04])
        points = foot + np.linspace(0, 1, 6)[:, None] * (np.array([0.02, 0.01, 0.6]) - foot)
        add(tk.tube(points, np.linspace(0.07, 0.05, 6), 10), bark, True)
    sparks = rng.normal(size=(260, 3)) * (0.28, 0.25, 0.6) + (0.15, 0, 1.3)
    shape = tk.sphere(1.0, 5, 6)
    sizes = tk.random_turns(rng, 260, rng.uniform(0.002, 0.006, 260))
    first = tk.copies(shape, sparks, sizes)
    flight = rng.normal(size=(260, 3)) * 0.05 + (0.02, 0, 0.2)
    last = tk.copies(shape, sparks + flight, sizes)
    tk.deform_straight(add(first, tk.glow("spark", (1.0, 0.35, 0.06), 60.0)), first[0], last[0])
    tent = np.array([[-1, 0, 0], [-1, 1.6, 0], [0, 1.6, 1.3], [0, 0, 1.3], [1, 0, 0], [1, 1.6, 0]])
    faces = np.array([[0, 1, 2, 3], [3, 2, 5, 4]])
    add((tent + (-1.35, 1.5, 0), faces), tk.thin("tent", (0.6, 0.25, 0.06), (0.7, 0.3, 0.1)))
    crate = material("crate", lambda tree: tk.wood(tree, 6, (0.45, 0.28, 0.14), (0.22, 0.12, 0.06)))
    for x, y, z in ((1.25, 0.9, 0.2), (1.65, 1.1, 0.2), (1.4, 1.0, 0.58)):
        add(place(tk.box(0.38, 0.38, 0.36), (x, y, z), tk.turn(z=x)), crate)
    pot = material("kettle", (0.75, 0.74, 0.72), 0.25, metallic=1.0, grain=(6, 0.3))
    add(place(tk.lathe([(0, 0), (0.14, 0), (0.17, 0.06), (0.13, 0.2), (0.03, 0.24), (0, 0.27)]),
              (-0.85, -0.35, 0.02)), pot, True)
    for x in rng.uniform(-5, 5, 26):
        trunk = np.linspace([x, rng.uniform(3.5, 6.5), 0], [x + rng.normal(0, 0.2), 5, 5], 6)
        add(tk.tube(trunk, np.linspace(0.14, 0.06, 6), 10), bark, True)
    camera((0.6, -3.9, 1.25), (0.12, 0, 0.92), 31, (0.02, 0.02, 0.004))


# Fog ----------------------------------------------------------------------------------------------


def fog(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.5, (0.35, 0.3, 0.28)), (0.56, (0.6, 0.55, 0.55)), (1.0, (0.25, 0.35, 0.5))],
                    0.35)
    lamp("SUN", (0, 0, 5), 14.0, (1.0, 0.72, 0.42), 0.012, target=(-3.2, -4.5, 3.5))
    thick = tk.volume("fog", lambda tree: tk.calculate(
        tree, "MULTIPLY", tk.ramp(tree, tk.noise(tree, 0.35, detail=2.0),
                                  [(0.35, (0.35,) * 3), (0.7, (1.0,) * 3)]), 0.065),
        (0.95, 0.96, 1.0), 0.55)
    add(place(tk.box(40, 44, 9), (0, 12, 4.3)), thick)
    ground = tk.grid(240, 240, 60, 60)
    x, y = ground[0][:, 0], ground[0][:, 1]
    ground[0][:, 2] = 0.25 * np.sin(x * 0.5) * np.cos(y * 0.4) + rng.normal(0, 0.02, len(x))
    add(ground, material("moss", lambda tree: tk.ramp(tree, tk.noise(tree, 1.2), [
        (0.35, (0.05, 0.035, 0.02)), (0.65, (0.06, 0.09, 0.02))]), 0.95, bump=0.8), True)
    bark = material("bark", (0.17, 0.12, 0.09), 0.9, grain=(7, 0.7), bump=1.0)
    spots = np.column_stack([rng.uniform(-13, 13, 110), rng.uniform(3, 30, 110)])
    spots = spots[np.abs(spots[:, 0] - 0.06 * spots[:, 1]) > 0.9]
    for x, y in spots:
        size = rng.uniform(0.12, 0.34)
        height = np.linspace(-0.3, 11, 12)
        bend = np.cumsum(rng.normal(0, 0.06, (12, 2)), 0)
        points = np.column_stack([x + bend[:, 0], y + bend[:, 1], height])
        radii = size * (1 + 0.9 * np.exp(-2.5 * (height + 0.3))) * (1 - 0.05 * height)
        add(tk.tube(points, radii, 14), bark, True)
        for _ in range(5):
            start = points[rng.integers(4, 11)]
            way = np.array([rng.normal(), rng.normal(), 0.4])
            twig = start + np.linspace(0, 1, 6)[:, None] * way * rng.uniform(0.8, 1.6)
            add(tk.tube(twig, np.linspace(0.05, 0.01, 6), 6), bark, True)
    fern = tk.thin("fern", (0.09, 0.2, 0.03), (0.2, 0.35, 0.05), 0.4, tinted=True)
    count = 9000
    base = np.column_stack([rng.uniform(-7, 7, count), rng.uniform(1.2, 18, count)])
    height = 0.25 * np.sin(base[:, 0] * 0.5) * np.cos(base[:, 1] * 0.4)
    clump = rng.integers(0, 260, count)
    centres = np.column_stack([rng.uniform(-7, 7, 260), rng.uniform(2, 18, 260)])
    base = centres[clump] + rng.normal(0, 0.18, (count, 2))
    height = 0.25 * np.sin(base[:, 0] * 0.5) * np.cos(base[:, 1] * 0.4) + 0.12
    blade = tk.copies(tk.box(0.34, 0.03, 0.002), np.column_stack([base, height]),
                      tk.random_turns(rng, count, rng.uniform(0.5, 1.1, count)))
    add(blade, fern, tint=tints(rng, count, 6, 0.4, 1.0, 0.3))
    stone = material("rock", (0.3, 0.3, 0.28), 0.9, tinted=True, grain=(8, 0.5), bump=0.7)
    rock = tk.sphere(1.0, 9, 12)
    spots = np.column_stack([rng.uniform(-4, 4, 60), rng.uniform(2, 14, 60), np.zeros(60)])
    add(tk.copies(rock, spots, tk.random_turns(rng, 60, rng.gamma(3, 0.07, 60))), stone, True,
        tints(rng, 60, len(rock[1])))
    coat = material("coat", (0.6, 0.06, 0.05), 0.8, grain=(20, 0.3))
    walker = tk.join([place(tk.lathe([(0, 0.8), (0.3, 0.75), (0.22, 1.3), (0.24, 1.45),
                                      (0.08, 1.55), (0, 1.55)])),
                      place(tk.sphere(0.13, 12, 16), (0, 0, 1.66)),
                      place(tk.rod(0.08, 0.8), (-0.1, 0.07, 0)),
                      place(tk.rod(0.08, 0.8), (0.1, -0.07, 0))])
    move(add(walker, coat, True), (0.5, 7.5, 0.05), (0.03, 0.05, 0.0), (0, 0, 0.03))
    lantern = add(tk.sphere(0.07), tk.glow("lantern", (1.0, 0.6, 0.25), 40.0), True)
    move(lantern, (0.87, 7.4, 0.85), (0.03, 0.05, 0.01))
    bird = tk.join([place(tk.box(0.4, 0.1, 0.02), (0.2, 0, 0), tk.turn(y=-0.4)),
                    place(tk.box(0.4, 0.1, 0.02), (-0.2, 0, 0), tk.turn(y=0.4))])
    for across, up in ((-0.9, 2.9), (-0.4, 3.2), (-1.3, 3.3)):
        move(add(bird, bark), (across, 9, up), (0.12, 0.0, 0.02), (0, 0.05, 0))
    camera((0.2, -0.6, 1.55), (0.55, 8, 1.75), 30, (0.015, 0.05, 0.003), (0.02, 0.05, 0))


# Night street -------------------------------------------------------------------------------------


def street(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.5, (0.03, 0.03, 0.06)), (0.6, (0.012, 0.015, 0.04)), (1, (0, 0, 0.01))],
                    0.6)
    asphalt, tree, output = tk.new_material("asphalt")
    wet = tk.ramp(tree, tk.noise(tree, 0.9), [(0.42, (0.06,) * 3), (0.6, (0.45,) * 3)])
    rough = tk.node(tree, "ShaderNodeBump", {"Height": tk.noise(tree, 40.0), "Strength": 0.25,
                                             "Distance": 0.01}).outputs[0]
    shader = tk.node(tree, "ShaderNodeBsdfPrincipled", {"Base Color": (0.03, 0.03, 0.033),
                                                        "Roughness": wet, "Normal": rough})
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    add(place(tk.grid(2, 2, 9, 90), (0, 40, 0)), asphalt)
    paving = material("paving", lambda tree: tk.tiles(
        tree, 0.4, ((0.22, 0.2, 0.19), (0.15, 0.14, 0.14)), (0.05, 0.05, 0.05)), 0.45)
    for side in (-1, 1):
        add(place(tk.box(3, 90, 0.16), (side * 6, 40, 0.08)), paving)
    paint = material("paint", (0.75, 0.75, 0.7), 0.5, grain=(3, 0.6))
    add(tk.join([place(tk.box(0.14, 1.6, 0.004), (0, 1 + 3.6 * k, 0.003)) for k in range(18)]),
        paint)

    lit: list[tk.Shape] = []
    panes: list[tk.Shape] = []
    plain: list[tk.Shape] = []
    facade = material("facade", lambda tree: tk.tiles(
        tree, 0.12, ((0.28, 0.13, 0.09), (0.36, 0.19, 0.13)), (0.3, 0.28, 0.25),
        (np.pi / 2, 0, np.pi / 2), 2.4), 0.85, tinted=True, bump=0.3)
    for side in (-1, 1):
        y = -2.0
        while y < 70:
            width, height = rng.uniform(5, 9), rng.uniform(8, 17)
            plain.append(place(tk.box(6, width - 0.15, height),
                               (side * 10.5, y + width / 2, height / 2)))
            plain.append(place(tk.box(0.5, width, 0.35), (side * 7.5, y + width / 2, height)))
            for floor in np.arange(3.8, height - 1.5, 2.9):
                for across in np.arange(y + 0.9, y + width - 0.8, 1.5):
                    window = place(tk.box(0.08, 0.85, 1.5), (side * 7.48, across, floor + 0.4))
                    (lit if rng.random() < 0.4 else panes).append(window)
                    plain.append(place(tk.box(0.24, 1.05, 0.1), (side * 7.46, across, floor - 0.4)))
            lit.append(place(tk.box(0.08, width - 1.6, 1.9), (side * 7.48, y + width / 2, 1.45)))
            y += width
    add(tk.join(plain), facade, tint=tints(rng, len(plain), 6, 0.5))
    warm = rng.uniform(0.1, 1.0, (len(lit), 1)) * np.array([1.0, 0.75, 0.5])
    add(tk.join(lit), tk.glow("windows", (1.0, 0.9, 0.8), 2.2, True), tint=np.repeat(
        warm * rng.uniform(0.7, 1.0, warm.shape), 6, 0))
    add(tk.join(panes), material("pane", (0.02, 0.025, 0.03), 0.05))

    bulb = tk.sphere(0.045, 6, 8)
    spots, colours = [], []
    for y in np.arange(3, 60, 2.7):
        across = np.linspace(-7.3, 7.3, 34)
        drop = 0.9 * (1 - (across / 7.3) ** 2)
        spots.append(np.column_stack([across, y + 0.4 * np.sin(across), 5.4 - drop]))
        wire = spots[-1] + (0, 0, 0.05)
        add(tk.tube(wire, np.full(34, 0.012), 5), material("wire", (0.02, 0.02, 0.02)))
        palette = np.array([[1, 0.62, 0.3], [1, 0.25, 0.12], [0.3, 0.7, 1.0], [0.4, 1, 0.45],
                            [1, 0.75, 0.2]])
        colours.append(palette[rng.integers(0, 5, 34)])
    places, tinted = np.concatenate(spots), np.concatenate(colours)
    bulbs = tk.copies(bulb, places, tk.random_turns(rng, len(places), np.ones(len(places))))
    add(bulbs, tk.glow("bulbs", (1, 1, 1), 9.0, True), True, np.repeat(tinted, len(bulb[1]), 0))

    iron = material("iron", (0.04, 0.04, 0.045), 0.4, metallic=0.6)
    for k, y in enumerate(np.arange(4, 64, 5.5)):
        side = -1 if k % 2 else 1
        add(place(tk.lathe([(0, 0), (0.14, 0), (0.1, 0.5), (0.05, 0.7), (0.045, 3.9), (0.2, 3.95),
                            (0, 4)]), (side * 5.1, y, 0.16)), iron, True)
        add(place(tk.sphere(0.17), (side * 5.1, y, 4.3)), tk.glow("globe", (1, 0.72, 0.42), 30.0))
    signs = [((0.9, 0.05, 0.2), -1, 7.5, 4.4), ((0.1, 0.8, 0.9), 1, 10.5, 3.9),
             ((0.95, 0.55, 0.05), -1, 14.5, 5.2), ((0.5, 0.1, 0.95), 1, 17.0, 5.5)]
    for colour, side, y, z in signs:
        bars = [place(tk.box(0.05, 0.05, rng.uniform(0.15, 0.4)), (side * (6.1 + 0.18 * k), y, z))
                for k in range(6)]
        add(tk.join(bars), tk.glow("neon", colour, 18.0))
        add(place(tk.box(1.3, 0.1, 0.6), (side * 6.55, y + 0.1, z)), iron)

    def car(paint_colour: tk.Colour) -> list[bpy.types.Object]:
        body = tk.join([place(tk.box(1.75, 4.1, 0.55), (0, 0, 0.55)),
                        place(tk.box(1.55, 2.3, 0.5), (0, 0.15, 1.05))])
        wheel = place(tk.rod(0.33, 0.22, 20), (0, 0, 0), tk.turn(y=np.pi / 2))
        wheels = tk.join([place(wheel, (x, y, 0.33)) for x in (-0.95, 0.72) for y in (-1.3, 1.3)])
        red = tk.join([place(tk.box(0.35, 0.04, 0.14), (x, -2.06, 0.65)) for x in (-0.6, 0.6)])
        white = tk.join([place(tk.box(0.3, 0.04, 0.16), (x, 2.06, 0.6)) for x in (-0.6, 0.6)])
        parts = [add(body, material("car", paint_colour, 0.25, coat_weight=1.0, grain=(2, 0.05))),
                 add(wheels, material("tyre", (0.02, 0.02, 0.02), 0.7)),
                 add(red, tk.glow("tail", (1.0, 0.03, 0.02), 14.0)),
                 add(white, tk.glow("head", (1.0, 0.95, 0.85), 60.0))]
        body_object = parts[0]
        bevel = body_object.modifiers.new("bevel", "BEVEL")
        bevel.width, bevel.segments = 0.13, 3
        return parts
    for part in car((0.35, 0.02, 0.02)):
        move(part, (1.3, 9.5, 0), (0.0, 0.22, 0.0))
    for part in car((0.5, 0.5, 0.55)):
        part.rotation_euler = (0, 0, np.pi)
        move(part, (-1.6, 17, 0), (0.0, -0.3, 0.0))
    for k, y in enumerate((6.5, 12.5, 19, 25)):
        for part in car(((0.05, 0.08, 0.2), (0.1, 0.1, 0.1), (0.4, 0.35, 0.1))[k % 3]):
            part.location = (3.5, y, 0)
    dark = material("people", (0.06, 0.06, 0.09), 0.8, tinted=True)
    figure = tk.join([tk.lathe([(0, 0), (0.12, 0), (0.2, 0.8), (0.24, 1.35), (0.07, 1.5),
                                (0, 1.5)]),
                      place(tk.sphere(0.12, 8, 10), (0, 0, 1.62))])
    for _ in range(10):
        person = add(figure, dark, True, tints(rng, len(figure[1]), 1, 0.3, 1.0, 0.5))
        move(person, (rng.choice([-1, 1]) * rng.uniform(4.7, 6.5), rng.uniform(6, 22), 0.16),
             (0, rng.choice([-0.05, 0.05]), 0))
    camera((-0.6, -1.5, 1.7), (-0.1, 12, 2.3), 32, (0.01, 0.09, 0.004), (0.0, 0.09, 0))


# Leaves -------------------------------------------------------------------------------------------


def leaves(rng: np.random.Generator) -> None:
    tk.sky(0.1, 35, 150, sun=False)
    lamp("SUN", (0, 0, 9), 5.0, (1.0, 0.92, 0.78), 0.009, target=(-2.2, -3.0, 6.6))

    def blade(tree: tk.Tree) -> tk.Value:
        return tk.node(tree, "ShaderNodeTexCoord").outputs["Generated"]
    bark = material("bark", (0.2, 0.14, 0.1), 0.9, grain=(10, 0.7), bump=1.0)
    tips, branches = [], []

    def grow(start: np.ndarray, way: np.ndarray, length: float, size: float,
             depth: int) -> None:
        steps = np.linspace(0, 1, 7)[:, None]
        bend = rng.normal(0, 0.12, 3) * length
        points = start + steps * way * length + steps ** 2 * bend
        branches.append(tk.tube(points, np.linspace(size, size * 0.6, 7), 7))
        if depth >= 3:
            tips.append(points[2:])
        if depth == 4:
            return
        for _ in range(4 if depth else 6):
            new = way + rng.normal(0, 0.55, 3)
            new[2] += 0.12
            at = points[rng.integers(3, 7)]
            grow(at, new / np.linalg.norm(new), length * rng.uniform(0.55, 0.75), size * 0.55,
                 depth + 1)
    grow(np.array([-1.3, 4.6, -1.5]), np.array([0.15, -0.05, 1.0]), 2.6, 0.1, 0)
    grow(np.array([2.3, 6.5, -1.5]), np.array([-0.25, 0, 1.0]), 2.9, 0.13, 0)
    add(tk.join(branches), bark, True)
    ends = np.concatenate(tips)
    count = 42000
    spots = ends[rng.integers(0, len(ends), count)] + rng.normal(0, 0.075, (count, 3))
    outline = np.array([[0, 0, 0], [0.3, -0.24, 0.05], [0.65, -0.2, 0.06], [1.0, 0, 0.0],
                        [0.65, 0.2, 0.06], [0.3, 0.24, 0.05]])
    faces = np.array([[0, 1, 2, 3], [0, 3, 4, 5]])
    matrices = tk.random_turns(rng, count, rng.uniform(0.05, 0.11, count))
    shape = (outline, faces)
    sway = rng.normal(0, 0.006, (count, 3))
    shapes = []
    for frame in FRAMES:
        wind = 0.012 * np.sin(0.9 * frame + 1.3 * spots[:, :1] + 0.7 * spots[:, 2:]) * [1, 0.4, 0.2]
        twist = np.sin(1.1 * frame + 40 * sway[:, :1])
        shapes.append(tk.copies(shape, spots + wind + sway * twist, matrices))
    green = tk.thin("leaf", (0.07, 0.16, 0.025), (0.34, 0.55, 0.06), 0.42, tinted=True)
    tint = tints(rng, count, 2, 0.55, 1.0, 0.25)
    tk.deform(add(shapes[0], green, tint=tint), [vertices for vertices, _ in shapes])

    def spray(tree: tk.Tree) -> tk.Value:
        """Rows of small leaflets cut out of a card by its alpha."""
        where = tk.node(tree, "ShaderNodeSeparateXYZ", {0: tk.coordinates(tree, source="UV")})
        u = tk.calculate(tree, "PINGPONG", tk.calculate(tree, "MULTIPLY", where.outputs[0], 7.0),
                         0.5)
        v = tk.calculate(tree, "ABSOLUTE", tk.calculate(tree, "SUBTRACT", where.outputs[1], 0.5))
        wide = tk.calculate(tree, "MULTIPLY_ADD", v, -0.8, 0.42)
        return tk.calculate(tree, "LESS_THAN", u, wide)
    fern = tk.thin("card", (0.1, 0.17, 0.02), (0.45, 0.5, 0.06), 0.45, alpha=spray, tinted=True)
    count = 2600
    spots = ends[rng.integers(0, len(ends), count)] + rng.normal(0, 0.12, (count, 3))
    card = (np.array([[0, -0.3, 0], [1, -0.3, 0.1], [1, 0.3, 0.1], [0, 0.3, 0]]),
            np.array([[0, 1, 2, 3]]))
    cards = add(tk.copies(card, spots, tk.random_turns(rng, count, rng.uniform(0.12, 0.25, count))),
                fern, tint=tints(rng, count, 1, 0.6, 1.0, 0.25))
    layer = cards.data.uv_layers.new(name="UVMap")
    corners = np.tile([[0, 0], [1, 0], [1, 1], [0, 1]], (count, 1)).astype(np.float32)
    layer.data.foreach_set("uv", corners.ravel())
    ground = tk.grid(120, 120, 60, 60)
    ground[0][:, 2] = -1.6 + rng.normal(0, 0.03, len(ground[0]))
    add(ground, material("meadow", (0.12, 0.2, 0.04), 0.9, grain=(2, 0.6)), True)
    hill = tk.sphere(9.0, 30, 50)
    woods = material("woods", (0.06, 0.11, 0.04), 0.95, grain=(3.0, 0.8), bump=1.0)
    for x, y in ((-9, 34), (7, 40), (22, 38)):
        add(place(hill, (x, y, -5.0), np.diag([1.6, 0.8, 0.75])), woods, True)
    bird = tk.join([place(tk.box(0.22, 0.07, 0.012), (0.1, 0, 0), tk.turn(y=-0.5)),
                    place(tk.box(0.22, 0.07, 0.012), (-0.1, 0, 0), tk.turn(y=0.5))])
    dark = material("bird", (0.03, 0.03, 0.03))
    for across, up in ((0.15, 1.9), (0.7, 2.3), (1.2, 1.75)):
        move(add(bird, dark), (across, 6.0, up), (0.07, 0.0, 0.015), (0, 0.1, 0))
    camera((0.3, -0.4, 0.6), (0.15, 5, 1.75), 32, (0.02, 0.012, 0.006))


# Falling snow -------------------------------------------------------------------------------------


def snow(rng: np.random.Generator) -> None:
    tk.gradient_sky([(0.45, (0.2, 0.24, 0.34)), (0.55, (0.24, 0.27, 0.36)), (1, (0.1, 0.13, 0.2))],
                    0.5)
    white = material("snow", (0.82, 0.85, 0.9), 0.65, grain=(3, 0.08), bump=0.3)
    ground = tk.grid(260, 260, 40, 40)
    x, y = ground[0][:, 0], ground[0][:, 1]
    ground[0][:, 2] = 0.1 * np.sin(x * 0.9 + 0.4 * y) + 0.07 * np.sin(1.7 * y) - 0.1
    path = np.exp(-((x - 0.5 * np.sin(0.4 * y)) / 0.5) ** 2)
    ground[0][:, 2] -= 0.12 * path + rng.normal(0, 0.012, len(x)) * path
    add(ground, white, True)
    logs = wooden_logs(rng)
    for k in range(9):
        add(place(tk.rod(0.14, 3.6, 14), (-2.6, 7.0, 0.1 + 0.25 * k), tk.turn(y=np.pi / 2)), logs,
            True)
        add(place(tk.rod(0.14, 3.4, 14), (1.0, 7.0, 0.1 + 0.25 * k), tk.turn(x=-np.pi / 2)), logs,
            True)
    roof = [place(tk.box(4.4, 2.4, 0.12), (-0.8, 6.7 + 2.0 * side, 2.75), tk.turn(x=-0.62 * side))
            for side in (0, 1)]
    roof[0] = place(tk.box(4.4, 2.4, 0.12), (-0.8, 7.0, 2.75), tk.turn(x=0.62))
    add(tk.join(roof), logs)
    add(place(tk.box(4.5, 2.3, 0.2), (-0.8, 6.95, 2.93), tk.turn(x=0.62)), white)
    warm = tk.glow("pane", (1.0, 0.55, 0.2), 5.0)
    for at in (-1.8, 0.1):
        add(place(tk.box(0.6, 0.05, 0.7), (at, 6.84, 1.25)), warm)
        bars = [place(tk.box(0.04, 0.06, 0.7), (at, 6.81, 1.25)),
                place(tk.box(0.6, 0.06, 0.04), (at, 6.81, 1.25))]
        add(tk.join(bars), logs)
        add(place(tk.box(0.7, 0.16, 0.07), (at, 6.78, 0.92)), white)
    add(place(tk.box(0.7, 0.06, 1.6), (-0.85, 6.84, 0.75)),
        material("door", (0.3, 0.05, 0.04), 0.5))
    iron = material("iron", (0.05, 0.05, 0.06), 0.5)
    for across, along in ((1.35, 4.6), (-1.5, 3.4)):
        add(place(tk.rod(0.035, 2.0), (across, along, -0.1)), iron, True)
        globe = place(tk.sphere(0.1), (across, along, 1.98))
        add(globe, tk.glow("globe", (1.0, 0.66, 0.32), 45.0), True)
        cap = tk.lathe([(0.17, 0), (0.1, 0.09), (0, 0.12)])
        add(place(cap, (across, along, 2.08)), white, True)
    needle = (np.array([[0, -0.035, 0], [1, -0.012, -0.12], [1, 0.012, -0.12], [0, 0.035, 0]]),
              np.array([[0, 1, 2, 3]]))
    pine = material("pine", (0.03, 0.07, 0.035), 0.8, tinted=True)
    for across, along, tall in (
        (-3.4, 6.0, 4.0), (2.3, 6.3, 3.6), (3.3, 8.5, 5.0), (-2.2, 9.5, 5.5), (1.6, 10.5, 5.2),
        (0.2, 11.5, 6.0), (-5.0, 9.0, 6.0), (1.9, 3.6, 1.5)
    ):
        add(place(tk.rod(0.03 * tall, 0.9 * tall), (across, along, 0)), logs, True)
        count = 1900
        up = rng.uniform(0.12, 1, count)
        angle = rng.uniform(0, 2 * np.pi, count)
        spots = np.column_stack([np.full(count, across), np.full(count, along), up * tall])
        turns = tk.about_z(angle, (1 - up + 0.05) * tall * 0.3 * rng.uniform(0.5, 1.1, count))
        add(tk.copies(needle, spots, turns), pine, tint=tints(rng, count, 1))
        loaded = spots[::2] + (0, 0, 0.025 * tall ** 0.5)
        add(tk.copies(needle, loaded, turns[::2] * 0.97), white)
    rails = []
    for k in range(16):
        foot = (-4 + 0.5 * k, 5.6 + 0.1 * np.sin(k), 0)
        rails.append(place(tk.box(0.07, 0.05, 0.9), np.add(foot, (0, 0, 0.35))))
    rails += [place(tk.box(8, 0.03, 0.06), (0, 5.63, z)) for z in (0.35, 0.65)]
    add(tk.join([rail for rail in rails if abs(rail[0][:, 0].mean() + 0.6) > 0.3]), logs)
    ball = tk.sphere(1.0, 16, 20)
    add(tk.join([place(ball, (0.62, 4.4, 0.2), np.eye(3) * 0.34),
                 place(ball, (0.62, 4.4, 0.68), np.eye(3) * 0.25),
                 place(ball, (0.62, 4.4, 1.04), np.eye(3) * 0.17)]), white, True)
    add(place(tk.lathe([(0.01, 0), (0, 0.2)], 10), (0.62, 4.25, 1.04), tk.turn(x=np.pi / 2)),
        material("carrot", (0.85, 0.3, 0.04)), True)
    add(place(tk.lathe([(0.2, 0), (0.13, 0.02), (0.12, 0.2), (0, 0.2)]), (0.62, 4.4, 1.17)), iron,
        True)
    scarf = material("scarf", (0.6, 0.04, 0.05), 0.9)
    add(place(tk.torus(0.17, 0.045), (0.62, 4.4, 0.9)), scarf, True)
    walker = tk.join([tk.lathe([(0, 0.1), (0.18, 0.1), (0.22, 0.6), (0.2, 1.3), (0.07, 1.45),
                                (0, 1.45)]), place(tk.sphere(0.13, 12, 16), (0, 0, 1.55))])
    move(add(walker, material("coat", (0.06, 0.12, 0.3), 0.9), True), (-1.15, 5.0, -0.15),
         (0.03, 0.02, 0))
    count = 5200
    flakes = np.column_stack([rng.uniform(-3.2, 3.2, count), rng.uniform(-0.6, 8, count),
                              rng.uniform(-0.2, 4.0, count)])
    shape = tk.sphere(1.0, 4, 6)
    sizes = tk.random_turns(rng, count, rng.gamma(4, 0.0016, count))
    fall = np.column_stack([rng.normal(0.06, 0.03, count), rng.normal(0, 0.02, count),
                            rng.normal(-0.16, 0.03, count)])
    first, last = (tk.copies(shape, flakes + way, sizes) for way in (-fall / 2, fall / 2))
    tk.deform_straight(add(first, white, True), first[0], last[0])
    camera((0.1, -1.2, 1.5), (-0.15, 6, 1.3), 30, (0.012, 0.02, 0.003))


def wooden_logs(rng: np.random.Generator) -> bpy.types.Material:
    return material("logs", lambda tree: tk.wood(tree, 6.0, (0.22, 0.13, 0.07), (0.1, 0.05, 0.025)),
                    0.85, bump=0.5)


KINDS: dict[str, Callable[[np.random.Generator], None]] = {
    "water": water, "smoke": smoke, "fog": fog, "street": street, "leaves": leaves, "snow": snow,
    "glass": indoors.glass, "skin": indoors.skin, "print": indoors.printed,
    "indirect": indoors.indirect, "cloth": indoors.cloth, "dof": indoors.depth_of_field,
    "blur": indoors.motion_blur,
}
BLURRED = frozenset({"blur"})
"""Kinds with motion blur, where Blender writes no vectors."""


def build(kind: str) -> bpy.types.Scene:
    """A scene with its camera; the same every time."""
    if kind not in KINDS:
        raise ValueError(f"no scene of kind {kind!r}: take some of {', '.join(KINDS)}")
    scene = tk.empty_scene()
    KINDS[kind](np.random.default_rng(list(kind.encode())))
    return scene
