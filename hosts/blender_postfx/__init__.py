"""Denoise and upscale what Cycles rendered, from Blender's render properties.

The work is done by the command `postfx` in a process of its own: nothing is installed into Blender, and Blender
stays usable meanwhile. Results stand beside the render, as `<name>denoised_####.exr`.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy

MARK = "denoised_"
"""Before the number in the name of a result."""
TICK = 0.25
"""Seconds between two looks at the running process."""


class Job:
    """One run of the command.

    Attributes:
        total: frames that it will write.
        stopped: whether the user stopped it.
        output: the pattern of its files, with #### for the number.
    """

    def __init__(self, command: list[str], source: str, output: str, frames: str, options: list[str]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="postfx-")
        self._log, errors = Path(self._folder.name, "log"), Path(self._folder.name, "errors")
        self.output, self.total, self.stopped, self._errors = output, 0, False, errors
        words = [*command, "run", source, "-o", output, "--frames", frames, "--overwrite", "--log", str(self._log)]
        with errors.open("w") as file:
            self._process = subprocess.Popen([*words, *options], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                             stderr=file)

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def done(self) -> int:
        """How many frames are written."""
        lines = self._log.read_text().splitlines() if self._log.exists() else []
        events = [json.loads(line) for line in lines if line.endswith("}")]
        self.total = next((event["wanted"] for event in events if event["event"] == "begin"), 0)
        self.total = len(self.total) if isinstance(self.total, list) else int(self.total)
        return sum(event["event"] == "frame" for event in events)

    def stop(self) -> None:
        """Have the frame in work finished, then end; finished frames stay."""
        if self.running:
            self.stopped = True
            self._process.send_signal(signal.SIGTERM if sys.platform == "win32" else signal.SIGINT)

    def wait(self) -> None:
        self._process.wait()

    def fault(self) -> str:
        """What went wrong; empty if nothing did."""
        if self._process.returncode == 0:
            return ""
        lines = [line for line in self._errors.read_text(errors="replace").splitlines() if line.strip()]
        told = [line for line in lines if line.startswith("error")] or lines[-1:]
        return told[0] if told else f"postfx ended with code {self._process.returncode}"


class Settings(bpy.types.PropertyGroup):
    scale: bpy.props.FloatProperty(name="Scale", default=1.0, min=1.0, max=3.0, description="Output over render size")
    model: bpy.props.EnumProperty(name="Network", default="m", items=[
        ("s", "Small", "Fastest"), ("m", "Medium", "Recommended"), ("l", "Large", "Best")])
    strength: bpy.props.FloatProperty(name="Strength", default=1.0, min=0.0, max=1.0)


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="Command", subtype="FILE_PATH", description="The command postfx, such as /opt/venv/bin/postfx; empty: as "
        "the system finds it. Install it by: pip install postfx-render")

    def draw(self, context):
        self.layout.prop(self, "command")


def find_command(context) -> list[str]:
    """Words that start postfx. Raises LookupError with what to do when it is not there."""
    addon = context.preferences.addons.get(__package__)
    text = addon.preferences.command.strip() if addon else ""
    words = ([text] if Path(text).is_file() else shlex.split(text)) if text else ["postfx"]
    if shutil.which(words[0]) is None:
        raise LookupError(f"there is no command '{words[0]}': install it (pip install postfx-render) and name "
                          "it in the add-on's preferences")
    return words


def patterns(scene) -> tuple[str, str]:
    """Where the scene's frames are and where results go, with #### for the number."""
    path = Path(bpy.path.abspath(scene.render.frame_path(frame=scene.frame_start)))
    number = re.search(r"\d+(?=\D*$)", path.stem)
    if number is None:
        raise LookupError(f"the render's files have no frame number: {path}")
    before, hashes, after = path.stem[:number.start()], "#" * len(number[0]), path.stem[number.end():]
    return (str(path.with_name(f"{before}{hashes}{after}.exr")),
            str(path.with_name(f"{before}{MARK}{hashes}{after}.exr")))


def file_of(pattern: str, frame: int) -> Path:
    """A frame's file."""
    hashes = re.search("#+", pattern)[0]
    return Path(pattern.replace(hashes, f"{frame:0{len(hashes)}d}"))


class SetUp(bpy.types.Operator):
    """Render the passes that postfx reads, into multilayer EXR files, without Blender's own denoiser"""

    bl_idname, bl_label, bl_options = "postfx.set_up", "Set up passes", {"REGISTER", "UNDO"}

    def execute(self, context):
        scene = context.scene
        if scene.render.engine != "CYCLES":
            self.report({"ERROR"}, "postfx reads passes of Cycles: choose it as the render engine")
            return {"CANCELLED"}
        for layer in scene.view_layers:
            layer.use_pass_z = layer.use_pass_normal = layer.use_pass_vector = True
            layer.use_pass_diffuse_color = layer.use_pass_glossy_color = True
            layer.cycles.denoising_store_passes = True
        scene.cycles.use_denoising = False
        image = scene.render.image_settings
        if "media_type" in image.bl_rna.properties:  # since Blender 5
            image.media_type = "MULTI_LAYER_IMAGE"
        image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"  # half floats are too coarse for depth
        if scene.render.use_motion_blur:
            self.report({"WARNING"}, "with motion blur Cycles writes no vectors: frames are then denoised one by one")
        return {"FINISHED"}


class Denoise(bpy.types.Operator):
    """Denoise the frames that are rendered, and put the results beside them"""

    bl_idname, bl_label = "postfx.denoise", "Denoise"

    whole: bpy.props.BoolProperty(name="Whole sequence", default=True, description="Else the current frame alone")

    def invoke(self, context, event):
        if not self._begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK, window=context.window)
        manager.progress_begin(0, 1)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self._job.stop()
            context.workspace.status_text_set("postfx stops after the frame in work")
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        done = self._job.done()
        context.window_manager.progress_update(done / max(1, self._job.total))
        if self._job.running:
            context.workspace.status_text_set(f"postfx: {done} of {self._job.total or '?'} frames. Esc to stop")
            return {"RUNNING_MODAL"}
        self.cancel(context)
        return self._end(context)

    def cancel(self, context):
        """Blender ends, or the operator does."""
        self._job.stop()
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)

    def execute(self, context):
        """Without a window: wait until all is done."""
        if not self._begin(context):
            return {"CANCELLED"}
        self._job.wait()
        return self._end(context)

    def _begin(self, context) -> bool:
        scene, settings = context.scene, context.scene.postfx
        try:
            source, output = patterns(scene)
            wanted = range(scene.frame_start, scene.frame_end + 1, scene.frame_step) if self.whole \
                else [scene.frame_current]
            there = [frame for frame in wanted if file_of(source, frame).is_file()]
            if len(there) < len(wanted):
                missing = next(frame for frame in wanted if frame not in there)
                raise LookupError(f"frame {missing} is not rendered: there is no {file_of(source, missing)}")
            command = find_command(context)
        except LookupError as error:
            self.report({"ERROR"}, str(error))
            return False
        options = ["--scale", str(round(settings.scale, 3)), "--model", settings.model,
                   "--strength", str(round(settings.strength, 3))]
        self._frames = list(wanted)
        self._job = Job(command, source, output, ",".join(map(str, wanted)), options)
        return True

    def _end(self, context):
        fault, done = self._job.fault(), self._job.done()
        if self._job.stopped:
            self.report({"INFO"}, f"postfx was stopped: {done} of {len(self._frames)} frames are done")
            return {"CANCELLED"}
        if fault:
            self.report({"ERROR"}, f"{fault} ({done} of {len(self._frames)} frames are done)")
            return {"CANCELLED"}
        show(context, self._job.output, self._frames)
        self.report({"INFO"}, f"postfx: {done} frames, {self._job.output}")
        return {"FINISHED"}


def show(context, pattern: str, frames: list[int]) -> None:
    """The result as an image of the file, in open image editors and for the compositor."""
    image = bpy.data.images.load(str(file_of(pattern, frames[0])), check_existing=True)
    image.source = "SEQUENCE" if len(frames) > 1 else "FILE"
    image.reload()
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                space = area.spaces.active
                space.image, user = image, space.image_user
                user.frame_start, user.frame_duration, user.use_auto_refresh = frames[0], len(frames), True
                user.frame_offset = frames[0] - 1


class Panel(bpy.types.Panel):
    bl_idname, bl_label = "RENDER_PT_postfx", "postfx"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"

    def draw(self, context):
        layout, settings = self.layout, context.scene.postfx
        layout.use_property_split = True
        layout.operator(SetUp.bl_idname)
        for name in ("scale", "model", "strength"):
            layout.prop(settings, name)
        row = layout.row(align=True)
        row.operator(Denoise.bl_idname, text="Denoise sequence").whole = True
        row.operator(Denoise.bl_idname, text="Current frame").whole = False


CLASSES = (Settings, Preferences, SetUp, Denoise, Panel)


def register() -> None:
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.postfx = bpy.props.PointerProperty(type=Settings)


def unregister() -> None:
    del bpy.types.Scene.postfx
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)
