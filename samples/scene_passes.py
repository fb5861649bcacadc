"""Time the passes by networks of scenes on the frames of the sample room.

python samples/scene_passes.py [--threads 1] [--runs 5]

Prints the milliseconds of each pass, medians of runs in turn: occlusion by GTAO and by the network, scene_shading from
planes alone and with history, and irradiance by a network of 3-16-16-3.
"""
import argparse
import statistics
import tempfile
from pathlib import Path

import postfx
from postfx import Device, Pipeline, Role
from postfx.neural import Network
from postfx.passes.scene import Irradiance, Occlusion, SceneShading

ROOM = Path(__file__).parent / "room"

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--threads", type=int, default=1)
parser.add_argument("--runs", type=int, default=5)
parser.add_argument("--device", default="cpu")
chosen = parser.parse_args()

device = Device(chosen.device, threads=chosen.threads)
frames = list(postfx.read_sequence(str(ROOM / "noisy.####.exr")))[:2]
with tempfile.TemporaryDirectory() as folder:
    network = Network(3, (16, 16), 3, "gelu")
    network.save_onnx(Path(folder) / "light.onnx", network.initial(1))
    ways = {
        "occlusion, GTAO": Occlusion(network=False),
        "occlusion, network": Occlusion(),
        "scene_shading, planes alone": SceneShading(model=str(ROOM / "shading.onnx")),
        "scene_shading, with history": SceneShading(model=str(ROOM / "temporal.onnx")),
        "irradiance": Irradiance(model=str(Path(folder) / "light.onnx")),
    }
    pipelines = {name: Pipeline([one], device, exposure=1.0) for name, one in ways.items()}
    times = {name: [] for name in ways}
    for run in range(chosen.runs + 1):
        for name, pipeline in pipelines.items():
            pipeline(frames[run % len(frames)])
            if run:  # the first makes it ready
                times[name].append(sum(pipeline.timings.values()))
height, width = frames[0][Role.COLOUR].shape[:2]
print(f"{width}x{height}, {chosen.threads} threads")
for name, taken in times.items():
    print(f"{name:<28} {statistics.median(taken):8.1f} ms")
