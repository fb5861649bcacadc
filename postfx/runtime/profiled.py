"""One run of a model as it is written, timed by ONNX Runtime's own profile."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnxruntime as ort

from postfx.runtime.session import Placement, providers_of, session_options


def run_profiled(
    model: bytes, placement: Placement, inputs: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], float]:
    """Outputs by name, and the milliseconds of the kernels alone. Nothing is fused, moved or folded."""
    options = session_options(placement, {})
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.enable_profiling = True
    with tempfile.TemporaryDirectory(prefix="postfx-profile-") as folder:
        options.profile_file_prefix = str(Path(folder) / "run")
        session = ort.InferenceSession(model, options, providers=providers_of(placement, exclusive=False))
        names = [item.name for item in session.get_outputs()]
        try:
            arrays = session.run(names, dict(inputs))
        finally:
            profile = session.end_profiling()
        return dict(zip(names, arrays, strict=True)), _milliseconds(Path(profile))


def _milliseconds(profile: Path) -> float:
    events = json.loads(profile.read_text(encoding="utf-8"))
    return sum(e["dur"] for e in events if e.get("cat") == "Node" and e["name"].endswith("_kernel_time")) / 1000
