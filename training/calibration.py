"""What a float network computes in runs over frames: ranges to keep its tensors in, and moments to round weights by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import onnx
import onnxruntime
from onnx import NodeProto

from training.graph_parts import value
from training.integer_stem import Stem
from training.qdq import Range, show
from training.rounding import Moments, Rounded

SAMPLED = 4096
"""Values of a tensor that are noted of each frame."""
SHARES = np.geomspace(0.01, 1, 120)
"""Parts of a tensor's full range that are tried."""
POWER = 1.5
"""Of the error that is least in sum. With 2, few extremes of few frames make ranges too wide for all others: pictures
are then 1.4 dB further from float32 (`m` and `s`, held-out frames); with 1, extremes fall out and one frame suffers."""


class Calibration:
    """Notes the runs of a float32 network.

    Args:
        tensors: names whose ranges are wanted.
        convolutions: nodes whose weights are to be rounded.
        stem: rounded as well, if any.
    """

    def __init__(self, model: onnx.ModelProto, tensors: Iterable[str], convolutions: Iterable[NodeProto],
                 stem: Stem | None = None) -> None:
        self._graph, self._nodes, self._stem = model.graph, list(convolutions), stem
        self._moments = {node.input[1]: Moments.of(node) for node in self._nodes}
        self._seen: dict[str, list[np.ndarray]] = {name: [] for name in tensors}
        inputs = {known.name for known in model.graph.input}
        read = (node.input[0] for node in self._nodes)
        self._computed = [name for name in dict.fromkeys([*self._seen, *read]) if name not in inputs]
        self._session = onnxruntime.InferenceSession(show(model, self._computed).SerializeToString(),
                                                     providers=["CPUExecutionProvider"])
        self._random = np.random.default_rng(0)

    def add(self, reads: Mapping[str, np.ndarray]) -> None:
        """Note a run with these inputs."""
        values = {**reads, **dict(zip(self._computed, self._session.run(None, dict(reads)), strict=True))}
        for name, seen in self._seen.items():
            flat = values[name].ravel()
            seen.append(flat[self._random.integers(0, flat.size, SAMPLED)])
        for node in self._nodes:
            self._moments[node.input[1]].add(values[node.input[0]])
        if self._stem:
            self._stem.add(reads)

    def ranges(self) -> dict[str, Range]:
        """For each tensor the range with the least error."""
        return {name: best_range(np.concatenate(seen)) for name, seen in self._seen.items()}

    def weights(self) -> dict[str, Rounded]:
        """Weights of the convolutions in integers, by name."""
        return {name: moments.rounded(value(self._graph, name)) for name, moments in self._moments.items()}


def best_range(values: np.ndarray) -> Range:
    """The part of the range of values that leaves the least error when it is kept in 8 bits."""
    counts, edges = np.histogram(values, 16384)
    middles = (edges[:-1] + edges[1:]) / 2
    tried = [Range.of(share * values.min(), share * values.max()) for share in SHARES]
    return min(tried, key=lambda kept: (counts * np.abs(kept.rounded(middles) - middles) ** POWER).sum())
