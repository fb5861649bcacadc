"""Weights of a network that was exported, for training to go on from: the inverse of ``export.py``."""
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor

from training.denoise.model import logits_of

PREFIX, HALF = "trunk.", "_half"


def weights_of(path: Path) -> dict[str, Tensor]:
    """Name -> float32 weights as a checkpoint holds them, from ``denoise_upscale.<tag>[.guides|.1x].onnx``.

    They are rounded to half precision, as the file keeps them. Raises ValueError for variants of other precision.
    """
    found = {t.name.removesuffix(HALF): torch.from_numpy(numpy_helper.to_array(t).astype("float32"))
             for t in onnx.load(path).graph.initializer}
    stored = {name: values for name, values in found.items() if "." in name or name == "rest"}
    if "fine.weight" not in stored:
        raise ValueError(f"{path}: no weights of the fine head: take the float32 model, as denoise_upscale.m.onnx")
    alike = (found[level] for level in sorted(found) if level.startswith("level"))
    stored |= {f"alike.{i}": logits_of(level).half().float() for i, level in enumerate(alike)}
    stored["stem.bias"] = stored.pop("stems.0.bias")
    stored["stem.weight"] = torch.cat([stored.pop(f"stems.{i}.weight") for i in range(2)], 1)
    return {PREFIX + name: values.contiguous() for name, values in stored.items()}
