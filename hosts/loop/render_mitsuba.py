"""Renders the pictures and regions that 'postfx loop' lists, in Mitsuba 3:

    postfx loop ... --render 'python render_mitsuba.py scene.xml {jobs}'
    postfx loop ... --render 'python render_mitsuba.py shot.py {jobs}'  # it has build(frame)

The scene's integrator renders the light, an 'aov' integrator around it albedo, normals and depth.
Regions are crop windows. They are written at full size, with a plane of sample counts that says
what a file holds.
"""

import json
import runpy
import sys
from pathlib import Path

import drjit
import mitsuba as mi
import numpy as np

AOVS = "albedo:albedo,nn:sh_normal,dd:depth"
LEAST_THREADS = 2  # with one, Mitsuba's writer of EXR waits for ever


def set_variant():
    """The fastest variant that works here: LLVM before 16 aborts in Mitsuba."""
    version = drjit.detail.llvm_version()
    names = ["cuda_ad_rgb", *["llvm_ad_rgb"] * bool(version and version[0] >= 16), "scalar_rgb"]
    mi.set_variant(*(name for name in names if name in mi.variants()))


def load(source, frame):
    """The scene of a frame."""
    if not source.endswith(".py"):
        return mi.load_file(source)
    scene = runpy.run_path(source)["build"](frame)
    return mi.load_dict(scene) if isinstance(scene, dict) else scene


def render(scene, job):
    """Render one picture or region into a file."""
    film = mi.traverse(scene.sensors()[0])
    size = [int(side) for side in film["film.size"]]
    box = job["region"] or {"x": 0, "y": 0, "width": size[0], "height": size[1]}
    film["film.crop_offset"] = [box["x"], box["y"]]
    film["film.crop_size"] = [box["width"], box["height"]]
    film.update()
    integrator = mi.load_dict({"type": "aov", "aovs": AOVS, "image": scene.integrator()})
    pixels = np.array(mi.render(scene, integrator=integrator, spp=job["samples"], seed=job["seed"]))
    aovs = [name for name in integrator.aov_names() if not name.startswith("image.")]
    names = ["R", "G", "B", "A"][: pixels.shape[2] - len(aovs)] + aovs
    rows = slice(box["y"], box["y"] + box["height"])
    columns = slice(box["x"], box["x"] + box["width"])
    whole = np.zeros((size[1], size[0], pixels.shape[2] + 1), np.float32)
    whole[rows, columns, :-1] = pixels
    whole[rows, columns, -1] = job["samples"]
    bitmap = mi.Bitmap(whole, mi.Bitmap.PixelFormat.MultiChannel, [*names, "sample_count.Y"])
    bitmap.metadata()["generatedBy"] = f"Mitsuba version {mi.__version__}"
    bitmap.metadata()["postfx:spp"] = job["samples"]
    if "x_fov" in film:
        bitmap.metadata()["postfx:fovX"] = float(np.ravel(film["x_fov"])[0])
    bitmap.write(job["output"])


def main():
    set_variant()
    drjit.set_thread_count(max(drjit.thread_count(), LEAST_THREADS))
    source, jobs = sys.argv[1:]
    frame = scene = None
    for job in json.loads(Path(jobs).read_text())["jobs"]:
        if job["frame"] != frame:
            frame, scene = job["frame"], load(source, job["frame"])
        render(scene, job)


if __name__ == "__main__":
    main()
