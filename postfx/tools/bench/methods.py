"""The methods that a benchmark can measure, by name, and the classes that carry them out."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from postfx.errors import BenchError, offer
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence
from postfx.passes.composite import BothWays
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.models import PASS, UNSCALED, exact
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.temporal.reverse_order import Backwards, RunUp
from postfx.tools.bench.baselines import Accumulator, HostKernels, Oidn

GUIDES_METHOD = "guides"
PRECISIONS = {"fp32": ("cpu", "cuda"), "int8": ("cpu",), "fp16": ("cuda",)}
"""Precision -> devices that it is made for."""
FAMILIES = {"ours": "this project's networks", "oidn": "Open Image Denoise", "plain": "no denoiser"}


@dataclass(frozen=True)
class Method:
    """One way to make the output.

    Attributes:
        name: for `--methods`.
        title: for tables and plots.
        family: one of FAMILIES.
        model: tag of the network with its precision, as in the pass's option `model`; '' if none.
        precision: of the network's weights and arithmetic.
        guides: whether it reads planes at output size.
        alone: whether it drops the history at every frame.
        both: whether it uses later frames as well.
        run_up: whether the first frame of a shot gets a run-up.
        quality: quality of OIDN; '' if not used.
        planes: how OIDN takes albedo and normal (see `Oidn`); 'best': like the best that was
            measured.
        accumulated: whether it accumulates frames at output size along the motion.
        without: names of planes that the network does not get; only in ablations.
    """

    name: str
    title: str
    family: str
    model: str = ""
    precision: str = "fp32"
    guides: bool = False
    alone: bool = False
    both: bool = False
    run_up: bool = False
    quality: str = ""
    planes: str = "clean"
    accumulated: bool = False
    without: tuple[str, ...] = ()


class Omission(NamedTuple):
    """A method that is not measured, and the reason."""

    what: str
    why: str


class Catalogue(NamedTuple):
    """Methods that can be measured, and methods that are left out."""

    methods: tuple[Method, ...]
    omissions: tuple[Omission, ...]


OTHERS = (
    Method("oidn-fast", "OIDN fast", "oidn", quality="fast"),
    Method("oidn-balanced", "OIDN balanced", "oidn", quality="balanced"),
    Method("oidn-high", "OIDN high", "oidn", quality="high"),
    Method("oidn-high-prefiltered", "OIDN high, planes prefiltered", "oidn", quality="high",
           planes="prefiltered"),
    Method("oidn-high-raw", "OIDN high, planes as noisy", "oidn", quality="high", planes="raw"),
    Method("oidn-high-colour", "OIDN high, colour alone", "oidn", quality="high", planes="none"),
    Method("oidn-high-accumulated", "OIDN high + accumulation", "oidn", quality="high",
           planes="best", accumulated=True),
    Method("accumulation", "accumulation", "plain", accumulated=True),
    Method("bicubic", "bicubic", "plain"),
)


def catalogue(models: Iterable[str], device: str, guides: bool, motion: bool,
              lost: Collection[str] = ()) -> Catalogue:
    """All methods for models of a library, a device 'cpu' or 'cuda', and frames with or without
    guides and motion.

    `lost`: planes that ablations leave out, each alone and all together.
    """
    names = [name.removeprefix(f"{PASS}.") for name in models
             if name.startswith(f"{PASS}.") and not name.endswith(UNSCALED)]  # the others take them
    methods: list[Method] = []
    omissions: list[Omission] = _absent(names, guides)
    for name in sorted(names, key=_place):
        made = _of_model(name, motion)
        reason = _unfit(made[0], device, guides)
        methods += [] if reason else made + _ablations(made[0], lost)
        omissions += [Omission(made[0].title, reason)] if reason else []
    for method in OTHERS:
        if method.accumulated and not motion:
            omissions.append(Omission(method.title, "the frames have no motion vectors"))
        else:
            methods.append(method)
    return Catalogue(tuple(methods), tuple(omissions))


def select(found: Catalogue, names: str | None, models: str | None) -> Catalogue:
    """The methods named by `names` (names or families) and, of ours, of the model tags `models`;
    comma-separated lists.

    Raises BenchError if a name matches nothing.
    """
    tags = {method.model.split(".")[0] for method in found.methods if method.model}
    chosen_tags = _words(models, tags, "--models") if models else tags
    known = {method.name for method in found.methods} | set(FAMILIES)
    chosen = _words(names, known, "--methods") if names else known
    named = [method for method in found.methods
             if method.name in chosen or method.family in chosen]
    methods = tuple(method for method in named
                    if not method.model or method.model.split(".")[0] in chosen_tags)
    if not methods:
        raise BenchError(f"--methods {names} --models {models} leaves nothing to measure: leave "
                         "one of them out")
    kept = tuple(item for item in found.omissions
                 if item.what.split(" ")[0] in chosen_tags or not models)
    return Catalogue(methods, kept)


def _of_model(name: str, motion: bool) -> list[Method]:
    """A network with its history and, where frames have motion, without, with a run-up, and in both
    directions."""
    parts = name.split(".")
    guides, kept = GUIDES_METHOD in parts, [part for part in parts if part != GUIDES_METHOD]
    precision = next((part for part in kept if part in PRECISIONS), "fp32")
    words = [*kept, *([GUIDES_METHOD] if guides else [])]
    plain = Method("-".join(words), " ".join([kept[0], precision, *words[len(kept) :]]), "ours",
                   ".".join(kept), precision, guides)
    alone = replace(plain, name=f"{plain.name}-alone", title=f"{plain.title}, no history",
                    alone=True)
    run_up = replace(plain, name=f"{plain.name}-run-up", title=f"{plain.title}, run-up",
                     run_up=True)
    both = replace(plain, name=f"{plain.name}-both-ways", title=f"{plain.title}, both ways",
                   both=True)
    return [plain, alone, run_up, both] if motion else [plain]


def _ablations(method: Method, lost: Collection[str]) -> list[Method]:
    """A network without each of some planes, and without all: only in full precision, which does
    not matter here, and without guides, which would replace the planes."""
    if method.guides or method.precision != "fp32":
        return []
    chosen = {name: (name,) for name in lost} | ({"all": tuple(lost)} if len(lost) > 1 else {})
    titles = {name: f"no {name.replace('_', ' ')}" for name in lost} | {"all": "colour only"}
    return [replace(method, name=f"{method.name}-without-{name}",
                    title=f"{method.title}, {titles[name]}", without=planes)
            for name, planes in chosen.items()]


def _unfit(method: Method, device: str, guides: bool) -> str | None:
    if method.guides and not guides:
        return "the frames have no AOVs at output size"
    if device not in PRECISIONS[method.precision]:
        return (f"{method.precision} is for {' and '.join(PRECISIONS[method.precision])}, not for "
                f"{device}")
    return None


def _absent(names: list[str], guides: bool) -> list[Omission]:
    """Precisions that networks lack and, for frames with guides, networks that do not read
    guides."""
    tags = dict.fromkeys(name.split(".")[0] for name in names)
    wanted = [(tag, precision) for tag in tags for precision in PRECISIONS if precision != "fp32"]
    wanted += [(tag, GUIDES_METHOD) for tag in tags if guides]
    return [Omission(f"{tag} {word}", f"there is no model {PASS}.{tag}.{word}")
            for tag, word in wanted if f"{tag}.{word}" not in names]


def _place(name: str) -> tuple[int, str]:
    """Order of networks: small to large, then others by name."""
    sizes = ("s", "m", "l", "xl")
    tag = name.split(".")[0]
    return (sizes.index(tag) if tag in sizes else len(sizes), name)


def _words(text: str, known: set[str], option: str) -> set[str]:
    words = {word.strip() for word in text.split(",") if word.strip()}
    unknown = sorted(words - known)
    if unknown:
        raise BenchError(f"{option} {text}: there is no '{unknown[0]}' here"
                         f"{offer(unknown[0], sorted(known))}")
    return words


class Network:
    """The project's denoised upscaler."""

    def __init__(self, method: Method, device: Device, scale: float,
                 sequence: Sequence | None) -> None:
        self._method = method
        self._lost = frozenset(map(Role, method.without))
        model = exact(method.model)
        run_up, self._backwards = None, None
        if method.run_up or method.both:
            assert sequence is not None, "frames are run ahead"
            run_up = RunUp(sequence, prepare=self._select_planes) if method.run_up else None
            if method.both:
                self._backwards = Backwards(sequence, device, prepare=self._select_planes,
                                            model=model, scale=scale)
        self._pipeline = Pipeline([DenoiseUpscale(model=model, scale=scale), BothWays()], device,
                                  run_up=run_up, checks=False)
        self.device_ms = 0.0

    def reset(self) -> None:
        """Drop the history."""
        self._pipeline.reset()
        if self._backwards:
            self._backwards.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Colour (H, W, 3) of a frame."""
        frame = self._select_planes(frame)
        frame = self._backwards(frame) if self._backwards else frame
        result = self._pipeline(replace(frame, reset=frame.reset or self._method.alone))
        self.device_ms += sum(self._pipeline.timings.values()) + sum(self._pipeline.ahead)
        self.device_ms += (self._backwards.milliseconds or 0.0) if self._backwards else 0.0
        return result[Role.COLOUR]

    def _select_planes(self, frame: Frame) -> Frame:
        """The frame with only the planes that the method may use."""
        planes = {role: plane for role, plane in frame.planes.items() if role not in self._lost}
        return replace(frame, guides=frame.guides if self._method.guides else {}, planes=planes)


class Chain:
    """A denoiser of single frames or none, cubic enlargement, then accumulation or none.

    Accumulation runs on the CPU and is not part of `device_ms`.
    """

    def __init__(self, method: Method, device: Device, size: tuple[int, int]) -> None:
        self._height, self._width = size
        self._kernels = HostKernels(device)
        self._oidn = None
        if method.quality:
            self._oidn = Oidn(method.quality, device.name.split(":")[0], device.threads,
                              method.planes)
        host = HostKernels(device if device.name == "cpu" else Device("cpu", device.threads))
        self._accumulator = Accumulator(host) if method.accumulated else None

    @property
    def device_ms(self) -> float:
        """Milliseconds in OIDN's filter and in the enlargement so far, without copies."""
        return self._kernels.milliseconds + (self._oidn.milliseconds if self._oidn else 0.0)

    def reset(self) -> None:
        """Drop the history."""
        if self._accumulator:
            self._accumulator.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Colour (H, W, 3) of a frame."""
        colour = self._oidn(frame) if self._oidn else frame[Role.COLOUR]
        large = self._kernels.enlarge(colour, self._height, self._width, frame.jitter)
        return self._accumulator(large, frame) if self._accumulator else large


def make(method: Method, device: Device, scale: float, size: tuple[int, int],
         sequence: Sequence | None = None) -> Network | Chain:
    """The object that carries out a method, for outputs of `size` (height, width). A run-up and
    both ways also need the `sequence`, as they run frames ahead."""
    return Network(method, device, scale, sequence) if method.model else Chain(method, device, size)
