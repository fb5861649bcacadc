"""Networks that know one scene: a U-Net from planes to shaded frames, with and without history or
one noisy sample.

    python -m training.datagen.make_sample views VIEWS
    python -m training.scene_network VIEWS MODELS

Trains three networks of the same shape, and writes their weights in half precision, as PyTorch's
(KIND.pt) and as ONNX: shading.onnx from planes alone; temporal.onnx from planes and its own
previous state; amplifier.onnx from planes and colour of one sample a pixel. These two begin with
the weights of MODELS/shading.pt, if it is there. `samples/scene_network.py` runs and measures them.

The networks read first-hit planes of one sample a pixel, and the camera: from them, the graph finds
each pixel's place in the room, and where the mirrored view ray leaves the room's box (Lagarde and
Zanuttini 2012), both with Fourier features (Tancik 2020). What they give is the logarithm of light
without reflectance, which the albedos put back. Codes near white say little about light, so it is
bounded by the most that training saw. Where a lamp or a miss is near white, the amplifier gives the
colour that it is given.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from training import ops

WIDTHS = (48, 64, 96, 104)
"""Channels of the U-Net's levels, from the finest one on."""
BANDS = 6
"""Pairs of waves (`waves`) of a pixel's place."""
BOX_BANDS = 5
"""The same, of the place where the mirrored ray leaves the scene's box."""
WAY_BANDS = 4
"""The same, of the mirrored ray's direction."""
EMITTER = 0.005
"""Reflectance below which a surface counts as an emitter."""
BRIGHT = 4.0
"""Light whose code is near white, 0.9."""
INPUTS = ("diffuse_albedo", "specular_albedo", "normal", "roughness", "depth", "camera")
KINDS = {"shading": (), "temporal": ("motion", "before"), "amplifier": ("colour",)}
"""What each network reads beyond INPUTS."""
STATE = 10
"""Numbers of a pixel that `temporal` hands to the next frame: light, place, 1, and codes of the
picture."""
KEPT = 0.6
"""Share of the picture before in a picture: planes of one sample show one side of an edge, another
in each frame."""
WHITEST = 0.99999
"""Code value that counts as the brightest, of a light of 4e4."""
NEAR = 0.01
"""Distance of a place from the plane of the surface it is history of, in metres and in shares of
the depth, at most."""


# The network --------------------------------------------------------------------------------------

def to_codes(light: torch.Tensor) -> torch.Tensor:
    """Light as codes 0..1: x/(1+x) and the sRGB curve."""
    x = light.clamp(min=0.0) / (1 + light.clamp(min=0.0))
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp(min=1e-6) ** (1 / 2.4) - 0.055)


def to_light(codes: torch.Tensor) -> torch.Tensor:
    """Light of codes 0..1, at most that of `WHITEST`."""
    bounded = codes.clamp(0.0, WHITEST)
    x = torch.where(bounded <= 0.04045, bounded / 12.92, ((bounded + 0.055) / 1.055) ** 2.4)
    return x / (1 - x)


def rays(camera: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Rays (N, 3, H, W) from the cameras (N, 16), 1 long along their axes."""
    u = torch.arange(width, device=camera.device, dtype=torch.float32)[None, None, :]
    v = torch.arange(height, device=camera.device, dtype=torch.float32)[None, :, None]
    x = (1 - 2 * (u + 0.5 + camera[:, 14, None, None]) / width) * camera[:, 12, None, None]
    y = (1 - 2 * (v + 0.5 + camera[:, 15, None, None]) / height) * camera[:, 13, None, None]
    left, up, forward = (camera[:, 3 * k:3 * k + 3, None, None] for k in range(3))
    return left * x[:, None] + up * y[:, None] + forward


def reflectance(diffuse: torch.Tensor, specular: torch.Tensor) -> torch.Tensor:
    """The reflectance that light is divided by: both albedos with a floor, 1 for lamps and
    misses."""
    total = diffuse + specular
    peak = total.amax(1, keepdim=True)
    return torch.where(is_emitter(diffuse, specular), torch.ones_like(total),
                       torch.maximum(total, 0.15 * peak) + 0.01)


def is_emitter(diffuse: torch.Tensor, specular: torch.Tensor) -> torch.Tensor:
    """Where a pixel (N, 1, H, W) shows a lamp or a miss, which reflect nothing."""
    return (diffuse + specular).amax(1, keepdim=True) < EMITTER


def waves(x: torch.Tensor, bands: int) -> torch.Tensor:
    """Sines and cosines of 2^k pi x, k < bands; from the second on by doubling the angle."""
    made = [(math.pi * x).sin(), (math.pi * x).cos()]
    for _ in range(bands - 1):
        sine, cosine = made[-2:]
        made += [2 * sine * cosine, 1 - 2 * sine * sine]
    return torch.cat(made, 1)


class Block(nn.Module):
    """Two convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.one = nn.Conv2d(width, width, 3, padding=1)
        self.two = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.two.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return F.relu(x + self.two(F.relu(self.one(x))))


class SceneNetwork(nn.Module):
    """Features of pixels -> light. `low` and `high` are the corners of the scene's box, `most` its
    brightest light."""

    def __init__(self, kind: str, low: torch.Tensor, high: torch.Tensor, most: float = 6e4) -> None:
        super().__init__()
        self.kind = kind
        self.register_buffer("low", low)
        self.register_buffer("high", high)
        self.register_buffer("most", torch.tensor(most))
        extra = {"shading": 0, "temporal": 4, "amplifier": 3}[kind]
        features = 6 * (BANDS + BOX_BANDS + WAY_BANDS) + 23 + extra
        self.stem = nn.Conv2d(features, WIDTHS[0], 1)
        self.first = nn.Conv2d(WIDTHS[0], WIDTHS[0], 3, padding=1)
        self.downs = nn.ModuleList(nn.Conv2d(a, b, 3, 2, 1)
                                   for a, b in zip(WIDTHS, WIDTHS[1:], strict=False))
        self.encoders = nn.ModuleList([nn.Conv2d(WIDTHS[1], WIDTHS[1], 3, padding=1),
                                       Block(WIDTHS[2]), Block(WIDTHS[3])])
        self.ups = nn.ModuleList(nn.Conv2d(b, a, 1)
                                 for a, b in zip(WIDTHS, WIDTHS[1:], strict=False))
        self.decoders = nn.ModuleList([Block(WIDTHS[0]),
                                       nn.Conv2d(WIDTHS[1], WIDTHS[1], 3, padding=1),
                                       Block(WIDTHS[2])])
        self.last = nn.Conv2d(WIDTHS[0], 4 if kind == "temporal" else 3, 1)
        nn.init.constant_(self.last.bias, 0.5)

    def features(self, x: dict[str, torch.Tensor],
                 ray: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The stem's inputs, of planes (N, C, H, W) and rays, and the places in the box, -1..1."""
        middle = (self.low + self.high)[None, :, None, None] / 2
        half = (self.high - self.low)[None, :, None, None] / 2
        hit = (x["depth"] < 1e6).float()
        eye = (x["camera"][:, 9:12, None, None] - middle) / half
        place = (eye + hit * x["depth"].clamp(max=1e6) * ray / half).clamp(-1.5, 1.5)
        way = F.normalize(ray, dim=1)
        normal = x["normal"]
        mirrored = way - 2 * (way * normal).sum(1, keepdim=True) * normal
        slope = mirrored / half
        slope = torch.where(slope.abs() < 1e-5, torch.full_like(slope, 1e-5), slope)
        reach = ((slope.sign() - place) / slope).amin(1, keepdim=True).clamp(min=0.0)
        leaves = (place + reach * slope).clamp(-1.5, 1.5)
        roughness = x["roughness"]
        albedo = torch.cat([x["diffuse_albedo"], x["specular_albedo"]], 1)
        parts = [place, waves(place, BANDS), waves(leaves, BOX_BANDS), waves(mirrored, WAY_BANDS),
                 leaves, normal, mirrored, albedo, roughness, hit,
                 torch.log1p(x["depth"].clamp(max=1e3)) / 3,
                 x["camera"][:, 14:16, None, None].expand(-1, -1, *ray.shape[2:])]
        return torch.cat(parts, 1), place

    def same_surface(self, before: torch.Tensor, place: torch.Tensor,
                     x: dict[str, torch.Tensor]) -> torch.Tensor:
        """Where a warped state (N, STATE, H, W) is of the surface at these places (N, 1, H, W)."""
        shift = (before[:, 3:6] - place) * (self.high - self.low)[None, :, None, None] / 2
        off = (shift * x["normal"]).sum(1, keepdim=True).abs()
        return (before[:, 6:7] > 0.99) & (off < NEAR * (1 + x["depth"].clamp(max=1e3)))

    def body(self, features: torch.Tensor) -> torch.Tensor:
        """The U-Net: features -> logarithm of light, and for `temporal` the share of history."""
        with torch.autocast(features.device.type, torch.bfloat16,
                            enabled=features.is_cuda and self.training, cache_enabled=False):
            x, kept = F.relu(self.first(F.relu(self.stem(features)))), []
            for down, encode in zip(self.downs, self.encoders, strict=True):
                kept.append(x)
                x = F.relu(encode(F.relu(down(x))))
            for level in reversed(range(len(self.ups))):
                x = F.interpolate(self.ups[level](x), kept[level].shape[2:], mode="nearest")
                x = F.relu(self.decoders[level](x + kept[level]))
        return self.last(x.float())

    def forward(self, x: dict[str, torch.Tensor],
                ray: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Colour, and for `temporal` the next state; all (N, C, H, W)."""
        features, place = self.features(x, ray)
        shine = reflectance(x["diffuse_albedo"], x["specular_albedo"])
        if self.kind == "shading":
            return self.shaded(F.softplus(self.body(features)), shine), None
        if self.kind == "amplifier":
            noisy = torch.log1p(x["colour"].clamp(0.0, 6e4) / shine) / 3
            found = self.shaded(F.softplus(self.body(torch.cat([features, noisy], 1))), shine)
            is_lamp = is_emitter(x["diffuse_albedo"], x["specular_albedo"]) & (found > BRIGHT)
            return torch.where(is_lamp, torch.minimum(x["colour"].clamp(min=BRIGHT), self.most),
                               found), None
        before = warp(x["before"], x["motion"])
        same = self.same_surface(before, place, x)
        past = torch.where(same, before[:, :3], torch.zeros_like(before[:, :3]))
        found = self.body(torch.cat([features, past / 3, same.float()], 1))
        share = torch.sigmoid(found[:, 3:]) * same
        light = torch.lerp(F.softplus(found[:, :3]), past, share)
        colour, codes = self.steadied(self.shaded(light, shine), x)
        return colour, torch.cat([light, place, torch.ones_like(share), codes], 1)

    def steadied(self, colour: torch.Tensor,
                 x: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
        """A picture (N, 3, H, W) averaged with the one before, and its codes.

        The one before is moved as the nearest of each pixel's neighbours does, and held within what
        they show now (Karis 2014, Salvi 2016). Not while the network learns: a frame is to be right
        by itself.
        """
        codes = to_codes(colour)
        if self.training:
            return colour, codes
        motion = nearest_motion(x["motion"], x["depth"])
        known = warp(x["before"][:, 6:7], motion) > 0.99
        around = F.pad(codes, (1, 1, 1, 1), "replicate")
        mean = F.avg_pool2d(around, 3, 1)
        spread = (F.avg_pool2d(around * around, 3, 1) - mean * mean).clamp(min=0.0).sqrt()
        low = torch.maximum(mean - spread, -F.max_pool2d(-around, 3, 1))
        high = torch.minimum(mean + spread, F.max_pool2d(around, 3, 1))
        before = warp(x["before"][:, 7:10], motion, "bicubic").clamp(low, high)
        mixed = torch.where(known, torch.lerp(codes, before, KEPT), codes)
        return torch.where(known, to_light(mixed), colour), mixed

    def shaded(self, light: torch.Tensor, shine: torch.Tensor) -> torch.Tensor:
        """Colour of logarithms of light, at most as bright as what the network learnt from."""
        return torch.minimum(shine * torch.expm1(light.clamp(max=12.0)), self.most)


def nearest_motion(motion: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
    """Motion (N, 2, H, W) of the nearest of each pixel's 3x3 neighbours by depth (N, 1, H, W)."""
    height, width = depth.shape[2:]
    depths, motions = (F.pad(plane, (1, 1, 1, 1), "replicate") for plane in (depth, motion))
    for down in range(3):
        for right in range(3):
            other = depths[:, :, down:down + height, right:right + width]
            motion = torch.where(other < depth,
                                 motions[:, :, down:down + height, right:right + width], motion)
            depth = torch.minimum(depth, other)
    return motion


def warp(image: torch.Tensor, motion: torch.Tensor, mode: str = "bilinear") -> torch.Tensor:
    """`image` (N, C, H, W) where `motion` (N, 2, H, W) in pixels points to; 0 outside."""
    _, _, height, width = image.shape
    x = torch.arange(width, device=image.device, dtype=torch.float32)[None, None, :] + motion[:, 0]
    y = torch.arange(height, device=image.device, dtype=torch.float32)[None, :, None] + motion[:, 1]
    grid = torch.stack([(2 * x + 1) / width - 1, (2 * y + 1) / height - 1], -1)
    return F.grid_sample(image, grid, mode, "zeros", align_corners=False)


class Exported(nn.Module):
    """A network as it is run: planes (H, W, C) -> colour (H, W, 3), and for `temporal` the next
    state (H, W, STATE)."""

    def __init__(self, network: SceneNetwork) -> None:
        super().__init__()
        self.network = network
        self.reads = (*INPUTS, *KINDS[network.kind])
        self.writes = ("shaded", "after") if network.kind == "temporal" else ("shaded",)

    def forward(self, *planes: torch.Tensor) -> torch.Tensor | tuple[torch.Tensor, ...]:
        x = {name: plane[None] if name == "camera" else plane.permute(2, 0, 1)[None]
             for name, plane in zip(self.reads, planes, strict=True)}
        height, width = x["depth"].shape[2:]
        colour, state = self.network(x, rays(x["camera"], height, width))
        made = [one[0].permute(1, 2, 0) for one in (colour, state) if one is not None]
        return tuple(made) if len(made) > 1 else made[0]


def load(kind: str, path: Path) -> SceneNetwork:
    """The network of a file KIND.pt, on the CPU."""
    weights = torch.load(path, map_location="cpu")
    network = SceneNetwork(kind, weights["low"].float(), weights["high"].float(),
                           float(weights["most"]))
    network.load_state_dict(weights)
    return network


def export_network(network: SceneNetwork, path: Path) -> None:
    """Write ONNX."""
    from torch.export import Dim

    from training.export import export, parity

    module, random = Exported(network.eval()), torch.Generator().manual_seed(0)
    channels = {"roughness": 1, "depth": 1, "motion": 2, "before": STATE}
    examples = [torch.rand(16, generator=random) if name == "camera" else
                torch.rand(24, 40, channels.get(name, 3), generator=random)
                for name in module.reads]
    free = [None if name == "camera" else {0: Dim.DYNAMIC, 1: Dim.DYNAMIC} for name in module.reads]
    names = {name: (16,) if name == "camera" else ("height", "width", channels.get(name, 3))
             for name in module.reads}
    names |= {"shaded": ("height", "width", 3), "after": ("height", "width", STATE)}
    export(module, examples, module.reads, module.writes, path, [tuple(free)], names)
    parity(module, path, examples, {"height": 24, "width": 40})


# Training -----------------------------------------------------------------------------------------

HALVES = ("reference_a", "reference_b")


def codes_of(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Codes of light that two independent noisy renders have in the mean."""
    return ops.without_bias(to_codes, first, second)


class Views:
    """Views on a device, as tensors (V, T, H, W, C)."""

    def __init__(self, paths: list[Path], device: str) -> None:
        from concurrent.futures import ThreadPoolExecutor

        def load(path: Path) -> dict[str, np.ndarray]:
            with np.load(path) as file:
                found = {name: file[name] for name in (*INPUTS, "motion", "colour")}
                return found | {half: file[half] for half in HALVES}

        with ThreadPoolExecutor(8) as pool:
            every = list(pool.map(load, paths))
        self.tensors = {name: torch.from_numpy(np.stack([one[name] for one in every])).to(device)
                              .float() for name in every[0]}
        self.count, self.frames, self.height, self.width, _ = self.tensors["depth"].shape
        self.colours = self.tensors["colour"].shape[1]
        self.device = device
        halves = [self.tensors.pop(half) for half in HALVES]
        self.most = float(((halves[0] + halves[1]) / 2).max())
        self.tensors["wanted"] = codes_of(*halves)
        cameras = self.tensors["camera"]
        flat = [rays(cameras[:, k], self.height, self.width).permute(0, 2, 3, 1)
                for k in range(self.frames)]
        self.tensors["ray"] = torch.stack(flat, 1).contiguous()

    def box(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Corners of the box that holds almost all first hits."""
        eye, depth = self.tensors["camera"][:, -1, None, None, 9:12], self.tensors["depth"][:, -1]
        places = (eye + depth * self.tensors["ray"][:, -1])[depth[..., 0] < 1e6][::37]
        ends = [places.kthvalue(max(1, round(share * (len(places) - 1))), 0).values
                for share in (0.001, 0.999)]
        return ends[0].cpu().half().float(), ends[1].cpu().half().float()

    def crops(self, picked: torch.Tensor, size: tuple[int, int],
              last: int) -> list[dict[str, torch.Tensor]]:
        """The last frames of crops: `picked` (B, 4) holds their views, rows, columns and which
        one-sample render."""
        view, colour = picked[:, 0, None, None], picked[:, 3, None, None]
        rows = picked[:, 1, None, None] + torch.arange(size[0], device=self.device)[None, :, None]
        columns = picked[:, 2, None, None] + torch.arange(size[1],
                                                          device=self.device)[None, None, :]
        made = []
        for frame in range(self.frames - last, self.frames):
            planes = {name: self.tensors[name][view, frame, rows, columns].permute(0, 3, 1, 2)
                      for name in (*INPUTS[:-1], "motion", "ray")}
            made.append(planes | {"camera": self.tensors["camera"][picked[:, 0], frame]})
        made[-1]["colour"] = self.tensors["colour"][view, colour, rows, columns].permute(0, 3, 1, 2)
        made[-1]["wanted"] = self.tensors["wanted"][view, rows, columns].permute(0, 3, 1, 2)
        return made


def loss_of(network: SceneNetwork, frames: list[dict[str, torch.Tensor]],
            begins: torch.Tensor) -> torch.Tensor:
    """Mean squared error of the last frame's codes and, with history, of their change along the
    motion.

    `begins` (B,) is the frame of each crop before which there is no history.
    """
    if network.kind != "temporal":
        found, _ = network(frames[-1], frames[-1]["ray"])
        return F.mse_loss(to_codes(found), frames[-1]["wanted"])
    batch, _, height, width = frames[0]["depth"].shape
    state = frames[0]["depth"].new_zeros(batch, STATE, height, width)
    change, codes = state.new_zeros(()), None
    for k, frame in enumerate(frames):
        frame["before"] = state * (begins < k)[:, None, None, None]
        found, state = network(frame, frame["ray"])
        shown = to_codes(found)
        if codes is not None:
            before = warp(frame["before"], frame["motion"])
            same = network.same_surface(before, state[:, 3:6], frame)
            change = (change + ((shown - warp(codes, frame["motion"])) * same).square()
                      .mean() / len(frames))
        codes = shown
    return F.mse_loss(codes, frames[-1]["wanted"]) + CHANGE * change


CHANGE = 0.5
"""Weight of the change along the motion."""


def steps_of(seconds: float, most: int) -> Iterator[tuple[int, float]]:
    """Numbers of steps, and how much of the time or of the steps has passed, 0..1."""
    began, done = time.monotonic(), 0
    while done < most and time.monotonic() - began < seconds:
        yield done, max((time.monotonic() - began) / seconds, done / most)
        done += 1
        if torch.cuda.is_available() and done % 16 == 0:
            torch.cuda.synchronize()


class Trainer:
    """Trains a network by Adam on crops of views, and averages its weights.

    On a GPU, steps from the fourth on replay a CUDA graph. So all that changes from step to step
    stands in tensors that are made once: what is drawn, the rate, and the weight of the average.

    Attributes:
        batch: crops a step.
        began: when steps began that take their usual time, of `time.monotonic`.
    """

    def __init__(self, network: SceneNetwork, views: Views, args: argparse.Namespace,
                 rate: float) -> None:
        self._network, self._views = network, views
        device, self._on_gpu = views.device, views.device == "cuda"
        network.to(device, memory_format=torch.channels_last).train()
        if args.compile:
            network.compile()
        height, width = min(args.crop, views.height), min(args.crop, views.width)
        self._size = height, width
        self._frames = views.frames if network.kind == "temporal" else 1
        self.batch = max(1, args.batch // (2 if self._frames > 1 else 1))
        self._limits = (views.count, views.height - height + 1, views.width - width + 1,
                        views.colours)
        self._random = torch.Generator().manual_seed(0)
        self._picked = torch.zeros(self.batch, 4, dtype=torch.int64, device=device)
        self._begins = torch.zeros(self.batch, device=device)
        self._rate = torch.tensor(rate, device=device)
        self._newest = torch.ones((), device=device)
        self._adam = torch.optim.AdamW(network.parameters(), lr=self._rate, betas=(0.9, 0.99),
                                       weight_decay=1e-4, capturable=self._on_gpu, fused=True)
        self._mean = {name: value.detach().clone() for name, value in network.named_parameters()}
        self._graph: torch.cuda.CUDAGraph | None = None
        self._loss = torch.zeros(())
        self._done = 0
        self.began = time.monotonic()

    def step(self, rate: float) -> torch.Tensor:
        """Change the weights by new crops, at this rate; returns the loss."""
        self._rate.fill_(rate)
        self._newest.fill_(max(0.002, 10 / (self._done + 10)))
        self._draw()
        if self._graph:
            self._graph.replay()
        elif not self._on_gpu or self._done < 3:
            self._loss = self._change_weights()
        else:
            self._capture()
        self._done += 1
        return self._loss

    def take_mean(self) -> None:
        """Give the network the average of its weights."""
        with torch.no_grad():
            for name, value in self._network.named_parameters():
                value.copy_(self._mean[name])

    def _draw(self) -> None:
        """Choose the crops, and before which frame each has no history."""
        chosen = [torch.randint(most, (self.batch,), generator=self._random)
                  for most in self._limits]
        self._picked.copy_(torch.stack(chosen, 1), non_blocking=True)
        begins = torch.randint(0, self._views.frames, (self.batch,), generator=self._random)
        self._begins.copy_(begins, non_blocking=True)

    def _change_weights(self) -> torch.Tensor:
        self._adam.zero_grad(set_to_none=False)
        crops = self._views.crops(self._picked, self._size, self._frames)
        loss = loss_of(self._network, crops, self._begins)
        loss.backward()
        nn.utils.clip_grad_norm_(self._network.parameters(), 1.0)
        self._adam.step()
        for name, value in self._network.named_parameters():
            self._mean[name].lerp_(value.detach(), self._newest)
        return loss.detach()

    def _capture(self) -> None:
        """Record the graph, after one more step on a stream of its own, as PyTorch asks for."""
        self._graph, side = torch.cuda.CUDAGraph(), torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            self._change_weights()
        torch.cuda.current_stream().wait_stream(side)
        with torch.cuda.graph(self._graph):
            self._loss = self._change_weights()
        self.began = time.monotonic()


def fit(network: SceneNetwork, views: Views, args: argparse.Namespace, seconds: float,
        rate: float) -> SceneNetwork:
    """Train with Adam at a rate that falls by half a cosine; returns the network with averaged
    weights."""
    trainer, done = Trainer(network, views, args, rate), 0
    for done, passed in steps_of(seconds, args.steps):
        warm = min(1, (done + 1) / 100)
        loss = trainer.step(rate * warm * (0.5 + 0.5 * math.cos(math.pi * passed)) + 1e-6)
        if done % args.report == 0:
            print(f"{network.kind} step {done}: {-10 * math.log10(float(loss)):.2f} dB, "
                  f"{passed:.0%}", flush=True)
    print(f"{network.kind}: {done + 1} steps of {trainer.batch} crops, "
          f"{1e3 * (time.monotonic() - trainer.began) / (done + 1):.2f} ms each, "
          f"{sum(p.numel() for p in network.parameters())} parameters", flush=True)
    trainer.take_mean()
    return network


def begun_with(network: SceneNetwork, other: SceneNetwork) -> SceneNetwork:
    """The network with the weights of `shading`; what it reads or gives beyond that begins
    with 0."""
    with torch.no_grad():
        for (_, mine), (_, given) in zip(network.named_parameters(), other.named_parameters(),
                                         strict=True):
            mine.zero_()[tuple(slice(0, n) for n in given.shape)] = given.to(mine.device)
    return network


SHARES = {"shading": (1.0, 2e-3), "temporal": (0.65, 1e-3), "amplifier": (0.6, 1.5e-3)}
"""Share of the seconds, and the rate that Adam begins with."""


def train(args: argparse.Namespace) -> None:
    """Write the networks' weights."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.backends.cudnn.benchmark = torch.backends.cudnn.allow_tf32 = True
    torch.backends.cuda.matmul.allow_tf32 = True
    torch.manual_seed(0)
    began = time.monotonic()
    views = Views(sorted(args.views.glob("view.[0-9]*[0-9].npz")), device)
    print(f"{views.count} views of {views.width}x{views.height}, loaded in "
          f"{time.monotonic() - began:.0f} s", flush=True)
    args.models.mkdir(parents=True, exist_ok=True)
    for kind in args.kinds:
        base = args.models / "shading.pt"
        if args.start:
            network = load(kind, args.start / f"{kind}.pt")
        else:
            other = load("shading", base) if kind != "shading" and base.exists() else None
            box = (other.low, other.high) if other else views.box()
            network = SceneNetwork(kind, *box, views.most)
            network = begun_with(network, other) if other else network
        began, (share, rate) = time.monotonic(), SHARES[kind]
        network = fit(network, views, args, args.seconds * share, rate)
        print(f"{kind}: {time.monotonic() - began:.0f} s", flush=True)
        weights = {name: value.half().cpu() for name, value in network.state_dict().items()}
        path = args.models
        torch.save(weights, path / f"{kind}.partial")
        (path / f"{kind}.partial").replace(path / f"{kind}.pt")


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views", type=Path, help="folder of view.NNNN.npz")
    parser.add_argument("models", type=Path, help="folder to write to")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--start", type=Path, help="folder of KIND.pt to go on from")
    parser.add_argument("--seconds", type=float, default=180,
                        help="of the first network; the others take 2/3 of that")
    parser.add_argument("--steps", type=int, default=10**9, help="at most")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--crop", type=int, default=128)
    parser.add_argument("--report", type=int, default=500,
                        help="steps between two lines of progress")
    parser.add_argument("--compile", action="store_true",
                        help="compile the network; takes a minute at first")
    parser.add_argument("--only", choices=("weights", "onnx"),
                        help="leave ONNX out, or only export MODELS/KIND.pt")
    args = parser.parse_args(argv)
    if args.only != "onnx":
        train(args)
    if args.only != "weights":
        for kind in args.kinds:
            export_network(load(kind, args.models / f"{kind}.pt"), args.models / f"{kind}.onnx")


if __name__ == "__main__":
    main()
