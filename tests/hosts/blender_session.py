"""What a user does in Blender, without a window: python blender_session.py EXTENSION.zip FOLDER
COMMAND.

Prints one JSON object on the last line.
"""

import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

EXTENSION, FOLDER, COMMAND = sys.argv[1:]
found = {"version": bpy.app.version_string}


def attempt(operator: Any, **options: Any) -> str:
    """An operator's answer, or the error that it reports."""
    try:
        return next(iter(operator(**options)))
    except RuntimeError as error:
        return str(error).strip().removeprefix("Error: ")


bpy.ops.extensions.package_install_files(filepath=EXTENSION, repo="user_default",
                                         enable_on_install=True)
name = next(name for name in bpy.context.preferences.addons.keys() if name.endswith(".postfx"))
preferences = bpy.context.preferences.addons[name].preferences
scene = bpy.context.scene
render = scene.render
render.filepath = str(Path(FOLDER) / "shot" / "box_")
render.resolution_x, render.resolution_y, render.resolution_percentage = 48, 32, 100
scene.frame_start, scene.frame_end = 1, 2
render.engine = "BLENDER_WORKBENCH"
found["wrong engine"] = attempt(bpy.ops.postfx.set_up)
render.engine, scene.cycles.samples, scene.cycles.use_adaptive_sampling = "CYCLES", 4, False
render.threads_mode, render.threads = "FIXED", 2
cube = bpy.data.objects["Cube"]
cube.keyframe_insert("location", index=0, frame=1)
cube.location.x = 0.3
cube.keyframe_insert("location", index=0, frame=2)
found["set up"] = attempt(bpy.ops.postfx.set_up)
found["not rendered"] = attempt(bpy.ops.postfx.denoise)
bpy.ops.render.render(animation=True)
preferences.command = "/nowhere/postfx"
found["no command"] = attempt(bpy.ops.postfx.denoise)
preferences.command = COMMAND
scene.postfx.model, scene.postfx.scale, scene.postfx.both_ways = "s", 2.0, True
found["denoise"] = attempt(bpy.ops.postfx.denoise)
image = next(image for image in bpy.data.images if "denoised" in image.name)
found["image"] = [image.name, image.source]
found["files"] = sorted(path.name for path in (Path(FOLDER) / "shot").iterdir() if path.is_file())
scene.frame_set(2)
scene.postfx.strength = 0.0
found["frame"] = attempt(bpy.ops.postfx.denoise, whole=False)
scene.postfx.look = "agx"
found["picture"] = attempt(bpy.ops.postfx.denoise, whole=False)
found["shown"] = "box_denoised_0002.png" in bpy.data.images
scene.postfx.look = "NONE"
Path(FOLDER, "shot", "box_0002.exr").write_bytes(b"no picture")
found["broken"] = attempt(bpy.ops.postfx.denoise, whole=False)

module: Any = sys.modules[name]
found["options"] = {}
for preset in ("NONE", "preview", "final", "animation"):
    scene.postfx.preset = preset
    found["options"][preset] = module.options_of(scene.postfx, whole=False)[4:]
scene.postfx.preset = "NONE"

# Without a window there are no events: these are handed to the operator's function.
preferences.command, module.PLACES = "", (Path(COMMAND),)
path = os.environ.pop("PATH")
found["place"] = module.find_command(bpy.context)
os.environ["PATH"] = path
job = module.Job([COMMAND], str(Path(FOLDER) / "shot" / "box_####.exr"),
                 str(Path(FOLDER) / "stopped_####.exr"), "1", ["--model", "s"])
job.stop()
job.wait()
found["stopped"] = [job.stopped, job.running, job.done()]
said, ended = [], []
window = SimpleNamespace(
    window_manager=SimpleNamespace(progress_update=lambda part: said.append(round(part, 2))),
    workspace=SimpleNamespace(status_text_set=said.append))
job = module.Job([COMMAND], str(Path(FOLDER) / "shot" / "box_####.exr"),
                 str(Path(FOLDER) / "seen_####.exr"), "1", ["--model", "s"])
operator = SimpleNamespace(_job=job, cancel=lambda context: ended.append("cancel"),
                           _end=lambda context: {"FINISHED"})
answers = [module.Denoise.modal(operator, window, SimpleNamespace(type=kind))
           for kind in ("MOUSEMOVE", "TIMER")]
job.wait()
answers.append(module.Denoise.modal(operator, window, SimpleNamespace(type="TIMER")))
found["modal"] = [[next(iter(answer)) for answer in answers], said, ended]
bpy.ops.preferences.addon_disable(module=name)
found["disabled"] = not hasattr(bpy.types.Scene, "postfx")
print("\n" + json.dumps(found))
