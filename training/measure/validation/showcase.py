"""Render the gallery's product shot in Cycles; runs in Blender's Python, from the repository's
root.

    python training/measure/validation/showcase.py FLIGHT_HELMET/scene.gltf ENVIRONMENT.hdr OUT

The model is "Flight Helmet" by Microsoft (CC0, glTF sample models), which no network was trained
on; the light an environment of Poly Haven (CC0). Writes OUT/noisy.####.exr as Blender writes it
with Denoising Data and the passes that postfx reads, and OUT/reference.####.exr for one frame.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from training.measure.validation import toolkit  # noqa: E402
from training.measure.validation.render_scenes import choose_passes, pair, set_up, use_device  # noqa: E402

START = (0.62, -1.30, 0.62)
TARGET = (0.02, 0.0, 0.44)
"""Where the camera begins and what it looks at, metres."""
LENS = 55.0
"""Focal length, millimetres."""
END = 9
"""Frame in which the camera stops."""
GLIDE = (0.008, 0.002, 0.0)
"""How far the camera goes in a frame, metres."""


def build(model: Path, environment: Path) -> bpy.types.Scene:
    """The helmet on a wooden table, lit by the environment."""
    scene = toolkit.empty_scene()
    bpy.ops.import_scene.gltf(filepath=str(model))
    top, tree, output = toolkit.new_material("table")
    planks = toolkit.wood(tree, 6.0, (0.30, 0.17, 0.09), (0.12, 0.06, 0.03))
    surface = toolkit.node(tree, "ShaderNodeBsdfPrincipled",
                           {"Base Color": planks, "Roughness": 0.35})
    tree.links.new(surface.outputs[0], output.inputs["Surface"])
    toolkit.add(toolkit.grid(2, 2, 8.0, 8.0), top)
    background = toolkit.background_tree()
    picture = toolkit.node(background, "ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(str(environment.resolve()))
    toolkit.finish_background(background, picture.outputs["Color"], 1.0)
    glide()
    return scene


def glide() -> None:
    """A camera that travels straight on and keeps the helmet in its middle."""
    eye = toolkit.camera(START, TARGET, LENS, (0.0, 0.0, 0.0))
    eye.animation_data_clear()
    for number in (0, END):
        eye.location = Vector(START) + number * Vector(GLIDE)
        eye.rotation_quaternion = (Vector(TARGET) - eye.location).to_track_quat("-Z", "Y")
        eye.keyframe_insert("location", frame=number)
        eye.keyframe_insert("rotation_quaternion", frame=number)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("environment", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=END - 1, help=f"at most {END - 1}")
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--reference", type=int, default=512, help="samples; 0: none")
    parser.add_argument("--reference-frame", type=int, default=8)
    parser.add_argument("--size", type=pair, default=(960, 540))
    parser.add_argument("--device", default="CPU", help="CPU (default), CUDA, OPTIX or HIP")
    args = parser.parse_args()
    scene = build(args.model, args.environment)
    use_device(scene, args.device)
    set_up(scene, args.size, args.size)
    # with it Blender 5.0.1 mixes up textures after passes change
    scene.render.use_persistent_data = False
    wanted = [(number, args.samples, "noisy") for number in range(1, args.frames + 1)]
    if args.reference:
        wanted.append((args.reference_frame, args.reference, "reference"))
    for number, samples, kind in wanted:
        choose_passes(scene.view_layers[0], kind == "reference", kind == "noisy")
        scene.render.resolution_x, scene.render.resolution_y = args.size
        scene.cycles.samples = samples
        scene.cycles.seed = number if kind == "noisy" else 1000
        scene.frame_set(number)
        scene.render.filepath = str((args.out / f"{kind}.{number:04}.exr").resolve())
        bpy.ops.render.render(write_still=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
