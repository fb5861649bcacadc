"""A material in latent textures and a small decoder, beside its maps in block compression.

python samples/neural_material.py [PICTURE] [--maps FILE.npy] [--steps 2000] [--size 256] [--wide]

The maps are base colour 3, normal x and y, roughness; as codes 0..1 (h, w, 6), from --maps or made
here: bricks with moss. Block compression takes 16 bits a texel: BC1 for colour, BC5 for normals,
BC4 for roughness; or 7 with normals and roughness at half the size. The neural material takes 8 or
16: latent textures of 12 channels (`LEVELS`), which are read bilinearly by a network of 12-32-6
(GELU), stored in half precision. Latents learn with the quantisation in place (straight-through).
The decoder runs by the fused kernels of postfx.neural. Prints PSNR and sizes, draws both. Needs
torch and matplotlib.

With --wide, other materials of 8 bits learn instead, from 16384 texels a step (`WIDE`): their
decoders have two layers of 64, and may read four texels around a point, and its place among 8x8
texels. Quantisation is noise first, rounding for the last quarter, in whose last half latents stay
as they are.
"""
import argparse
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from matplotlib.figure import Figure

from postfx import Device
from postfx.neural import Learner, Network


class Level(NamedTuple):
    """A latent texture.

    Attributes:
        step: texels along a side of one of its own.
        channels, bits: how many there are, and bits of each.
        around: whether four of its texels are read around a point, instead of their bilinear mean.
    """

    step: int
    channels: int
    bits: int
    around: bool = False


class Way(NamedTuple):
    """How a material is stored: its latent textures, its decoder's layers, and whether that reads a
    texel's place."""

    levels: tuple[Level, ...]
    hidden: tuple[int, ...] = (32,)
    placed: bool = False

    @property
    def inputs(self) -> int:
        """Numbers that the decoder reads."""
        read = sum(level.channels * (AROUND if level.around else 1) for level in self.levels)
        return read + 2 * len(PERIODS) * self.placed * 2

    def bits(self, network: Network, size: int) -> float:
        """Bits a texel, the decoder in half precision."""
        stored = sum(level.channels * level.bits / level.step**2 for level in self.levels)
        return stored + 16 * network.count / size**2


AROUND = 4
PERIODS = (2, 4, 8)
"""Texels of the waves that tell a texel's place."""
SOME = 16384
"""Texels of a step of wide decoders."""
NARROW = {
    "neural, 8 bits": Way((Level(2, 7, 4), Level(4, 5, 3))),
    "neural, 16 bits": Way((Level(1, 2, 4), Level(2, 7, 4), Level(4, 3, 4)))}
WIDE = {
    "wide": Way((Level(2, 6, 4), Level(4, 2, 4)), (64, 64)),
    "two grids": Way((Level(2, 7, 3, True), Level(4, 4, 3)), (64, 64), True),
    "full grid": Way((Level(1, 1, 4, True), Level(2, 3, 2, True), Level(4, 2, 4)), (64, 64), True)}

# Block compression: as the formats decode, encoded by least squares -------------------------------


def blocks_of(image: np.ndarray) -> np.ndarray:
    """(h, w, c) -> (blocks, 16, c)."""
    h, w, c = image.shape
    return image.reshape(h // 4, 4, w // 4, 4, c).swapaxes(1, 2).reshape(-1, 16, c)


def image_of(blocks: np.ndarray, h: int, w: int) -> np.ndarray:
    return blocks.reshape(h // 4, w // 4, 4, 4, -1).swapaxes(1, 2).reshape(h, w, -1)


def compressed(image: np.ndarray, steps: int, bits: tuple[int, ...]) -> np.ndarray:
    """What a format gives back that has two ends a block, in so many bits a channel, and `steps`
    values from end to end: BC1 is 4 steps of 5, 6, 5 bits, BC4 8 steps of 8.

    Ends begin at the principal axis. Least squares and the choice of values take turns, and the
    best turn counts.
    """
    blocks = blocks_of(image)
    most = np.array([2**b - 1 for b in bits], float)
    mean = blocks.mean(1, keepdims=True)
    axis = np.linalg.svd(blocks - mean, full_matrices=False)[2][:, :1]
    along = ((blocks - mean) * axis).sum(-1)
    ends = [mean + axis * np.quantile(along, q, axis=1)[:, None, None] for q in (0.03, 0.97)]
    best, least = np.zeros_like(blocks), np.full(len(blocks), np.inf)
    for _ in range(6):
        ends = [np.round(np.clip(end, 0, 1) * most) / most for end in ends]
        values = [ends[0] + (ends[1] - ends[0]) * k / (steps - 1) for k in range(steps)]
        errors = np.stack([((blocks - value) ** 2).sum(-1) for value in values])
        chosen = errors.argmin(0)
        error = errors.min(0).sum(-1)
        share = chosen / (steps - 1)
        found = ends[0] + (ends[1] - ends[0]) * share[..., None]
        better = error < least
        best[better], least[better] = found[better], error[better]
        a, b, c = ((1 - share) ** 2).sum(1), ((1 - share) * share).sum(1), (share**2).sum(1)
        p, q = (((1 - share)[..., None] * blocks).sum(1), (share[..., None] * blocks).sum(1))
        det = np.maximum(a * c - b * b, 1e-9)[:, None]
        fresh = ((c[:, None] * p - b[:, None] * q) / det, (a[:, None] * q - b[:, None] * p) / det)
        solvable = (a * c - b * b > 1e-6)[:, None, None]
        ends = [np.where(solvable, new[:, None], old) for new, old in zip(fresh, ends, strict=True)]
    return image_of(best, *image.shape[:2])


def block_compressed(maps: np.ndarray) -> np.ndarray:
    """Colour by BC1, normals by BC5, which is two of BC4, roughness by BC4."""
    parts = [compressed(maps[..., :3], 4, (5, 6, 5)),
             *(compressed(maps[..., k:k + 1], 8, (8,)) for k in (3, 4, 5))]
    return np.concatenate(parts, -1)


def halved(maps: np.ndarray, compress: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Maps that are compressed at half the size, and read bilinearly."""
    small = torch.from_numpy(compress(maps.reshape(len(maps) // 2, 2, -1, 2, maps.shape[-1])
                                      .mean((1, 3))))
    wide = F.interpolate(small.permute(2, 0, 1)[None], scale_factor=2, mode="bilinear",
                         align_corners=False)
    return wide[0].permute(1, 2, 0).numpy()


# The material -------------------------------------------------------------------------------------


def noise(size: int, cells: int, random: np.random.Generator) -> np.ndarray:
    """Tiling value noise of several octaves, about 0..1."""
    total, weight = np.zeros((size, size)), 0.0
    while cells < size:
        grid = random.random((cells, cells))
        at = np.arange(size) * cells / size
        low = at.astype(int)
        t = (at - low) ** 2 * (3 - 2 * (at - low))
        rows = grid[low] + (grid[(low + 1) % cells] - grid[low]) * t[:, None]
        total += (rows[:, low] + (rows[:, (low + 1) % cells] - rows[:, low]) * t) / cells
        weight, cells = weight + 1 / cells, 2 * cells
    return total / weight


def bricks(size: int) -> np.ndarray:
    """Maps (size, size, 6) of a brick wall with moss in its joints."""
    random = np.random.default_rng(0)
    fine, wide, moss = noise(size, 16, random), noise(size, 4, random), noise(size, 8, random)
    y, x = np.mgrid[:size, :size] / size
    row = np.floor(8 * y)
    u, v = (4 * x + 0.5 * (row % 2) + 0.03 * (wide - 0.5)) % 1, 8 * y % 1
    edge = np.minimum(np.minimum(u, 1 - u) * 2, np.minimum(v, 1 - v))
    brick = np.clip((edge - 0.04 - 0.05 * fine) * 12, 0, 1)
    tone = random.random((8, 5))[row.astype(int), np.floor(4 * x + 0.5 * (row % 2)).astype(int)]
    green = np.clip((moss - 0.5 + 0.35 * (1 - brick)) * 5, 0, 1)
    height = brick * (0.7 + 0.2 * fine) + 0.25 * green * fine
    slope = [np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (1, 0)]
    normal = np.stack([-slope[0], slope[1], np.full_like(height, 0.35)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    clay = np.array([0.55, 0.27, 0.2]) * (0.6 + 0.5 * tone[..., None]) * (0.7
                                                                          + 0.6 * fine[..., None])
    joint = np.array([0.62, 0.6, 0.55]) * (0.6 + 0.6 * fine[..., None])
    colour = joint + (clay - joint) * brick[..., None]
    colour = (colour
              + (np.array([0.2, 0.32, 0.08]) * (0.4 + fine[..., None]) - colour) * green[..., None])
    rough = 0.9 - 0.35 * brick * (1 - fine) * (1 - green) - 0.1 * tone * brick
    return np.clip(np.concatenate([colour, normal[..., :2] / 2 + 0.5, rough[..., None]], -1), 0, 1)


class Material(torch.nn.Module):
    """Latent textures, and the decoder in the order of `postfx.neural.Network`."""

    def __init__(self, size: int, way: Way, network: Network) -> None:
        super().__init__()
        self.size, self.way = size, way
        sides = [(level.channels, size // level.step) for level in way.levels]
        self.latents = torch.nn.ParameterList(0.5 + 0.1 * torch.randn(1, channels, side, side)
                                              for channels, side in sides)
        self.layers = torch.nn.ModuleList(torch.nn.Linear(reads, makes)
                                          for makes, reads in network.shapes)
        self.rounds = True

    def texels(self, rows: torch.Tensor, columns: torch.Tensor) -> torch.Tensor:
        """What the decoder reads of some texels (n,): (n, inputs), quantised, with the gradient of
        what is not."""
        found = []
        for latent, level in zip(self.latents, self.way.levels, strict=True):
            coded = self._coded(latent.clamp(0, 1), 2**level.bits - 1)[0]
            found.append(self._read(coded, level, rows, columns))
        if self.way.placed:
            for period in PERIODS:
                for place in (rows, columns):
                    angle = 2 * math.pi * (place + 0.5) / period
                    found += [torch.sin(angle)[:, None], torch.cos(angle)[:, None]]
        return torch.cat(found, 1)

    def _coded(self, held: torch.Tensor, most: int) -> torch.Tensor:
        if not self.rounds:
            return held + (torch.rand_like(held) - 0.5) / most
        return held + (torch.round(held * most) / most - held).detach()

    @staticmethod
    def _read(coded: torch.Tensor, level: Level, rows: torch.Tensor,
              columns: torch.Tensor) -> torch.Tensor:
        """Four texels of a texture (channels, h, w) around texels of the material, or their
        bilinear mean."""
        last = coded.shape[-1] - 1
        axes = []
        for places in (rows, columns):
            at = ((places + 0.5) / level.step - 0.5).clamp(0, last)
            low = at.floor().long()
            axes.append((low, (low + 1).clamp(max=last), at - low))
        (top, bottom, down), (left, right, along) = axes
        corners = [coded[:, top, left], coded[:, top, right], coded[:, bottom, left],
                   coded[:, bottom, right]]
        if level.around:
            return torch.cat(corners).T
        shares = ((1 - down) * (1 - along), (1 - down) * along, down * (1 - along), down * along)
        return sum(share * corner for share, corner in zip(shares, corners, strict=True)).T

    def all_texels(self) -> torch.Tensor:
        """What the decoder reads of each texel in turn."""
        every = torch.arange(self.size**2)
        return self.texels(every // self.size, every % self.size)

    def forward(self, texels: torch.Tensor) -> torch.Tensor:
        for layer in self.layers[:-1]:
            texels = F.gelu(layer(texels))
        return self.layers[-1](texels)

    def parameters_of(self) -> np.ndarray:
        parts = [part.detach().half().float().numpy().ravel() for layer in self.layers
                 for part in layer.parameters()]
        return np.concatenate(parts)


def psnr(found: np.ndarray, wanted: np.ndarray) -> list[float]:
    """Of colour, normals, roughness, and all six channels."""
    error = ((found - wanted) ** 2).mean((0, 1))
    return [float(-10 * np.log10(part.mean()))
            for part in (error[:3], error[3:5], error[5:], error)]


parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "neural_material.png")
parser.add_argument("--maps", type=Path,
                    help="an array (h, w, 6) of codes 0..1, square, sides a multiple of 4")
parser.add_argument("--size", type=int, default=256)
parser.add_argument("--steps", type=int, default=2000)
parser.add_argument("--threads", type=int, default=1)
parser.add_argument("--wide", action="store_true", help="materials of 8 bits with wide decoders")
chosen = parser.parse_args()
torch.set_num_threads(chosen.threads)
torch.manual_seed(0)

maps = np.load(chosen.maps) if chosen.maps else bricks(chosen.size)
size = maps.shape[0]
wanted = torch.from_numpy(maps.reshape(-1, 6).astype(np.float32))
device, rows = Device("cpu", threads=chosen.threads), []
blocky, coarse = block_compressed(maps), halved(maps, block_compressed)
rows.append(("blocks, 16 bits", blocky, 16.0))
rows.append(("blocks, 7 bits", np.concatenate([blocky[..., :3], coarse[..., 3:]], -1), 7.0))
for name, way in (WIDE if chosen.wide else NARROW).items():
    network = Network(way.inputs, way.hidden, 6, "gelu")
    material, began = Material(size, way, network), time.process_time()
    optimizer = torch.optim.Adam([{"params": material.latents.parameters(), "lr": 2e-2},
                                  {"params": material.layers.parameters(), "lr": 5e-3}])
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, chosen.steps)
    for step in range(chosen.steps):
        if chosen.wide:
            material.rounds = step >= 0.75 * chosen.steps
            material.latents.requires_grad_(step < 0.875 * chosen.steps)
            some = torch.randint(size**2, (SOME,))
            loss = F.mse_loss(material(material.texels(some // size, some % size)), wanted[some])
        else:
            loss = F.mse_loss(material(material.all_texels()), wanted)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    taken = time.process_time() - began
    decoder = Learner(device, network, parameters=material.parameters_of())
    texels = device.wrap("texels", np.ascontiguousarray(material.all_texels().detach().numpy()))
    values, times = device.heap.tensor("values", (size * size, 6)), []
    for _ in range(5):
        commands = device.command_buffer("decode")
        with commands.compute_encoder("decode") as encoder:
            decoder.run(encoder, texels, values)
        commands.commit()
        commands.wait()
        times.append(sum(ms for _, ms in commands.timings))
    found = np.clip(values.array.reshape(size, size, 6), 0, 1)
    rows.append((name, found, way.bits(network, size)))
    print(f"{name}: {network.count} parameters learnt in {taken:.0f} s; {np.median(times):.2f} ms "
          "to decode")
print(f"{'':16} {'bits':>6} {'colour':>7} {'normal':>7} {'rough':>7} {'all':>7}")
for name, found, count in rows:
    print(f"{name:16} {count:6.2f} " + " ".join(f"{one:7.2f}" for one in psnr(found, maps)))

figure = Figure((9, 6), layout="constrained")
panels = figure.subplots(2, 3)
part = slice(0, min(size, 128))
for row, channels in zip(panels, (slice(0, 3), slice(3, 5)), strict=True):
    for panel, (name, picture, _) in zip(row, (("maps", maps, 0), *rows[1:3]), strict=True):
        shown = picture[part, part, channels]
        panel.imshow(shown if shown.shape[-1] == 3
                     else np.concatenate([shown, np.ones_like(shown[..., :1])], -1))
        panel.set_title(name)
        panel.axis("off")
figure.savefig(chosen.picture, dpi=80)
print(f"wrote {chosen.picture}")
