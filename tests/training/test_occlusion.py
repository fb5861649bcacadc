"""The U-Net of ambient occlusion: what it reads, its ONNX form beside the kernels, and that it
learns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("onnxscript")

from postfx import Device, Library
from postfx.kernels.occlusion import FAR
from postfx.runtime import ArgumentTable
from training.occlusion import (
    READS,
    OcclusionNet,
    Views,
    camera_of,
    classical,
    export_network,
    mirrored,
    planes_of,
    squared_error,
    train,
)


def make_view(seed: int) -> dict[str, np.ndarray]:
    """A ball on a plane that faces the camera, and an empty corner; "visibility" is what the normal
    tells."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-1, 1, 48) - random.uniform(-0.3, 0.3), np.linspace(1, -1, 32))
    high = np.sqrt(np.maximum(0.25 - x**2 - y**2, 0))
    normal = np.where(high[..., None] > 0, np.stack([x, y, high], -1) / 0.5, [0, 0, 1.0])
    depth = np.where((x < -0.9) & (y > 0.8), 2 * FAR, 3 - high)
    return {"normal": normal.astype(np.float16), "depth": depth.astype(np.float32),
            "tangent": np.float32(0.4),
            "visible": np.tile(0.5 + 0.5 * normal[..., 0] * normal[..., 2], (3, 1, 1))
                       .astype(np.float16), "radii": np.float32([0.1, 0.2, 0.4])}


def given(device: Device, view: dict[str, np.ndarray], k: int) -> list[np.ndarray]:
    return [view["normal"].astype(np.float32), view["depth"][..., None], camera_of(view, k),
            *classical(device, view, k)]


def planes(arrays: list[np.ndarray]) -> torch.Tensor:
    """What the network reads of one view."""
    normal, depth, *others = (torch.from_numpy(array)[None] for array in arrays)
    return planes_of(normal, depth[..., 0], *others)


@pytest.mark.soak
def test_the_onnx_form_reads_what_the_kernels_make(tmp_path: Path) -> None:
    torch.manual_seed(0)
    device, network, view = Device("cpu", threads=1), OcclusionNet(8), make_view(0)
    torch.nn.init.normal_(network.last.weight, std=0.05)
    arrays = given(device, view, 1)
    with torch.no_grad():
        wanted = network(planes(arrays))[0, 0].clamp(0, 1).numpy()
    export_network(network, tmp_path / "occlusion.onnx")
    state = device.pipeline_state(Library(tmp_path), "occlusion", {"height": 32, "width": 48})
    bound = {name: device.wrap(name, np.ascontiguousarray(array))
             for name, array in zip(READS, arrays, strict=True)}
    visible = device.heap.tensor("visible", (32, 48))
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("network") as encoder:
        encoder.dispatch_network(state, ArgumentTable(state, bound | {"visible": visible}))
    commands.commit()
    commands.wait()
    there = view["depth"] < FAR
    # its weights are in half precision
    np.testing.assert_allclose(visible.array[there], wanted[there], atol=2e-3)
    assert not there.all() and (visible.array[~there] == 1).all() and wanted[there].std() > 0.01


def test_mirrored_planes_are_those_of_the_mirrored_view() -> None:
    device, view = Device("cpu", threads=1), make_view(1)
    arrays = given(device, view, 2)
    made, truth = planes(arrays), torch.rand(1, 1, 32, 48)
    for how, axis, part in ((1, 1, 0), (2, 0, 1)):
        other = [np.ascontiguousarray(array if array.ndim == 1 else np.flip(array, axis))
                 for array in arrays]
        other[0][..., part] *= -1
        found, turned = mirrored(made, truth, how)
        torch.testing.assert_close(found, planes(other))
        torch.testing.assert_close(turned, truth.flip(axis - 2))


def test_it_learns_what_the_normal_tells(tmp_path: Path) -> None:
    for seed in range(4):
        np.savez(tmp_path / f"view-{seed}.0.npz", **make_view(seed))
    views = Views(tmp_path, torch.device("cpu"))
    made, truth = views.batch(np.arange(len(views.samples)))
    network = train(views, steps=60, width=8, batch=4)
    with torch.no_grad():
        after = squared_error(network(made), truth, made)
    assert after.mean() < 0.3 * squared_error(made[:, 8:9], truth, made).mean()
