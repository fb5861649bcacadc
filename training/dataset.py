"""Training clips resident on the GPU, and the batches drawn from them.

A clip (``training/clips.py``) is a reference and several independent noisy renders of it. Everything is kept as
float16 on the device, so that a batch costs no transfer; depth is kept as its logarithm to fit the range.
"""
import random
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.networks.denoise_upscale import Inputs

PLANES = (("colour", 3), ("diffuse_albedo", 3), ("specular_albedo", 3), ("normal", 3), ("roughness", 1), ("depth", 1),
          ("motion", 2))
LUMINANCE = (0.2126, 0.7152, 0.0722)


@dataclass
class Clip:
    """``planes`` (V, T, 16, h, w) float16, ``jitter`` (V, T, 2), ``reference`` (T, 3, H, W) float16."""

    name: str
    planes: Tensor
    jitter: Tensor
    reference: Tensor
    exposure: float


@dataclass
class Batch:
    """``frames`` are T inputs of one draw, ``references`` (T, N, 3, H, W) exposed linear colour."""

    frames: list[Inputs]
    references: Tensor


def grey_exposure(colour: np.ndarray) -> float:
    """Multiplier that brings the log-average luminance of (H, W, 3) to 0.18."""
    luminance = colour.astype(np.float64) @ np.array(LUMINANCE)
    return float(0.18 / np.exp(np.mean(np.log(luminance + 1e-3 * luminance.mean() + 1e-9))))


def load(path: Path, device: torch.device) -> Clip:
    """Read one clip file and move it to ``device``."""
    data = np.load(path)
    variants = sorted({k.split("_", 1)[0] for k in data.files if k.startswith("v") and k[1].isdigit()})
    stacked, jitter = [], []
    for v in variants:
        planes = [data[f"{v}_{name}"].astype(np.float32) for name, _ in PLANES]
        planes = [p[..., None] if p.ndim == 3 else p for p in planes]
        planes[5] = np.log2(np.clip(planes[5], 1e-4, 1e10))
        stacked.append(np.concatenate(planes, -1).astype(np.float16))
        jitter.append(data[f"{v}_jitter"].astype(np.float32))
    planes = torch.from_numpy(np.stack(stacked)).to(device).permute(0, 1, 4, 2, 3).contiguous()
    reference = torch.from_numpy(data["reference"]).to(device).permute(0, 3, 1, 2).contiguous()
    return Clip(path.stem, planes, torch.from_numpy(np.stack(jitter)).to(device), reference,
                grey_exposure(data["reference"][0]))


def inputs_of(planes: Tensor, jitter: Tensor, exposure: Tensor) -> Inputs:
    """Inputs of one frame from stacked planes (N, 16, h, w) float32; ``exposure`` (N, 1, 1, 1)."""
    split = dict(zip([name for name, _ in PLANES], planes.split([c for _, c in PLANES], 1), strict=True))
    split["colour"] = (torch.nan_to_num(split["colour"]).clamp(min=0) * exposure).clamp(max=1e4)
    split["depth"] = torch.exp2(split["depth"])
    return Inputs(**split, jitter=jitter)


class ClipPool:
    """All clips of a folder; grows while the data factory is still writing."""

    def __init__(self, folder: Path, device: torch.device, share: int = 0, shares: int = 1, held_out: int = 20):
        self.folder, self.device, self.share, self.shares, self.held_out = folder, device, share, shares, held_out
        self.seen: set[Path] = set()
        self.training: dict[tuple[int, ...], list[Clip]] = {}
        self.validation: list[Clip] = []

    def refresh(self, limit: int | None = None) -> int:
        """Load files that are new (at most ``limit``); one in ``held_out`` scenes is kept for validation."""
        fresh = [p for p in sorted(self.folder.glob("*.npz")) if p not in self.seen]
        mine = [p for p in fresh if self._number(p) % self.shares == self.share]
        for path in mine[:limit]:
            self.seen.add(path)
            clip = load(path, self.device)
            if (self._number(path) // self.shares) % self.held_out == 0:
                self.validation.append(clip)
            else:
                self.training.setdefault(tuple(clip.reference.shape), []).append(clip)
        return len(self)

    @staticmethod
    def _number(path: Path) -> int:
        return int("".join(c for c in path.stem if c.isdigit()) or 0)

    def __len__(self) -> int:
        return sum(map(len, self.training.values()))

    def draw(self, size: int, augment: "Augment", seed: int) -> Batch:
        """A batch of clips of one output size; ``seed`` picks the size, so that all GPUs work on the same one."""
        shapes = sorted(self.training)
        shape = random.Random(seed).choices(shapes, [len(self.training[s]) for s in shapes])[0]
        clips = random.choices(self.training[shape], k=size)
        return augment(*collate(clips, [random.randrange(len(c.planes)) for c in clips], self.device))


def collate(clips: list[Clip], variants: list[int], device: torch.device) -> tuple[Tensor, ...]:
    """Stack to planes (N, T, 16, h, w), jitter (N, T, 2), reference (N, T, 3, H, W) and exposure (N, 1, 1, 1)."""
    return (torch.stack([c.planes[v] for c, v in zip(clips, variants, strict=True)]).float(),
            torch.stack([c.jitter[v] for c, v in zip(clips, variants, strict=True)]),
            torch.stack([c.reference for c in clips]).float(),
            torch.tensor([c.exposure for c in clips], device=device, dtype=torch.float32)[:, None, None, None])


def to_batch(planes: Tensor, jitter: Tensor, reference: Tensor, exposure: Tensor) -> Batch:
    frames = [inputs_of(planes[:, t], jitter[:, t], exposure) for t in range(planes.shape[1])]
    return Batch(frames, (reference * exposure[:, None]).clamp(0, 1e4).transpose(0, 1))


@dataclass
class Augment:
    """Random views of the same clips; every choice is drawn once a batch entry or once a batch."""

    stops: float = 1.5
    drop: float = 0.06
    crop: int = 96

    def __call__(self, planes: Tensor, jitter: Tensor, reference: Tensor, exposure: Tensor) -> Batch:
        planes, jitter, reference = self._flip(planes.clone(), jitter.clone(), reference)
        planes, reference = self._crop(*self._permute_channels(planes, reference))
        exposure = exposure * torch.exp2((torch.rand_like(exposure) * 2 - 1) * self.stops)
        batch = to_batch(planes, jitter, reference, exposure)
        return Batch(self._drop_planes(batch.frames), batch.references)

    @staticmethod
    def _flip(planes: Tensor, jitter: Tensor, reference: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Mirror and transpose the picture; motion and jitter follow."""
        for axis in (0, 1):
            if random.random() < 0.5:
                planes, reference = planes.flip(-1 - axis), reference.flip(-1 - axis)
                planes[:, :, 14 + axis] *= -1
                jitter[..., axis] *= -1
        if random.random() < 0.5:
            planes, reference = planes.transpose(-1, -2), reference.transpose(-1, -2)
            planes = torch.cat((planes[:, :, :14], planes[:, :, 14:].flip(2)), 2)
            jitter = jitter.flip(-1)
        return planes, jitter, reference

    def _crop(self, planes: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
        """Cut the same window of ``crop`` render pixels out of all clips; even offsets fit scale 1.5 as well."""
        (h, w), (height, width) = planes.shape[-2:], reference.shape[-2:]
        y, x = (2 * random.randrange(max(size - self.crop, 0) // 2 + 1) for size in (h, w))
        window = [slice(start * full // size, (start + self.crop) * full // size)
                  for start, full, size in ((y, height, h), (x, width, w))]
        return planes[..., y:y + self.crop, x:x + self.crop], reference[..., window[0], window[1]]

    @staticmethod
    def _permute_channels(planes: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
        """Shuffle the colour primaries and the axes of the world; neither has a preferred order."""
        rgb, xyz = random.sample(range(3), 3), random.sample(range(3), 3)
        order = [*rgb, *(3 + i for i in rgb), *(6 + i for i in rgb), *(9 + i for i in xyz), 12, 13, 14, 15]
        planes = planes[:, :, order]
        signs = torch.tensor([random.choice((-1.0, 1.0)) for _ in range(3)], device=planes.device)
        planes[:, :, 9:12] *= signs[:, None, None]
        return planes, reference[:, :, rgb]

    def _drop_planes(self, frames: list[Inputs]) -> list[Inputs]:
        """Files do not always have every plane: leave some out, for the whole clip, as the reader would fill them."""
        lost = {}
        first = frames[0]
        for names, chance in ((("specular_albedo", "roughness"), 2 * self.drop), (("normal",), self.drop),
                              (("depth",), self.drop), (("diffuse_albedo", "specular_albedo"), self.drop / 2)):
            if random.random() < chance:
                lost.update({name: torch.full_like(getattr(first, name), ABSENT[name]) for name in names})
        return [replace(frame, **lost) for frame in frames]


# What stands in for a plane that a file lacks; postfx/passes/denoise_upscale.py fills the same values.
ABSENT = {"diffuse_albedo": 0.0, "specular_albedo": 0.0, "normal": 0.0, "roughness": 0.5, "depth": 1.0}
