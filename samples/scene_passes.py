"""Time the passes by networks of scenes on the frames of the sample room.

python samples/scene_passes.py [--threads 1] [--runs 5] [--size 1000x640] [--only scene_shading]

Prints the milliseconds of each pass, and the processor's time of a call with its frames a second,
which other programs change less; with --device cuda, the time of a whole call with its frames a
second. Medians of runs in turn. The passes: occlusion by GTAO and by the network; scene_shading by
a U-Net from planes alone and with history, and by a network of points, 33-64-64-64-3; irradiance by
a network of 3-16-16-3. The last two have random weights, which take as long. With a size, pixels of
the room are repeated.
"""
import argparse
import json
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import postfx
from postfx import Device, Pipeline, Role
from postfx.kernels.scene import POINT
from postfx.neural import Network
from postfx.passes.scene import Irradiance, Occlusion, SceneShading
from postfx.passes.scene_points import SceneBox

ROOM = Path(__file__).parent / "room"

parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("--threads", type=int, default=1)
parser.add_argument("--runs", type=int, default=5)
parser.add_argument("--device", default="cpu")
parser.add_argument("--only", default="", help="passes whose names begin so")
parser.add_argument("--size", help="such as 1000x640; default: the room's own")
chosen = parser.parse_args()

device = (Device(chosen.device, threads=chosen.threads) if chosen.device == "cpu"
          else Device(chosen.device))
clock, whose = ((time.process_time, "processor") if chosen.device == "cpu"
                else (time.perf_counter, "call"))
frames = list(postfx.read_sequence(str(ROOM / "noisy.####.exr")))[:2]
if chosen.size:
    width, height = map(int, chosen.size.split("x"))
    known_height, known_width = frames[0][Role.COLOUR].shape[:2]
    rows = np.arange(height) * known_height // height
    columns = np.arange(width) * known_width // width
    frames = [replace(frame, planes={role: np.ascontiguousarray(plane[rows][:, columns])
                                     for role, plane in frame.planes.items()}) for frame in frames]
with tempfile.TemporaryDirectory() as folder:
    network = Network(3, (16, 16), 3, "gelu")
    network.save_onnx(Path(folder) / "light.onnx", network.initial(1))
    network = Network(POINT, (64, 64, 64), 3, "gelu", bands=4, encoded=3)
    network.save_onnx(Path(folder) / "points.onnx", network.initial(1))
    (Path(folder) / "points.json").write_text(json.dumps(SceneBox(np.zeros(3, np.float32), 3.0)
                                                         .card()))
    ways = {
        "occlusion, GTAO": Occlusion(network=False),
        "occlusion, network": Occlusion(),
        "scene_shading, planes alone": SceneShading(model=str(ROOM / "shading.onnx")),
        "scene_shading, with history": SceneShading(model=str(ROOM / "temporal.onnx")),
        "scene_shading, points": SceneShading(model=str(Path(folder) / "points.onnx")),
        "irradiance": Irradiance(model=str(Path(folder) / "light.onnx")),
    }
    pipelines = {name: Pipeline([one], device, exposure=1.0) for name, one in ways.items()
                 if name.startswith(chosen.only)}
    times = {name: [] for name in pipelines}
    work = {name: [] for name in pipelines}
    for run in range(chosen.runs + 1):
        for name, pipeline in pipelines.items():
            began = clock()
            pipeline(frames[run % len(frames)])
            if run:  # the first makes it ready
                times[name].append(sum(pipeline.timings.values()))
                work[name].append(clock() - began)
height, width = frames[0][Role.COLOUR].shape[:2]
print(f"{width}x{height}, {device.name}, {chosen.threads} threads")
for name, taken in times.items():
    middle = statistics.median(taken)
    busy = statistics.median(work[name])
    print(f"{name:<28} {middle:8.1f} ms, of the {whose} {1000 * busy:8.1f} ms, {1 / busy:6.2f} "
          "frames a second")
