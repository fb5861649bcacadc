"""Clips made by formula on a GPU, without a renderer: any amount of content that is rare in
renders.

    python -m training.datagen.formula --out CLIPS --clips 400 [--seed 0] [--device cuda]

Surfaces with textures from one pixel to many, text, smooth light, lamps out of focus and thin
signs; moving objects with right vectors or the world's; planes that are exact, of few samples, or
cover a pixel partly, as in fog and hair; 1 to 1024 samples a pixel, evenly in stops, and some
without noise. Such clips complement rendered ones and do not replace them: their noise is drawn
from distributions, and light does not bounce.

Lengths are render pixels. Textures are lattices of 64x64 cells that repeat.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from training.datagen.clip_file import save_clip

LATTICE = 64
LAYERS = 4  # the ground, a disc, a box and a thin bar
DEPTHS = (12.0, 6.0, 4.0, 2.5)
"""Of the layers."""
SCALES = (1.0, 1.5, 2.0, 3.0)
"""Output size over the render's."""
CHANCES = (0.42, 0.08, 0.38, 0.12)
"""Of each scale."""
VARIANTS = 3  # noisy renders of a clip, beside one without noise
GLOSS = 0.2  # share of the reflectance that is specular, by roughness

# shares of the clips
SPARSE = 0.25
"""With planes of few samples."""
COVERED = 0.2
"""With surfaces that cover pixels partly."""
LAMPS = 0.15
SIGNS = 0.15
JITTERED = 0.3
"""With one sample position for each frame."""
FALSE_MOTION = 0.15
"""With the ground's vectors for moving objects."""


@dataclass
class Scene:
    """A batch of N scenes of L layers; the first layer is everywhere.

    ``albedo`` (N, L, 3, 64, 64), ``cell`` (N, L) and ``smooth`` (N, L) are the textures; ``light``
    (N, L, 3, 64, 64) and ``span`` (N, L) the light and the size of its cells; ``centre``, ``speed``
    (N, L, 2) and ``size`` (N, L) the objects' positions, motion and size; ``glow`` (N, L, 3) their
    emission; ``cover`` (N, 64, 64) the share of a pixel that surfaces cover, and ``air`` (N, 3,
    1, 1) the light of the rest.
    """

    albedo: Tensor
    cell: Tensor
    smooth: Tensor
    light: Tensor
    span: Tensor
    centre: Tensor
    speed: Tensor
    size: Tensor
    glow: Tensor
    normal: Tensor
    roughness: Tensor
    cover: Tensor
    air: Tensor


@dataclass
class Seen:
    """Noise-free values at positions of a frame, (N, C, P); ``layer`` and ``cover`` name the
    visible surface."""

    albedo: Tensor
    shaded: Tensor
    light: Tensor
    glow: Tensor
    layer: Tensor
    cover: Tensor


@dataclass
class Sampling:
    """Sampling of N clips, all (N, 1, 1, 1): ``samples`` a pixel of the colour and ``few`` of the
    planes; ``quiet`` without noise; ``sparse`` planes whose samples each saw another point of a
    texture; ``flies``, the share of light that comes in few samples; ``spots``, the share of
    samples that hit a lamp."""

    samples: Tensor
    few: Tensor
    quiet: Tensor
    sparse: Tensor
    flies: Tensor
    spots: Tensor


# Scenes -------------------------------------------------------------------------------------------

def log_uniform(low: float, high: float, *shape: int, device: torch.device) -> Tensor:
    return torch.exp(math.log(low) + torch.rand(shape, device=device) * math.log(high / low))


def draw_share(share: float, count: int, device: torch.device) -> Tensor:
    """(count,) bool, a share of them true."""
    return torch.rand(count, device=device) < share


def draw_scenes(count: int, side: int, device: torch.device) -> Scene:
    shape = (count, LAYERS)
    values = torch.rand(*shape, 3, LATTICE, LATTICE, device=device)
    two = (torch.rand(*shape, 1, LATTICE, LATTICE, device=device) < 0.5).float()
    low, high = torch.rand(2, *shape, 3, 1, 1, device=device)
    kind = torch.rand(*shape, 1, 1, 1, device=device)
    text = text_lattice().to(device)
    pattern = torch.where(kind < 0.3, two, torch.where(kind < 0.5, text, values))
    albedo = 0.02 + 0.9 * torch.lerp(low.expand_as(values), high.expand_as(values), pattern)
    albedo = torch.where(kind > 0.75, low.expand_as(albedo), albedo)  # no texture
    cell = log_uniform(1, 24, *shape, device=device)
    cell = torch.where((kind[:, :, 0, 0, 0] < 0.5) & (torch.rand(shape, device=device) < 0.6),
                       cell.round(), cell)
    cell = torch.where(torch.rand(shape, device=device) < 0.4, 1.0, cell)  # texture of one pixel
    light = torch.exp(0.8 * torch.randn(*shape, 1, LATTICE, LATTICE, device=device))
    light = light * (0.7 + 0.6 * torch.rand(*shape, 3, 1, 1, device=device))
    speed = torch.randn(*shape, 2, device=device) * 3
    whole = torch.rand(*shape, 1, device=device)
    speed = torch.where(whole < 0.5, speed.round(), speed) * (whole > 0.2)
    glow = torch.zeros(*shape, 3, device=device)
    lamp, sign = draw_share(LAMPS, count, device), draw_share(SIGNS, count, device)
    tint = 0.4 + 0.6 * torch.rand(count, 3, device=device)
    glow[:, 1] = (log_uniform(2, 60, count, device=device) * lamp)[:, None] * tint
    glow[:, 3] = (log_uniform(1, 30, count, device=device) * sign)[:, None]
    size = torch.stack((
        torch.full((count,), 1e6, device=device), log_uniform(2, side / 4, count, device=device),
        log_uniform(4, side / 2, count, device=device), log_uniform(0.5, 2, count, device=device)
    ), 1)
    normal = torch.nn.functional.normalize(torch.randn(*shape, 3, device=device), dim=2)
    covered = draw_share(COVERED, count, device)[:, None, None]
    cover = torch.where(covered, 0.1 + 0.9 * torch.rand(count, LATTICE, LATTICE, device=device),
                        1.0)
    smooth = torch.rand(shape, device=device) < 0.3
    span = log_uniform(12, 96, *shape, device=device)
    return Scene(albedo, cell, smooth, light, span, torch.rand(*shape, 2, device=device) * side,
                 speed, size, glow, normal, torch.rand(shape, device=device), cover,
                 torch.rand(count, 3, 1, 1, device=device))


def text_lattice() -> Tensor:
    """(64, 64): strokes of one cell in lines, 1 for ink."""
    ink = torch.zeros(LATTICE, LATTICE)
    for top in range(1, LATTICE - 8, 9):
        for left in range(1, LATTICE - 5, 6):
            for across, at in torch.randint(0, 4, (3, 2)).tolist():
                if across < 2:
                    ink[top + 2 * at, left:left + 4] = 1
                else:
                    ink[top:top + 7, left + at] = 1
    return ink


# Pictures of the scenes ---------------------------------------------------------------------------

def lattice_at(lattice: Tensor, u: Tensor, v: Tensor, smooth: Tensor) -> Tensor:
    """Values (N, C, P) of lattices (N, C, 64, 64) at cells' coordinates (N, P): linear between the
    centres if ``smooth`` (N, 1), else the cell's."""
    n, c = lattice.shape[:2]
    flat = lattice.reshape(n, c, -1)
    x, y = (torch.where(smooth, at - 0.5, at) for at in (u, v))
    left, top = x.floor(), y.floor()
    across, down = ((at - first) * smooth for at, first in ((x, left), (y, top)))

    def cell(i: int, j: int) -> Tensor:
        index = ((top + j) % LATTICE * LATTICE + (left + i) % LATTICE).long()
        return flat.gather(2, index[:, None].expand(-1, c, -1))

    upper = torch.lerp(cell(0, 0), cell(1, 0), across[:, None])
    return torch.lerp(upper, torch.lerp(cell(0, 1), cell(1, 1), across[:, None]), down[:, None])


def look(scene: Scene, places: Tensor, time: float) -> Seen:
    """The scene at ``places`` (P, 2) or (N, P, 2), x and y in render pixels, at a frame's
    number."""
    n = scene.cell.shape[0]
    places = places.expand(n, -1, -1)
    layer = torch.zeros(places.shape[:2], dtype=torch.long, device=places.device)
    found: dict[str, Tensor] = {}
    for i in range(LAYERS):
        local = places - scene.speed[:, i, None] * time
        u, v = (local / scene.cell[:, i, None, None]).unbind(2)
        albedo = lattice_at(scene.albedo[:, i], u, v, scene.smooth[:, i, None])
        u, v = (local / scene.span[:, i, None, None]).unbind(2)
        light = lattice_at(scene.light[:, i], u, v,
                           torch.ones_like(scene.smooth[:, i, None]))
        mine = {"albedo": albedo, "light": light,
                "glow": scene.glow[:, i, :, None].expand_as(albedo)}
        here = within(scene, i, local)
        layer = torch.where(here, i, layer)
        found = {name: torch.where(here[:, None], own, found[name]) if i else own
                 for name, own in mine.items()}
    ground = places - scene.speed[:, 0, None] * time
    u, v = (ground / 16).unbind(2)
    cover = lattice_at(scene.cover[:, None], u, v,
                       torch.ones_like(scene.smooth[:, :1]))
    return Seen(found["albedo"], found["albedo"] * found["light"], found["light"], found["glow"],
                layer, cover)


def within(scene: Scene, i: int, local: Tensor) -> Tensor:
    """Positions that a layer covers, (N, P): the whole ground, a disc, a box, a long thin bar."""
    x, y = (local - scene.centre[:, i, None]).unbind(2)
    size = scene.size[:, i, None]
    if i == 1:
        return x.square() + y.square() < size.square()
    if i == 3:
        return (x.abs() < size) & (y.abs() < 20 * size)
    return (x.abs() < size) & (y.abs() < size)


def grid(height: int, width: int, scale: float, taps: int, device: torch.device) -> Tensor:
    """Positions of ``taps`` x ``taps`` samples in a picture's pixels, (H * W * taps^2, 2), pixel by
    pixel."""
    lines = [((torch.arange(side * taps, device=device) + 0.5) / (taps * scale)).reshape(side, taps)
             for side in (height, width)]
    y = lines[0][:, None, :, None].expand(height, width, taps, taps)
    x = lines[1][None, :, None, :].expand(height, width, taps, taps)
    return torch.stack((x, y), -1).reshape(-1, 2)


def mean_of(values: Tensor, height: int, width: int) -> Tensor:
    """(N, C, H * W * k) -> (N, C, H, W)."""
    return values.unflatten(2, (height * width, -1)).mean(3).unflatten(2, (height, width))


# Noise --------------------------------------------------------------------------------------------

def hits(share: Tensor, samples: Tensor) -> Tensor:
    """The share of ``samples`` (N, 1, 1, 1) that hit a target of this ``share``, at random."""
    return torch.binomial(samples.expand_as(share).contiguous(),
                          share.clamp(0, 1).contiguous()) / samples


def noise_of(shape: torch.Size, samples: Tensor, flies: Tensor) -> Tensor:
    """Random factors of mean 1 on light of the given samples: a sample's deviation is the light,
    and a share ``flies`` of the light comes in few samples."""
    even = torch._standard_gamma(samples.expand(shape).contiguous()) / samples
    rare = hits(torch.full(shape, 0.02, device=samples.device), samples) / 0.02
    return torch.lerp(even, rare, flies)


# Clips --------------------------------------------------------------------------------------------

def draw_sampling(count: int, device: torch.device, noisy: bool = True) -> Sampling:
    none = (count, 1, 1, 1)
    samples = torch.exp2(torch.randint(0, 11, none, device=device).float())
    few = torch.exp2(torch.randint(0, 5, none, device=device).float())
    return Sampling(samples, torch.where(torch.rand(none, device=device) < 0.5, few, samples),
                    torch.full(none, not noisy, device=device),
                    torch.rand(none, device=device) < SPARSE,
                    0.4 * torch.rand(none, device=device) * (torch.rand(none, device=device) < 0.4),
                    0.02 + 0.98 * torch.rand(none, device=device))


def draw_clips(count: int, frames: int, side: int, scale: float,
               device: torch.device) -> list[tuple[np.ndarray, list[dict[str, Any]],
                                                   dict[str, Any]]]:
    """Clips of ``frames`` frames at ``side`` x ``side`` render pixels, for `save_clip`: the
    reference at ``scale`` times that, the noisy renders, and guides of one sample a pixel."""
    scene, full = draw_scenes(count, side, device), round(side * scale)
    jittered = draw_share(JITTERED * (scale > 1), count, device)
    jitter = (torch.rand(count, frames, 2, device=device) - 0.5) * jittered[:, None, None]
    false = draw_share(FALSE_MOTION, count, device)
    draws = [draw_sampling(count, device, noisy=v < VARIANTS) for v in range(VARIANTS + 1)]
    references, guides = [], []
    renders: list[list[dict[str, Any]]] = [[] for _ in draws]
    for t in range(frames):
        truth = look(scene, grid(full, full, full / side, 3 if scale < 2 else 2, device), t)
        references.append(mean_of(clean_light(scene, truth), full, full))
        guides.append(plain_planes(scene, look(scene, grid(full, full, full / side, 1, device), t),
                                   full))
        for planes, drawn in zip(renders, draws, strict=True):
            planes.append(noisy_planes(scene, t, side, drawn, jitter[:, t], jittered, false))
    shots = [torch.stack(planes, 1).movedim(2, -1).cpu().numpy()
             for planes in (references, guides, *renders)]
    still = np.zeros((frames, 2), np.float32)
    clips = []
    for n in range(count):
        variants = [split_planes(planes[n]) | {"jitter": jitter[n].cpu().numpy(),
                                               "spp": int(drawn.samples[n]),
                                               "style": "realtime" if jittered[n] else "box",
                                               "exact": bool(drawn.quiet[n])}
                    for planes, drawn in zip(shots[2:], draws, strict=True)]
        guide = split_planes(np.concatenate((np.zeros_like(shots[1][n][..., :3]), shots[1][n]),
                                            -1)) | {"jitter": still}
        clips.append((shots[0][n], variants, {"scale": scale, "guides": guide, "scene": "formula",
                                              "meta": {"kind": "formula"}}))
    return clips


def split_planes(planes: np.ndarray) -> dict[str, np.ndarray]:
    """Planes by name of (T, H, W, 14 or more)."""
    return {"colour": planes[..., :3], "diffuse_albedo": planes[..., 3:6],
            "specular_albedo": planes[..., 6:9],
            "normal": planes[..., 9:12], "roughness": planes[..., 12], "depth": planes[..., 13],
            "motion": planes[..., 14:]}


def clean_light(scene: Scene, seen: Seen) -> Tensor:
    return seen.shaded * seen.cover + seen.glow + scene.air[..., 0] * (1 - seen.cover)


def noisy_planes(scene: Scene, t: int, side: int, drawn: Sampling, jitter: Tensor, jittered: Tensor,
                 false: Tensor) -> Tensor:
    """The planes of a frame, (N, 16, side, side), in the order of `split_planes`."""
    device, samples, few = jitter.device, drawn.samples, drawn.few
    spread = look(scene, grid(side, side, 1, 3, device), t)
    point = look(scene, grid(side, side, 1, 1, device) + jitter[:, None], t)
    one = jittered[:, None, None, None]

    def pixel(name: str) -> Tensor:
        return torch.where(one, mean_of(getattr(point, name), side, side),
                           mean_of(getattr(spread, name), side, side))

    albedo, light, shaded, glow, cover = map(pixel, ("albedo", "light", "shaded", "glow", "cover"))
    level = albedo.mean(1, keepdim=True).clamp(0.02, 0.98)
    # black and white, finer than a pixel
    seen, lit = hits(level, few) / level, hits(level, samples) / level
    part, filled = hits(cover, few), hits(cover, samples)
    lit, filled = torch.where(few == samples, seen, lit), torch.where(few == samples, part, filled)
    part, filled = (torch.where(cover < 1, share, 1.0) for share in (part, filled))
    colour = torch.where(drawn.sparse, light * albedo * lit, shaded) * filled
    colour = colour * noise_of(cover.shape, samples, drawn.flies)
    colour = colour + scene.air * (1 - cover) * noise_of(cover.shape, samples, 0 * drawn.flies)
    lamp = (0.9 * drawn.spots).expand_as(cover)
    colour = colour + glow * torch.where(drawn.spots < 0.5, hits(lamp, samples) / lamp, 1.0)
    colour = torch.where(drawn.quiet, shaded * cover + glow + scene.air * (1 - cover), colour)
    surface, shown = plain_planes(scene, point, side), torch.where(drawn.quiet, cover, part)
    doubt = (drawn.sparse & ~drawn.quiet).float()
    albedo = torch.where(doubt > 0, (albedo * seen).clamp(max=1.0), albedo) * shown
    normal = (surface[:, 6:9] + doubt * torch.randn_like(albedo) * 0.7 / few.sqrt()) * shown
    rough, depth = surface[:, 9:10], surface[:, 10:11]
    speed = torch.where(false[:, None, None], scene.speed[:, :1], scene.speed)
    motion = -of_layer(speed, point, side)
    return torch.cat((colour, albedo * (1 - GLOSS * rough), albedo * GLOSS * rough, normal, rough,
                      depth, motion), 1)


def plain_planes(scene: Scene, seen: Seen, side: int) -> Tensor:
    """Exact planes (N, 11, side, side) of one sample a pixel: both albedos, normal, roughness and
    depth."""
    rough = of_layer(scene.roughness[:, :, None], seen, side)
    depth = torch.tensor(DEPTHS, device=rough.device)[None, :, None].expand(len(rough), -1, -1)
    albedo = mean_of(seen.albedo, side, side)
    return torch.cat((albedo * (1 - GLOSS * rough), albedo * GLOSS * rough,
                      of_layer(scene.normal, seen, side), rough, of_layer(depth, seen, side)), 1)


def of_layer(values: Tensor, seen: Seen, side: int) -> Tensor:
    """Values (N, L, C) of the layers that are seen, (N, C, side, side)."""
    index = seen.layer[:, :, None].expand(-1, -1, values.shape[2])
    return values.gather(1, index).movedim(1, 2).unflatten(2, (side, side))


def write_clips(folder: Path, count: int, seed: int, device: torch.device, frames: int = 8,
                side: int = 128, batch: int = 8, scale: float | None = None) -> None:
    """Clips in batches of one scale each, drawn from a seed or given."""
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed)
    random = np.random.default_rng(seed)
    for first in range(0, count, batch):
        drawn = float(random.choice(SCALES, p=CHANCES))
        clips = draw_clips(min(batch, count - first), frames, side, scale or drawn, device)
        for i, (reference, variants, facts) in enumerate(clips):
            number = first + i
            save_clip(folder / f"clip.{number:05d}.npz", reference, variants,
                      facts | {"seed": seed * 100_000 + number})
        print(f"{min(first + batch, count)} of {count} clips", file=sys.stderr, flush=True)


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of clip.NNNNN.npz")
    parser.add_argument("--clips", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--side", type=int, default=128,
                        help="render pixels (default: %(default)s)")
    parser.add_argument("--scale", type=float, help="one scale for all clips (default: drawn)")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    return parser


def main(argv: list[str] | None = None) -> int:
    args = options().parse_args(argv)
    write_clips(args.out, args.clips, args.seed, torch.device(args.device), args.frames, args.side,
                scale=args.scale)
    return 0


if __name__ == "__main__":
    sys.exit(main())
