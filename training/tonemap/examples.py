"""Examples for the tone mapper: random views of pictures, made on the device that trains.

All colour is scene-linear Rec.709. A few pictures become many by crops, views of panoramas, a
smooth light field with hard edges (windows, shadows), lamps, another white balance and saturation,
sometimes a wide gamut or noise. The result is exposed again as by the run-time's meter, plus a
random error of some stops. Some views are always synthetic charts, so pictures are optional.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as F

from training.tonemap.looks import LUMINANCE, Look, before_view, log_luminance
from training.tonemap.model import default_shaper, look_up, shape
from training.tonemap.pictures import LARGEST, WIDE, Pictures, perspective

SHAPES = ((320, 512), (384, 384), (512, 320), (288, 512))
# largest shift in pixels between the two views of a consistency pair; views are larger by it
SHIFT = 8
CHARTS = 0.12  # share of synthetic views


class Source(Protocol):
    """Something to train on."""

    random: np.random.Generator

    def batch(self, size: int,
              scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Exposed colour (N,3,H+8,W+8), its look, and its shaped colour before the look's cube if
        known."""


class Views:
    """Endless batches of views of pictures, each with the look's result."""

    def __init__(
        self, pictures: Pictures, look: Look, cube: torch.Tensor, device: torch.device,
        seed: int = 1
    ) -> None:
        self.device, self.look, self.cube = device, look, cube.to(device)
        self.random = np.random.default_rng(seed)
        self.pictures = [(self._load(picture), name in pictures.panoramas)
                         for name, picture in pictures.train.items()]

    def _load(self, picture: np.ndarray) -> torch.Tensor:
        return (torch.from_numpy(picture.astype(np.float32)).permute(2, 0, 1).contiguous()
                .to(self.device))

    def uniform(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def chance(self, p: float) -> bool:
        return bool(self.random.random() < p)

    def batch(self, size: int,
              scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Exposed views (size,3,H+8,W+8) of one random shape, their look, and their shaped colour
        before the cube.

        `scale` shrinks the shape for toy runs.
        """
        views = self.views(size, scale)
        shaped = shape(before_view(views, self.look), *default_shaper(self.device))
        return views, look_up(shaped, self.cube), shaped

    def views(self, size: int, scale: float = 1.0) -> torch.Tensor:
        """The exposed views of a batch alone."""
        h, w = SHAPES[self.random.integers(len(SHAPES))]
        size_in_pixels = (int(h * scale) + SHIFT, int(w * scale) + SHIFT)
        return torch.stack([self._view(size_in_pixels) for _ in range(size)])

    def _view(self, shape: tuple[int, int]) -> torch.Tensor:
        x = (self._synthetic(shape) if not self.pictures or self.chance(CHARTS)
             else self._picture(shape))
        x = self._grade(x)
        if self.chance(0.5):
            x = x * self._light(shape)
        if self.chance(0.25):
            x = x + self._lamps(shape)
        if self.chance(0.2):
            x = (x * (1 + self.uniform(0.0, 0.15) * torch.randn(3, *shape, device=self.device))
                 .clamp_min(0))
        if self.chance(0.2):
            x = torch.einsum("ij,jhw->ihw", WIDE[self.random.integers(len(WIDE))].to(x), x)
        return self._expose(x)

    def _picture(self, shape: tuple[int, int]) -> torch.Tensor:
        picture, panorama = self.pictures[int(self.random.integers(len(self.pictures)))]
        if panorama and self.chance(0.7):
            x = perspective(picture, self.uniform(-180, 180), self.uniform(-35, 35),
                            self.uniform(45, 120), shape)
        else:
            x = self._crop(picture, shape)
        x = x.flip(-1) if self.chance(0.5) else x
        return x.flip(-2) if self.chance(0.1) else x

    def _crop(self, picture: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
        """A window of random size and position with the aspect of `shape`, resampled to it."""
        h, w = picture.shape[-2:]
        largest = min(h / shape[0], w / shape[1])
        size = largest * self.uniform(0.4, 1.0)
        ch, cw = max(8, int(shape[0] * size)), max(8, int(shape[1] * size))
        y, x = int(self.random.integers(h - ch + 1)), int(self.random.integers(w - cw + 1))
        window = picture[None, :, y : y + ch, x : x + cw]
        return F.interpolate(window, size=shape, mode="bilinear", align_corners=False,
                             antialias=True)[0].clamp_min(0)

    def _noise(self, shape: tuple[int, int], cells: int, channels: int = 1) -> torch.Tensor:
        """Smooth random field (channels,H,W), roughly normal, with `cells` bumps across."""
        seeds = torch.from_numpy(self.random.standard_normal((1, channels, cells, cells),
                                                             np.float32)).to(self.device)
        return F.interpolate(seeds, size=shape, mode="bicubic", align_corners=False)[0]

    def _region(self, shape: tuple[int, int]) -> torch.Tensor:
        """Mask (1,H,W) in [0,1] of a half plane, box or ellipse, with an edge from hard to very
        soft."""
        y, x = torch.meshgrid(
            torch.linspace(-1, 1, shape[0], device=self.device),
            torch.linspace(-1, 1, shape[1], device=self.device),
            indexing="ij",
        )
        angle = self.uniform(0, 2 * math.pi)
        x, y = x - self.uniform(-1, 1), y - self.uniform(-1, 1)
        u, v = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
        a, b = self.uniform(0.08, 0.9), self.uniform(0.08, 0.9)
        kind = self.random.integers(3)
        if kind == 0:
            distance = u
        elif kind == 1:
            distance = torch.maximum(u.abs() - a, v.abs() - b)
        else:
            distance = (torch.sqrt((u / a) ** 2 + (v / b) ** 2) - 1) * min(a, b)
        softness = 2.0 ** self.uniform(-9, -1)
        return torch.sigmoid(-distance / softness)[None]

    def _light(self, shape: tuple[int, int]) -> torch.Tensor:
        """Multiplier (3,H,W): smooth light of a few stops, regions up to +-5 stops, faintly
        coloured."""
        stops = self._noise(shape, int(self.random.integers(2, 6))) * self.uniform(0, 1.5)
        for _ in range(int(self.random.integers(0, 4))):
            stops = stops + self._region(shape) * self.uniform(-5, 5)
        tint = self._noise(shape, 3, 3) * 0.15
        return torch.exp2((stops + tint).clamp(-10, 10))

    def _colour(self, spread: float) -> torch.Tensor:
        tint = self.random.standard_normal((3, 1, 1)) * spread
        return torch.exp2(torch.tensor(tint, dtype=torch.float32, device=self.device))

    def _lamps(self, shape: tuple[int, int]) -> torch.Tensor:
        lamps = torch.zeros(3, *shape, device=self.device)
        for _ in range(int(self.random.integers(1, 4))):
            lamps = (lamps + self._region(shape) * self._colour(self.uniform(0.3, 3))
                     * 2.0 ** self.uniform(-1, 7))
        return lamps

    def _synthetic(self, shape: tuple[int, int]) -> torch.Tensor:
        """Gradients over up to 16 stops with coloured regions, which are rare in photographs."""
        ramp = self._noise(shape, int(self.random.integers(2, 8))) * self.uniform(0.5, 4)
        colour = self._noise(shape, int(self.random.integers(2, 8)), 3) * self.uniform(0.1, 2.5)
        stops = ramp + colour
        for _ in range(int(self.random.integers(0, 6))):
            stops = stops + self._region(shape) * torch.log2(self._colour(self.uniform(0.5, 4)))
        return torch.exp2(stops.clamp(-12, 12))

    def _grade(self, x: torch.Tensor) -> torch.Tensor:
        """White balance, saturation, sometimes other hues and another contrast."""
        x = x * self._colour(0.25)
        if self.chance(0.25):
            x = x[self.random.permutation(3).tolist()]
        weights = torch.tensor(LUMINANCE, device=self.device).view(3, 1, 1)
        grey = (x * weights).sum(0, keepdim=True)
        saturation = self.uniform(1.4, 3.0) if self.chance(0.15) else self.uniform(0.4, 1.4)
        x = (grey + (x - grey) * saturation).clamp_min(0)
        if self.chance(0.3):
            contrast = self.uniform(0.6, 1.3)
            x = x * ((grey + 1e-4) / 0.18) ** (contrast - 1)
        return x

    def _expose(self, x: torch.Tensor) -> torch.Tensor:
        """Bring the geometric mean to mid grey, then add an error: mostly within 1.5 stops,
        sometimes up to 3."""
        log = log_luminance(x[None])
        error = self.uniform(-3, 3) if self.chance(0.25) else float(self.random.normal(0.0, 0.8))
        return (x * torch.exp2(math.log2(0.18) - log.mean() + error)).clamp(-LARGEST, LARGEST)
