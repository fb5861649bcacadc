"""A network of the denoiser at 1x that gives the denoised picture itself. `l` is one.

The trunks of `model.py` and `residual.py` predict filters, so a pixel stays within the hull of its
neighbours. This one is a U-Net that predicts the colour of each pixel. It has the layers of Open
Image Denoise's network for noisy planes (2.5, Apache-2.0), so that a training may begin with the
weights that were published with it (`open_weights.py`). That network knows neither the history nor
Blender's planes that follow mirrors: this one learns them. The layout `LARGE` is that of the
network for planes without noise. With it, planes must be cleaned, too.

Its first nine inputs are those of Open Image Denoise: colour behind the curve `encode`, albedo and
normal. The others are the features of `model.features`, the planes that follow mirrors and glass,
and the accumulated colour and the last output behind the same curve. A branch of three levels reads
all of them. It corrects the nine inputs, which is how noise leaves the planes, and it joins the
first and the finest level. All that it adds begins as zero. With a gate, it also chooses the share
of the accumulated colour and of the last output in the colour that the network reads: a share is a
product with the picture, which convolutions cannot give. The controls are found last, beside the
difference of the new picture and the history.

Published weights have a learning rate of their own (`train.py --published-rate`). Two trainings at
a rate for random weights ended below their starts (docs/lab/denoiser.md).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from torch import Tensor, nn

from postfx.kernels import denoise as layout
from postfx.kernels.denoise import CONTROLS, FEATURES, MIRRORED
from postfx.kernels.denoise.network_io import LEAST_LOG_ERROR, MOST_LOG_ERROR
from training import ops
from training.denoise import model as network
from training.denoise.model import Inputs, State, Step, TrunkConfig
from training.denoise.residual import USUAL_ERROR, ResidualConfig

# The curve of colour in Open Image Denoise's HDR networks, in which equal steps look alike over the
# range of half precision: linear, then a power, then a logarithm.
LINEAR_SLOPE = 1.41283765e03
POWER_FACTOR = 1.64593172e00
POWER = 4.31384981e-01
POWER_OFFSET = -2.94139609e-03
LOG_FACTOR = 1.92653254e-01
LOG_SHIFT = 6.26026094e-03
LOG_OFFSET = 9.98620152e-01
LINEAR_END = 1.57945760e-06  # light
POWER_END = 3.22087631e-02  # light
LINEAR_END_CODE = 2.23151711e-03
POWER_END_CODE = 3.70974749e-01
MOST_LIGHT = 65504.0  # of half precision; its code is 1
CODE_SCALE = 1 / 3.13511896  # 1 / (LOG_FACTOR * log(MOST_LIGHT + LOG_SHIFT) + LOG_OFFSET)
LEAST_BASE = 1e-12  # of a power, whose gradient at 0 is infinite

GUIDED_INPUTS = 9  # colour, albedo, normal: what Open Image Denoise reads
FURTHER_INPUTS = FEATURES + MIRRORED + 6
ACCUMULATED = FURTHER_INPUTS - 6  # where the codes of the accumulated colour begin among them
HISTORY = FURTHER_INPUTS - 3  # where the codes of the last output begin among them
VALID = 21  # the feature that says where a pixel has a history
JUDGE = 24  # channels of what compares the picture with the history
DETAIL = 24  # channels of what compares the picture with the albedo's texture
ALONE = 24  # channels of what compares the albedo with one that was filtered alone
EVEN_SIDE_PX = 7  # side of the windows in which light is taken as even
GUARDED_SIDE_PX = 15  # side of the windows in which a history is compared with the new picture
USUAL_CHANGE = 0.3  # squared difference of such a history, over the expected squared error
LEAST_CHANGE = 1e-9  # squared, in codes
LEAST_VALID = 1e-3  # share of a window: less than one of its pixels
LEAST_LIGHT = 1e-5  # whose code still has a small gradient
LEAST_ALBEDO = 0.01  # is added, so that ratios of black surfaces stay small
DETAIL_BEGINS = -3.0  # logit of the share of the albedo's texture: 5 %
LEVELS = 4
DEEPEST = 96  # channels at 1/8 of the size in a deep branch
PUBLISHED = ("enc_", "dec_", "alone.")
"""How the names of layers begin that published networks have."""
ADDED_LAYERS = ("correct", "enter", "join", "gate", "detail", "coarser", "choose")
"""Layers that add to a published network: without them it is that network, but for gates, which are
nearly closed then."""
COARSER_BEGINS = (-3.0, -1.0, -1.0)
"""Logits of the share of the next coarser planes at 1, 1/2 and 1/4 of the size: 5 % and 27 %."""
BLEND_BEGINS = 1.5  # logit of the new picture's share beside the history
DISTRUST_BEGINS = -2.0  # logit
ALONE_BEGINS = -3.0  # logit of the share of an albedo that was filtered alone: 5 %
GATE_BEGINS = -3.0  # logit of a share of the history in the colour that is read: 5 %
HEAD_STD = 0.01
# Channels of the controls: as the last ones of a fine head, of which the mix is the blend here.
BLEND = 0
DISTRUST = layout.DISTRUST - layout.MIX
IMPORTANCE = layout.IMPORTANCE - layout.MIX
MEMORY = layout.MEMORY - layout.MIX


def encode(light: Tensor) -> Tensor:
    """Codes in [0, 1] of light in [0, 65504]."""
    power = POWER_FACTOR * light.clamp(min=LEAST_BASE) ** POWER + POWER_OFFSET
    bright = LOG_FACTOR * torch.log(light + LOG_SHIFT) + LOG_OFFSET
    dim = torch.where(light <= LINEAR_END, LINEAR_SLOPE * light, power)
    return torch.where(light <= POWER_END, dim, bright) * CODE_SCALE


def decode(codes: Tensor) -> Tensor:
    """Light of codes in [0, 1]: the inverse of `encode`."""
    found = codes / CODE_SCALE
    base = ((found - POWER_OFFSET) / POWER_FACTOR).clamp(min=LEAST_BASE)
    dim = torch.where(found <= LINEAR_END_CODE, found / LINEAR_SLOPE, base ** (1 / POWER))
    bright = torch.exp((found.clamp(max=1 / CODE_SCALE) - LOG_OFFSET) / LOG_FACTOR) - LOG_SHIFT
    return torch.where(found <= POWER_END_CODE, dim, bright)


@dataclass(frozen=True)
class PictureConfig:
    """Layout of the network.

    Attributes:
        down: channels on the way down at 1, 1/2, 1/4, 1/8 and 1/16 of the size.
        up: channels on the way up at 1, 1/2, 1/4 and 1/8.
        last: channels that the last convolution reads.
        beside: channels of the branch at 1, 1/2 and 1/4 of the size.
        large: two convolutions a level on the way down, too, as in Open Image Denoise's large
            networks.
        gated: the branch mixes the history into the colour that is read.
        detailed: fine detail may come from the albedo instead of the picture.
        deep: the branch has further convolutions, and a level at 1/8 of the size.
        averaged: the branch mixes coarser albedo and normal into those that are read.
        filtered: a published network filters the albedo alone, and the branch chooses where.
        guarded: a history that differs too much from the new picture counts less.
        error_slope: factor of the logarithm of the expected squared error, behind the guard.
        error_bias: is added to it then. `training.measure.predicted_error` fits both.
    """

    picture: bool = True
    down: tuple[int, ...] = (32, 48, 64, 80, 96)
    up: tuple[int, ...] = (64, 64, 96, 112)
    last: int = 32
    beside: tuple[int, ...] = (32, 48, 64)
    large: bool = False
    gated: bool = False
    detailed: bool = False
    deep: bool = False
    averaged: bool = False
    filtered: bool = False
    guarded: bool = False
    error_slope: float = 1.0
    error_bias: float = 0.0
    trust: bool = False
    guides: bool = False
    mirrored: bool = True

    def __post_init__(self) -> None:
        if not len(self.down) == len(self.up) + 1 == LEVELS + 1:
            raise ValueError(f"{LEVELS + 1} channels down and {LEVELS} up: {self}")

    @property
    def sees(self) -> int:
        """Pixels of the render size that the network sees around each, as far as they matter."""
        return 4 + sum(4 << level for level in range(LEVELS + 1))

    @property
    def align(self) -> int:
        """Height and width of the network's input are multiples of this."""
        return 2 ** LEVELS

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, config: dict[str, Any]) -> PictureConfig:
        known = {field.name: config[field.name] for field in fields(cls) if field.name in config}
        given: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value
                                 for name, value in known.items()}
        return cls(**given)

    def published_layers(self, inputs: int = GUIDED_INPUTS) -> dict[str, Layer]:
        """The convolutions that a published network with so many inputs has, by their names
        there."""
        one, two, three, four, five = self.down
        up_one, up_two, up_three, up_four = self.up
        if self.large:
            way_down = {
                "enc_conv1a": Layer(inputs, one, 0),
                "enc_conv1b": Layer(one, one, 0),
                "enc_conv2a": Layer(one, two, 1),
                "enc_conv2b": Layer(two, two, 1),
                "enc_conv3a": Layer(two, three, 2),
                "enc_conv3b": Layer(three, three, 2),
                "enc_conv4a": Layer(three, four, 3),
                "enc_conv4b": Layer(four, four, 3),
            }
        else:
            way_down = {
                "enc_conv0": Layer(inputs, one, 0),
                "enc_conv1": Layer(one, one, 0),
                "enc_conv2": Layer(one, two, 1),
                "enc_conv3": Layer(two, three, 2),
                "enc_conv4": Layer(three, four, 3),
            }
        return way_down | {
            "enc_conv5a": Layer(four, five, 4),
            "enc_conv5b": Layer(five, five, 4),
            "dec_conv4a": Layer(five + three, up_four, 3),
            "dec_conv4b": Layer(up_four, up_four, 3),
            "dec_conv3a": Layer(up_four + two, up_three, 2),
            "dec_conv3b": Layer(up_three, up_three, 2),
            "dec_conv2a": Layer(up_three + one, up_two, 1),
            "dec_conv2b": Layer(up_two, up_two, 1),
            "dec_conv1a": Layer(up_two + inputs, up_one, 0),
            "dec_conv1b": Layer(up_one, self.last, 0),
            self.picture_layer: Layer(self.last, 3, 0),
        }

    @property
    def picture_layer(self) -> str:
        """Name of the convolution that gives the picture."""
        return "dec_conv1c" if self.large else "dec_conv0"

    def products(self) -> float:
        """Multiplications of the network a render pixel."""
        levels = BRANCH_LEVELS | {name: layer.level
                                  for name, layer in self.published_layers().items()}
        levels |= {f"alone.{name}": layer.level
                   for name, layer in PictureConfig().published_layers().items()}
        return sum(module.weight.numel() / 4 ** levels.get(name, 0)
                   for name, module in PictureNetwork(self).named_modules()
                   if isinstance(module, nn.Conv2d))


class Layer(NamedTuple):
    """A convolution of a published network: channels that it reads and writes, and levels below the
    render size."""

    inputs: int
    outputs: int
    level: int


LARGE = PictureConfig(down=(64, 96, 128, 192, 256), up=(64, 96, 128, 192), last=64, large=True,
                      gated=True, detailed=True, deep=True, averaged=True, filtered=True,
                      guarded=True)
"""The layout of Open Image Denoise's large networks, with a gate for the history, one for detail,
a deep branch, planes from a pyramid, a filter for the albedo alone, and a guard at the history."""
BRANCH_LEVELS = {"branch.half_down": 1, "branch.half_up": 1, "branch.half_more": 1,
                 "branch.quarter_in": 2, "branch.quarter_out": 2, "branch.eighth_in": 3,
                 "branch.eighth_out": 3, "branch.quarter_more": 3,
                 "coarser.1": 1, "coarser.2": 2}
"""Levels below the render size of convolutions that add to a published network."""


def conv(inputs: int, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1)


class PublishedNetwork(nn.Module):
    """The common part of networks with published weights: their layers, by their names there, and
    the way through them."""

    def __init__(self, layers: dict[str, Layer]) -> None:
        super().__init__()
        for name, layer in layers.items():
            setattr(self, name, conv(layer.inputs, layer.outputs))

    def way_down(self, stream: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The streams at 1/2, 1/4, 1/8 and 1/16 of the size, each before its level's convolutions;
        the last one after them. ``stream`` is that of the first convolution."""
        x = F.relu(stream)
        first = F.max_pool2d(F.relu(self.enc_conv1(x)), 2)
        second = F.max_pool2d(F.relu(self.enc_conv2(first)), 2)
        third = F.max_pool2d(F.relu(self.enc_conv3(second)), 2)
        x = F.max_pool2d(F.relu(self.enc_conv4(third)), 2)
        return first, second, third, F.relu(self.enc_conv5b(F.relu(self.enc_conv5a(x))))

    def way_up(self, first: Tensor, second: Tensor, third: Tensor, coarsest: Tensor,
               inputs: Tensor) -> Tensor:
        """The finest level's stream before its last convolutions."""
        x = F.relu(self.dec_conv4b(F.relu(self.dec_conv4a(beside(coarsest, third)))))
        x = F.relu(self.dec_conv3b(F.relu(self.dec_conv3a(beside(x, second)))))
        x = F.relu(self.dec_conv2b(F.relu(self.dec_conv2a(beside(x, first)))))
        return self.convolve(self.dec_conv1a, enlarge(x), inputs)

    @staticmethod
    def convolve(layer: nn.Conv2d, *inputs: Tensor) -> Tensor:
        """A convolution over several tensors beside each other."""
        return layer(torch.cat(inputs, 1))


class PictureNetwork(PublishedNetwork):
    """Features (N, 35, h, w) and planes of mirrors (N, 6, h, w), h and w multiples of 16 -> four
    tensors of that size.

    - the picture (N, 3, h, w): log(1 + exposed colour),
    - the controls (N, 11, h, w): share of this picture beside the history, distrust of what was
      accumulated, 1, and the hidden state (8),
    - the logarithm of the expected squared error of each pixel, (N, 1, h, w),
    - albedo and normal without their noise, as `guide_codes` (N, 6, h, w): for training alone.
    """

    def __init__(self, config: PictureConfig | None = None):
        config = config or PictureConfig()
        super().__init__(config.published_layers())
        self.config = config
        self.align = config.align
        up_one, last, known = self.config.up[0], self.config.last, self.config.beside[0]
        branch = DeepBranch if self.config.deep else Branch
        self.branch = branch(GUIDED_INPUTS + FURTHER_INPUTS, self.config.beside)
        self.correct = conv(known, GUIDED_INPUTS)
        self.enter = nn.Conv2d(known, self.config.down[0], 3, padding=1, bias=False)
        self.join = nn.Conv2d(known, up_one, 1)
        if self.config.gated:
            self.gate = conv(known, 2)
        if self.config.detailed:
            self.compare_detail = conv(known + 12, DETAIL)
            self.detail = conv(DETAIL, 1)
        if self.config.averaged:
            self.coarser = nn.ModuleList(conv(channels, 2) for channels in self.config.beside)
        if self.config.filtered:
            self.alone = AlbedoFilter()
            self.compare_alone = conv(known + 9, ALONE)
            self.choose = conv(ALONE, 1)
        self.judge = nn.Sequential(conv(last + known + 6, JUDGE), nn.ReLU())
        self.controls = nn.Conv2d(JUDGE, CONTROLS, 1)
        self.error = nn.Conv2d(JUDGE, 1, 1)
        for name in ADDED_LAYERS:
            if hasattr(self, name):
                for weight in getattr(self, name).parameters():
                    nn.init.zeros_(weight)
        for head in (self.controls, self.error):
            nn.init.normal_(head.weight, std=HEAD_STD)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.controls.bias[BLEND], BLEND_BEGINS)
        nn.init.constant_(self.controls.bias[DISTRUST], DISTRUST_BEGINS)
        nn.init.constant_(self.error.bias, USUAL_ERROR)

    def forward(self, features: Tensor, mirrored: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        guided, further = network_inputs(features, mirrored)
        known, half, quarter = self.branch(torch.cat((guided, further), 1))
        colour, planes = guided[:, :3], guided[:, 3:]
        if self.config.gated:
            colour = colour + self.mixed_in(guided, further, known)
        if self.config.averaged:
            planes = self.averaged_planes(planes, (known, half, quarter))
        corrected = torch.cat((colour, planes), 1) + self.correct(known)
        if self.config.filtered:
            corrected = self.with_filtered_albedo(corrected, guided[:, 3:6], known)
        if self.config.large:
            streams = self.large_way_down(self.enc_conv1a(corrected) + self.enter(known))
        else:
            streams = self.way_down(self.enc_conv0(corrected) + self.enter(known))
        stream = self.way_up(*streams, corrected) + self.join(known)
        stream = F.relu(self.dec_conv1b(F.relu(stream)))
        # a step of bfloat16 in a code is 2 % of the light
        with torch.autocast(stream.device.type, enabled=False):
            codes = getattr(self, self.config.picture_layer)(stream.float()).clamp(0.0, 1.0)
        if self.config.detailed:
            codes = self.with_detail(codes, guided[:, :3], corrected[:, 3:6], known)
        history = further[:, HISTORY:]
        compared = torch.cat((codes, codes - history), 1)
        judged = F.relu(self.convolve(self.judge[0], stream, known, compared))
        with torch.autocast(stream.device.type, enabled=False):
            judged = judged.float()
            controls, error = self.controls(judged), self.error(judged)
            if self.config.guarded:
                change = codes - history.float()
                valid = further[:, VALID:VALID + 1].float()
                controls = with_guarded_history(controls, change, valid, error)
                error = error * self.config.error_slope + self.config.error_bias
            found = activate(codes, controls, error)
        return *found, corrected[:, 3:]

    def mixed_in(self, guided: Tensor, further: Tensor, known: Tensor) -> Tensor:
        """What shares of the accumulated colour and of the last output change in the codes of
        colour, (N, 3, h, w)."""
        shares = torch.sigmoid(self.gate(known) + GATE_BEGINS) * further[:, VALID:VALID + 1]
        colour = guided[:, :3]
        accumulated = further[:, ACCUMULATED:HISTORY] - colour
        history = further[:, HISTORY:] - colour
        return shares[:, :1] * accumulated + shares[:, 1:] * history

    def averaged_planes(self, planes: Tensor, streams: tuple[Tensor, ...]) -> Tensor:
        """Albedo and normal (N, 6, h, w), in part replaced by means over larger cells.

        Noise that a convolution takes out pixel by pixel has to pass through all its channels. A
        share of a mean takes it out at once, out of focus and in motion blur, and leaves texture
        where the share is 0. The ``streams`` of the branch at 1, 1/2 and 1/4 of the size give the
        shares of the next coarser level, for albedo and normal.
        """
        with torch.autocast(planes.device.type, enabled=False):
            planes = planes.float()
            coarse = F.avg_pool2d(planes, 2)
            if len(streams) > 1:
                coarse = self.averaged_planes(coarse, streams[1:])
            smooth = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
            level = len(self.coarser) - len(streams)
            logits = self.coarser[level](streams[0].float()) + COARSER_BEGINS[level]
            shares = torch.sigmoid(logits).repeat_interleave(3, 1)
            return torch.lerp(planes, smooth, shares)

    def with_filtered_albedo(self, inputs: Tensor, noisy: Tensor, known: Tensor) -> Tensor:
        """The nine inputs of the published network, their albedo in part replaced by that of
        `AlbedoFilter`.

        It takes more noise out than the branch does, but takes fine print for noise, too.
        """
        alone = self.alone(noisy)
        albedo = inputs[:, 3:6]
        compared = torch.cat((albedo, alone - albedo, noisy - albedo), 1)
        seen = F.relu(self.convolve(self.compare_alone, known, compared))
        with torch.autocast(inputs.device.type, enabled=False):
            share = torch.sigmoid(self.choose(seen.float()) + ALONE_BEGINS)
            chosen = torch.lerp(albedo.float(), alone, share)
        return torch.cat((inputs[:, :3], chosen, inputs[:, 6:]), 1)

    def with_detail(self, codes: Tensor, noisy: Tensor, albedo: Tensor, known: Tensor) -> Tensor:
        """The codes of the picture (N, 3, h, w), in part replaced by `albedo_in_even_light`.

        A texture of single pixels looks like noise, and a network takes it out of the picture. The
        cleaned ``albedo`` (N, 3, h, w) still has it. How far the two agree with the ``noisy`` codes
        (N, 3, h, w) helps to tell where light changes from pixel to pixel, so that the albedo says
        little.
        """
        with torch.autocast(codes.device.type, enabled=False):
            noisy, albedo = noisy.float(), albedo.float()
            even = albedo_in_even_light(decode(codes), albedo)
            textured = encode(even.clamp(LEAST_LIGHT, MOST_LIGHT))
        compared = torch.cat((codes, noisy - codes, textured - codes, noisy - textured), 1)
        seen = F.relu(self.convolve(self.compare_detail, known, compared))
        with torch.autocast(codes.device.type, enabled=False):
            share = torch.sigmoid(self.detail(seen.float()) + DETAIL_BEGINS)
            return torch.lerp(codes, textured, share)

    def large_way_down(self, stream: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """`way_down` with two convolutions a level."""
        x = F.relu(stream)
        first = F.max_pool2d(F.relu(self.enc_conv1b(x)), 2)
        second = F.max_pool2d(F.relu(self.enc_conv2b(F.relu(self.enc_conv2a(first)))), 2)
        third = F.max_pool2d(F.relu(self.enc_conv3b(F.relu(self.enc_conv3a(second)))), 2)
        x = F.max_pool2d(F.relu(self.enc_conv4b(F.relu(self.enc_conv4a(third)))), 2)
        return first, second, third, F.relu(self.enc_conv5b(F.relu(self.enc_conv5a(x))))

    def published(self) -> list[nn.Parameter]:
        """Weights that a published network has, too."""
        return [weight
                for name, weight in self.named_parameters() if name.startswith(PUBLISHED)]


class AlbedoFilter(PublishedNetwork):
    """Albedo with noise (N, 3, h, w) in [0, 1] -> without noise.

    It has the layers of Open Image Denoise's network for an albedo alone (`rt_alb`), and reads and
    gives albedo behind the sRGB curve, as that one does.
    """

    def __init__(self) -> None:
        super().__init__(PictureConfig().published_layers(inputs=3))

    def forward(self, albedo: Tensor) -> Tensor:
        with torch.autocast(albedo.device.type, enabled=False):
            shown = linear_rgb_to_rgb(albedo.float().clamp(0.0, 1.0))
        streams = self.way_down(self.enc_conv0(shown))
        stream = F.relu(self.dec_conv1b(F.relu(self.way_up(*streams, shown))))
        with torch.autocast(albedo.device.type, enabled=False):
            return rgb_to_linear_rgb(self.dec_conv0(stream.float()).clamp(0.0, 1.0))


class Branch(nn.Module):
    """All inputs (N, C, h, w) -> what the branch knows of each pixel, (N, K, h, w), and its streams
    at 1/2 and 1/4 of the size.

    It sees about 20 pixels around each.
    """

    def __init__(self, inputs: int, channels: tuple[int, ...]):
        super().__init__()
        one, two, three = channels
        self.full = conv(inputs, one)
        self.half_down = conv(one, two)
        self.quarter_in = conv(two, three)
        self.quarter_out = conv(three, three)
        self.half_up = conv(three + two, two)
        self.known = conv(two + one, one)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        full = self.further_full(F.relu(self.full(inputs)))
        half = self.further_half(F.relu(self.half_down(F.max_pool2d(full, 2))))
        quarter = F.relu(self.quarter_in(F.max_pool2d(half, 2)))
        quarter = self.further_quarter(F.relu(self.quarter_out(quarter)))
        half = F.relu(self.half_up(beside(quarter, half)))
        return F.relu(self.known(beside(half, full))), half, quarter

    def further_full(self, full: Tensor) -> Tensor:
        """The stream of the whole size, before the coarser levels."""
        return full

    def further_half(self, half: Tensor) -> Tensor:
        """The stream of half the size, before the coarser level."""
        return half

    def further_quarter(self, quarter: Tensor) -> Tensor:
        """The coarsest stream."""
        return quarter


class DeepBranch(Branch):
    """A branch with one more convolution at 1 and 1/2 of the size, and a level at 1/8: it sees
    about 45 pixels around each.

    Its convolutions add to the streams of the other branch, and begin as zero.
    """

    def __init__(self, inputs: int, channels: tuple[int, ...]):
        super().__init__(inputs, channels)
        one, two, three = channels
        self.full_more = conv(one, one)
        self.half_more = conv(two, two)
        self.eighth_in = conv(three, DEEPEST)
        self.eighth_out = conv(DEEPEST, DEEPEST)
        self.quarter_more = nn.Conv2d(DEEPEST, three, 1)
        for layer in (self.full_more, self.half_more, self.quarter_more):
            for weight in layer.parameters():
                nn.init.zeros_(weight)

    def further_full(self, full: Tensor) -> Tensor:
        return F.relu(full + self.full_more(full))

    def further_half(self, half: Tensor) -> Tensor:
        return F.relu(half + self.half_more(half))

    def further_quarter(self, quarter: Tensor) -> Tensor:
        eighth = F.relu(self.eighth_in(F.max_pool2d(quarter, 2)))
        eighth = F.relu(self.eighth_out(eighth))
        return F.relu(quarter + enlarge(self.quarter_more(eighth)))


def albedo_in_even_light(light: Tensor, albedo: Tensor) -> Tensor:
    """The picture (N, 3, h, w) of the albedo in light that hardly changes from pixel to pixel: its
    mean around each pixel, over the mean of the albedo there, times the albedo."""
    factor = albedo.clamp(min=0.0) + LEAST_ALBEDO
    return factor * local_mean(light) / local_mean(factor)


def with_guarded_history(controls: Tensor, change: Tensor, valid: Tensor, error: Tensor) -> Tensor:
    """The controls (N, 11, h, w) before they are activated, with a larger share of the new picture
    where it has moved away from the history.

    Under moving water, light and shadow do not go where the motion leads. Single pixels of such a
    history look as right as noise lets them, but all of them together differ from the new picture
    by more than its expected error. ``change`` (N, 3, h, w) are the differences of codes,
    ``valid`` (N, 1, h, w) is 1 where a pixel has a history, and ``error`` (N, 1, h, w) are the
    logarithms of the expected squared errors. Pixels without a history say nothing about that of
    their neighbours.
    """
    changed = local_mean(valid * change.square().mean(1, keepdim=True), GUARDED_SIDE_PX)
    squared = changed / local_mean(valid, GUARDED_SIDE_PX).clamp(min=LEAST_VALID)
    excess = F.relu(torch.log((squared + LEAST_CHANGE) / USUAL_CHANGE) - error)
    return torch.cat((controls[:, :DISTRUST] + excess, controls[:, DISTRUST:]), 1)


def local_mean(plane: Tensor, side: int = EVEN_SIDE_PX) -> Tensor:
    """The mean of a plane (N, C, h, w) around each pixel: along rows, then along columns, which
    takes a third of the time of squares."""
    reach = side // 2
    rows = F.avg_pool2d(plane, (1, side), 1, (0, reach), count_include_pad=False)
    return F.avg_pool2d(rows, (side, 1), 1, (reach, 0), count_include_pad=False)


def beside(coarser: Tensor, skip: Tensor) -> Tensor:
    """The coarser level, enlarged, and what the finer one kept."""
    return torch.cat((enlarge(coarser), skip), 1)


def enlarge(coarser: Tensor) -> Tensor:
    """A level at the size of the next finer one."""
    return F.interpolate(coarser, scale_factor=2.0, mode="nearest")


def activate(codes: Tensor, controls: Tensor, error: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The network's outputs from its last convolutions."""
    light = decode(codes)
    shares = torch.sigmoid(controls[:, :IMPORTANCE])
    one = torch.ones_like(controls[:, IMPORTANCE:MEMORY])
    known = torch.cat((shares, one, torch.tanh(controls[:, MEMORY:])), 1)
    return torch.log1p(light), known, error.clamp(LEAST_LOG_ERROR, MOST_LOG_ERROR)


def network_inputs(features: Tensor, mirrored: Tensor) -> tuple[Tensor, Tensor]:
    """The inputs of Open Image Denoise (N, 9, h, w), and the further ones (N, 47, h, w), from the
    features."""
    diffuse, specular, normal = features[:, 9:12], features[:, 12:15], features[:, 15:18]
    factor = ops.demodulation(diffuse, specular)
    colour, accumulated, history = (
        encode((torch.expm1(features[:, first:first + 3]) * factor).clamp(0.0, MOST_LIGHT))
        for first in (0, 3, 6))
    guided = torch.cat((colour, guide_codes(diffuse + specular, mirrored[:, :3], normal)), 1)
    return guided, torch.cat((features, mirrored, accumulated, history), 1)


def guide_codes(total: Tensor, followed: Tensor, normal: Tensor) -> Tensor:
    """Albedo and normal as Open Image Denoise's networks read them, (N, 6, h, w) in [0, 1].

    The albedo is the ``followed`` one (N, 3, h, w), seen through mirrors and glass, or else the
    ``total`` (N, 3, h, w).
    """
    albedo = torch.where(followed.amax(1, keepdim=True) > 0, followed, total.clamp(0.0, 1.0))
    return torch.cat((albedo, 0.5 * normal + 0.5), 1)


class PictureDenoiser(nn.Module):
    """One recurrent step at the render's own size, with the interface of `model.DenoiseUpscale`."""

    def __init__(self, trunk: PictureNetwork | None = None):
        super().__init__()
        self.trunk = trunk or PictureNetwork()
        self.config = self.trunk.config

    def step(self, inputs: Inputs, state: State) -> Step:
        """A frame, with all that the network says of it. Raises ValueError if the output has
        another size."""
        h, w = inputs.colour.shape[-2:]
        if state.output.shape[-2:] != (h, w):
            raise ValueError(f"a picture network keeps the size {h}x{w}, not "
                             f"{tuple(state.output.shape[-2:])}")
        past = network.reproject(inputs, state)
        factor = ops.demodulation(inputs.diffuse_albedo, inputs.specular_albedo)
        scale = ops.depth_scale(inputs.depth)
        seen = [network.features(inputs, past, factor, scale), network.mirrored_features(inputs)]
        padded = (network.mirror_to_multiple(x, self.trunk.align) for x in seen)
        picture, controls, error, planes = (x[..., :h, :w] for x in self.trunk(*padded))
        noisy = network.hold(network.demodulate(inputs.colour, factor))
        distrust = controls[:, DISTRUST:IMPORTANCE]
        accumulated, count = network.accumulate(noisy, past.accumulated, past.count, distrust)
        share = past.inside * (1 - controls[:, BLEND:DISTRUST])
        output = network.blend_with_history(picture, past.output, share)
        state = State(output, accumulated, count, controls[:, MEMORY:], inputs.depth,
                      torch.ones_like(state.fresh))
        return Step(torch.expm1(output), state, past.output, error, planes)


def layout_from(config: dict[str, Any]) -> TrunkConfig | ResidualConfig | PictureConfig:
    """The layout that a checkpoint's config tells."""
    kind = (PictureConfig if config.get("picture") else ResidualConfig if "down" in config
            else TrunkConfig)
    return kind.from_dict(config)
