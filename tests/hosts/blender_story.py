"""An artist's first hour, without a window: python blender_story.py EXTENSION.zip FOLDER COMMAND.

A scene with two light groups is set up, rendered and denoised by the extension; the compositor then
shows Combined and a light group of the result. Prints one JSON object on the last line.
"""

import json
import sys
from pathlib import Path

import bpy

EXTENSION, FOLDER, COMMAND = sys.argv[1:]
FRAMES, SIZE = 4, (96, 64)
found = {}

bpy.ops.extensions.package_install_files(filepath=EXTENSION, repo="user_default",
                                         enable_on_install=True)
name = next(name for name in bpy.context.preferences.addons.keys() if name.endswith(".postfx"))
bpy.context.preferences.addons[name].preferences.command = COMMAND
scene, layer = bpy.context.scene, bpy.context.view_layer
render = scene.render
render.engine, scene.cycles.samples, scene.cycles.use_adaptive_sampling = "CYCLES", 4, False
render.threads_mode, render.threads = "FIXED", 2
render.filepath = str(Path(FOLDER) / "shot" / "torus_")
render.resolution_x, render.resolution_y, render.resolution_percentage = *SIZE, 100
scene.frame_start, scene.frame_end = 1, FRAMES
bpy.ops.mesh.primitive_plane_add(size=20, location=(0, 0, -1))
bpy.ops.mesh.primitive_torus_add(location=(1.5, 1, 0))
torus = bpy.context.object
torus.keyframe_insert("location", index=0, frame=1)
torus.location.x = 2.5
torus.keyframe_insert("location", index=0, frame=FRAMES)
bpy.ops.object.light_add(type="AREA", location=(-3, -2, 4))
for group, lamp in (("key", bpy.data.objects["Light"]), ("fill", bpy.context.object)):
    layer.lightgroups.add(name=group)
    lamp.lightgroup = group
scene.world.lightgroup, bpy.context.object.data.energy = "fill", 300
found["set up"] = next(iter(bpy.ops.postfx.set_up()))
found["seeds"] = scene.cycles.use_animated_seed
bpy.ops.render.render(animation=True)
found["check"] = next(iter(bpy.ops.postfx.check()))
found["findings"] = scene.postfx.findings
scene.postfx.model, scene.postfx.parts = "s", True
found["denoise"] = next(iter(bpy.ops.postfx.denoise()))
found["said"] = scene.postfx.findings

tree = bpy.data.node_groups.new("show", "CompositorNodeTree")
scene.compositing_node_group = tree
tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
shown, node = tree.nodes.new("NodeGroupOutput"), tree.nodes.new("CompositorNodeImage")
node.image = bpy.data.images.load(str(Path(FOLDER) / "shot" / "torus_denoised_0003.exr"))
found["passes"] = [socket.name for socket in node.outputs]
settings = render.image_settings
if "media_type" in settings.bl_rna.properties:
    settings.media_type = "IMAGE"
settings.file_format, settings.color_depth = "OPEN_EXR", "32"
for socket in ("Combined", "Combined_key"):
    tree.links.new(node.outputs[socket], shown.inputs["Image"])
    render.filepath = str(Path(FOLDER) / f"{socket}.exr")
    bpy.ops.render.render(write_still=True)
print("\n" + json.dumps(found))
