"""All steps of the denoiser on a frame, as tables that are read from top to bottom: which kernel
runs, when, and on which buffers.

    WIDENED        converts colours to wider primaries, if the frame's own do not hold its light,
                   and back at the end (primaries.py)
    RESAMPLED      brings planes and guides to the sizes at which they are read (planes.py)
    MASKED         makes the mask of where the history is not used, from the difference of two
                   colours (planes.py)
    REFLECTED      replaces the motion of smooth surfaces by that of their reflections
                   (reflections.py)
    GATHERED       adds the frame's own alpha to the mean of its samples (alpha.py)
    RESIZED        brings what the frame before left to this frame's size (history.py)
    FRAME_NEEDS    makes what windows need of the whole frame (assembly.py)
    WINDOW_STEPS   takes the picture of a window through a network (window.py, network.py);
                   CLASSIC_STEPS does so without one
    LAYER_STEPS    filters the layers beside the picture in the same window; ALPHA filters alpha
    ASSEMBLED      puts windows together (assembly.py)
    RESTORED       gives the picture, and its parts, detail back (output.py)
    BLENDED        blends the picture, and its parts, with the input by strength (output.py)
    BALANCED       makes light add up to the picture (part_sums.py)
    CORRECTED      brings alpha nearer to its mean and to the picture's colours (alpha.py)
    DECODED        turns what was filtered as if it were light into its own values (part_values.py)
    PASSED_ON      brings planes beside colour to the output's size (planes.py)

`ReadyNetwork.encode` in frame.py records them in this order; the files named here hold their
buffers.

Parts with negative light are split into two layers by its sign, and joined again at the end
(`postfx/passes/signed_light.py`).

A step runs if all of its words hold, and none of those behind `unless`:

    moves      the last output is warped to this frame
    masked     each pixel keeps its own share of the history, not all the same
    guided     the frame has guides, planes of the output's size
    mirrored   the network reads planes that follow mirrors and glass
    doubts     the network says how far planes are trusted
    stored     the network reads features in 8 bits, which their kernel makes
    coded      the fine head is made of 8-bit codes by the kernels that read it
    error      the expected error is asked for
    reactive   the frame has a mask of where the history is not used
    gpu        a GPU fuses some filters
    shaded     it fuses the last filter and the reflectance, too
    plain, guides, unscaled, given
               what ends the window: colour is enlarged with its reflectance, or gets that of
               guides, or stays at the render size, or the network gives the picture itself
    filtered   layers have light of their own to filter, unlike the whole picture beside parts
    state      what is resized has a state, unlike a layer's history
    part       not the picture, but a part of it, after the picture
    single     the plane has one channel, and was filtered as three

A step that runs over several things runs on each of them by itself, where its own words hold, too:

    planes     that are resampled
    layers     that are filtered at once
      divided  by their own reflectance
    inputs     of the network, which kernels make in the form of its file
      halves   channels last, in half precision
      codes    channels last, in 8 bits
      ringed   with a border
    outputs    of the network, which kernels open
      fine     the fine head, not that of a level
      raw      channels last, in half precision
      phased   before activations, with its phases in a row
      logits   before activations
      sums     of integer products
      behind   behind the head in one memory, so that some take the place of those before
      codes    8-bit factors, whose products are summed here
    rows       of the output
      mixed    of the input and the result, unlike rows of the input alone
      in_place whose result lies where the mixture goes
      varied   by a strength of each pixel
    error, motion, alpha, overlay, partner, strength
               the plane of this name, where it is brought to the output's size
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from postfx.kernels import Kernel
from postfx.kernels.colour import CONVERT_PRIMARIES
from postfx.kernels.denoise import IN_HALF, alpha
from postfx.kernels.denoise.classic import ATROUS, GATHER, RESOLVE, STEPS
from postfx.kernels.denoise.features import FEATURE, GUIDE, MIRROR, STORED_FEATURE, TRUST
from postfx.kernels.denoise.history import (
    HISTORY,
    KEEP,
    REACTIVE,
    REFLECTIONS,
    RESIZE,
    SPREAD_MASK,
)
from postfx.kernels.denoise.network_io import (
    OPEN,
    OPEN_CODES,
    OPEN_ERROR,
    OPEN_FINE,
    OPEN_FINE_CODES,
    OPEN_FINE_PRODUCTS,
    OPEN_PHASED,
    OPEN_PRODUCTS,
    OPEN_SOME_PRODUCTS,
    PACK,
    STORE,
    STORE_RINGED,
)
from postfx.kernels.denoise.output import ASSEMBLE, DETAIL, JUDGE, RESTORE, STRENGTH
from postfx.kernels.denoise.parts import (
    ACCUMULATE_PART,
    BALANCE,
    DECODE,
    DECODE_ONE,
    REFLECT,
    UPSAMPLE_LIGHT,
)
from postfx.kernels.denoise.prepare import ACCUMULATE, DILATE, MEANS, SCALE
from postfx.kernels.denoise.pyramid import (
    ENLARGE_ALPHA,
    FILTER,
    FILTER_CODES,
    FILTER_MIXED,
    FILTER_SHADED,
    LEVEL,
    MIX_LEVELS,
    POOL,
    POOLS,
    REMODULATE,
    REMODULATE_BOTH,
)
from postfx.kernels.denoise.upsample import (
    BLEND_PICTURE,
    CODES_GUIDED,
    CODES_PLAIN,
    CODES_UNSCALED,
    UPSAMPLE,
    UPSAMPLE_GUIDED,
    UPSAMPLE_UNSCALED,
)
from postfx.kernels.image import ENLARGE_OVERLAY, RESAMPLE
from postfx.kernels.partner import ENLARGE_MOTION
from postfx.passes.denoise.geometry import PYRAMID_LEVELS
from postfx.runtime import CommandBuffer, PipelineState, Tensor
from postfx.runtime.states import parse


class KernelStep(NamedTuple):
    """A kernel, and where it runs.

    Attributes:
        kernel: None for the network that the step runs over.
        when: words of this module's description that must all hold.
        unless: words of which none may hold.
        over: name of the things that it runs over, one by one; empty for one run.
        level: level of the pyramid whose size its buffers have.
        buffers: binding -> name of its buffer, where the two names differ.
    """

    kernel: Kernel | None
    when: frozenset[str]
    unless: frozenset[str]
    over: str
    level: int
    buffers: Mapping[str, str]


Steps = tuple[KernelStep, ...]
Table = Mapping[str, Steps]
"""Steps by the label of their encoder."""


def step(kernel: Kernel | None, when: str = "", *, unless: str = "", over: str = "",
         **buffers: str) -> KernelStep:
    """A step; words are given in one text, buffers by the names of bindings."""
    return KernelStep(kernel, frozenset(when.split()), frozenset(unless.split()), over, 0, buffers)


# Before the windows: planes and history as these read them.

WIDENED: Table = {"primaries": (step(CONVERT_PRIMARIES),)}
RESAMPLED: Table = {"resample": (step(RESAMPLE, over="planes"),)}
MASKED: Table = {"reactive": (step(REACTIVE),)}
REFLECTED: Table = {"reflections": (step(REFLECTIONS),)}
GATHERED: Table = {"gather alpha": (
    step(DILATE),
    step(alpha.NEAR_ALPHA, "gpu"),
    step(alpha.GATHER))}
RESIZED: Table = {"resize": (
    step(RESIZE, "state"),
    step(RESAMPLE, over="planes", rows="at_rows", columns="at_columns"))}
FRAME_NEEDS: Table = {"scale": (
    step(SCALE),
    step(SPREAD_MASK, "reactive"))}

# The picture of a window.


def _pool(i: int) -> KernelStep:
    """Halves the size of light, weighted by importance."""
    return step(POOL, unless="gpu given",
                finer=f"pool {i - 1}", finer_importance=f"importance {i - 1}",
                finer_rows=f"finer_rows {i}", finer_columns=f"finer_columns {i}",
                level=f"pool {i}", importance=f"importance {i}")


def _filtering(i: int) -> Steps:
    """Filters one level of the pyramid, mixed with the filtered level below it."""
    head, area = f"head level{i}" if i else "head fine", f"area {i}"
    buffers = {"heads": head, "area": area, "filtered": f"filtered {i}"}
    if i == PYRAMID_LEVELS:
        return (step(FILTER, unless="given", mixed=f"pool {i}", **buffers),)
    buffers |= {"mixed": f"mixed {i}", "level": f"pool {i}", "coarse": f"filtered {i + 1}",
                "coarse_rows": f"coarse_rows {i}", "coarse_columns": f"coarse_columns {i}"}
    if i > 0:
        return (
            step(MIX_LEVELS, unless="gpu given", **buffers),
            step(FILTER, unless="gpu given", **buffers),
            step(FILTER_MIXED, "gpu", unless="given", **buffers))
    return (
        step(MIX_LEVELS, unless="gpu given", **buffers),
        step(FILTER, unless="gpu given coded", **buffers),
        step(FILTER_CODES, "coded", unless="given", **buffers),
        step(FILTER_MIXED, "gpu", unless="given shaded", **buffers),
        step(FILTER_SHADED, "gpu shaded", **buffers))


_POOLS = step(POOLS, "gpu", unless="given", finer="pool 0", finer_importance="importance 0",
              level1="pool 1", level2="pool 2", level3="pool 3", level4="pool 4",
              importance1="importance 1", importance2="importance 2",
              importance3="importance 3", importance4="importance 4")
PYRAMID: Steps = (
    _POOLS,
    *(_pool(i)._replace(level=i) for i in range(1, PYRAMID_LEVELS + 1)),
    *(one._replace(level=i) for i in range(PYRAMID_LEVELS, -1, -1) for one in _filtering(i)))
"""Filters 'pool 0' into 'filtered 0'."""

PREPARE: Steps = (
    step(DILATE),
    step(MEANS, "doubts"),
    step(HISTORY, "moves"),
    step(KEEP, "masked"),
    step(FEATURE, unless="stored"),
    step(STORED_FEATURE, "stored"),
    step(GUIDE, "guided"),
    step(TRUST, "guided"),
    step(MIRROR, "mirrored"))
PACK_STEPS: Steps = (
    step(PACK, "halves", over="inputs", packed="closed"),
    step(STORE, "codes", unless="ringed", over="inputs", stored="closed"),
    step(STORE_RINGED, "codes ringed", over="inputs", stored="closed"))
OPEN_STEPS: Steps = (
    step(OPEN_PHASED, "phased", over="outputs", phased_fine="closed", fine="head"),
    step(OPEN_FINE, "raw fine", over="outputs", raw_fine="closed", fine="head"),
    step(OPEN, "raw", unless="fine", over="outputs", raw="closed", heads="head"),
    step(OPEN_SOME_PRODUCTS, "sums behind", over="outputs", products="closed", fine="head"),
    step(OPEN_FINE_PRODUCTS, "sums fine", unless="behind", over="outputs", products="closed",
         fine="head"),
    step(OPEN_PRODUCTS, "sums", unless="fine", over="outputs", products="closed", heads="head"),
    step(OPEN_FINE_CODES, "codes fine", over="outputs", codes="closed", fine="head"),
    step(OPEN_CODES, "codes", unless="fine", over="outputs", codes="closed", heads="head"))
ACCUMULATE_AND_FILTER: Steps = (
    step(ACCUMULATE, level="level 0"),
    *PYRAMID,
    step(REMODULATE, "plain", unless="shaded", filtered="filtered 0"),
    step(REMODULATE_BOTH, "guides", filtered="filtered 0"),
    step(REMODULATE_BOTH, "unscaled", filtered="filtered 0"))
ENLARGE: Steps = (
    step(UPSAMPLE, "plain", unless="coded"),
    step(CODES_PLAIN, "plain coded"),
    step(UPSAMPLE_GUIDED, "guides", unless="coded"),
    step(CODES_GUIDED, "guides coded"),
    step(UPSAMPLE_UNSCALED, "unscaled", unless="coded"),
    step(CODES_UNSCALED, "unscaled coded"),
    step(BLEND_PICTURE, "given", picture="head picture", controls="head controls"),
    step(OPEN_ERROR, "error", log_error="head error"))
BEFORE_ENLARGING: Table = {
    "prepare": PREPARE,
    "pack": PACK_STEPS,
    "network": (step(None, over="network"),),
    "open": OPEN_STEPS,
    "filter": ACCUMULATE_AND_FILTER}
ENLARGING: Table = {"upsample": ENLARGE}
WINDOW_STEPS: Table = {**BEFORE_ENLARGING, **ENLARGING}
CLASSIC_STEPS: Table = {
    "prepare": (step(DILATE), step(KEEP, "masked"), step(GATHER, light="smooth 0")),
    "filter": tuple(
        step(ATROUS, light=f"smooth {k % 2}", smooth=f"smooth {1 - k % 2}", step=f"step {far}")
        for k, far in enumerate(STEPS)),
    "upsample": (step(RESOLVE, light=f"smooth {len(STEPS) % 2}"),)}

# What is filtered beside the picture: layers of one stack, and alpha.

LAYER_STEPS: Table = {"parts": (
    step(REFLECT, "filtered divided", over="layers"),
    step(ACCUMULATE_PART, "filtered", over="layers"),
    *(one._replace(when=one.when | {"filtered"}) for one in PYRAMID),
    step(REMODULATE, "filtered", over="layers", filtered="filtered 0"),
    step(UPSAMPLE_LIGHT))}
ALPHA: Table = {"alpha": (
    step(LEVEL, level="pool 0"),
    *PYRAMID,
    step(ENLARGE_ALPHA, filtered="filtered 0"))}

# After the windows: pictures of the output's size.

ASSEMBLED: Table = {"assemble": (step(ASSEMBLE),)}
RESTORED: Table = {"restore": (
    step(JUDGE, unless="part"),
    step(DETAIL, unless="part"),
    step(RESTORE))}
BLENDED: Table = {
    "plain": (step(RESAMPLE, over="rows", image="colour", rows="plain_rows",
                   columns="plain_columns", output="plain"),),
    "strength": (
        step(RESAMPLE, "mixed varied", over="rows", image="strength_plane", rows="strength_rows",
             columns="strength_columns", output="strength"),
        step(STRENGTH, "mixed in_place", over="rows", plain="result", denoised="result",
             output="denoised"),
        step(STRENGTH, "mixed", over="rows"))}
BALANCED: Table = {"balance": (step(BALANCE),)}
CORRECTED: Table = {"correct alpha": (
    step(alpha.FIT),
    step(alpha.CORRECT))}
DECODED: Table = {"decode": (
    step(DECODE, unless="single"),
    step(DECODE_ONE, "single"))}
PASSED_ON: Table = {
    "error": (step(RESAMPLE, over="error"),),
    "motion": (step(ENLARGE_MOTION, over="motion"),),
    "alpha": (step(RESAMPLE, over="alpha"),),
    "overlay": (step(ENLARGE_OVERLAY, over="overlay"),),
    "partner": (step(RESAMPLE, over="partner"),),
    "strength": (step(RESAMPLE, over="strength"),)}


class Each(NamedTuple):
    """One of several things that a step runs over.

    Attributes:
        words: that hold for it, beside the frame's.
        buffers: of its own, by name.
        network: the network that runs, for a step without a kernel.
    """

    words: frozenset[str] = frozenset()
    buffers: Mapping[str, Tensor] = MappingProxyType({})
    network: PipelineState | None = None


Over = Mapping[str, Sequence[Each]]
"""What steps run over, by name."""
ONE: Sequence[Each] = (Each(),)
OVER_NOTHING: Over = MappingProxyType({})
NO_WORDS = frozenset[str]()
SOMETIMES = frozenset({"moves", "masked", "error"})
"""Words that hold in some frames of a window and not in others."""


def run_steps(commands: CommandBuffer, table: Table, buffers: Mapping[str, Tensor],
              words: frozenset[str] = NO_WORDS, over: Over = OVER_NOTHING,
              half: bool = False) -> None:
    """Record the steps of a table that run where these words hold.

    Args:
        buffers: tensors by name.
        over: the things that steps run over; their own buffers come before `buffers`.
        half: whether kernels run in half precision where they have that form.
    """
    for label, one, each in _steps_of(table, words, over):
        if one.kernel is None:
            assert each.network  # which such a step runs over
            commands.run(each.network, label, **each.buffers)
            continue
        kernel = IN_HALF.get(one.kernel, one.kernel) if half else one.kernel
        tensors = {}
        for binding in kernel.reads + kernel.writes:
            name = one.buffers.get(binding, binding)
            tensors[binding] = each.buffers[name] if name in each.buffers else buffers[name]
        commands.run(kernel, label, **tensors)


def shapes_of(table: Table, sizes: Callable[[int], Mapping[str, int]],
              words: frozenset[str] = NO_WORDS) -> dict[str, tuple[int, ...]]:
    """Shapes of the buffers that steps may write where no more than these words hold, by name.

    Buffers whose shapes have other symbols are left out, and so are steps that run over something.

    Args:
        sizes: gives the values of the shapes' symbols at a level of the pyramid.
    """
    found = dict[str, tuple[int, ...]]()
    for _, one, _ in _steps_of(table, words, OVER_NOTHING, SOMETIMES):
        assert one.kernel  # as it runs over nothing
        known = sizes(one.level)
        for binding in one.kernel.writes:
            sides = [parse(side) for side in one.kernel.shapes[binding]]
            if all(side.symbol is None or side.symbol in known for side in sides):
                found[one.buffers.get(binding, binding)] = tuple(
                    side.factor * known.get(side.symbol or "", 1) for side in sides)
    return found


def kernels_of(table: Table, words: frozenset[str] = NO_WORDS, over: Over = OVER_NOTHING,
               half: bool = False) -> list[Kernel]:
    """The kernels that may run where no more than these words hold."""
    found = [one.kernel for _, one, _ in _steps_of(table, words, over, SOMETIMES) if one.kernel]
    return [IN_HALF.get(kernel, kernel) if half else kernel for kernel in found]


def _steps_of(table: Table, words: frozenset[str], over: Over,
              maybe: frozenset[str] = NO_WORDS) -> Iterator[tuple[str, KernelStep, Each]]:
    """The steps that run, with their labels, once for each thing that they run over. Words in
    `maybe` hold in some frames only: they let steps run that need them, and stop none."""
    for label, steps in table.items():
        for one in steps:
            for each in over.get(one.over, ()) if one.over else ONE:
                held = words | each.words
                if one.when <= held and not one.unless & held - maybe:
                    yield label, one, each
