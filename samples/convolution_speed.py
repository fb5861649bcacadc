"""Time convolutions of 3x3 pixels by tiles, and by ONNX Runtime: single layers, and whole networks.

    python samples/convolution_speed.py [--width 960] [--height 544] [--runs 7] [--threads 1]

Layers are the largest of `xl`, with an activation behind each. Prints milliseconds of processor
time, medians of runs that take turns, the ratio, and the largest difference of the results over the
largest one.
"""
import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper

from postfx.passes.denoise.models import find_model, model_of
from postfx.runtime.own_convolutions import operators_library, with_own_convolutions

LAYERS = (
    (64, 64, 1), (96, 64, 1), (64, 32, 1), (32, 32, 1), (64, 3, 1),
    (192, 96, 2), (96, 96, 2),
    (288, 128, 4), (128, 128, 4),
    (384, 192, 8),
)
"""Channels read and made, and by what the frame's sides are divided there."""
NETWORKS = ("xl", "l")
SIDE = 3


def layer(channels: int, results: int) -> bytes:
    """A model of one convolution of random weights and an activation."""
    random = np.random.default_rng(channels)
    weight = random.normal(0, 1 / (SIDE * channels**0.5), (results, channels, SIDE, SIDE))
    weights = [numpy_helper.from_array(values.astype(np.float32), name)
               for name, values in (("weight", weight), ("bias", random.normal(size=results)))]
    nodes = [helper.make_node("Conv", ["image", "weight", "bias"], ["sums"], pads=[1] * 4,
                              kernel_shape=[SIDE, SIDE]),
             helper.make_node("Relu", ["sums"], ["out"])]
    shapes = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, count, "height", "width"])
              for name, count in (("image", channels), ("out", results))]
    graph = helper.make_graph(nodes, "layer", shapes[:1], shapes[1:], weights)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    content: bytes = made.SerializeToString()
    return content


def runner(model: bytes, size: tuple[int, int], threads: int) -> Callable[[], list[np.ndarray]]:
    """A function that runs a model on random input of a (height, width)."""
    options = ort.SessionOptions()
    options.intra_op_num_threads, options.enable_mem_pattern = threads, False
    options.log_severity_level = 3
    options.register_custom_ops_library(str(operators_library()))
    for name, pixels in zip(("height", "width"), size, strict=True):
        options.add_free_dimension_override_by_name(name, pixels)
    session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    random = np.random.default_rng(1)
    given = {value.name: random.random(value.shape, np.float32) for value in session.get_inputs()}

    def run() -> list[np.ndarray]:
        return [np.asarray(result) for result in session.run(None, given)]

    return run


def compare(name: str, model: bytes, size: tuple[int, int], given: argparse.Namespace) -> None:
    """Print the times of a model both ways."""
    ways = [runner(one, size, given.threads) for one in (model, with_own_convolutions(model))]
    theirs, ours = (way() for way in ways)
    largest = max(float(np.abs(one - other).max() / np.abs(one).max())
                  for one, other in zip(theirs, ours, strict=True))
    times: list[list[float]] = [[], []]
    for _ in range(given.runs):
        for way, taken in zip(ways, times, strict=True):
            began = time.process_time()
            way()
            taken.append(1e3 * (time.process_time() - began))
    before, after = map(statistics.median, times)
    print(f"{name:26} {before:7.1f} ms {after:7.1f} ms {after / before:5.2f}  "
          f"off by {largest:.1e}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--height", type=int, default=544)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    print(f"{'':26} {'ORT':>7}    {'tiles':>7}")
    for channels, results, divisor in LAYERS:
        size = given.height // divisor, given.width // divisor
        name = f"{channels} -> {results}, {size[1]}x{size[0]}"
        compare(name, layer(channels, results), size, given)
    for tag in NETWORKS:
        library, name = find_model(model_of(tag, ".1x"))
        compare(f"{tag}, {given.width}x{given.height}", library.load(name),
                (given.height, given.width), given)


if __name__ == "__main__":
    main()
