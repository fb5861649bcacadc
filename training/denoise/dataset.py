"""Training clips resident on the GPU, and the batches drawn from them.

A clip (``training/datagen/clip_file.py``) is a reference and several independent noisy renders of
it. Everything stays on the device as float16, so that a batch costs no transfer; depth is stored as
its logarithm, which fits the range.
"""

import json
import math
import random
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from postfx.passes.denoise.planes import HAZY, shows_volume
from training import ops
from training.datagen.clip_file import MIRRORED
from training.denoise.model import Guides, Inputs, State

# Clips and batches --------------------------------------------------------------------------------

PLANES = (("colour", 3), ("diffuse_albedo", 3), ("specular_albedo", 3), ("normal", 3),
          ("roughness", 1), ("depth", 1),
          ("denoising_albedo", 3), ("denoising_normal", 3), ("motion", 2))
GUIDES = PLANES[1:6]
CHANNELS = sum(channels for _, channels in PLANES)
# Samples a pixel whose mean albedo is taken for the true one: beside a render of a quarter of
# them, and alone.
SOME_SAMPLES = 32
MANY_SAMPLES = 256
QUIET_RATIO = 16
"""Samples of a reference over those of a render whose error shows next to none of its noise."""
MOST_TRIES = 5
"""How often the reading of a clip is tried. NumPy parses the headers of arrays as Python code. The
parser of Python 3.11 is not quite safe in threads: now and then it raises SystemError for code that
is right."""
LUMINANCE = (0.2126, 0.7152, 0.0722)
LEFT_SPREAD = (-0.03, 0.06)
"""Bounds of a neighbour's weight where a little of a pixel filter is left, or too much of it was
undone. A gaussian filter of half a pixel has 0.107."""


@dataclass
class Clip:
    """``planes`` (V, T, C, h, w) float16, ``jitter`` (V, T, 2), ``reference`` (T, 3, H, W) float16.

    ``planes`` has the 22 channels of ``PLANES``, then two channels for each of ``pairs``, further
    kinds of motion (see ``PAIRS``). ``spread`` (V,) says which renders spread their samples over
    the pixel, ``samples`` (V,) gives the samples a pixel; ``keep`` (T,) is 0 at cuts and at the
    first frame; ``guides`` (T, 11, H, W) float16 are the planes at output size, if asked for.
    ``halved`` (V,) marks renders from half of the reference's samples, which are compared with the
    other ``half`` (T, 3, H, W); ``exact`` (V,) marks renders with the true planes, ``hazy`` (V,)
    those of a volume, which have no depth and albedo, as in the product. A clip of ``weight`` 2 is
    drawn twice as often as one of weight 1.
    """

    name: str
    planes: Tensor
    jitter: Tensor
    spread: list[bool]
    keep: Tensor
    reference: Tensor
    guides: Tensor | None
    exposure: float
    half: Tensor | None
    halved: list[bool]
    exact: list[bool]
    hazy: list[bool]
    samples: list[int]
    pairs: tuple[str, ...] = ()
    weight: float = 1.0


@dataclass
class Batch:
    """``frames`` are T inputs of one draw, ``references`` (T, N, 3, H, W) exposed linear colour.

    ``keep`` (T, N, 1, 1, 1) is 0 where the history ends. Lists of T motions (N, 2, h, w):
    ``inverse`` leads to the next frame, for clips that also run backwards; ``static`` is the motion
    if only the camera moved; ``true_motion`` is set if the motion of the frames may be false.
    ``quiet`` (N, 1, 1, 1) is true for entries whose reference has much less noise than the frames.
    ``surfaces`` are T inputs with the true albedos and normals, NaN in entries where they are
    unknown. ``state`` is the history that the first frame continues; None: there is none.
    """

    frames: list[Inputs]
    references: Tensor
    keep: Tensor
    quiet: Tensor | None = None
    inverse: list[Tensor] | None = None
    static: list[Tensor] | None = None
    true_motion: list[Tensor] | None = None
    surfaces: list[Inputs] | None = None
    state: State | None = None

    def reflectance(self) -> list[Tensor]:
        """The true reflectance of each frame (N, 3, h, w), NaN in entries where it is unknown."""
        found = []
        assert self.surfaces is not None, "a batch of clips has the true planes"
        for frame in self.surfaces:
            factor = ops.demodulation(frame.diffuse_albedo, frame.specular_albedo)
            found.append(torch.where(frame.diffuse_albedo[:, :1].isnan(), torch.nan, factor))
        return found


@dataclass
class Stack:
    """Stacked windows of several clips: the fields of ``Clip`` with N in front, exposure (N, 1, 1,
    1), and planes with the true albedos, normals and roughness (N, T, C, h, w), NaN where they are
    unknown."""

    planes: Tensor
    jitter: Tensor
    spread: Tensor
    keep: Tensor
    reference: Tensor
    surfaces: Tensor
    guides: Tensor | None
    exposure: Tensor
    quiet: Tensor
    pairs: tuple[str, ...] = ()


def grey_factor(colour: np.ndarray) -> float:
    """Multiplier that brings the log-average luminance of (H, W, 3) to 0.18."""
    # samples of volumes may be negative
    luminance = (colour.astype(np.float64) @ np.array(LUMINANCE)).clip(min=0)
    return float(0.18 / np.exp(np.mean(np.log(luminance + 1e-3 * luminance.mean() + 1e-9))))


def load(path: Path, device: torch.device, guides: bool = False, pairs: tuple[str, ...] = (),
         blank_volumes: bool = True) -> Clip:
    """Read one clip file and move it to ``device``, with its guides and further kinds of motion, if
    asked for.

    ``blank_volumes``: renders of a volume have no depth and albedo, as for networks that do not
    read such planes. Raises ValueError if it lacks the guides.
    """
    data = np.load(path)
    if guides and "guide_depth" not in data.files:
        raise ValueError(f"{path}: no planes at output size, which --guides needs")
    names = {key.split("_", 1)[0] for key in data.files}
    variants = sorted(name for name in names if name[0] == "v" and name[1:].isdigit())
    hazy = {v: blank_volumes and shows_volume(data[f"{v}_depth"][0, ..., None].astype(np.float32))
            for v in variants}

    def plane(key: str) -> Tensor:
        variant, _, name = key.partition("_")
        if name in MIRRORED and key not in data.files:
            return torch.zeros_like(plane(f"{variant}_normal"))
        values = torch.from_numpy(data[key]).to(device)
        if hazy.get(variant) and name in HAZY:
            values = torch.full_like(values, ABSENT[name])
        values = values.movedim(-1, 1) if values.ndim == 4 else values[:, None]
        if key.startswith("v") and key.endswith("_depth"):
            values = values.clamp(1e-4, 1e10).log2()
        return values.half()

    def render(variant: str) -> Tensor:
        planes = [plane(f"{variant}_{name}") for name, _ in PLANES]
        motions = [torch.from_numpy(PAIRS[name](data, variant)).movedim(-1, 1).to(device).half()
                   for name in pairs]
        return torch.cat([*planes, *motions], 1)

    def is_marked(variant: str, mark: str) -> bool:
        key = f"{variant}_{mark}"
        return key in data.files and bool(data[key])

    reference = data["reference"]
    resets = data["reset"] if "reset" in data.files else np.zeros(len(reference))
    jitter = np.stack([data[f"{v}_jitter"] for v in variants]).astype(np.float32)
    return Clip(
        name=path.stem,
        planes=torch.stack([render(v) for v in variants]),
        jitter=torch.from_numpy(jitter).to(device),
        spread=[str(data[f"{v}_style"]) != "realtime" for v in variants],
        keep=torch.from_numpy(1 - resets.astype(np.float32)).to(device),
        reference=plane("reference"),
        guides=torch.cat([plane(f"guide_{name}") for name, _ in GUIDES], 1) if guides else None,
        exposure=grey_factor(reference[0]),
        half=plane("half") if "half" in data.files else None,
        halved=[is_marked(v, "half") for v in variants],
        exact=[is_marked(v, "exact") for v in variants],
        hazy=[hazy[v] for v in variants],
        samples=[int(data[f"{v}_spp"]) for v in variants],
        pairs=pairs,
    )


def inverse_motion(data: Mapping[str, np.ndarray], variant: str) -> np.ndarray:
    """Motion (T, h, w, 2) from each pixel to its position in the next frame; 0 in the last
    frame."""
    from postfx.temporal.reverse_motion import invert_motion

    motion = data[f"{variant}_motion"].astype(np.float32)
    depth = data[f"{variant}_depth"][..., None].astype(np.float32)
    frames = pairwise(zip(motion, depth, strict=True))
    return np.stack([*(invert_motion(*after, shown) for (_, shown), after in frames),
                     np.zeros_like(motion[-1])])


def static_motion(data: Mapping[str, np.ndarray], variant: str) -> np.ndarray:
    """Motion (T, h, w, 2) as if only the camera moved: moving objects get the vectors of a world at
    rest.

    It follows from depth and the camera's poses (x left, y up, z forward), which only the Mitsuba
    clips hold. The first frame, cuts and clips without poses keep the motion of the file.
    """
    motion = data[f"{variant}_motion"].astype(np.float32)
    depth = data[f"{variant}_depth"].astype(np.float64)
    meta = json.loads(str(data["meta"])) if "meta" in data else {}
    if "to_world" not in meta:
        return motion
    poses, fov = np.array(meta["to_world"]), np.broadcast_to(meta["fov"], len(motion))
    frames, h, w = depth.shape
    cuts = data["reset"] if "reset" in data else np.zeros(frames)
    y, x = np.meshgrid(np.arange(h) + 0.5, np.arange(w) + 0.5, indexing="ij")
    for t in range(1, frames):
        if cuts[t]:
            continue
        # focal lengths in pixels
        now, before = (w / (2 * math.tan(math.radians(fov[k]) / 2)) for k in (t, t - 1))
        local = np.stack([(w / 2 - x) / now, (h / 2 - y) / now, np.ones((h, w))],
                         -1) * depth[t][..., None]
        world = local @ poses[t, :3, :3].T + poses[t, :3, 3]
        seen = (world - poses[t - 1, :3, 3]) @ poses[t - 1, :3, :3]
        far = np.maximum(seen[..., 2], 1e-6)
        there = np.stack([w / 2 - before * seen[..., 0] / far, h / 2 - before * seen[..., 1] / far],
                         -1)
        motion[t] = np.where(seen[..., 2:] > 1e-6, there - np.stack([x, y], -1), motion[t])
    return motion


PAIRS = {"inverse": inverse_motion, "static": static_motion}


class ClipPool:
    """All clips of some folders, each with the weight of its clips; grows while the data factory is
    still writing. ``prepare`` changes each clip that is loaded."""

    def __init__(self, folders: Mapping[Path, float], device: torch.device, guides: bool = False,
                 share: int = 0, shares: int = 1, held_out: int = 20, pairs: tuple[str, ...] = (),
                 blank_volumes: bool = True, prepare: Callable[[Clip], Clip] | None = None):
        self.prepare = prepare
        self.folders, self.device, self.guides, self.pairs = folders, device, guides, pairs
        self.blank_volumes = blank_volumes
        self.share, self.shares, self.held_out = share, shares, held_out
        self.seen: set[Path] = set()
        self.training: dict[tuple[int, ...], list[Clip]] = {}
        self.validation: list[Clip] = []

    def refresh(self) -> int:
        """Load new files; one clip in ``held_out`` is for validation. Returns the number of clips
        for training.

        Names clips that lack guides and leaves them out: Cycles renders none.
        """
        mine = self._new_files()
        with ThreadPoolExecutor(8) as threads:
            clips = list(threads.map(self._load, mine))
        for path, clip in zip(mine, clips, strict=True):
            if clip is not None:
                self._add(path, clip)
        return len(self)

    def watch(self, pause: float = 2.0) -> Callable[[], None]:
        """Load new files in a thread of its own, while others draw from the pool; returns a
        function that ends it."""
        ended = threading.Event()

        def follow() -> None:
            while not ended.wait(pause):
                for path in self._new_files():
                    clip = self._load(path)
                    if clip is not None:
                        self._add(path, clip)

        threading.Thread(target=follow, daemon=True).start()
        return ended.set

    def _new_files(self) -> list[Path]:
        """Files of this share that were not asked for before."""
        found = [p for folder in self.folders for p in sorted(folder.glob("[!.]*.npz"))]
        mine = [p for p in found
                if p not in self.seen and self._number(p) % self.shares == self.share]
        self.seen.update(mine)
        return mine

    def _add(self, path: Path, clip: Clip) -> None:
        """Add a clip, to those of validation or of training."""
        if (self._number(path) // self.shares) % self.held_out == 0:
            self.validation.append(clip)
        else:
            weighted = replace(clip, weight=self.folders[path.parent])
            self.training.setdefault(tuple(clip.reference.shape), []).append(weighted)

    def _load(self, path: Path) -> Clip | None:
        for _ in range(MOST_TRIES):
            try:
                clip = load(path, self.device, self.guides, self.pairs, self.blank_volumes)
                return self.prepare(clip) if self.prepare else clip
            except ValueError as fault:
                print(f"left out: {fault}", flush=True)
                return None
            except SystemError:  # see MOST_TRIES
                continue
        print(f"left out: {path}: cannot be read beside others", flush=True)
        return None

    @staticmethod
    def _number(path: Path) -> int:
        return int("".join(c for c in path.stem if c.isdigit()) or 0)

    def __len__(self) -> int:
        return sum(map(len, self.training.values()))

    def draw(self, size: int, crop: int, seed: int, sparse: float = 0.0, turn: int = 0,
             blend: float = 0.0) -> Stack:
        """Windows of clips of one output size; ``seed`` picks the size, so that all GPUs work on
        the same one.

        ``sparse`` is the share of clips whose albedo, normal and roughness come from a render with
        fewer samples, ``blend`` the share of those whose noise is mixed from two renders. Turn 0
        plays the clips forwards; each later ``turn``, drawn with the same random state, plays the
        same windows of other renders the other way than the turn before, and continues its history.
        """
        shapes = sorted(self.training)
        # `watch` may add to them meanwhile
        there = [list(self.training[shape]) for shape in shapes]
        weights = [[clip.weight for clip in clips] for clips in there]
        drawn = random.Random(seed).choices(range(len(shapes)), [sum(w) for w in weights])[0]
        clips = random.choices(there[drawn], weights[drawn], k=size)
        renders_of = [compared(clip) for clip in clips]
        order = [random.sample(renders, len(renders)) for renders in renders_of]
        variants = [renders[turn % len(renders)] for renders in order]
        thinned = [random.random() < sparse for _ in clips]
        surfaces = [sparser(c, v, turn) if thin else v
                    for c, v, thin in zip(clips, variants, thinned, strict=True)]
        blended = [random.random() < blend for _ in clips]
        others = [companion(c, v) if mixed else None
                  for c, v, mixed in zip(clips, variants, blended, strict=True)]
        stack = collate(clips, variants, crop, surfaces, others)
        return stack if turn == 0 else play_on(stack, backwards=turn % 2 == 1)


def compared(clip: Clip) -> list[int]:
    """Renders that have a reference of other samples."""
    return [v for v in range(len(clip.planes)) if clip.half is not None or not clip.halved[v]]


def play_on(stack: Stack, backwards: bool) -> Stack:
    """Windows that continue after the same windows were played the other way: the frame at the turn
    comes twice, and nothing moves between the two."""
    kept, planes = stack.keep.clone(), stack.planes.clone()
    if backwards:
        inverse = MOTION + 2 * (1 + stack.pairs.index("inverse"))
        for first in range(MOTION, planes.shape[2], 2):
            # 0 in the last frame
            planes[:, :, first:first + 2] = stack.planes[:, :, inverse:inverse + 2]
        kept = torch.cat((torch.ones_like(kept[:, :1]), kept[:, 1:].flip(1)), 1)
        return replace(stack, planes=planes.flip(1), keep=kept, jitter=stack.jitter.flip(1),
                       reference=stack.reference.flip(1), surfaces=stack.surfaces.flip(1),
                       guides=None if stack.guides is None else stack.guides.flip(1))
    kept[:, 0], planes[:, 0, MOTION:] = 1, 0
    return replace(stack, planes=planes, keep=kept)


def sparser(clip: Clip, variant: int, turn: int = 0) -> int:
    """Another render of the same frames with fewer samples, spread over the pixel, a next one each
    turn; else the render itself."""
    fewer = [v for v in range(len(clip.planes))
             if clip.samples[v] < clip.samples[variant] and clip.spread[v]]
    return fewer[turn % len(fewer)] if fewer and clip.spread[variant] else variant


def companion(clip: Clip, variant: int) -> int | None:
    """Another render of the same frames whose samples are spread over the pixel and not part of a
    reference; None if there is none, or the render itself is of another kind."""
    if not clip.spread[variant] or clip.exact[variant]:
        return None
    others = [v for v in range(len(clip.planes))
              if v != variant and clip.spread[v] and not clip.halved[v] and not clip.exact[v]]
    return random.choice(others) if others else None


def collate(clips: list[Clip], variants: list[int], crop: int | None = None,
            surfaces: list[int] | None = None, others: Sequence[int | None] = ()) -> Stack:
    """Stack one noisy render of each clip, complete or in windows of ``crop`` render pixels.

    ``surfaces`` are the renders that provide albedo, normal and roughness; by default the same
    ones. Where ``others`` names another render, the two are mixed by a random share, as if samples
    of both were drawn: one clip then shows ever other noise.
    """
    windows = [_window(clip, crop) for clip in clips]
    chosen = list(zip(clips, variants, windows, strict=True))
    device = clips[0].planes.device
    planes = torch.stack([c.planes[v, ..., w[0], w[1]] for c, v, w in chosen]).float()
    true = torch.full_like(planes[:, :, :CHANNELS], torch.nan)
    for entry, (clip, variant, (rows, columns, *_)) in enumerate(chosen):
        other = others[entry] if others else None
        if other is not None:
            share = random.random()
            for part in (COLOUR, *SURFACE):
                second = clip.planes[other, :, part, rows, columns].float()
                planes[entry, :, part] = torch.lerp(planes[entry, :, part], second, share)
        source = surfaces[entry] if surfaces else variant
        known = None if clip.hazy[source] else true_planes(clip, source)
        for part in SURFACE:
            if known is not None:
                true[entry, :, part] = clip.planes[known, :, part, rows, columns].float()
            if source != variant:
                planes[entry, :, part] = clip.planes[source, :, part, rows, columns].float()
    guides = [c.guides[..., w[2], w[3]] for c, _, w in chosen if c.guides is not None]
    exposure = torch.tensor([c.exposure for c in clips], device=device, dtype=torch.float32)
    return Stack(
        planes=planes,
        jitter=torch.stack([c.jitter[v] for c, v, _ in chosen]),
        spread=torch.tensor([c.spread[v] for c, v, _ in chosen], device=device),
        keep=torch.stack([c.keep for c in clips]),
        reference=torch.stack([target(c, v)[..., w[2], w[3]] for c, v, w in chosen]).float(),
        surfaces=true,
        guides=torch.stack(guides).float() if guides else None,
        exposure=exposure[:, None, None, None],
        quiet=torch.tensor([has_quiet_target(c, v) for c, v, _ in chosen], device=device),
        pairs=clips[0].pairs,
    )


def target(clip: Clip, variant: int) -> Tensor:
    """The reference of a noisy render, made of other samples than the render."""
    if not clip.halved[variant]:
        return clip.reference
    assert clip.half is not None, "a clip with halved renders has the other half"
    return clip.half


def has_quiet_target(clip: Clip, variant: int) -> bool:
    """Whether the reference of a noisy render has many times its samples. References without halves
    count as free of noise."""
    if not any(clip.halved):
        return True
    if clip.halved[variant]:
        return False
    reference = 2 * clip.samples[clip.halved.index(True)]
    return reference >= QUIET_RATIO * clip.samples[variant]


def true_planes(clip: Clip, variant: int) -> int | None:
    """The render with the true albedos and normals of a noisy one: an exact one, itself if all its
    samples lie at one place, else a render with many samples; None if there is none."""
    if any(clip.exact):
        return clip.exact.index(True)
    if not clip.spread[variant]:
        return variant
    best = max(range(len(clip.samples)), key=lambda v: clip.samples[v] if clip.spread[v] else 0)
    enough = MANY_SAMPLES
    if best != variant:
        enough = min(MANY_SAMPLES, max(SOME_SAMPLES, 4 * clip.samples[variant]))
    return best if clip.samples[best] >= enough else None


def _window(clip: Clip, crop: int | None) -> tuple[slice, slice, slice, slice]:
    """Rows and columns at render size, then at output size; even offsets fit scale 1.5 as well."""
    inner, outer = [], []
    for size, full in zip(clip.planes.shape[-2:], clip.reference.shape[-2:], strict=True):
        length = min(crop or size, size)
        start = 2 * random.randrange((size - length) // 2 + 1)
        inner.append(slice(start, start + length))
        outer.append(slice(start * full // size, (start + length) * full // size))
    return inner[0], inner[1], outer[0], outer[1]


def to_batch(stack: Stack) -> Batch:
    guides = [None] * stack.planes.shape[1] if stack.guides is None else stack.guides.unbind(1)
    planes, *motions = stack.planes.split([CHANNELS, *[2] * len(stack.pairs)], 2)
    frames = [frame_inputs(p, j, g, stack.exposure)
              for p, j, g in zip(planes.unbind(1), stack.jitter.unbind(1), guides, strict=True)]
    references = (stack.reference * stack.exposure[:, None]).clamp(0, 1e4).transpose(0, 1)
    pairs = {name: list(motion.unbind(1))
             for name, motion in zip(stack.pairs, motions, strict=True)}
    surfaces = [Inputs(**_split(true, PLANES), jitter=jitter)
                for true, jitter in zip(stack.surfaces.unbind(1), stack.jitter.unbind(1),
                                        strict=True)]
    return Batch(frames, references, stack.keep.T[..., None, None, None],
                 quiet=stack.quiet[:, None, None, None], inverse=pairs.get("inverse"),
                 static=pairs.get("static"), surfaces=surfaces)


def frame_inputs(planes: Tensor, jitter: Tensor, guides: Tensor | None,
                 exposure: Tensor) -> Inputs:
    """Inputs of one frame from stacked planes (N, 22, h, w); ``exposure`` (N, 1, 1, 1)."""
    split = _split(planes, PLANES)
    split["colour"] = (torch.nan_to_num(split["colour"]).clamp(min=0) * exposure).clamp(max=1e4)
    return Inputs(**split, jitter=jitter,
                  guides=None if guides is None else Guides(**_split(guides, GUIDES)))


def _split(stacked: Tensor, planes: tuple[tuple[str, int], ...]) -> dict[str, Tensor]:
    split = dict(zip([name for name, _ in planes], stacked.split([c for _, c in planes], 1),
                     strict=True))
    return split | {"depth": torch.exp2(split["depth"])}


# Augmentation -------------------------------------------------------------------------------------
# Random views of the same clips: mirrored, transposed, recoloured, exposed differently, nearly free
# of noise, with false motion or missing planes.

# First channels of these planes in a stack; further kinds of motion follow motion.
NORMAL, DEPTH, MIRRORED_ALBEDO, MIRRORED_NORMAL, MOTION = 9, 13, 14, 17, 20
COLOUR = slice(0, 3)
# Albedos, normals and roughness: means over a pixel's samples, where those are spread.
SURFACE = slice(3, 13), slice(14, 20)
# Values for a plane that a file lacks; postfx/passes/denoise/planes.py fills in the same ones.
ABSENT = {"diffuse_albedo": 0.0, "specular_albedo": 0.0, "normal": 0.0, "roughness": 0.5,
          "depth": 1.0, "denoising_albedo": 0.0, "denoising_normal": 0.0, "motion": 0.0}
# Planes that are missing together, and how often: renderers seldom write roughness.
LOSSES = (
    (("roughness",), 0.2),
    (("specular_albedo",), 0.04),
    (("specular_albedo", "roughness"), 0.06),
    (("normal",), 0.05),
    (("depth",), 0.05),
    (("diffuse_albedo",), 0.03),
    (("diffuse_albedo", "specular_albedo"), 0.05),
    (("motion",), 0.03),
    (MIRRORED, 0.3),
    (tuple(ABSENT), 0.05),
)


@dataclass
class Augment:
    """Random changes of a batch. Every choice is drawn for each entry; mirroring and transposing
    once a batch.

    stops: exposure varies by this much either way. drop: factor on the chances that planes are
    missing. clean: chance of colour of many more samples, up to all, which teaches the network to
    keep good pixels. false_motion: chance of wrong motion vectors, which teach the network to doubt
    the history by depth, albedo and normal. spread: chance that noise of neighbouring pixels is not
    quite independent, as where a renderer's pixel filter was undone.
    """

    stops: float = 1.5
    drop: float = 1.0
    clean: float = 0.25
    false_motion: float = 0.0
    spread: float = 0.0

    def __call__(self, stack: Stack) -> Batch:
        stack = _permute_channels(_flip(self._converge(stack)))
        if self.spread:
            stack = spread_noise(stack, self.spread)
        stops = (torch.rand_like(stack.exposure) * 2 - 1) * self.stops
        batch = to_batch(replace(stack, exposure=stack.exposure * torch.exp2(stops)))
        return self._drop_planes(falsify_motion(batch, self.false_motion) if self.false_motion
                                 else batch)

    def _converge(self, stack: Stack) -> Stack:
        """Move some colours towards the reference, if their samples are spread over the pixel like
        the reference's."""
        planes, reference = stack.planes, stack.reference
        h, w = planes.shape[-2:]
        chosen = (torch.rand_like(stack.exposure) < self.clean) & stack.spread[:, None, None, None]
        share = (chosen * (1 - torch.rand_like(stack.exposure) ** 3))[:, None]
        mean = ops.box_mean(reference.flatten(0, 1), h, w).unflatten(0, planes.shape[:2])
        return replace(stack, planes=torch.cat((torch.lerp(planes[:, :, :3], mean, share),
                                                planes[:, :, 3:]), 2))

    def _drop_planes(self, batch: Batch) -> Batch:
        """Replace some planes for a whole clip by the reader's stand-ins: files may lack planes."""
        entries, device = batch.keep.shape[1], batch.keep.device
        lost = {name: torch.zeros(entries, 1, 1, 1, dtype=torch.bool, device=device)
                for name in ABSENT}
        for names, chance in LOSSES:
            chosen = torch.rand(entries, 1, 1, 1, device=device) < chance * self.drop
            lost |= {name: lost[name] | chosen for name in names}
        inverse = batch.inverse and [torch.where(lost["motion"], ABSENT["motion"], motion)
                                     for motion in batch.inverse]
        unknown = lost["diffuse_albedo"] | lost["specular_albedo"]
        assert batch.surfaces is not None, "a batch of clips has the true planes"
        surfaces = [_without(frame, lost) for frame in batch.surfaces]
        surfaces = [replace(frame,
                            diffuse_albedo=torch.where(unknown, torch.nan, frame.diffuse_albedo))
                    for frame in surfaces]
        return replace(batch, frames=[_without(frame, lost) for frame in batch.frames],
                       surfaces=surfaces, keep=batch.keep * ~lost["motion"], inverse=inverse)


def spread_noise(stack: Stack, chance: float) -> Stack:
    """Filter colour, albedos, normals and roughness of some entries, and their references, by three
    pixels each way. Other sizes of reference stay as they are, with their renders."""
    planes = stack.planes
    if planes.shape[-2:] != stack.reference.shape[-2:]:
        return stack
    entries, device = len(planes), planes.device
    low, high = LEFT_SPREAD
    shape = entries, 1, 1, 1, 1
    weight = torch.rand(shape, device=device) * (high - low) + low
    chosen = torch.rand(shape, device=device) < chance

    def filtered(values: Tensor) -> Tensor:
        found = values
        for axis in (-1, -2):
            found = found + weight * _curvature(found, axis)
        return torch.where(chosen, found, values)

    planes, surfaces = planes.clone(), stack.surfaces.clone()
    for part in (COLOUR, *SURFACE):
        planes[:, :, part] = filtered(planes[:, :, part])
        surfaces[:, :, part] = filtered(surfaces[:, :, part])
    return replace(stack, planes=planes, surfaces=surfaces, reference=filtered(stack.reference))


def _curvature(values: Tensor, axis: int) -> Tensor:
    """Both neighbours along an axis less twice the value; edges are repeated."""
    last = values.shape[axis] - 1
    before = torch.cat((values.narrow(axis, 0, 1), values.narrow(axis, 0, last)), axis)
    after = torch.cat((values.narrow(axis, 1, last), values.narrow(axis, last, 1)), axis)
    return before + after - 2 * values


def falsify_motion(batch: Batch, chance: float) -> Batch:
    """Give some entries of a batch wrong motion for the whole clip; ``true_motion`` keeps the right
    one for the loss.

    Each entry draws one mistake: moving objects have the motion of a world at rest (if the batch
    has ``static``), an ellipse of the picture has the mean motion around it, the ellipse has no
    motion, or the whole picture has none.
    """
    true = [frame.motion for frame in batch.frames]
    device, (n, _, h, w) = true[0].device, true[0].shape
    kind = torch.randint(0, 4, (n, 1, 1, 1), device=device)
    chosen = torch.rand(n, 1, 1, 1, device=device) < chance
    centre, radius = torch.rand(n, 2, device=device), 0.1 + 0.3 * torch.rand(n, 2, device=device)
    region = ellipse(centre, radius, h, w)
    ring = ellipse(centre, 1.4 * radius, h, w) & ~region
    frames = []
    for t, (frame, motion) in enumerate(zip(batch.frames, true, strict=True)):
        pixels = ring.sum((2, 3), keepdim=True).clamp(min=1)
        around = (motion * ring).sum((2, 3), keepdim=True) / pixels
        led_around = torch.where(region, around, motion)
        stopped = torch.where(region | (kind == 3), torch.zeros_like(motion), motion)
        false = torch.where(kind == 1, led_around, stopped)
        false = torch.where(kind == 0, batch.static[t] if batch.static else led_around, false)
        frames.append(replace(frame, motion=torch.where(chosen, false, motion)))
    return replace(batch, frames=frames, static=None, true_motion=true)


def ellipse(centre: Tensor, radius: Tensor, h: int, w: int) -> Tensor:
    """True inside an ellipse of the picture, (N, 1, h, w); centre and radius (N, 2) in shares of
    width and height."""
    x = (torch.arange(w, device=centre.device) + 0.5) / w
    y = (torch.arange(h, device=centre.device) + 0.5) / h
    across = ((x - centre[:, :1]) / radius[:, :1]) ** 2
    down = ((y - centre[:, 1:]) / radius[:, 1:]) ** 2
    return (across[:, None, None] + down[:, None, :, None]) < 1


def _without(planes: Inputs, lost: dict[str, Tensor]) -> Inputs:
    """The planes with stand-ins in the entries that lost them; guides likewise."""
    guides = planes.guides
    if guides is not None:
        guides = replace(guides, **_stand_ins(guides, lost))
    return replace(planes, **_stand_ins(planes, lost), guides=guides)


def _stand_ins(planes: Inputs | Guides, lost: dict[str, Tensor]) -> dict[str, Any]:
    """The planes that some entries lost, with stand-ins there."""
    return {f.name: torch.where(lost[f.name], ABSENT[f.name], getattr(planes, f.name))
            for f in fields(planes) if f.name in lost}


def _flip(stack: Stack) -> Stack:
    """Mirror and transpose the picture; motion and jitter follow."""
    planes = stack.planes
    jitter = stack.jitter.clone()
    reference = stack.reference
    guides = stack.guides
    surfaces = stack.surfaces
    signs = torch.ones(planes.shape[2], device=planes.device)
    for axis in (0, 1):
        if random.random() < 0.5:
            planes, reference, surfaces = (x.flip(-1 - axis) for x in (planes, reference, surfaces))
            guides = None if guides is None else guides.flip(-1 - axis)
            signs[MOTION + axis::2] = -1
            jitter[..., axis] *= -1
    planes = planes * signs[:, None, None]
    if random.random() < 0.5:
        planes, reference, surfaces = (x.transpose(-1, -2) for x in (planes, reference, surfaces))
        guides = None if guides is None else guides.transpose(-1, -2)
        motions = planes[:, :, MOTION:].unflatten(2, (-1, 2)).flip(3).flatten(2, 3)
        planes = torch.cat((planes[:, :, :MOTION], motions), 2)
        jitter = jitter.flip(-1)
    return replace(stack, planes=planes, jitter=jitter, reference=reference, surfaces=surfaces,
                   guides=guides)


def _permute_channels(stack: Stack) -> Stack:
    """Shuffle the colour primaries and the axes of the world; neither has a preferred order."""
    rgb, xyz = random.sample(range(3), 3), random.sample(range(3), 3)
    axes = random.sample(range(3), 3)  # of the other normal, which may be the camera's
    order = list(range(stack.planes.shape[2]))
    for first, places in ((0, rgb), (3, rgb), (6, rgb), (NORMAL, xyz), (MIRRORED_ALBEDO, rgb),
                          (MIRRORED_NORMAL, axes)):
        order[first:first + 3] = [first + i for i in places]
    signs = torch.ones(len(order), device=stack.planes.device)
    for first in (NORMAL, MIRRORED_NORMAL):
        signs[first:first + 3] = torch.tensor([random.choice((-1.0, 1.0)) for _ in range(3)])
    planes = stack.planes[:, :, order] * signs[:, None, None]
    guides = stack.guides
    if guides is not None:
        last = MIRRORED_ALBEDO
        guides = guides[:, :, [c - 3 for c in order[3:last]]] * signs[3:last, None, None]
    surfaces = stack.surfaces[:, :, order[:CHANNELS]] * signs[:CHANNELS, None, None]
    return replace(stack, planes=planes, reference=stack.reference[:, :, rgb], surfaces=surfaces,
                   guides=guides)
