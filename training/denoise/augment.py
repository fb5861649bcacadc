"""Random changes of the windows that a network is trained on.

The same clip is mirrored, transposed, recoloured, exposed differently, nearly freed of noise, given
wrong motion or deprived of planes, so that the network learns what frames have in common.
"""

import random
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from training import ops
from training.datagen.clip_file import MIRRORED
from training.denoise.clips import (
    ABSENT,
    CHANNELS,
    COLOUR,
    MIRRORED_ALBEDO,
    MIRRORED_NORMAL,
    MOTION,
    NORMAL,
    SURFACE,
)
from training.denoise.dataset import Batch, Stack, to_batch
from training.denoise.model import Guides, Inputs

LEFT_SPREAD = (-0.03, 0.06)
"""Bounds of a neighbour's weight where a little of a pixel filter is left, or too much of it was
undone. A gaussian filter of half a pixel has 0.107."""


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
    return replace(stack, planes=planes, surfaces=surfaces, reference=filtered(stack.reference),
                   half=filtered(stack.half))


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
    guides = stack.guides
    pictures = planes, stack.reference, stack.half, stack.surfaces
    signs = torch.ones(planes.shape[2], device=planes.device)
    for axis in (0, 1):
        if random.random() < 0.5:
            pictures = tuple(x.flip(-1 - axis) for x in pictures)
            guides = None if guides is None else guides.flip(-1 - axis)
            signs[MOTION + axis::2] = -1
            jitter[..., axis] *= -1
    is_turned = random.random() < 0.5
    if is_turned:
        pictures = tuple(x.transpose(-1, -2) for x in pictures)
    planes, reference, half, surfaces = pictures
    planes = planes * signs[:, None, None]
    if is_turned:
        guides = None if guides is None else guides.transpose(-1, -2)
        motions = planes[:, :, MOTION:].unflatten(2, (-1, 2)).flip(3).flatten(2, 3)
        planes = torch.cat((planes[:, :, :MOTION], motions), 2)
        jitter = jitter.flip(-1)
    return replace(stack, planes=planes, jitter=jitter, reference=reference, half=half,
                   surfaces=surfaces, guides=guides)


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
    return replace(stack, planes=planes, reference=stack.reference[:, :, rgb],
                   half=stack.half[:, :, rgb], surfaces=surfaces, guides=guides)
