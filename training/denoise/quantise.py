"""Make the int8 variant of a denoised upscaler, for CPUs, by noisy frames like its training frames.

    python -m training.denoise.quantise denoise_upscale.m --clips FOLDER_OF_CLIPS
    python -m training.denoise.quantise denoise_upscale.m.guides --clips 'shot/noisy.####.exr'
    python -m training.denoise.quantise denoise_upscale.m.1x --clips FOLDER_OF_CLIPS

Runs the network over the frames with its history, records the outputs of its layers, brings their
channels to more equal ranges, picks the 8-bit ranges with the least error, and compares the
pictures of both variants. Needs no checkpoint. Only ranges, and what weights are rounded by, are
taken from the frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
import onnxruntime
from onnx import NodeProto, numpy_helper

import postfx
from postfx.colour.displays import srgb_encode
from postfx.frame import Frame, Role
from postfx.passes.denoise.models import GUIDED, UNSCALED, exact, split_ending
from postfx.runtime import Device, Library, PipelineState, Tensor
from postfx.runtime.convolutions import Head
from postfx.runtime.device import Dims
from training.datagen.clip_file import GUIDES, PLANES, guide_depth, load_clip
from training.denoise.int8 import (
    Moments,
    Range,
    Rounded,
    Stem,
    activations,
    convolutions,
    facts,
    heads,
    in_integers,
    quantise,
    show,
    unfold_half,
)
from training.export import (
    MODELS,
    constant_value,
    known_recipe,
    lower_constants,
    store_half,
    write_card,
    write_model,
)

# Calibration --------------------------------------------------------------------------------------
# Statistics of a float network over frames: ranges of its tensors, and moments to round its weights
# by.

SAMPLED = 4096
"""Values of a tensor that are sampled in each frame, about: all channels of some places."""
SHARES = np.geomspace(0.01, 1, 120)
"""Ranges that are tried, as parts of a tensor's full range."""
POWER = 1.5
"""The range with the least sum of errors to this power is chosen. With 2, a few extremes of a few
frames make ranges too wide for all others: pictures are then 1.4 dB further from float32 (`m` and
`s`, held-out frames); with 1, extremes are cut off and one frame suffers."""


class Calibration:
    """Collects statistics of runs of a float32 network.

    Args:
        tensors: names of tensors to find ranges of.
        convolutions: nodes whose weights will be rounded.
        stem: rounded as well, if any.
    """

    def __init__(self, model: onnx.ModelProto, tensors: Iterable[str],
                 convolutions: Iterable[NodeProto], stem: Stem | None = None) -> None:
        self._graph, self._nodes, self._stem = model.graph, list(convolutions), stem
        self._moments = {node.input[1]: Moments.of(node) for node in self._nodes}
        self._seen: dict[str, list[np.ndarray]] = {name: [] for name in tensors}
        inputs = {known.name for known in model.graph.input}
        read = (node.input[0] for node in self._nodes)
        self._computed = [name
                          for name in dict.fromkeys([*self._seen, *read]) if name not in inputs]
        self._session = onnxruntime.InferenceSession(show(
            model, self._computed
        ).SerializeToString(), providers=["CPUExecutionProvider"])
        self._random = np.random.default_rng(0)

    def add(self, reads: Mapping[str, np.ndarray]) -> None:
        """Add a run with these inputs."""
        values = {**reads,
                  **dict(zip(self._computed, self._session.run(None, dict(reads)), strict=True))}
        for name, seen in self._seen.items():
            flat = values[name].reshape(values[name].shape[1], -1)
            seen.append(flat[:, self._random.integers(0, flat.shape[1], -(-SAMPLED // len(flat)))])
        for node in self._nodes:
            self._moments[node.input[1]].add(values[node.input[0]])
        if self._stem:
            self._stem.add(reads)

    def ranges(self) -> dict[str, Range]:
        """For each tensor the range with the least error."""
        return {name: best_range(np.concatenate(seen, 1)) for name, seen in self._seen.items()}

    def shares(self) -> dict[str, np.ndarray]:
        """For each tensor how much of the widest channel's range each of its channels needs,
        (C,)."""
        found = {}
        for name, seen in self._seen.items():
            reach = np.abs(np.concatenate(seen, 1)).max(1)
            found[name] = reach / max(reach.max(), 1e-12)
        return found

    def weights(self) -> dict[str, Rounded]:
        """Weights of the convolutions in integers, by name."""
        return {name: moments.round_weights(constant_value(self._graph, name))
                for name, moments in self._moments.items()}


def best_range(values: np.ndarray) -> Range:
    """The part of the values' range that has the least error in 8 bits."""
    counts, edges = np.histogram(values, 16384)
    middles = (edges[:-1] + edges[1:]) / 2
    tried = [Range.of(share * values.min(), share * values.max()) for share in SHARES]
    return min(tried,
               key=lambda kept: (counts * np.abs(kept.decode(middles) - middles) ** POWER).sum())


# Equal channels -----------------------------------------------------------------------------------
# A tensor has one step for all of its channels, and most channels use a small part of its range: 8
# bits are then coarse for them. Between two convolutions a channel may be multiplied by any
# positive number and its weights divided by it; neither ReLU nor maxima, sums or repeated pixels
# change that (Nagel et al., "Data-Free Quantization Through Weight Equalization and Bias
# Correction", 2019). Weights divided by more are rounded more coarsely, so channels are brought
# half of the way, in stops (Xiao et al., "SmoothQuant", 2023): pictures of `m` are then 58.6 dB
# from float32, instead of 57.0 (126 frames of 9 clips).

WAY = 0.5
"""How far channels are brought to equal ranges."""
LEAST_SHARE = 1 / 64
"""Channels that need less of the range than this, perhaps none of it, are treated as if they needed
this much."""
CHANNELWISE = ("Relu", "MaxPool", "Resize", "Add")


def find_groups(graph: onnx.GraphProto) -> dict[str, str]:
    """Tensor -> the group of tensors whose channels have to be multiplied alike, by one of them;
    without tensors that must stay as they are."""
    constants = {weight.name for weight in graph.initializer}
    group: dict[str, str] = {}
    fixed = {value.name for value in (*graph.input, *graph.output)}
    for node in graph.node:
        if node.op_type == "Conv":
            group.setdefault(node.output[0], node.output[0])
            continue
        tensors = [name for name in (*node.input, *node.output) if name and name not in constants]
        if node.op_type not in CHANNELWISE:
            fixed |= set(tensors)
        for name in tensors:  # those of the first one's group join that of the last
            before, after = (group.setdefault(each, each) for each in (tensors[0], name))
            group.update((each, after) for each, held in list(group.items()) if held == before)
    fixed = {group.get(name, name) for name in fixed}
    return {name: held for name, held in group.items() if held not in fixed}


def equalise(model: onnx.ModelProto, shares: Mapping[str, np.ndarray]) -> onnx.ModelProto:
    """A float32 network that gives the same result, and whose channels use their tensors' ranges
    alike.

    Args:
        shares: tensor -> the part of its range that each channel needs, (C,).
    """
    model = onnx.ModelProto.FromString(model.SerializeToString())
    group = find_groups(model.graph)
    needs: dict[str, np.ndarray] = {}
    for name, share in shares.items():
        if name in group:
            needs[group[name]] = np.maximum(needs.get(group[name], 0), share)
    gains = {name: (np.maximum(need, LEAST_SHARE) ** -WAY).astype(np.float32)
             for name, need in needs.items()}
    weights = {weight.name: weight for weight in model.graph.initializer}

    def multiply(name: str, factor: np.ndarray) -> None:
        weights[name].CopyFrom(numpy_helper.from_array(constant_value(model.graph, name) * factor,
                                                       name))

    for node in model.graph.node:
        read, written = (gains.get(group.get(name, "")) for name in (node.input[0], node.output[0]))
        if node.op_type == "Conv":
            if read is not None:
                multiply(node.input[1], 1 / read[None, :, None, None])
            if written is not None:
                multiply(node.input[1], written[:, None, None, None])
                for bias in node.input[2:]:
                    multiply(bias, written)
        elif node.op_type == "Add" and written is not None:
            for constant in weights.keys() & set(node.input):
                multiply(constant, written[:, None, None])
    return model


# The command --------------------------------------------------------------------------------------

PRECISION = "int8"
LAYERS = ("down", "lift", "up")
"""Modules of the trunk whose ranges are measured. Heads and, except at 1x, the stem are in integers
as well: heads read the outputs of these modules, and the stem has its own ranges
(`training.denoise.int8`). At 1x the stem stays in float: in 8 bits it costs frames of many samples
0.9 dB."""
FINE = {"m": ("down.0",), "s": ("down.0", "down.1")}
"""Size of a network -> its first layers, which stay in float at 1x: in integers they would cost
frames of many samples up to a decibel. The second one costs `m` 60 ms of 430 at 960x540 and gains
0.01 dB, `s` 8 ms of 166 and gains 0.04 dB."""

Look = Callable[[Mapping[str, np.ndarray]], None]


class Shot(NamedTuple):
    """Frames in order, and output size over render size; None for the size of the guides, or 2."""

    scale: float | None
    frames: Iterable[Frame]


class WatchedDevice(Device):
    """A CPU device that always runs one given network, whatever a pass asks for, and passes its
    inputs to `look`."""

    def __init__(self, library: Library, name: str, look: Look) -> None:
        super().__init__("cpu")
        self._library, self._name, self._look = library, name, look

    def pipeline_state(
        self, library: Library, name: str, dims: Dims | None = None,
        in_place: Mapping[str, str] | None = None, threads: int | None = None,
        heads: Mapping[str, Head] | None = None, own_kernels: bool = False,
    ) -> PipelineState:
        state = super().pipeline_state(self._library, self._name, dims, in_place, threads, heads,
                                       own_kernels)
        vars(state)["prepare"] = partial(self._prepare, state, state.prepare)
        return state

    def _prepare(self, state: PipelineState,
                 prepare: Callable[[list[Tensor]], Callable[[], None]],
                 tensors: list[Tensor]) -> Callable[[], None]:
        run = prepare(tensors)
        reads = {b.name: t.host_view()
                 for b, t in zip(state.bindings, tensors, strict=True) if b.access == "read"}

        def watch() -> None:
            self._look(reads)
            run()

        return watch


def shots(source: str, ending: str) -> Iterator[Shot]:
    """Frames of a folder of clips or of a sequence, for a network whose name has this ending: a
    network for guides gets only frames with guides, others get all frames without them; a network
    for 1x runs at scale 1, whatever the size of the references.

    Raises ValueError if there are none.
    """
    found, guided, unscaled = 0, ending == GUIDED, ending == UNSCALED
    clips = sorted(Path(source).glob("[!.]*.npz")) if Path(source).is_dir() else []
    for clip in map(load_clip, clips):
        # at scale 1 guides are not read
        if guided and ("guide_jitter" not in clip or clip["scale"] == 1):
            continue
        for variant in range(clip["variants"]):
            frames = [_frame(clip, variant, t, guided) for t in range(len(clip["reference"]))]
            yield Shot(1 if unscaled else clip["scale"], frames)
            found += 1
    if not clips:
        sequence = postfx.read_sequence(source)
        yield Shot(1 if unscaled else None,
                   (frame for frame in sequence if frame.guides or not guided))
        found = len(sequence)
    if not found:
        raise ValueError(f"{source}: no clip with guides")


def _frame(clip: Mapping[str, Any], variant: int, t: int, guided: bool) -> Frame:
    v = f"v{variant}_"
    planes = {Role(name): _plane(clip[v + name][t]) for name in PLANES}
    guides = {Role(name): _plane(clip[f"guide_{name}"][t]) for name in GUIDES if guided}
    if guided:
        guides[Role.DEPTH] = _plane(guide_depth(clip["guide_depth"][t]))
    return Frame(planes, t + 1, tuple(clip[v + "jitter"][t].tolist()), reset=bool(clip["reset"][t]),
                 guides=guides)


def _plane(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values.reshape(*values.shape[:2], -1), np.float32)


def pictures(found: Iterable[Shot], library: Library, name: str,
             look: Look = lambda reads: None) -> list[np.ndarray]:
    """Results of a network for all shots as people see them: exposed, x/(1+x), sRGB."""
    device, tag = WatchedDevice(library, name, look), name.split(".")[1]
    results = []
    for shot in found:
        pipeline = postfx.Pipeline([postfx.DenoiseUpscale(model=exact(tag), scale=shot.scale)],
                                   device)
        for frame in shot.frames:
            light = np.maximum(pipeline(frame)[Role.COLOUR] * pipeline.exposure, 0)
            results.append(srgb_encode(light / (1 + light)).astype(np.float16))
    return results


def variant_name(name: str, precision: str) -> str:
    """'denoise_upscale.m.guides' -> 'denoise_upscale.m.int8.guides'."""
    plain, ending = split_ending(name)
    return f"{plain}.{precision}{ending}"


def layers_of(graph: onnx.GraphProto, name: str) -> list[str]:
    """Modules of a network to quantise, as 'up.0'."""
    size, ending = name.split(".")[1], split_ending(name)[1]
    kept = FINE.get(size, ()) if ending == UNSCALED else ()
    found = dict.fromkeys(".".join(node.input[1].split(".")[:2])
                          for node in convolutions(graph, LAYERS))
    return [layer for layer in found if layer not in kept]


def make_int8(name: str, library: Library, source: str, folder: Path) -> dict[str, Any]:
    """Write a network's int8 variant and its card to a folder; returns the card."""
    model = unfold_half(lower_constants(onnx.load_from_string(library.load(name))))
    ending = split_ending(name)[1]
    layers = layers_of(model.graph, name)
    kept = activations(model.graph, layers)
    widths = Calibration(model, dict.fromkeys(kept.values()), ())
    pictures(shots(source, ending), library, name, widths.add)
    model = equalise(model, widths.shares())
    stem = None if ending == UNSCALED else Stem(model.graph)
    quantised = convolutions(model.graph, layers)
    calibration = Calibration(model, dict.fromkeys(kept.values()),
                              [*quantised, *heads(model.graph).values()], stem)
    before = pictures(shots(source, ending), library, name, calibration.add)
    ranges, weights = calibration.ranges(), calibration.weights()
    small = quantise(model, layers, {tensor: ranges[like] for tensor, like in kept.items()},
                     weights)
    small = in_integers(small, weights, stem)
    store_half(small.graph)
    path = folder / f"{variant_name(name, PRECISION)}.onnx"
    told = facts(small)
    write_model(small, path)
    card = {**library.card(name), "name": path.stem, "tag": path.stem.split(".", 1)[1],
            "precision": PRECISION}
    for other in ("quality", "parity", "recipe"):  # they belong to the float32 network
        card.pop(other, None)
    card |= known_recipe(path.with_suffix(".json"))
    known, found = library.card(name).get("outputs", {}), told
    found["outputs"] = {output: known.get(output, own) for output, own in found["outputs"].items()}
    card |= {"made_from": {"name": name, "sha256": library.card(name).get("sha256")},
             **found, "int8_layers": len(quantised) + (stem is not None)}
    write_card(path, card)  # the card says which outputs are constant
    after = pictures(shots(source, ending), Library(folder), path.stem)
    card["difference"] = {**difference(after, before), "frames": len(before)}
    write_card(path, card)
    return card


def difference(found: list[np.ndarray], wanted: list[np.ndarray]) -> dict[str, float]:
    """PSNR in dB of pictures 0..1 against others: mean over the pictures, and of the worst one."""
    errors = [np.square(a.astype(np.float32) - b).mean()
              for a, b in zip(found, wanted, strict=True)]
    decibels = -10 * np.log10(np.maximum(errors, 1e-12))
    return {"psnr_db": round(float(decibels.mean()), 2),
            "worst_psnr_db": round(float(decibels.min()), 2)}


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name",
                        help="model of the folder, as denoise_upscale.m or denoise_upscale.m.1x")
    parser.add_argument("--clips", required=True, metavar="SOURCE",
                        help="folder of clips (.npz), or a noisy sequence")
    parser.add_argument("-o", "--models", type=Path, default=MODELS, metavar="FOLDER",
                        help="where it is, and where to write")
    return parser


def main() -> None:
    args = options().parse_args()
    card = make_int8(args.name, Library(args.models), args.clips, args.models)
    path = args.models / f"{card['name']}.onnx"
    print(f"{path}: {path.stat().st_size} bytes, {card['int8_layers']} "
          f"convolutions in int8; against float32 {card['difference']['psnr_db']} dB, worst frame "
          f"{card['difference']['worst_psnr_db']} dB")


if __name__ == "__main__":
    main()
