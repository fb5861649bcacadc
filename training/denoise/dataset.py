"""Batches of training: clips that stay on the device, and windows that are drawn from them.

`ClipPool` holds the clips and grows while the data factory writes more. It draws windows of one
noisy render of each of several clips (`Stack`). `to_batch` makes of them what the network reads and
what its result is compared with (`Batch`); `augment` changes them before.
"""

import random
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from training import ops
from training.denoise.clips import (
    CHANNELS,
    COLOUR,
    GUIDES,
    MOTION,
    PLANES,
    SURFACE,
    Clip,
    load,
)
from training.denoise.model import Guides, Inputs, State

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


@dataclass
class Batch:
    """Windows of N clips as T frames, which the network runs one after the other.

    Attributes:
        frames: what the network reads of each frame.
        references: (T, N, 3, H, W) exposed linear colour.
        halves: (T, N, 3, H, W) the same from half of their samples, or the same where references
            have no halves.
        keep: (T, N, 1, 1, 1) 0 where the history ends, else 1.
        inverse: T motions (N, 2, h, w) to the next frame, for clips that also run backwards.
        static: T motions as if only the camera moved.
        true_motion: T motions, where those of the frames may be false.
        quiet: (N, 1, 1, 1) true where the reference has much less noise than the frames.
        surfaces: T inputs with the true albedos and normals, NaN in entries where they are
            unknown.
        state: the history that the first frame continues; None for none.
    """

    frames: list[Inputs]
    references: Tensor
    halves: Tensor
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
    """Windows of N clips: the fields of ``Clip``, of one render each, with N in front.

    Attributes:
        half: (N, T, 3, H, W) the reference from half of its samples, or itself.
        exposure: (N, 1, 1, 1).
        quiet: (N,) whether the reference has much less noise than the frames.
        surfaces: (N, T, C, h, w) planes with the true albedos, normals and roughness, NaN where
            these are unknown.
    """

    planes: Tensor
    jitter: Tensor
    spread: Tensor
    keep: Tensor
    reference: Tensor
    half: Tensor
    surfaces: Tensor
    guides: Tensor | None
    exposure: Tensor
    quiet: Tensor
    motions: tuple[str, ...] = ()


class ClipPool:
    """All clips of some folders, each with the weight of its clips; grows while the data factory is
    still writing.

    ``prepare`` changes each clip that is loaded. With ``both_halves``, no render is drawn that is
    made of half of its reference's samples.
    """

    def __init__(self, folders: Mapping[Path, float], device: torch.device, guides: bool = False,
                 share: int = 0, shares: int = 1, held_out: int = 20, motions: tuple[str, ...] = (),
                 blank_volumes: bool = True, prepare: Callable[[Clip], Clip] | None = None,
                 both_halves: bool = False):
        self.prepare, self.both_halves = prepare, both_halves
        self.folders, self.device, self.guides, self.motions = folders, device, guides, motions
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
                clip = load(path, self.device, self.guides, self.motions, self.blank_volumes)
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
        renders_of = [compared(clip, self.both_halves) for clip in clips]
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


def compared(clip: Clip, both_halves: bool = False) -> list[int]:
    """Renders that have a reference of other samples, and, if asked for, one of both halves."""
    may_be_half = clip.half is not None and not both_halves
    return [v for v in range(len(clip.planes)) if may_be_half or not clip.halved[v]]


def play_on(stack: Stack, backwards: bool) -> Stack:
    """Windows that continue after the same windows were played the other way: the frame at the turn
    comes twice, and nothing moves between the two."""
    kept, planes = stack.keep.clone(), stack.planes.clone()
    if backwards:
        inverse = MOTION + 2 * (1 + stack.motions.index("inverse"))
        for first in range(MOTION, planes.shape[2], 2):
            # 0 in the last frame
            planes[:, :, first:first + 2] = stack.planes[:, :, inverse:inverse + 2]
        kept = torch.cat((torch.ones_like(kept[:, :1]), kept[:, 1:].flip(1)), 1)
        return replace(stack, planes=planes.flip(1), keep=kept, jitter=stack.jitter.flip(1),
                       reference=stack.reference.flip(1), half=stack.half.flip(1),
                       surfaces=stack.surfaces.flip(1),
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
        half=torch.stack([half_of_target(c, v)[..., w[2], w[3]] for c, v, w in chosen]).float(),
        surfaces=true,
        guides=torch.stack(guides).float() if guides else None,
        exposure=exposure[:, None, None, None],
        quiet=torch.tensor([has_quiet_target(c, v) for c, v, _ in chosen], device=device),
        motions=clips[0].motions,
    )


def target(clip: Clip, variant: int) -> Tensor:
    """The reference of a noisy render, made of other samples than the render."""
    if not clip.halved[variant]:
        return clip.reference
    assert clip.half is not None, "a clip with halved renders has the other half"
    return clip.half


def half_of_target(clip: Clip, variant: int) -> Tensor:
    """The reference of a noisy render from half of its samples, or itself where there is none."""
    return target(clip, variant) if clip.half is None else clip.half


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
    planes, *further = stack.planes.split([CHANNELS, *[2] * len(stack.motions)], 2)
    frames = [frame_inputs(p, j, g, stack.exposure)
              for p, j, g in zip(planes.unbind(1), stack.jitter.unbind(1), guides, strict=True)]
    references, halves = ((light * stack.exposure[:, None]).clamp(0, 1e4).transpose(0, 1)
                          for light in (stack.reference, stack.half))
    motions = {name: list(motion.unbind(1))
               for name, motion in zip(stack.motions, further, strict=True)}
    surfaces = [Inputs(**_split(true, PLANES), jitter=jitter)
                for true, jitter in zip(stack.surfaces.unbind(1), stack.jitter.unbind(1),
                                        strict=True)]
    return Batch(frames, references, halves, stack.keep.T[..., None, None, None],
                 quiet=stack.quiet[:, None, None, None], inverse=motions.get("inverse"),
                 static=motions.get("static"), surfaces=surfaces)


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
