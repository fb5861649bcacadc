"""A U-Net that corrects classical ambient occlusion.

    python -m training.datagen.occlusion SCENES VIEWS --rounds 7 --rays 128
    python -m training.occlusion VIEWS MODELS [--steps 6000]

Trains on the views and writes MODELS/occlusion.onnx, with weights in half precision (that of
samples/ learned for 9300 steps; docs/lab/networks.md has all commands). It reads what
postfx/kernels/occlusion.py reads and writes: normals in camera space (h, w, 3), depth (h, w, 1),
the camera (12,), and GTAO's visibility (h, w), raw and smooth; sides are multiples of 16. It adds a
correction to the smooth one. `samples/occlusion.py` measures it. One scene in 12 is never learnt
from; their PSNR is printed.

How dark a place is does not depend on left and right or top and bottom: views are mirrored at
random.
"""

from __future__ import annotations

import argparse
import copy
import math
import zlib
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.export import Dim
from torch.nn import functional as F

from postfx import Device
from postfx.kernels.occlusion import FAR, FIND_SURFACE, HORIZONS, SMOOTH_OCCLUSION
from postfx.runtime import ArgumentTable
from training.export import export

HELD = 12
SETTINGS = np.array((0.9, 0.0), np.float32)
READS = ("normal", "depth", "camera", "raw", "smooth")
WINDOWS = 3, 9, 27, 81
"""Pixels of the squares in which the network compares a pixel's depth with those around it."""
MEAN = 0.002
"""How fast the mean of the weights, which is exported, follows them."""


# What the network reads ---------------------------------------------------------------------------

def camera_of(view: dict[str, np.ndarray], k: int) -> np.ndarray:
    """The argument `camera` (12,) of a view's k-th radius; its normals are in camera space
    already."""
    (height, width), tangent = view["depth"].shape, view["tangent"]
    return np.array([*np.eye(3).ravel(), view["radii"][k], tangent, tangent * height / width],
                    np.float32)


def classical(device: Device, view: dict[str, np.ndarray], k: int) -> tuple[np.ndarray, np.ndarray]:
    """GTAO's visibility (h, w) within a view's k-th radius, raw and smooth."""
    (height, width), new = view["depth"].shape, device.heap.tensor
    made = {"normal": device.wrap("normal", np.ascontiguousarray(view["normal"], np.float32)),
            "depth": device.wrap("depth",
                                 np.ascontiguousarray(view["depth"][..., None], np.float32)),
            "camera": device.wrap("camera", camera_of(view, k)),
            "settings": device.wrap("settings", SETTINGS),
            "surface": new("surface", (height, width, 4)), "raw": new("raw", (height, width)),
            "smooth": new("smooth", (height, width))}
    commands = device.command_buffer("occlusion")
    for kernel, renamed in ((FIND_SURFACE, {}), (HORIZONS, {"visible": "raw"}),
                            (SMOOTH_OCCLUSION, {"noisy": "raw", "visible": "smooth"})):
        state = device.compute_state(kernel)
        with commands.compute_encoder(kernel.name) as encoder:
            encoder.barrier(after="compute", before="compute")
            names = (*kernel.reads, *kernel.writes)
            encoder.dispatch(state, ArgumentTable(state, {name: made[renamed.get(name, name)]
                                                          for name in names}))
    commands.commit()
    commands.wait()
    return made["raw"].array.copy(), made["smooth"].array.copy()


def planes_of(normal: torch.Tensor, depth: torch.Tensor, camera: torch.Tensor, raw: torch.Tensor,
              smooth: torch.Tensor) -> torch.Tensor:
    """Planes (n, 13, h, w) of normals (n, h, w, 3), depth (n, h, w), cameras (n, 12) and GTAO's
    visibility (n, h, w).

    They are the normal; depth in radii, log; pixels of the radius, log; cosine of the normal to the
    view ray; whether there is a surface; GTAO's raw and smooth visibility; for each window how much
    nearer than the pixel it is in the mean, in radii, squeezed into [-1, 1].

    The last four tell what few bits of the logarithm cannot. The reciprocal of depth is averaged,
    because it is linear in the picture on a plane, so that planes have 0 however they lie.
    """
    height, width = depth.shape[1:]
    radius, across, down = (camera[:, k, None, None] for k in (9, 10, 11))
    z = depth / radius
    there = ((z > 0) & (z < float(FAR))).float()
    z = torch.where(there > 0, z, torch.full_like(z, 100.0))
    x = ((torch.arange(width, device=z.device)[None, None] + 0.5) / width * 2 - 1) * across
    y = (1 - (torch.arange(height, device=z.device)[None, :, None] + 0.5) / height * 2) * down
    size = torch.log((width / (2 * across * z)).clamp(0.25, 256.0))
    facing = ((normal[..., 2] - normal[..., 0] * x - normal[..., 1] * y)
              / torch.sqrt(x**2 + y**2 + 1))
    heights = []
    for window in WINDOWS:
        nearer = z * (z * _box((there / z)[:, None], window)[:, 0] - 1)
        heights.append(there * nearer / (1 + nearer.abs()))
    return torch.stack([*normal.unbind(-1), torch.log(z), size, facing, there, raw, smooth,
                        *heights], 1)


def _box(x: torch.Tensor, size: int) -> torch.Tensor:
    """Means of squares (n, c, h, w), of what lies in the picture."""
    half, mean = size // 2, F.avg_pool2d
    rows = mean(x, (size, 1), stride=1, padding=(half, 0), count_include_pad=False)
    return mean(rows, (1, size), stride=1, padding=(0, half), count_include_pad=False)


# The network --------------------------------------------------------------------------------------

class Block(nn.Module):
    """Two convolutions beside a third of one pixel."""

    def __init__(self, reads: int, makes: int) -> None:
        super().__init__()
        self.a = nn.Conv2d(reads, makes, 3, padding=1)
        self.b = nn.Conv2d(makes, makes, 3, padding=1)
        self.c = nn.Conv2d(reads, makes, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        found: torch.Tensor = self.c(x) + self.b(F.relu(self.a(F.relu(x))))
        return found


class OcclusionNet(nn.Module):
    """A U-Net of five levels, from planes (n, 13, h, w) to visibility (n, 1, h, w); untrained, that
    of GTAO."""

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        sizes = [width, width * 3 // 2, width * 2, width * 3, width * 4]
        self.first = nn.Conv2d(9 + len(WINDOWS), width, 3, padding=1)
        self.down = nn.ModuleList(Block(sizes[max(k - 1, 0)], sizes[k]) for k in range(5))
        self.up = nn.ModuleList(Block(sizes[k + 1] + sizes[k], sizes[k]) for k in range(4))
        self.last = nn.Conv2d(width, 1, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, planes: torch.Tensor) -> torch.Tensor:
        kept, y = [], self.first(planes)
        for k, block in enumerate(self.down):
            y = block(F.avg_pool2d(y, 2) if k else y)
            kept.append(y)
        for k in range(3, -1, -1):
            y = self.up[k](torch.cat([F.interpolate(y, scale_factor=2.0), kept[k]], 1))
        found: torch.Tensor = planes[:, 8:9] + self.last(y)
        return found


class _Exported(nn.Module):
    """The network with what it reads and writes as the kernels have it."""

    def __init__(self, network: OcclusionNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, normal: torch.Tensor, depth: torch.Tensor, camera: torch.Tensor,
                raw: torch.Tensor, smooth: torch.Tensor) -> torch.Tensor:
        planes = planes_of(normal[None], depth[None, ..., 0], camera[None], raw[None], smooth[None])
        found = self.network(planes)[0, 0].clamp(0.0, 1.0)
        return torch.where(planes[0, 6] > 0, found, torch.ones_like(found))


def export_network(network: OcclusionNet, path: Path) -> None:
    """Write the network as ONNX, for pictures whose sides are multiples of 16."""
    height, width = 16 * Dim("rows", min=2, max=512), 16 * Dim("columns", min=2, max=512)
    examples = [torch.rand(32, 48, 3), 1 + torch.rand(32, 48, 1), torch.rand(12) + 0.5,
                *torch.rand(2, 32, 48)]
    sides = {0: height, 1: width}
    names: dict[str, tuple[int | str, ...]] = {
        "normal": ("height", "width", 3), "depth": ("height", "width", 1), "camera": (12,),
        **dict.fromkeys(("raw", "smooth", "visible"), ("height", "width"))}
    free = [sides, sides, None, sides, sides]
    rounded = copy.deepcopy(network).half().float()
    export(_Exported(rounded.cpu().eval()), examples, READS, ["visible"], path, free, names)


# Training -----------------------------------------------------------------------------------------

class Views:
    """All views of a folder at all radii on a device, each pair a sample; what is read of them is
    made when asked for.

    Attributes:
        samples: view and radius (n, 2) of each.
        held, learnt: indices of samples to measure by and to learn from.
    """

    def __init__(self, folder: Path, place: torch.device) -> None:
        device, held = Device("cpu"), []
        parts: dict[str, list[torch.Tensor]] = {key: [] for key in (*READS, "visible")}
        self.samples = np.empty((0, 2), np.int64)
        for index, path in enumerate(sorted(folder.glob("*.npz"))):
            with np.load(path) as file:
                view = dict(file)
            radii = range(len(view["radii"]))
            found = [classical(device, view, k) for k in radii]
            arrays = (view["normal"], view["depth"], np.stack([camera_of(view, k) for k in radii]),
                      *(np.stack(some).astype(np.float16) for some in zip(*found, strict=True)),
                      view["visible"])
            for key, array in zip(parts, arrays, strict=True):
                parts[key].append(torch.from_numpy(array))
            self.samples = np.concatenate([self.samples, [(index, k) for k in radii]])
            held += [zlib.crc32(path.name.split(".")[0].encode()) % HELD == 0] * len(radii)
        self._parts = {key: torch.stack(some).to(place) for key, some in parts.items()}
        self.held, self.learnt = (np.flatnonzero(np.equal(held, value)) for value in (True, False))

    @property
    def device(self) -> torch.device:
        return self._parts["depth"].device

    def batch(self, chosen: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Planes (n, 13, h, w) and truth (n, 1, h, w)."""
        at, k = torch.from_numpy(self.samples[chosen].T).to(self.device)
        normal, depth = (self._parts[key][at].float() for key in ("normal", "depth"))
        camera, raw, smooth, truth = (self._parts[key][at, k].float()
                                      for key in ("camera", "raw", "smooth", "visible"))
        return planes_of(normal, depth, camera, raw, smooth), truth[:, None]


def mirrored(planes: torch.Tensor, truth: torch.Tensor,
             how: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Views with left and right (bit 0) and top and bottom (bit 1) exchanged; normals turn with
    them."""
    for bit, axis in ((0, -1), (1, -2)):
        if how >> bit & 1:
            planes, truth = planes.flip(axis), truth.flip(axis)
            planes[:, bit] = -planes[:, bit]
    return planes, truth


def squared_error(found: torch.Tensor, truth: torch.Tensor, planes: torch.Tensor) -> torch.Tensor:
    """Mean over pixels with a surface (n,)."""
    there = planes[:, 6:7]
    return ((found - truth) ** 2 * there).sum((1, 2, 3)) / there.sum((1, 2, 3)).clamp(min=1)


def measure(network: OcclusionNet, views: Views) -> str:
    """PSNR of held-out views, classical and by the network, over all radii."""
    errors = np.zeros(2)
    for at in views.held:
        planes, truth = views.batch(np.array([at]))
        with torch.no_grad():
            found = network(planes).clamp(0.0, 1.0)
        errors += [squared_error(one, truth, planes).mean().item()
                   for one in (planes[:, 8:9], found)]
    before, after = -10 * np.log10(errors / max(len(views.held), 1) + 1e-12)
    return f"held-out: classical {before:.2f} dB, network {after:.2f} dB"


def train(views: Views, steps: int, width: int = 32, batch: int = 32,
          seed: int = 0) -> OcclusionNet:
    """A network that has learnt so many steps, with the mean of its last weights."""
    torch.manual_seed(seed)
    random, place = np.random.default_rng(seed), views.device
    network = OcclusionNet(width).to(place)
    mean = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), 1e-3, weight_decay=1e-3)
    for step in range(steps):
        begun = min(1, (step + 1) / min(200, steps / 4))
        left = (1 + math.cos(math.pi * step / steps)) / 2
        for group in optimizer.param_groups:
            group["lr"] = 1e-3 * begun * left + 1e-6
        planes, truth = mirrored(*views.batch(random.choice(views.learnt, batch)), step % 4)
        with torch.autocast(place.type, torch.bfloat16, enabled=place.type == "cuda"):
            found = network(planes)
        # each view counts
        loss = torch.sqrt(squared_error(found.float(), truth, planes) + 1e-5).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        with torch.no_grad():
            for one, other in zip(mean.parameters(), network.parameters(), strict=True):
                one.lerp_(other, max(MEAN, 10 / (step + 10)))
        if step % 500 == 499:
            print(f"step {step + 1}: loss {loss.item():.5f}, {measure(network, views)}", flush=True)
    print(f"{step} steps; {measure(mean, views)}", flush=True)
    return mean


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views", type=Path)
    parser.add_argument("models", type=Path)
    parser.add_argument("--steps", type=int, default=6000)
    return parser


def main() -> None:
    args = options().parse_args()
    views = Views(args.views, torch.device("cuda" if torch.cuda.is_available() else "cpu"))
    print(f"{len(views.learnt)} views at a radius to learn from, {len(views.held)} held out")
    export_network(train(views, args.steps), args.models / "occlusion.onnx")


if __name__ == "__main__":
    main()
