"""Random views of the same clips: mirrored, turned, recoloured, exposed otherwise, nearly free of noise, or with
planes missing."""
import random
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from training.dataset import Batch, Stack, to_batch
from training.networks import ops
from training.networks.denoise_upscale import Guides, Inputs

NORMAL, MOTION = 9, 14  # first channels of these planes in a stack; inverse motion, if it is there, follows motion
# What stands in for a plane that a file lacks; postfx/passes/denoise_upscale.py fills the same values.
ABSENT = {"diffuse_albedo": 0.0, "specular_albedo": 0.0, "normal": 0.0, "roughness": 0.5, "depth": 1.0, "motion": 0.0}
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
    (tuple(ABSENT), 0.05),
)


@dataclass
class Augment:
    """Every choice is drawn once a batch entry or, mirroring and turning, once a batch.

    stops: exposure varies by as much either way. drop: factor on the chances that planes are missing. clean: chance of
    colour of far more samples, up to all, which teaches the network to leave good pixels alone.
    """

    stops: float = 1.5
    drop: float = 1.0
    clean: float = 0.25

    def __call__(self, stack: Stack) -> Batch:
        stack = _permute_channels(_flip(self._converge(stack)))
        stops = (torch.rand_like(stack.exposure) * 2 - 1) * self.stops
        return self._drop_planes(to_batch(replace(stack, exposure=stack.exposure * torch.exp2(stops))))

    def _converge(self, stack: Stack) -> Stack:
        """Move some colours towards the reference, where samples are spread over the pixel as the reference's are."""
        planes, reference = stack.planes, stack.reference
        h, w = planes.shape[-2:]
        chosen = (torch.rand_like(stack.exposure) < self.clean) & stack.spread[:, None, None, None]
        share = (chosen * (1 - torch.rand_like(stack.exposure) ** 3))[:, None]
        mean = ops.box_mean(reference.flatten(0, 1), h, w).unflatten(0, planes.shape[:2])
        return replace(stack, planes=torch.cat((torch.lerp(planes[:, :, :3], mean, share), planes[:, :, 3:]), 2))

    def _drop_planes(self, batch: Batch) -> Batch:
        """Files do not always have every plane: leave some out, for the whole clip, as the reader would fill them."""
        entries, device = batch.keep.shape[1], batch.keep.device
        lost = {name: torch.zeros(entries, 1, 1, 1, dtype=torch.bool, device=device) for name in ABSENT}
        for names, chance in LOSSES:
            chosen = torch.rand(entries, 1, 1, 1, device=device) < chance * self.drop
            lost |= {name: lost[name] | chosen for name in names}
        inverse = batch.inverse and [torch.where(lost["motion"], ABSENT["motion"], motion) for motion in batch.inverse]
        return replace(batch, frames=[_without(frame, lost) for frame in batch.frames],
                       keep=batch.keep * ~lost["motion"], inverse=inverse)


def _without(planes: Inputs | Guides, lost: dict[str, Tensor]) -> Inputs | Guides:
    """The planes with what stands in for the lost ones, in the entries where they are lost; guides likewise."""
    changed = {f.name: torch.where(lost[f.name], ABSENT[f.name], getattr(planes, f.name))
               for f in fields(planes) if f.name in lost}
    guides = getattr(planes, "guides", None)
    return replace(planes, **changed, **({} if guides is None else {"guides": _without(guides, lost)}))


def _flip(stack: Stack) -> Stack:
    """Mirror and transpose the picture; motion and jitter follow."""
    planes, jitter, reference, guides = stack.planes, stack.jitter.clone(), stack.reference, stack.guides
    signs = torch.ones(planes.shape[2], device=planes.device)
    for axis in (0, 1):
        if random.random() < 0.5:
            planes, reference = planes.flip(-1 - axis), reference.flip(-1 - axis)
            guides = None if guides is None else guides.flip(-1 - axis)
            signs[MOTION + axis::2] = -1
            jitter[..., axis] *= -1
    planes = planes * signs[:, None, None]
    if random.random() < 0.5:
        planes, reference = planes.transpose(-1, -2), reference.transpose(-1, -2)
        guides = None if guides is None else guides.transpose(-1, -2)
        motions = planes[:, :, MOTION:].unflatten(2, (-1, 2)).flip(3).flatten(2, 3)
        planes = torch.cat((planes[:, :, :MOTION], motions), 2)
        jitter = jitter.flip(-1)
    return replace(stack, planes=planes, jitter=jitter, reference=reference, guides=guides)


def _permute_channels(stack: Stack) -> Stack:
    """Shuffle the colour primaries and the axes of the world; neither has a preferred order."""
    rgb, xyz = random.sample(range(3), 3), random.sample(range(3), 3)
    rest = range(12, stack.planes.shape[2])
    order = [*rgb, *(3 + i for i in rgb), *(6 + i for i in rgb), *(9 + i for i in xyz), *rest]
    signs = torch.ones(len(order), device=stack.planes.device)
    signs[NORMAL:NORMAL + 3] = torch.tensor([random.choice((-1.0, 1.0)) for _ in range(3)])
    planes = stack.planes[:, :, order] * signs[:, None, None]
    guides = stack.guides
    if guides is not None:
        guides = guides[:, :, [c - 3 for c in order[3:MOTION]]] * signs[3:MOTION, None, None]
    return replace(stack, planes=planes, reference=stack.reference[:, :, rgb], guides=guides)
