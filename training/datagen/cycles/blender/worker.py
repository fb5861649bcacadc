"""Render clips inside Blender: one JSON request a line in, one answer a line out.

Request: {"clip": n, "seed": s, "folder": where EXR files go, "library": folder or null, "kind":
name or null, "frames", "width", "height": of the noisy frames, "scale", "spp": [of each noisy
render], "half_spp": of each half of the reference}. Answer: {"clip": n, "facts": {...}} or {"clip":
n, "error": text}.

`exchange.py` names the EXR files that a clip leaves in its folder, and draws its seeds.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..exchange import (
    clip_generator,
    half_file,
    noisy_file,
    read_pass,
    scene_generator,
    vectors_file,
)
from . import kinds
from .kinds import Library

THREADS = 2  # a process: many run side by side
DARKEST_SHARE = 0.02  # of the mean light: darker pixels do not make a picture brighter
LEAST_HALF_SHARE = 0.4  # of the samples of a half of a reference that each pixel gets, at least
# of each half, as Cycles' adaptive sampling counts it, at a mean brightness of 0.2
HALF_ERROR = 0.006
PATTERNS = ("AUTOMATIC", "TABULATED_SOBOL", "BLUE_NOISE")


def use_device() -> str:
    """Use CUDA if there is a GPU, else the CPU. Needed for every new scene: Blender resets its
    preferences with it."""
    chosen = bpy.context.preferences.addons["cycles"].preferences
    try:
        chosen.compute_device_type = "CUDA"
    except TypeError:
        return "CPU"
    chosen.get_devices()
    cards = [device for device in chosen.devices if device.type == "CUDA"]
    for device in chosen.devices:
        device.use = device.type == "CUDA"
    return "GPU" if cards else "CPU"


def set_up(scene: bpy.types.Scene, device: str, rng: np.random.Generator) -> dict[str, Any]:
    """Apply settings that all renders of a clip share; returns the random choices."""
    cycles, render, layer = scene.cycles, scene.render, scene.view_layers[0]
    cycles.device = device
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sampling_pattern = str(rng.choice(PATTERNS))
    cycles.sample_clamp_indirect = float(rng.choice([10.0, 0.0], p=[0.6, 0.4]))
    cycles.max_bounces = int(rng.choice([12, 6, 24], p=[0.7, 0.2, 0.1]))
    cycles.diffuse_bounces = cycles.glossy_bounces = int(rng.choice([4, 8]))
    cycles.volume_bounces = int(rng.choice([0, 1, 2, 4], p=[0.4, 0.2, 0.2, 0.2]))
    cycles.pixel_filter_type = str(rng.choice(["BLACKMAN_HARRIS", "BOX", "GAUSSIAN"],
                                              p=[0.8, 0.1, 0.1]))
    cycles.filter_width = 1.5
    # on a CPU, Blender 5.0.1 crashes with it now and then
    render.use_persistent_data = device == "GPU"
    render.threads_mode, render.threads = "FIXED", THREADS
    render.film_transparent = bool(rng.random() < 0.1)
    render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    render.image_settings.color_depth, render.image_settings.exr_codec = "16", "NONE"
    render.use_compositing = render.use_sequencer = False
    layer.use_pass_z = layer.use_pass_normal = True
    layer.use_pass_diffuse_color = layer.use_pass_glossy_color = True
    layer.cycles.denoising_store_passes = True
    return {"filter": cycles.pixel_filter_type, "clamp": cycles.sample_clamp_indirect}


def shoot(scene: bpy.types.Scene, path: Path, frame: int, size: tuple[int, int], spp: int,
          seed: int, error: float = 0.0) -> None:
    """Render one frame into an EXR file. With an ``error``, pixels whose noise is below it get
    fewer samples."""
    scene.cycles.use_adaptive_sampling = error > 0
    scene.cycles.adaptive_threshold = error
    scene.cycles.adaptive_min_samples = round(LEAST_HALF_SHARE * spp)
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.cycles.samples, scene.cycles.seed = spp, seed
    scene.frame_set(frame)
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def probe(scene: bpy.types.Scene, folder: Path, frame: int) -> tuple[float, float, float]:
    """A coarse render of a frame: log-average luminance, share of black pixels, share of pixels at
    edges."""
    path = folder / "probe.exr"
    blur, scene.render.use_motion_blur = scene.render.use_motion_blur, False
    shoot(scene, path, frame, (32, 32), 32, 7)
    scene.render.use_motion_blur = blur
    light = read_pass(path, "Combined", 3) @ np.array([0.2126, 0.7152, 0.0722])
    level = float(np.exp(np.log(light + DARKEST_SHARE * light.mean() + 1e-9).mean()))
    normal, albedo = read_pass(path, "Normal", 3), read_pass(path, "Denoising Albedo", 3)
    change = [np.abs(np.diff(plane, axis=axis)).max(-1)[:31, :31] for plane in (normal, albedo)
              for axis in (0, 1)]
    return level, float((light < 1e-6).mean()), float((np.max(change, 0) > 0.15).mean())


def make(request: dict[str, Any], library: Library) -> dict[str, Any]:
    """Build and render a clip; returns its facts."""
    folder, seed, clip = Path(request["folder"]), request["seed"], request["clip"]
    chooser = clip_generator(seed, clip)
    names, weights = zip(*kinds.KINDS.items(), strict=True)
    frames, (w, h) = request["frames"], (request["width"], request["height"])
    for attempt in range(6):
        kind = request["kind"] or str(chooser.choice(names, p=np.array(weights) / sum(weights)))
        rng = scene_generator(seed, clip, kind, attempt)
        shot = kinds.build(kind, library, frames, w, rng)
        scene = bpy.context.scene
        shot.facts |= set_up(scene, use_device(), rng) | {"attempt": attempt}
        level, black, edges = probe(scene, folder, frames // 2)
        if level > 1e-5 and black < 0.4 and edges > 0.06:
            break
    scene.cycles.film_exposure = 0.2 * 2 ** rng.normal(0, 0.5) / level
    output = (round(w * request["scale"]), round(h * request["scale"]))
    layer, blur = scene.view_layers[0], shot.facts["blur"]
    error = HALF_ERROR * (level / 0.2) ** 0.5  # Cycles divides noise by the square root of light
    seeds = iter(rng.integers(1, 1 << 30, 64 * frames).tolist())
    for frame in range(frames):
        layer.use_pass_vector = not blur
        for k, spp in enumerate(request["spp"]):
            shoot(scene, noisy_file(folder, k, frame), frame, (w, h), spp, next(seeds))
        for half in range(2):
            shoot(scene, half_file(folder, half, frame), frame, output, request["half_spp"],
                  next(seeds), error)
        if blur:
            scene.render.use_motion_blur, layer.use_pass_vector = False, True
            shoot(scene, vectors_file(folder, frame), frame, (w, h), 1, next(seeds))
            scene.render.use_motion_blur = True
    return shot.facts | {"level": level}


def main() -> None:
    answers = os.fdopen(os.dup(1), "w")  # Blender prints its own lines to standard output
    os.dup2(2, 1)
    library = None
    print(json.dumps({"ready": use_device()}), file=answers, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        library = library or Library(request["library"] and Path(request["library"]))
        answer: dict[str, Any]
        try:
            answer = {"facts": make(request, library)}
        except Exception as fault:  # the next clip may well work
            traceback.print_exc()
            answer = {"error": f"{type(fault).__name__}: {fault}"}
        print(json.dumps({"clip": request["clip"], **answer}), file=answers, flush=True)


if __name__ == "__main__":
    main()
