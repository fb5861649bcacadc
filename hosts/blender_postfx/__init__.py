# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoise what Cycles rendered, from Blender's render properties.

The work is done by the command `postfx` in a process of its own: nothing is installed into Blender,
and Blender stays usable meanwhile. Results stand beside the render, as `<name>denoised_####.exr`.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
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

    def __init__(self, command: list[str], source: str, output: str, frames: str,
                 options: list[str]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="postfx-")
        self._log, errors = Path(self._folder.name, "log"), Path(self._folder.name, "errors")
        self.output, self.total, self.stopped, self._errors = output, 0, False, errors
        words = [*command, "run", source, "-o", output, "--frames", frames, "--overwrite", "--log",
                 str(self._log)]
        with errors.open("w") as file:
            self._process = subprocess.Popen([*words, *options], stdin=subprocess.DEVNULL,
                                             stdout=subprocess.DEVNULL, stderr=file)

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
            self._process.terminate()  # SIGINT is ignored where Blender runs in the background

    def wait(self) -> None:
        self._process.wait()

    def fault(self) -> str:
        """What went wrong; empty if nothing did."""
        if self._process.returncode == 0:
            return ""
        lines = [line
                 for line in self._errors.read_text(errors="replace").splitlines() if line.strip()]
        told = [line for line in lines if line.startswith("error")] or lines[-1:]
        return told[0] if told else f"postfx ended with code {self._process.returncode}"

    def warnings(self) -> list[str]:
        """What the command said of the frames, such as motion of the wrong sign, each once."""
        lines = self._errors.read_text(errors="replace").splitlines()
        told = [line.removeprefix("warning").strip()
                for line in lines if line.startswith("warning ")]
        return list(dict.fromkeys(told))

    def doing(self) -> str:
        """The command's last line, such as that it compiles kernels the first time."""
        lines = [line.strip()
                 for line in self._errors.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1] if lines else "starting"


PRESETS = [("NONE", "Standard", "Every frame uses the frames before it"),
           ("preview", "Preview", "The fastest: the small network, alone"),
           ("final", "Final",
            "For delivery: the largest network in both directions, many times the time"),
           ("animation", "Animation", "In both directions, and steady in brightness")]
OWN_NETWORK = ("preview", "final")
"""Presets that choose the network themselves."""

LOOKS = [("NONE", "None (EXR)", "Scene-linear EXR for the compositor"),
         ("aces2", "ACES 2", "Pictures (PNG) by ACES 2"),
         ("agx", "AgX", "Pictures (PNG) by AgX, as Blender shows them"),
         ("pbr_neutral", "PBR Neutral", "Pictures (PNG) that keep the colours of products"),
         ("local", "Local", "Pictures (PNG) whose dark and bright places are both seen")]
PLACES = (Path.home() / ".local/bin/postfx", Path("/usr/local/bin/postfx"))
"""Where the command may be when a desktop starts Blender without the shell's PATH."""


class Settings(bpy.types.PropertyGroup):
    preset: bpy.props.EnumProperty(name="Preset", default="NONE", items=PRESETS)
    parts: bpy.props.BoolProperty(
        name="Light groups and passes", default=False,
        description="Denoise them with the picture, so that they still add up to it")
    fireflies: bpy.props.FloatProperty(
        name="Clamp fireflies", default=0.0, min=0.0, max=100.0,
        description="Darken pixels that are more than this many times as bright as those around "
        "them; 0 for none")
    findings: bpy.props.StringProperty(description="What postfx said of the passes, a line each")
    both_ways: bpy.props.BoolProperty(
        name="Both directions", default=False,
        description="Also denoise the sequence in reverse order and mix the results: cleaner, "
        "takes two to three times as long")
    look: bpy.props.EnumProperty(name="Look", default="NONE", items=LOOKS)
    scale: bpy.props.FloatProperty(name="Scale", default=1.0, min=1.0, max=3.0,
                                   description="Output over render size")
    model: bpy.props.EnumProperty(name="Network", default="AUTO", description="The presets Preview "
                                  "and Final choose their own", items=[
        ("AUTO", "Automatic", "Extra large; Medium where memory is short"),
        ("s", "Small", "Fastest"), ("m", "Medium", "Fast"), ("l", "Large", "Better"),
        ("xl", "Extra large", "The cleanest, and slowest")])
    strength: bpy.props.FloatProperty(name="Strength", default=1.0, min=0.0, max=1.0)


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="Command", subtype="FILE_PATH",
        description="The command postfx, such as /opt/venv/bin/postfx; empty: as the system finds "
        "it. Install it in a checkout of postfx by: python3 -m pip install .")

    def draw(self, context):
        self.layout.prop(self, "command")


def find_command(context) -> list[str]:
    """Words that start postfx. Raises LookupError with what to do when it is not there."""
    addon = context.preferences.addons.get(__package__)
    text = addon.preferences.command.strip() if addon else ""
    words = ([text] if Path(text).is_file() else shlex.split(text)) if text else ["postfx"]
    if not text and shutil.which("postfx") is None:
        words = next(([str(place)] for place in PLACES if place.is_file()), words)
    if shutil.which(words[0]) is None:
        raise LookupError(f"there is no command '{words[0]}': install it (python3 -m pip install . "
                          "in a checkout of postfx) and name it in the add-on's preferences")
    return words


def patterns(scene) -> tuple[str, str]:
    """Where the scene's frames are and where results go, with #### for the number."""
    path = Path(bpy.path.abspath(scene.render.frame_path(frame=scene.frame_start)))
    number = re.search(r"\d+(?=\D*$)", path.stem)
    if number is None:
        raise LookupError(f"the render's files have no frame number: {path}")
    before = path.stem[:number.start()]
    hashes = "#" * len(number[0])
    after = path.stem[number.end():]
    return (str(path.with_name(f"{before}{hashes}{after}.exr")),
            str(path.with_name(f"{before}{MARK}{hashes}{after}.exr")))


def options_of(settings, whole: bool) -> list[str]:
    """Options of `postfx run` for what the panel says, for the whole sequence or one frame."""
    options = ["--scale", str(round(settings.scale, 3)),
               "--strength", str(round(settings.strength, 3))]
    chosen = settings.model != "AUTO" and settings.preset not in OWN_NETWORK
    options += ["--model", settings.model] if chosen else []
    options += ["--preset", settings.preset] if settings.preset != "NONE" else []
    options += ["--aov", "auto"] if settings.parts else []
    options += (["--clamp-fireflies", str(round(settings.fireflies, 3))] if settings.fireflies
                else [])
    options += ["--both-ways"] if settings.both_ways and whole else []
    return options + (["--tonemap", settings.look] if settings.look != "NONE" else [])


def file_of(pattern: str, frame: int) -> Path:
    """A frame's file."""
    hashes = re.search("#+", pattern)[0]
    return Path(pattern.replace(hashes, f"{frame:0{len(hashes)}d}"))


class SetUp(bpy.types.Operator):
    """Render the passes that postfx reads, into multilayer EXR files, with a seed for each frame
    and without Blender's own denoiser"""

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
        scene.cycles.use_denoising, scene.cycles.use_animated_seed = False, True
        image = scene.render.image_settings
        if "media_type" in image.bl_rna.properties:  # since Blender 5
            image.media_type = "MULTI_LAYER_IMAGE"
        # half floats are too coarse for depth
        image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
        if scene.render.use_motion_blur:
            self.report({"WARNING"},
                        "with motion blur Cycles writes no vectors: frames are then denoised one "
                        "by one")
        return {"FINISHED"}


class Check(bpy.types.Operator):
    """Look for mistakes in the passes of the rendered frames, and list them with their fixes"""

    bl_idname, bl_label = "postfx.check", "Check passes"

    def execute(self, context):
        try:
            source, _ = patterns(context.scene)
            command = find_command(context)
        except LookupError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        done = subprocess.run([*command, "inspect", source, "--json"], capture_output=True,
                              text=True, stdin=subprocess.DEVNULL)
        if not done.stdout.strip():
            self.report({"ERROR"},
                        (done.stderr.strip().splitlines() or ["postfx said nothing"])[-1])
            return {"CANCELLED"}
        found = [one for one in json.loads(done.stdout)["findings"] if one["level"] != "info"]
        context.scene.postfx.findings = "\n".join(f"{one['role']}: {one['cause']}; {one['fix']}"
                                                  for one in found)
        many = "s" if len(found) > 1 else ""
        self.report({"WARNING"} if found else {"INFO"}, f"postfx: {len(found)} finding{many}"
                    if found else "postfx found no mistake in the passes")
        return {"FINISHED"}


class Denoise(bpy.types.Operator):
    """Denoise the frames that are rendered, and put the results beside them"""

    bl_idname, bl_label = "postfx.denoise", "Denoise"

    whole: bpy.props.BoolProperty(name="Whole sequence", default=True,
                                  description="Else the current frame alone")

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
            doing = f". {self._job.doing()}" if not done else ""
            context.workspace.status_text_set(
                f"postfx: {done} of {self._job.total or '?'} frames. Esc to stop{doing}")
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
                raise LookupError(f"frame {missing} is not rendered: there is no "
                                  f"{file_of(source, missing)}")
            command = find_command(context)
        except LookupError as error:
            self.report({"ERROR"}, str(error))
            return False
        if settings.look != "NONE":
            output = str(Path(output).with_suffix(".png"))
        self._frames = list(wanted)
        self._job = Job(command, source, output, ",".join(map(str, wanted)),
                        options_of(settings, self.whole))
        return True

    def _end(self, context):
        fault, done = self._job.fault(), self._job.done()
        if self._job.stopped:
            self.report({"INFO"},
                        f"postfx was stopped: {done} of {len(self._frames)} frames are done")
            return {"CANCELLED"}
        if fault:
            self.report({"ERROR"}, f"{fault} ({done} of {len(self._frames)} frames are done)")
            return {"CANCELLED"}
        show(context, self._job.output, self._frames)
        told = self._job.warnings()
        context.scene.postfx.findings = "\n".join(told)
        for line in told:
            self.report({"WARNING"}, f"postfx: {line}")
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
                user.frame_start = frames[0]
                user.frame_duration = len(frames)
                user.use_auto_refresh = True
                user.frame_offset = frames[0] - 1


class Panel(bpy.types.Panel):
    bl_idname, bl_label = "RENDER_PT_postfx", "postfx"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"

    def draw(self, context):
        layout, settings = self.layout, context.scene.postfx
        layout.use_property_split = True
        layout.operator(SetUp.bl_idname)
        layout.operator(Check.bl_idname)
        for name in ("preset", "model", "both_ways", "scale", "strength", "fireflies", "parts",
                     "look"):
            layout.prop(settings, name)
        row = layout.row(align=True)
        row.operator(Denoise.bl_idname, text="Denoise sequence").whole = True
        row.operator(Denoise.bl_idname, text="Current frame").whole = False
        for line in settings.findings.splitlines():
            layout.label(text=line, icon="ERROR")


CLASSES = (Settings, Preferences, SetUp, Check, Denoise, Panel)


def register() -> None:
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.postfx = bpy.props.PointerProperty(type=Settings)


def unregister() -> None:
    del bpy.types.Scene.postfx
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)
