"""Adapt a network to a shot, from a few clean frames or from two independent renders: see
`postfx tune --help`.

    python -m training.denoise.tune SHOT --references REF -o shot.onnx --minutes 10
    python -m training.denoise.tune SHOT --halves OTHER -o shot.onnx

It trains at the render's size on windows of a few frames (`shot_examples`), whose history the
recurrent step makes as in the product. The target of the last frame is a reference, or the other
render. Noise of a target averages out, as in Noise2Noise (Lehtinen et al., 2018), if errors of
linear light are squared. They are weighted by the slope of the display curve at the result, so that
they are errors of what is seen.

Now and then a mixture of old and new weights is measured on the part of the shot that is held back,
and the best one is kept. If it does not gain, nothing is written.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
import torch
from torch import Tensor

from postfx.cli.options import Parser
from postfx.cli.tune import DESCRIPTION, TUNE
from postfx.errors import OptionError, PostfxError
from postfx.system import usable_cores
from training.denoise.checkpoint import PREFIX, load_weights
from training.denoise.export import card, export_trunk, load_trunk
from training.denoise.loss import (
    ERROR,
    LIGHT,
    display,
    error_loss,
    frame_loss,
    light_loss,
    seen_error,
)
from training.denoise.model import DenoiseUpscale, Step, empty_state
from training.denoise.picture import PictureDenoiser
from training.denoise.shot_examples import Split, Windows, read_examples
from training.export import MODELS, write_card

Denoiser = DenoiseUpscale | PictureDenoiser

FROZEN = ("judge", "controls", "gate", "error")
"""Layers of a picture network that are not trained: they say how much of the history counts, which
a few frames teach badly."""
RATE = 3e-4
"""Highest learning rate."""
WARM_STEPS = 10
"""Steps over which the learning rate rises."""
FRAMES_WITH_GRADIENT = 2
"""Last frames of an example through which gradients flow."""
LOOKS = 20
"""Times that a training is measured on the part held back, at most."""
LOOKING_SHARE = 0.1
"""Share of the time that measuring may take."""
SHARES = (0.5, 0.25)
"""Shares of the new weights in the mixtures with the old ones that are tried; the first one is
measured during the training. New weights alone fit the noise of what they learn from."""
LEAST_SHARE = 0.05
"""Share of a measured error that is taken as the network's own, even if noise of the targets seems
to be all of it."""
LEAST_SURE = 1.0
"""Standard errors by which a gain must be above 0 for a network to be written."""


def run(model: Denoiser, windows: Windows) -> Step:
    """The results for the last frames of windows, with the frames before them as the history."""
    first = windows.frames[0]
    state = empty_state(first, *first.colour.shape[-2:])
    pairs = list(zip(windows.frames, windows.follows, strict=True))
    with torch.no_grad():
        for inputs, follows in pairs[:-FRAMES_WITH_GRADIENT]:
            state = model.step(inputs, state.drop(follows)).state
    for inputs, follows in pairs[-FRAMES_WITH_GRADIENT:]:
        step = model.step(inputs, state.drop(follows))
        state = step.state
    return step


def loss_of(step: Step, target: Tensor, known: Tensor, is_noisy: bool) -> Tensor:
    """The loss of a batch over the pixels that count. is_noisy: whether the target is a render, not
    a reference."""
    share = known.mean().clamp(min=1e-3)
    result = step.output
    if is_noisy:
        return (seen_error(result, target, result.detach()).square() * known).mean() / share
    target = torch.where(known > 0, target, result.detach())
    ones = torch.ones(len(result), 1, 1, 1, device=result.device)
    found = (frame_loss(display(result), display(target), ones)
             + LIGHT[0] * light_loss(result, target, LIGHT[1]))
    if step.error is not None:
        predicted = torch.where(known > 0, step.error, step.error.detach())
        found = found + ERROR * error_loss(predicted, display(result), display(target))
    return found / share


@dataclass(frozen=True)
class Score:
    """How much better a network is in the pixels that are held back.

    Attributes:
        gain_db: over the network that training began with, without the noise of targets.
        sure: the gain in squared error over its standard error.
    """

    gain_db: float
    sure: float


class Measure:
    """Compares networks with the first one by squared errors of what is seen, in windows that are
    held back.

    Args:
        split: has the windows.
        model: the network that training begins with.
        is_noisy: whether targets are renders, not references.
    """

    def __init__(self, split: Split, model: Denoiser, is_noisy: bool) -> None:
        self._windows, self._is_noisy = split.held_windows(), is_noisy
        self._at = self._results(model)
        self._first = self._errors(self._at)
        first = float(self._first.mean())
        self._before = max(first - self._noise(), LEAST_SHARE * first)

    def __call__(self, model: Denoiser) -> Score:
        change = self._first - self._errors(self._results(model))
        spread = float(change.std(ddof=1)) / len(change) ** 0.5 if len(change) > 1 else np.inf
        mean = float(change.mean())
        gain = -10 * np.log10(max(1 - mean / self._before, LEAST_SHARE))
        return Score(float(gain), mean / max(spread, 1e-12))

    @torch.no_grad()
    def _results(self, model: Denoiser) -> list[Tensor]:
        """What a network makes of each window."""
        return [run(model, one).output for one in self._windows]

    def _errors(self, results: list[Tensor]) -> np.ndarray:
        """The error of each window's result."""
        errors = []
        for one, light, result in zip(self._windows, self._at, results, strict=True):
            squared = (seen_error(result, one.target, light).square() if self._is_noisy
                       else (display(result) - display(one.target)).square())
            errors.append(_mean(squared, one.known))
        return np.array(errors)

    def _noise(self) -> float:
        """The squared error of noisy targets: half of their squared difference from the frames,
        which have as much noise of their own."""
        if not self._is_noisy:
            return 0.0
        return float(np.mean([
            _mean(0.5 * seen_error(one.frames[-1].colour, one.target, light).square(), one.known)
            for one, light in zip(self._windows, self._at, strict=True)]))


def _mean(squared: Tensor, known: Tensor) -> float:
    """The mean of what counts."""
    return float((squared.mean(1, keepdim=True) * known).sum() / known.sum().clamp(min=1))


class Clock:
    """How much of a training is over: by steps, or by minutes."""

    def __init__(self, minutes: float, steps: int | None) -> None:
        self._minutes, self._steps = minutes, steps
        self._began = time.monotonic()

    def seconds(self) -> float:
        return time.monotonic() - self._began

    def passed(self, step: int) -> float:
        """From 0 to 1 and above."""
        return step / self._steps if self._steps else self.seconds() / 60 / self._minutes


@dataclass(frozen=True)
class Trained:
    """What a training gave.

    Attributes:
        weights: new weights whose mixture with the old ones was best on the part held back.
        steps: how many there were.
        minutes: how long they took.
    """

    weights: dict[str, Tensor]
    steps: int
    minutes: float


def train(model: Denoiser, split: Split, measure: Measure,
          arguments: argparse.Namespace) -> Trained:
    """Train, and now and then measure a mixture of old and new weights."""
    generator = random.Random(arguments.seed)
    start = weights_of(model)
    device = next(model.parameters()).device
    learnt = [weight for weight in model.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(learnt, lr=0.0, betas=(0.9, 0.99), weight_decay=1e-4)
    clock, step = Clock(arguments.minutes, arguments.steps), 0
    best, best_gain = start, -np.inf
    next_look, looking = 1 / LOOKS, 0.0
    while (passed := clock.passed(step)) < 1:
        for rates in optimiser.param_groups:
            rise = min((step + 1) / WARM_STEPS, 1)
            rates["lr"] = RATE * rise * 0.5 * (1 + np.cos(np.pi * passed))
        windows = split.draw(generator)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            done = run(model, windows)
        loss = loss_of(done, windows.target, windows.known, bool(arguments.halves))
        optimiser.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(learnt, 1.0)
        if torch.isfinite(norm):
            optimiser.step()
        step += 1
        passed = clock.passed(step)
        if passed < 1 and (passed < next_look or looking > LOOKING_SHARE * clock.seconds()):
            continue
        began = clock.seconds()
        now = weights_of(model)
        model.load_state_dict(mixture(start, now, SHARES[0]))
        gain = measure(model).gain_db
        model.load_state_dict(now)
        looking += clock.seconds() - began
        next_look = passed + 1 / LOOKS
        if gain > best_gain:
            best, best_gain = now, gain
        print(f"step {step}, {clock.seconds():.0f} s, loss {loss.item():.4f}, held back "
              f"{gain:+.2f} dB", file=sys.stderr, flush=True)
    return Trained(best, step, clock.seconds() / 60)


def weights_of(model: Denoiser) -> dict[str, Tensor]:
    """A copy of the weights."""
    return {name: value.detach().clone() for name, value in model.state_dict().items()}


def load_model(tag: str) -> tuple[Denoiser, dict[str, object]]:
    """A shipped network for the render's size, and its layout."""
    path = start_path(tag)
    config = json.loads(path.with_suffix(".json").read_text())["config"]
    trunk = load_trunk({"config": config, "weights": load_weights(path)}).train()
    model = PictureDenoiser(trunk) if config.get("picture") else DenoiseUpscale(trunk=trunk)
    for name, weight in model.named_parameters():
        weight.requires_grad_(not name.removeprefix(PREFIX).startswith(FROZEN))
    return model, config


def start_path(tag: str) -> Path:
    return MODELS / f"denoise_upscale.{tag}.1x.onnx"


def tune(arguments: argparse.Namespace) -> dict[str, object]:
    """Train, and write the network if it gains; returns facts on both."""
    torch.manual_seed(arguments.seed)
    device = choose_device(arguments.device)
    # where cores are busy, threads that wait for each other take ten times as long
    free = int(usable_cores() - os.getloadavg()[0]) if device.type == "cpu" else 1
    torch.set_num_threads(max(1, free))
    model, config = load_model(arguments.model)
    model = model.to(device)
    split = Split(read_examples(arguments, not config.get("picture"), device))
    measure = Measure(split, model, bool(arguments.halves))
    start = weights_of(model)
    trained = train(model, split, measure, arguments)
    scores = {}
    for share in SHARES:
        model.load_state_dict(mixture(start, trained.weights, share))
        scores[share] = measure(model)
    share = max(scores, key=lambda one: scores[one].gain_db)
    score = scores[share]
    gains = score.sure >= LEAST_SURE
    facts: dict[str, object] = {
        "steps": trained.steps, "minutes": round(trained.minutes, 2), "device": device.type,
        "examples": len(split.seen), "held_back": len(split.held),
        "target": "halves" if arguments.halves else "references", "share": share,
        "gain_db": round(score.gain_db, 3), "sure": round(score.sure, 1),
        "start": start_path(arguments.model).stem, "written": arguments.output if gains else "",
    }
    if gains:
        mixed = mixture(start, trained.weights, share)
        weights = {name: value.cpu() for name, value in mixed.items()}
        write({"config": config, "weights": weights, "notes": facts}, Path(arguments.output))
    return facts


def choose_device(name: str) -> torch.device:
    """The device of --device. Raises OptionError where it is not there."""
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionError("--device cuda: PyTorch finds no GPU here: take --device cpu, or install "
                          "a build of PyTorch for CUDA")
    uses_gpu = name == "cuda" or (name == "auto" and torch.cuda.is_available())
    return torch.device("cuda" if uses_gpu else "cpu")


def mixture(start: dict[str, Tensor], tuned: dict[str, Tensor], share: float) -> dict[str, Tensor]:
    """Weights between the old ones and the new ones."""
    return {name: torch.lerp(start[name], tuned[name], share) for name in start}


def write(checkpoint: dict[str, object], path: Path) -> None:
    """Write the network and its card."""
    path.parent.mkdir(parents=True, exist_ok=True)
    notes = {key: value for key, value in checkpoint["notes"].items() if key != "written"}  # type: ignore[attr-defined]
    with redirect_stdout(StringIO()), catch_warnings():  # PyTorch tells its own steps
        simplefilter("ignore", FutureWarning)
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
    gained = f"{facts['gain_db']:+.2f} dB on what was held back, after {facts['steps']} steps"
    words = (f"wrote    {arguments.output}: {gained}" if facts["written"]
             else f"no gain  {gained}: nothing is written")
    print(json.dumps(facts) if arguments.json else words)
    return 0 if facts["written"] else 1


if __name__ == "__main__":
    sys.exit(main())
