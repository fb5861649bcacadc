"""Recurrent denoised upscaler: one step turns a noisy frame and the state into the output and the
next state.

A network (``Trunk``) predicts filters; all work on colour is small fixed operations: accumulate
demodulated colour over time, filter it in a pyramid of 5x5 kernels from coarse to fine, multiply by
the albedo, upsample with 3x3 kernels that know the samples' positions, and blend with the
reprojected last output.
"""

from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels import denoise as layout
from postfx.kernels.denoise import (
    BLEND,
    DISTRUST,
    FEATURES,
    FINE,
    GUIDES,
    HIDDEN,
    IMPORTANCE,
    KERNEL,
    MAX_COUNT,
    MEMORY,
    MIX,
    PLANE_TRUST,
    SHARPEN,
    TRUST_CELL,
)
from training import ops

# The network --------------------------------------------------------------------------------------
# U-Net that predicts filters from a frame's features: the machine-learning part of the upscaler.

NO_SHARPENING = -3.0  # where the head's biases start
LEVELS = 4  # of the filter pyramid, below the render size


@dataclass(frozen=True)
class TrunkConfig:
    """Layout of the network.

    ``widths`` are the channels of the levels at 1/2, 1/4, 1/8 and 1/16 of the render size,
    ``depth`` the convolutions a level; ``stem`` the channels of the stem (None: those of the first
    level) and ``reach`` its side, 4 or 2 pixels. There may be fewer levels than in the filter
    pyramid, whose coarser levels then have one filter each. With ``trust`` the last hidden channel
    says how far the planes of a pixel are trusted (`trust_reflectance`).
    """

    widths: tuple[int, ...] = (64, 128, 192, 256)
    depth: int = 2
    guides: bool = False
    stem: int | None = None
    reach: int = 4
    trust: bool = False

    @property
    def mirrored(self) -> bool:
        """Whether the network reads Blender's Denoising Albedo and Denoising Normal, and predicts
        its error."""
        return False

    @property
    def first(self) -> int:
        """Channels of the stem."""
        return self.stem or self.widths[0]

    @property
    def align(self) -> int:
        """Height and width of the network's input are multiples of this."""
        return 2 ** len(self.widths)

    @property
    def heads(self) -> tuple[int, ...]:
        """Channels of the heads of all levels of the pyramid: 5x5 kernel and, except for the
        coarsest, mix."""
        return (*[KERNEL + 1] * (LEVELS - 1), KERNEL)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, config: dict[str, Any]) -> "TrunkConfig":
        """From the dictionary of a checkpoint; older ones do not have all entries."""
        known = {field.name: config[field.name] for field in fields(cls) if field.name in config}
        return cls(**{**known, "widths": tuple(config["widths"])})


def weights_from(logits: Tensor) -> Tensor:
    """Positive filter weights; bounded so that sums in half precision neither vanish nor
    overflow."""
    return torch.exp(logits.clamp(-8, 8))


def activate_fine(fine: Tensor) -> Tensor:
    """The activated fine head (N, 80, h, w) from its logits."""
    return torch.cat((weights_from(fine[:, :BLEND]), torch.sigmoid(fine[:, BLEND:MEMORY]),
                      torch.tanh(fine[:, MEMORY:])), 1)


def filters(head: Tensor) -> Tensor:
    """A level's 5x5 kernel and mix, if it has one, from their logits."""
    return torch.cat((weights_from(head[:, :KERNEL]), torch.sigmoid(head[:, KERNEL:])), 1)


def logits_of(head: Tensor) -> Tensor:
    """The inverse of `filters`."""
    return torch.cat((head[:, :KERNEL].log(), head[:, KERNEL:].logit(1e-6)), 1)


class Block(nn.Sequential):
    """3x3 convolutions with ReLU, no normalisation: half-precision friendly and cheap
    everywhere."""

    def __init__(self, inputs: int, outputs: int, depth: int):
        layers: list[nn.Module] = []
        for i in range(depth):
            layers += [nn.Conv2d(inputs if i == 0 else outputs, outputs, 3, padding=1), nn.ReLU()]
        super().__init__(*layers)


def stem(config: TrunkConfig, inputs: int, bias: bool = True) -> nn.Conv2d:
    """The convolution that reads planes of render size and writes half as many rows and columns."""
    return nn.Conv2d(inputs, config.first, config.reach, stride=2, padding=config.reach // 2 - 1,
                     bias=bias)


class Trunk(nn.Module):
    """Features (N, 35, h, w) and guides (N, 44, h, w) or none, h and w multiples of
    ``config.align`` -> the heads, all activated.

    ``fine`` (N, 80, h, w); ``level1`` .. ``level3`` (N, 26, h/2 .. h/8, w/2 .. w/8): 5x5 kernel and
    mix; ``level4`` (N, 25, h/16, w/16): 5x5 kernel. Levels that the network does not have are (1,
    26 or 25, 1, 1): the same at all pixels.
    """

    def __init__(self, config: TrunkConfig | None = None):
        super().__init__()
        self.config = config or TrunkConfig()
        w, d = self.config.widths, self.config.depth
        count, heads, self.align = len(w), self.config.heads, self.config.align
        self.stem = stem(self.config, FEATURES)
        self.guide_stem = stem(self.config, GUIDES, bias=False) if self.config.guides else None
        above = (self.config.first, *w)
        self.down = nn.ModuleList([Block(above[i], w[i], 1 if i == 0 else d) for i in range(count)])
        self.lift = nn.ModuleList([nn.Conv2d(w[i + 1], w[i], 1) for i in range(count - 1)])
        self.up = nn.ModuleList([Block(w[i], w[i], d) for i in range(min(count, LEVELS - 1))])
        self.heads = nn.ModuleList([nn.Conv2d(c, k, 1)
                                    for c, k in zip(w, heads[:count], strict=True)])
        self.alike = nn.ParameterList([nn.Parameter(torch.zeros(1, k, 1, 1))
                                       for k in heads[count:]])
        self.rest = nn.Parameter(torch.zeros(1, w[-1], 1, 1)) if self.alike else None
        self.fine = nn.Conv2d(w[0], 4 * FINE, 1)
        for head in (*self.heads, self.fine):
            nn.init.normal_(head.weight, std=0.01)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.fine.bias[4 * SHARPEN:4 * MIX], NO_SHARPENING)

    def forward(self, features: Tensor, guides: Tensor | None = None) -> tuple[Tensor, ...]:
        return self.behind(self.stem(features), guides)

    def behind(self, x: Tensor, guides: Tensor | None) -> tuple[Tensor, ...]:
        """The heads from the stem's output for the features."""
        x = F.relu(x if self.guide_stem is None else x + self.guide_stem(guides))
        skips = []
        for i, block in enumerate(self.down):
            x = block(F.max_pool2d(x, 2) if i else x)
            skips.append(x)
        levels = [filters(logits) for logits in self.alike]
        for i in reversed(range(len(skips))):
            x = self._up(i, skips[i], x)
            levels.insert(0, filters(self.heads[i](x)))
        return (self._fine(x), *levels)

    def _up(self, level: int, skip: Tensor, coarser: Tensor) -> Tensor:
        """A level's output from its own features and the coarser level's. The coarsest one gets a
        constant if the pyramid has more levels, else nothing."""
        if level + 1 < len(self.down):
            return self.up[level](skip + F.interpolate(self.lift[level](coarser), scale_factor=2.0,
                                                       mode="nearest"))
        return skip if self.rest is None else self.up[level](skip + self.rest)

    def _fine(self, x: Tensor) -> Tensor:
        return activate_fine(F.pixel_shuffle(self.fine(x), 2))


# The output ---------------------------------------------------------------------------------------
# From filtered radiance at render size to the output: enlarged, given the guides' reflectance,
# sharpened, and blended with the history.

MOST_LOG = 20.0  # no valid history is beyond this


@dataclass(frozen=True)
class Reflectance:
    """Reflectance of the guides at output size, (N, 3, H, W), and how far it is trusted, (N, 1, H,
    W)."""

    factor: Tensor
    trust: Tensor


def resolve(radiance: Tensor, fine: Tensor, jitter: Tensor, warped: Tensor, inside: Tensor,
            guided: Reflectance | None, at: ops.Centres | None = None) -> Tensor:
    """Upsample radiance, sharpen it, and blend it with the reprojected history ``warped``; history
    and result are log-encoded. With ``guided`` the radiance is (N, 6, h, w): without reflectance,
    and with that of the render size. The first is multiplied by the guides' reflectance and counts
    as far as this is trusted. ``at`` gives the output's positions; None: the same area. Broken
    values, NaN or above `MOST_LOG`, count as 0."""
    n, _, h, w = radiance.shape
    height, width = warped.shape[-2:]
    weights = fine[:, KERNEL:BLEND].reshape(n, 9, 4, h, w)
    controls = fine[:, BLEND:MIX].reshape(n, 2, 4, h, w)
    if at is None:
        controls = ops.interpolate_phases(controls, height, width)
        pictures = ops.upsample(radiance, weights, jitter, height, width)
    else:
        controls = ops.interpolate_at(controls, at)
        pictures = ops.upsample_at(radiance, weights, jitter, at)
    blend, sharpen = controls[:, :, None].unbind(1)
    if guided is not None:
        pictures = tuple(torch.lerp(plain, exact * guided.factor, guided.trust)
                         for exact, plain in (picture.chunk(2, 1) for picture in pictures))
    detail, soft = (ops.log_encode(x) for x in pictures)
    return blend_with_history((detail + sharpen * (detail - soft)).clamp(min=0), warped,
                              inside * (1 - blend))


def blend_with_history(current: Tensor, warped: Tensor, share: Tensor) -> Tensor:
    """A picture and the reprojected history, of which a ``share`` (N, 1, H, W) is kept; all
    log-encoded. Broken values count as 0."""
    current = torch.where(current <= MOST_LOG, current, 0)
    mixed = current + share * (warped - current)  # an infinite history stays infinite at any share
    # rounding could make light negative
    return torch.where(mixed <= MOST_LOG, mixed.clamp(min=0), current)


def reflectance(factor: Tensor, own: Tensor) -> Reflectance:
    """The guides' ``factor`` (N, 3, H, W), trusted as far as the planes' ``own`` (N, 3, h, w)
    confirms it."""
    h, w = own.shape[-2:]
    whole = torch.arange(h, device=own.device), torch.arange(w, device=own.device)
    cells = ops.trust(own, factor, whole, h, w, torch.ones_like(own[:, :1]))
    height, width = factor.shape[-2:]
    return Reflectance(factor,
                       ops.trust_at(cells, ops.centres(h, w, height, width, own.device), h, w))


# The recurrent step -------------------------------------------------------------------------------

# Plain numbers: torch.compile breaks graphs at NumPy's.
MOST_REFLECTANCE = float(layout.MOST_REFLECTANCE)
MAX_DEPTH, MAX_FLOAT, MAX_LIGHT = (float(most) for most in (layout.MAX_DEPTH, layout.MAX_FLOAT,
                                                            layout.MAX_LIGHT))
ALIGN = 16


@dataclass(frozen=True)
class Guides:
    """Planes at output size (H, W), in the conventions of ``postfx.frame``; all NCHW float32."""

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    normal: Tensor
    roughness: Tensor
    depth: Tensor


@dataclass(frozen=True)
class Inputs:
    """A frame at render size (h, w), in the conventions of ``postfx.frame``; all NCHW float32.

    ``colour`` is already multiplied by the exposure; ``jitter`` is (N, 2); ``gain`` (N, 1, 1, 1) is
    the exposure over the previous frame's, None if it did not change. Planes may hold NaN and
    infinity. ``denoising_albedo`` and ``denoising_normal`` are Blender's planes of that name, which
    follow mirrors and glass; None: there are none.
    """

    colour: Tensor
    diffuse_albedo: Tensor
    specular_albedo: Tensor
    normal: Tensor
    roughness: Tensor
    depth: Tensor
    motion: Tensor
    jitter: Tensor
    gain: Tensor | None = None
    guides: Guides | None = None
    denoising_albedo: Tensor | None = None
    denoising_normal: Tensor | None = None


@dataclass(frozen=True)
class State:
    """The history. ``output`` is log(1 + exposed colour) at output size; all else has the render
    size."""

    output: Tensor
    accumulated: Tensor
    count: Tensor
    hidden: Tensor
    depth: Tensor
    fresh: Tensor

    def drop(self, keep: Tensor) -> "State":
        """Forget the history of the batch entries where ``keep`` (N, 1, 1, 1) is 0."""
        return replace(self, fresh=self.fresh * keep)


@dataclass(frozen=True)
class Reprojected:
    """The state seen from the current frame."""

    motion: Tensor
    output: Tensor
    inside: Tensor
    accumulated: Tensor
    count: Tensor
    hidden: Tensor
    depth_change: Tensor
    valid: Tensor


def empty_state(inputs: Inputs, height: int, width: int) -> State:
    n, _, h, w = inputs.colour.shape
    new = inputs.colour.new_zeros
    return State(new(n, 3, height, width), new(n, 3, h, w), new(n, 1, h, w), new(n, HIDDEN, h, w),
                 new(n, 1, h, w) + 1, new(n, 1, 1, 1))


def reproject(inputs: Inputs, state: State) -> Reprojected:
    """Move the state along the motion; pixels from beyond the border or from before a reset are
    marked invalid."""
    motion = ops.dilate_motion(inputs.motion, inputs.depth)
    return recall(inputs, state, motion, reproject_output(state.output, motion, inputs.gain))


def reproject_output(output: Tensor, motion: Tensor, gain: Tensor | None) -> Tensor:
    """The last output moved to this frame, rescaled if the exposure changed."""
    moved = ops.warp(output, ops.enlarge_motion(motion, *output.shape[-2:]), "bicubic").clamp(min=0)
    return moved if gain is None else torch.log1p(torch.expm1(moved) * gain)


def recall(inputs: Inputs, state: State, motion: Tensor, output: Tensor,
           place: ops.Place | None = None) -> Reprojected:
    """The rest of the state moved along the dilated ``motion``, together with the reprojected
    ``output``; for the whole frame, or for a ``place`` in it."""
    valid = ops.inside(motion, place, state.depth.shape[-2:]) * state.fresh
    inside = ops.inside(ops.enlarge_motion(motion, *output.shape[-2:])) * state.fresh
    rest = ops.warp(torch.cat((state.accumulated, state.count, state.hidden), 1), motion,
                    place=place)
    # a mean with less weight keeps its value
    accumulated, rest = rest[:, :3] * (valid > 0), rest[:, 3:] * valid
    accumulated = accumulated if inputs.gain is None else accumulated * inputs.gain
    depth = ops.warp_nearest(state.depth, motion, place)
    before, now = (ops.sanitise(z, 1e-6, MAX_DEPTH) for z in (depth, inputs.depth))
    change = (4 * torch.log(before / now)).clamp(-1, 1) * valid
    return Reprojected(motion, output, inside, accumulated, rest[:, :1], rest[:, 1:], change, valid)


def demodulate(colour: Tensor, factor: Tensor) -> Tensor:
    """Colour without reflectance, in [0, 1e30]."""
    return (ops.sanitise(colour, 0, MAX_FLOAT) / factor).clamp(max=MAX_LIGHT)


def hold(light: Tensor) -> Tensor:
    """Light in [0, 1e4]; a brighter pixel keeps its hue."""
    return light * (layout.MAX_COLOUR / light.amax(1, keepdim=True).clamp(min=layout.MAX_COLOUR))


def features(inputs: Inputs, past: Reprojected, factor: Tensor, scale: Tensor) -> Tensor:
    """The trunk's input (N, 35, h, w), with the ``scale`` of depth; ``postfx/kernels`` fills the
    same channels."""
    h, w = inputs.colour.shape[-2:]
    return features_of(inputs, past, factor, scale, ops.box_mean(past.output, h, w),
                       w / past.output.shape[-1])


def features_of(inputs: Inputs, past: Reprojected, factor: Tensor, scale: Tensor, mean: Tensor,
                shrink: float | Tensor) -> Tensor:
    """`features` from the ``mean`` of the last output at each render pixel; ``shrink`` is render
    over output size."""
    plane = torch.ones_like(inputs.depth)
    history = torch.expm1(mean) * past.valid
    return torch.cat((
        ops.log_encode(demodulate(inputs.colour, factor)),
        ops.log_encode(past.accumulated * past.valid), ops.log_encode(history / factor),
        ops.sanitise(inputs.diffuse_albedo, 0, MOST_REFLECTANCE),
        ops.sanitise(inputs.specular_albedo, 0, MOST_REFLECTANCE),
        ops.sanitise(inputs.normal, -1, 1), ops.sanitise(inputs.roughness, 0, 1),
        scale / (scale + ops.sanitise(inputs.depth, 0, MAX_DEPTH)),
        past.depth_change, past.valid, past.count / MAX_COUNT,
        plane * inputs.jitter[:, :, None, None],
        torch.log1p(past.motion.norm(dim=1, keepdim=True)) / 4,
        plane * shrink, past.hidden), 1)


def mirrored_features(inputs: Inputs) -> Tensor:
    """The planes that follow mirrors and glass, (N, 6, h, w): 0 where a file lacks them."""
    none = torch.zeros_like(inputs.normal)
    return mirrored_planes(none if inputs.denoising_albedo is None else inputs.denoising_albedo,
                           none if inputs.denoising_normal is None else inputs.denoising_normal)


def mirrored_planes(albedo: Tensor, normal: Tensor) -> Tensor:
    """The trunk's channels of these planes, without what no such plane holds."""
    return torch.cat((ops.sanitise(albedo, 0, 1), ops.sanitise(normal, -1, 1)), 1)


def guide_features(guides: Guides, h: int, w: int, scale: Tensor) -> Tensor:
    """The guides at the four quarter-pixel corners of each render pixel, nearest sample: (N, 44, h,
    w)."""
    at = seen_guides(guides, scale)
    rows = ops.corner_index(h, at.shape[-2], at.device)
    columns = ops.corner_index(w, at.shape[-1], at.device)
    return torch.cat([ops.pick(at, rows[i], columns[j]) for i in range(2) for j in range(2)], 1)


def seen_guides(guides: Guides, scale: Tensor) -> Tensor:
    """The trunk's channels for each pixel of the guides: (N, 11, H, W)."""
    return torch.cat((
        ops.sanitise(guides.diffuse_albedo, 0, 2), ops.sanitise(guides.specular_albedo, 0, 2),
        ops.sanitise(guides.normal, -1, 1), ops.sanitise(guides.roughness, 0, 1),
        scale / (scale + ops.sanitise(guides.depth, 0, MAX_DEPTH))), 1)


def mirror_to_multiple(image: Tensor, multiple: int = ALIGN) -> Tensor:
    """``image`` (N, C, h, w) mirrored at its right and lower edge up to the next multiple."""
    h, w = image.shape[-2:]
    rows, columns = (ops.mirror_index(size, size + -size % multiple, image.device)
                     for size in (h, w))
    return ops.pick(image, rows, columns)


def accumulate(colour: Tensor, mean: Tensor, count: Tensor,
               distrust: Tensor) -> tuple[Tensor, Tensor]:
    """Running ``mean`` of demodulated colour and its effective sample count; ``distrust`` 1 starts
    again."""
    share = 1 / (count + 1)
    alpha = share + (1 - share) * distrust
    return torch.lerp(mean, colour, alpha), (1 / alpha).clamp(max=MAX_COUNT)


def pad_head(head: Tensor, level: Tensor) -> Tensor:
    """A head padded to the rows and columns of its level; a head of 1x1 stays as it is."""
    (h, w), (rows, columns) = level.shape[-2:], head.shape[-2:]
    return (head if (rows, columns) in ((1, 1), (h, w))
            else F.pad(head, (0, w - columns, 0, h - rows)))


def filter_pyramid(colour: Tensor, importance: Tensor, fine: Tensor, levels: tuple[Tensor, ...],
                   height: int, width: int) -> Tensor:
    """Coarse to fine: mix a level's own colour with the coarser result, then smooth both by the
    level's kernels.

    Heads may be smaller than their levels, as missing rows and columns lie outside the picture; a
    head of 1x1 holds for the whole picture.
    """
    valid = [ops.valid_area(colour, height, width)]
    colours, weight = [colour], importance.clamp(min=ops.LEAST_IMPORTANCE) * valid[0]
    for _ in levels:
        pooled, weight = ops.pool(colours[-1], weight)
        colours.append(pooled)
        valid.append(F.max_pool2d(valid[-1], 2))
    fine, *coarser = (pad_head(head, of) for head, of in zip((fine, *levels), colours, strict=True))
    result = ops.filter_kernels(colours[-1], coarser[-1], valid[-1])
    heads = [(fine[:, :KERNEL], fine[:, MIX:MIX + 1]),
             *((x[:, :KERNEL], x[:, KERNEL:]) for x in coarser[:-1])]
    for i in reversed(range(len(heads))):
        kernels, mix = heads[i]
        coarse = F.interpolate(result, scale_factor=2.0, mode="nearest")
        result = ops.filter_kernels(torch.lerp(coarse, colours[i], mix), kernels, valid[i])
    return result


def mean_reflectance(factor: Tensor) -> Tensor:
    """Mean over cells of 8x8 pixels; the last ones may hold fewer."""
    return F.avg_pool2d(factor, TRUST_CELL, ceil_mode=True, count_include_pad=False)


def mix_in_mean(factor: Tensor, mean: Tensor, doubt: Tensor) -> Tensor:
    """Reflectance of planes that may be noisy, mixed with a share ``doubt`` of its mean around each
    pixel. Colour is divided and multiplied by the result, so it does not get the planes' noise."""
    return factor - (factor - mean) * doubt


def trust_reflectance(factor: Tensor, share: Tensor) -> Tensor:
    """Reflectance of a frame, trusted by ``share`` (N, 1, h, w) in [-1, 1]; its mean replaces the
    rest."""
    h, w = factor.shape[-2:]
    rows, columns = (torch.arange(size, device=factor.device) for size in (h, w))
    mean = ops.between(ops.between(mean_reflectance(factor), columns, w, -1), rows, h, -2)
    return mix_in_mean(factor, mean, 0.5 - 0.5 * share)


@dataclass(frozen=True)
class Step:
    """The results of a frame: exposed linear ``output`` (N, 3, H, W), the next ``state``, the last
    output reprojected (log-encoded), and the logarithm of the expected squared error of each pixel
    (N, 1, h, w), in code values of the display, or None from a network that does not predict it;
    ``planes`` are albedo and normal without their noise (N, 6, h, w), as codes, or None from a
    network that does not clean them."""

    output: Tensor
    state: State
    reprojected: Tensor
    error: Tensor | None
    planes: Tensor | None = None


class DenoiseUpscale(nn.Module):
    """One recurrent step. Output size is free: any width and height of 1 to 3 times the render
    size.

    ``trunk`` is a network with the interface of ``Trunk``; None makes one by ``config``.
    """

    def __init__(self, config: TrunkConfig | None = None, trunk: nn.Module | None = None):
        super().__init__()
        self.trunk = trunk or Trunk(config)
        self.config = self.trunk.config

    def forward(self, inputs: Inputs, state: State) -> tuple[Tensor, State, Tensor]:
        """Exposed linear output (N, 3, H, W), the next state, and the last output reprojected
        (log-encoded)."""
        done = self.step(inputs, state)
        return done.output, done.state, done.reprojected

    def step(self, inputs: Inputs, state: State) -> Step:
        """A frame, with all that the network says of it."""
        h, w = inputs.colour.shape[-2:]
        align = self.trunk.align
        past = reproject(inputs, state)
        factor = ops.demodulation(inputs.diffuse_albedo, inputs.specular_albedo)
        scale, guides = ops.depth_scale(inputs.depth), inputs.guides
        seen = [features(inputs, past, factor, scale)]
        if self.config.guides:
            assert guides is not None, "the network reads planes at output size"
            seen.append(guide_features(guides, h, w, scale))
        if self.config.mirrored:
            seen.append(mirrored_features(inputs))
        heads = self.trunk(*(mirror_to_multiple(x, align) if h % align or w % align else x
                             for x in seen))
        fine, *levels = (head.float() for head in heads)
        error = levels.pop()[..., :h, :w] if self.config.mirrored else None
        coarsest = 2 ** len(levels)
        pad = (0, -w % coarsest, 0, -h % coarsest)
        here = fine[..., :h, :w]
        planes = factor
        if self.config.trust:
            factor = trust_reflectance(factor, here[:, PLANE_TRUST:])
        noisy, distrust = hold(demodulate(inputs.colour, factor)), here[:, DISTRUST:IMPORTANCE]
        accumulated, count = accumulate(noisy, past.accumulated, past.count, distrust)
        importance = F.pad(here[:, IMPORTANCE:MEMORY], pad)
        filtered = filter_pyramid(F.pad(accumulated, pad), importance, fine, tuple(levels), h, w)
        radiance = filtered[..., :h, :w]
        guided = None
        if self.config.guides and guides is not None:
            guided = reflectance(ops.demodulation(guides.diffuse_albedo, guides.specular_albedo),
                                 planes)
        elif (self.config.trust and state.output.shape[-2:] == (h, w)):
            # at the same size texture is not resampled
            guided = Reflectance(factor,
                                 (inputs.jitter == 0).all(1).to(factor.dtype)[:, None, None, None])
        shaded = (radiance * factor if guided is None
                  else torch.cat((radiance, radiance * factor), 1))
        output = resolve(shaded, here, inputs.jitter, past.output, past.inside, guided)
        state = State(output, accumulated, count, here[:, MEMORY:], inputs.depth,
                      torch.ones_like(state.fresh))
        return Step(torch.expm1(output), state, past.output, error)
