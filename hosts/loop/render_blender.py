"""Renders the pictures and regions that 'postfx loop' lists, in Blender with Cycles:

    postfx loop ... --render 'blender -b shot.blend -P render_blender.py -- {jobs}'
    postfx loop ... --render 'python render_blender.py shot.blend {jobs}'      # with the module bpy

Regions are border renders at full size, so each file says by its plane of sample counts what it
holds. Blender's own denoiser, adaptive sampling and the compositor are off, since postfx denoises,
chooses samples and merges what comes from the renderer itself. Blender 5.0.1 crashes now and then
when it keeps a scene between renders; the loop then starts it again for what is left.
"""

import json
import sys
from pathlib import Path

import bpy


def set_up(scene):
    """Settings without which renders cannot be merged, and the passes that help the denoiser."""
    scene.render.engine = "CYCLES"
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_animated_seed = False
    scene.render.use_compositing = scene.render.use_sequencer = False
    # else each region costs as much as a scene takes to load
    scene.render.use_persistent_data = True
    image = scene.render.image_settings
    if "media_type" in image.bl_rna.properties:  # since Blender 5
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "32", "ZIP"
    for layer in scene.view_layers:
        layer.cycles.pass_debug_sample_count = layer.cycles.denoising_store_passes = True
        layer.use_pass_z = layer.use_pass_normal = True
        layer.use_pass_diffuse_color = layer.use_pass_glossy_color = True
        layer.use_pass_vector = not scene.render.use_motion_blur


def use_samples(cycles, job):
    """The next samples of the sequence that the first round began, which spread better than those
    of a new one."""
    cycles.samples, cycles.seed = job["samples"], job["seed"]
    cycles.use_sample_subset = "first_sample" in job
    if cycles.use_sample_subset:
        cycles.sampling_pattern, cycles.seed = "TABULATED_SOBOL", job["first_seed"]
        cycles.sample_offset, cycles.sample_subset_length = job["first_sample"], job["samples"]
        cycles.samples = job["first_sample"] + job["samples"]


def render(scene, job):
    """Render one picture or region into a file."""
    scene.frame_set(job["frame"])
    use_samples(scene.cycles, job)
    settings, region = scene.render, job["region"]
    settings.use_border, settings.use_crop_to_border = region is not None, False
    if region:
        scale = settings.resolution_percentage / 100
        width, height = (int(side * scale)
                         for side in (settings.resolution_x, settings.resolution_y))
        settings.border_min_x = region["x"] / width
        settings.border_max_x = (region["x"] + region["width"]) / width
        settings.border_min_y = 1 - (region["y"] + region["height"]) / height
        settings.border_max_y = 1 - region["y"] / height
    settings.use_file_extension = False
    settings.filepath = job["output"]
    bpy.ops.render.render(write_still=True)


def main():
    words = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    if len(words) == 2:
        bpy.ops.wm.open_mainfile(filepath=words[0])
    scene = bpy.context.scene
    set_up(scene)
    for job in json.loads(Path(words[-1]).read_text())["jobs"]:
        render(scene, job)


if __name__ == "__main__":
    main()
