"""Adapt the network s to a shot, from a few clean frames or from two independent renders: see
`postfx tune --help`.

    python -m training.denoise.tune SHOT --references REF -o shot.onnx --minutes 10

It trains at the render's size on windows of two frames, whose history the recurrent step makes as
in the product; the second frame's target is a reference, or the other render. Noise of a target
averages out only in light that is nearly linear: there the error is squared and divided by the
squared brightness of the result.

References may hold tiles only: with a plane of sample counts, pixels with less than half of the
most samples do not count. Where such tiles are small, windows are smaller, and there are more of
them.

A quarter is held back: frames where there are four or more targets, else the right quarter of the
pixels that count. The best of several mixtures of old and new weights counts, as a mixture forgets
less. If it does not gain, nothing is written.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from postfx.cli.options import Parser
from postfx.cli.tune import DESCRIPTION, TUNE
from postfx.errors import FrameError, OptionError, PostfxError
from postfx.exposure import ExposureMeter
from postfx.frame import ROLES, Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes.denoise.planes import shows_volume
from postfx.system import usable_cores
from training.denoise.checkpoint import load_weights
from training.denoise.dataset import ABSENT
from training.denoise.export import card, export_trunk, load_trunk
from training.denoise.loss import LIGHT, display, frame_loss, light_loss
from training.denoise.model import DenoiseUpscale, Inputs, State, empty_state
from training.export import MODELS, write_card

START = MODELS / "denoise_upscale.s.1x.onnx"
RATE = 1e-4
WARM = 10
"""Steps over which the learning rate rises."""
WINDOW, BATCH = 128, 4
SPARSE = 0.25
"""Share of the pixels that count below which windows have half the side, and there are four times
as many."""
SHARES = (1.0, 0.75, 0.5, 0.25)
"""Of the new weights in the mixtures that are tried."""
LEAST = 0.1
"""Gain in dB on what was held back for which a network is written."""
KEPT = 4
"""One target, or one column of a picture, in so many is held back."""
FLOOR = 0.01
"""Added to the squared brightness that errors against noisy targets are divided by."""
BRIGHTEST = 1e4


@dataclass
class Example:
    """A frame with a target, and the frame before it: inputs of one picture each, exposed alike.

    known: 1 where the target counts, else 0, (1, 1, height, width).
    """

    before: Inputs
    now: Inputs
    target: Tensor
    known: Tensor
    follows: bool
    name: str


def inputs_of(frame: Frame, exposure: float) -> Inputs:
    """A frame as the product gives it to the network."""
    height, width = frame[Role.COLOUR].shape[:2]
    absent = dict(ABSENT)
    if Role.DEPTH in frame and shows_volume(frame[Role.DEPTH]):
        missing = {"depth", "diffuse_albedo", "specular_albedo"}
    else:
        missing = set()
    planes = {}
    for name, value in absent.items():
        role = Role(name)
        held = role in frame and name not in missing
        plane = frame[role] if held else np.full((height, width, ROLES[role].channels), value,
                                                 np.float32)
        planes[name] = torch.from_numpy(np.ascontiguousarray(plane)).permute(2, 0, 1)[None]
    colour = torch.from_numpy(frame[Role.COLOUR]).permute(2, 0, 1)[None]
    colour = (torch.nan_to_num(colour).clamp(min=0) * exposure).clamp(max=BRIGHTEST)
    return Inputs(colour=colour, **planes, jitter=torch.tensor([frame.jitter], dtype=torch.float32))


def load(arguments: argparse.Namespace) -> list[Example]:
    """The examples of a shot."""
    values = TUNE.values_for("sequence", arguments)
    shot = read_sequence(
        arguments.input, arguments.frames, arguments.profile, motion="auto", **values).first_view()
    other = read_sequence(
        arguments.references or arguments.halves, profile=arguments.profile, motion="auto",
        **values)
    meter = ExposureMeter()
    found: list[Example] = []
    pairs = [(shot, other), (other, shot)] if arguments.halves else [(shot, other)]
    for source, target in pairs:
        for number in (one for one in shot.numbers if source.holds(one) and target.holds(one)):
            before = source.before(number, 1)
            frames = [source.read(one) for one in (*before, number)]
            with target.open(number) as files:
                has_counts = Role.SAMPLE_COUNT in files.layout.planes
            held = target.read(number, [Role.COLOUR, *[Role.SAMPLE_COUNT] * has_counts])
            wanted = held[Role.COLOUR]
            if wanted.shape != frames[-1][Role.COLOUR].shape:
                raise FrameError(f"{target.pattern}: frame {number} has another size than the "
                                 "shot's: render it at the render's size")
            exposure = float(meter(frames[-1]))
            made = [inputs_of(frame, exposure) for frame in frames]
            light = torch.from_numpy(wanted).permute(2, 0, 1)[None].clamp(min=0) * exposure
            follows = bool(before) and Role.MOTION in frames[-1] and not frames[-1].reset
            known = torch.from_numpy(known_pixels(held))[None, None]
            light = torch.nan_to_num(light).clamp(max=BRIGHTEST)
            found.append(Example(made[0], made[-1], light, known, follows,
                                 f"{source.pattern} {number}"))
    if not found:
        raise OptionError(f"{other.pattern}: has none of the frames {shot.pattern}: number them "
                          "alike")
    return found


def known_pixels(target: Frame) -> np.ndarray:
    """1 where a target counts, else 0, (height, width) float32: finite, with at least half of the
    most samples."""
    known = np.isfinite(target[Role.COLOUR]).all(axis=2)
    if Role.SAMPLE_COUNT in target:
        counts = target[Role.SAMPLE_COUNT][:, :, 0]
        known &= (counts > 0) & (counts >= counts.max() / 2)
    return known.astype(np.float32)


def cut(inputs: Inputs, rows: slice, columns: slice) -> Inputs:
    """A window of a frame."""
    names = ("colour", *ABSENT)
    return Inputs(**{name: getattr(inputs, name)[..., rows, columns] for name in names},
                  jitter=inputs.jitter)


def stack(frames: Sequence[Inputs]) -> Inputs:
    """Windows of one size as a batch."""
    names = ("colour", *ABSENT, "jitter")
    return Inputs(**{name: torch.cat([getattr(one, name) for one in frames]) for name in names})


def run(model: DenoiseUpscale, before: Inputs, now: Inputs, follows: Tensor) -> Tensor:
    """Exposed result of a frame after the one before it."""
    size = now.colour.shape[-2:]
    state: State = empty_state(before, *size)
    _, state, _ = model(before, state)
    result: Tensor = model(now, state.drop(follows))[0]
    return result


def error(result: Tensor, target: Tensor, known: Tensor, is_noisy: bool) -> Tensor:
    """The loss of a batch, as if all of it were known."""
    share = known.mean().clamp(min=1e-3)
    if is_noisy:
        return (relative_error(result, target) * known).mean() / share
    target = torch.where(known > 0, target, result.detach())
    ones = torch.ones(len(result), 1, 1, 1, device=result.device)
    found = (frame_loss(display(result), display(target), ones)
             + LIGHT[0] * light_loss(result, target, LIGHT[1]))
    return found / share


def relative_error(result: Tensor, target: Tensor) -> Tensor:
    """Squared error of light over the squared brightness of the result, without which lamps would
    decide alone."""
    scale = result.detach().mean(1, keepdim=True).square() + FLOOR
    return (result - target).square() / scale


class Split:
    """What is trained on, and what is held back."""

    def __init__(self, examples: list[Example]) -> None:
        examples = [one for one in examples if one.known.any()]
        if not examples:
            raise FrameError("no pixel of the references counts: all have no samples or are not "
                             "finite")
        self._by_frame = len(examples) >= KEPT
        numbers = range(KEPT // 2, len(examples), KEPT) if self._by_frame else range(len(examples))
        self.held = [examples[number] for number in numbers]
        others = [one for number, one in enumerate(examples) if number not in numbers]
        self.seen = others if self._by_frame else examples
        self._places = [torch.nonzero(one.known[0, 0, :, self.columns(one, held=False)])
                        for one in self.seen]
        is_sparse = sum(float(one.known.mean()) for one in self.seen) < SPARSE * len(self.seen)
        self._window, self._batch = (WINDOW // 2, BATCH * 4) if is_sparse else (WINDOW, BATCH)

    def columns(self, example: Example, held: bool) -> slice:
        """Columns of a picture that count for either."""
        width = example.known.shape[-1]
        if self._by_frame:
            return slice(0, width)
        filled = torch.nonzero(example.known[0, 0])[:, 1].sort().values
        edge = int(filled[len(filled) - len(filled) // KEPT - 1]) + 1
        return slice(edge, width) if held else slice(0, edge)

    def draw(self, generator: random.Random) -> tuple[Inputs, Inputs, Tensor, Tensor, Tensor]:
        """Windows around random pixels that count: frames before, frames, targets, what of them is
        known, and where the history goes on."""
        chosen = [generator.randrange(len(self.seen)) for _ in range(self._batch)]
        sides = [min(self._window, *(one.known.shape[axis] if axis == -2 else
                                     len(range(one.known.shape[-1])[self.columns(one, held=False)])
                                     for one in (self.seen[number] for number in chosen)))
                 for axis in (-2, -1)]
        pairs = []
        for number in chosen:
            one, places = self.seen[number], self._places[number]
            limits = one.known.shape[-2], self.columns(one, held=False).stop
            spot = places[generator.randrange(len(places))].tolist()
            begins = [min(max(at - generator.randrange(side), 0), limit - side)
                      for at, side, limit in zip(spot, sides, limits, strict=True)]
            pairs.append((one, [slice(begin, begin + side)
                                for begin, side in zip(begins, sides, strict=True)]))
        return (stack([cut(one.before, *window) for one, window in pairs]),
                stack([cut(one.now, *window) for one, window in pairs]),
                torch.cat([one.target[..., window[0], window[1]] for one, window in pairs]),
                torch.cat([one.known[..., window[0], window[1]] for one, window in pairs]),
                torch.tensor([float(one.follows) for one, _ in pairs])[:, None, None, None])

    @torch.no_grad()
    def measure(self, model: DenoiseUpscale, is_noisy: bool) -> float:
        """Squared error of what was held back: of code values, or relative one of light against a
        noisy target."""
        errors, pixels = [], []
        for one in self.held:
            result = run(model, one.before, one.now, torch.full((1, 1, 1, 1), float(one.follows)))
            columns = self.columns(one, held=True)
            result, target, known = (result[..., columns], one.target[..., columns],
                                     one.known[..., columns])
            if is_noisy:
                # the same for all networks
                scale = target.mean((1, 2, 3), keepdim=True).square() + FLOOR
                square = (result - target).square() / (scale + target.square().mean())
            else:
                square = (display(result) - display(target)).square()
            errors.append(float((square * known).sum() / square.shape[1]))
            pixels.append(float(known.sum()))
        return sum(errors) / sum(pixels)


def tune(arguments: argparse.Namespace) -> dict[str, object]:
    """Train and, where there is a gain, write; returns what became of it."""
    torch.manual_seed(arguments.seed)
    free = int(usable_cores() - os.getloadavg()[0])
    # where cores are busy, threads that wait for each other take ten times as long
    torch.set_num_threads(max(1, free))
    generator, is_noisy = random.Random(arguments.seed), bool(arguments.halves)
    examples = load(arguments)
    split = Split(examples)
    config = json.loads(START.with_suffix(".json").read_text())["config"]
    start = load_weights(START)
    model = DenoiseUpscale(trunk=load_trunk({"config": config, "weights": start}).train())
    before = split.measure(model, is_noisy)
    optimiser = torch.optim.AdamW(model.parameters(), lr=RATE, betas=(0.9, 0.99), weight_decay=1e-4)
    begin, step = time.monotonic(), 0
    while True:
        passed = (step / arguments.steps if arguments.steps
                  else (time.monotonic() - begin) / 60 / arguments.minutes)
        if passed >= 1:
            break
        for group in optimiser.param_groups:
            group["lr"] = RATE * min((step + 1) / WARM, 1) * 0.5 * (1 + np.cos(np.pi * passed))
        earlier, later, target, known, follows = split.draw(generator)
        loss = error(run(model, earlier, later, follows), target, known, is_noisy)
        optimiser.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        if torch.isfinite(norm):
            optimiser.step()
        step += 1
        if step % 20 == 0:
            print(f"step {step}, {time.monotonic() - begin:.0f} s, loss {loss.item():.4f}",
                  file=sys.stderr, flush=True)
    tuned = {name: value.detach().clone() for name, value in model.state_dict().items()}
    scores = {}
    for share in SHARES:
        model.load_state_dict(mixture(start, tuned, share))
        scores[share] = split.measure(model, is_noisy)
    best = min(scores, key=lambda share: scores[share])
    gain = float(10 * np.log10(before / scores[best]))
    facts: dict[str, object] = {
        "steps": step, "minutes": round((time.monotonic() - begin) / 60, 2),
        "examples": len(examples), "held_back": len(split.held),
        "target": "halves" if is_noisy else "references", "share": best, "gain_db": round(gain, 3),
        "start": START.stem, "written": "" if gain < LEAST else arguments.output,
    }
    if gain >= LEAST:
        write({"config": config, "weights": mixture(start, tuned, best), "notes": facts},
              Path(arguments.output))
    return facts


def mixture(start: dict[str, Tensor], tuned: dict[str, Tensor], share: float) -> dict[str, Tensor]:
    """Weights between the old ones and the new ones."""
    return {name: torch.lerp(start[name], tuned[name], share) for name in start}


def write(checkpoint: dict[str, object], path: Path) -> None:
    """Write the network and its card."""
    path.parent.mkdir(parents=True, exist_ok=True)
    notes = {key: value for key, value in checkpoint["notes"].items() if key != "written"}  # type: ignore[attr-defined]
    with redirect_stdout(sys.stderr):  # PyTorch tells its steps there
        difference = export_trunk(load_trunk(checkpoint), path)
    made = card({**checkpoint, "notes": notes}, path.stem, difference, {})
    made |= {"name": path.stem,
             "summary": "recurrent denoised upscaler, tuned to one shot, for its own size"}
    made["training"]["script"] = "training/denoise/tune.py"
    write_card(path, made)


def main() -> int:
    parser = Parser(prog="postfx tune", description=DESCRIPTION,
                    formatter_class=argparse.RawDescriptionHelpFormatter)
    TUNE.add_to(parser)
    arguments = parser.parse_args()
    try:
        facts = tune(arguments)
    except PostfxError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    unit = "dB less error against the other render" if arguments.halves else "dB"
    gained = f"{facts['gain_db']:+.2f} {unit} on what was held back, after {facts['steps']} steps"
    words = (f"wrote    {arguments.output}: {gained}" if facts["written"]
             else f"no gain  {gained}: nothing is written")
    print(json.dumps(facts) if arguments.json else words)
    return 0 if facts["written"] else 1


if __name__ == "__main__":
    sys.exit(main())
