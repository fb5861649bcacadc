"""Where a tone mapper's training starts: at a shipped model, or at nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from postfx.system import models_dir
from training.networks.hdrnet import GUIDE_PARTS, HDRNet

STATE = dict[str, torch.Tensor]


def start_network(start: str, cube: torch.Tensor) -> HDRNet:
    """A network with the weights of a model, by tag or file, and with another cube; a fresh one for 'none'."""
    net = HDRNet(cube)
    if start != "none":
        net.load_state_dict(weights_of(find_model(start), net.state_dict()) | {"cube": cube})
    return net


def find_model(start: str) -> Path:
    """A model file by its own name, or by the tag of a shipped look."""
    path = Path(start) if start.endswith(".onnx") else models_dir() / f"tonemap.{start}.onnx"
    if not path.is_file():
        raise SystemExit(f"{path}: no such model to start from: name another with --start, or 'none'")
    return path


def shipped_cubes() -> dict[str, torch.Tensor]:
    """Cubes of all shipped looks, by tag."""
    found = {path.name.split(".")[1]: _initializers(path) for path in sorted(models_dir().glob("tonemap.*.onnx"))}
    return {tag: torch.from_numpy(values["cube"].copy()) for tag, values in found.items()}


def weights_of(path: Path, like: STATE) -> STATE:
    """Weights of an exported network; what the exporter left out because it is zero stays as in `like`."""
    found = _initializers(path)
    if "guide" not in found:
        raise SystemExit(f"{path}: not a look with a grid: start from another, or from 'none'")
    parts = np.split(found["guide"], np.cumsum(list(GUIDE_PARTS.values()))[:-1])
    found |= {f"guide.{name}": part for name, part in zip(GUIDE_PARTS, parts, strict=True)}
    return {name: torch.from_numpy(found[name].copy()).reshape(value.shape) if name in found else value
            for name, value in like.items()}


def _initializers(path: Path) -> dict[str, np.ndarray]:
    """All constants of a model, float32."""
    import onnx  # a machine that starts from nothing may lack it

    return {item.name.removesuffix("_half"): onnx.numpy_helper.to_array(item).astype(np.float32)
            for item in onnx.load(path).graph.initializer}
