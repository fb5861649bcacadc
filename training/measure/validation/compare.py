"""Measures every method on every render of the clips.

PSNR here is that of `postfx bench` with the reference's own noise, known from its halves, taken out of the error.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from postfx.bench.job import Bench, Wish
from postfx.bench.material import Sources
from training.measure.validation.expand import expand
from training.measure.validation.report import mean

FIGURES = ("ssim", "flip", "flicker")


def compare(clips: list[Path], args: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each clip, render and method. Files go to RESULTS/SCENE.SEED/RENDER, EXR frames to RESULTS/frames."""
    rows = []
    for clip in clips:
        folder, facts = expand(clip, args.results / "frames")
        for name in [name for name in facts["renders"] if name in args.renders.split(",")]:
            print(f"{folder.name} {name}", file=sys.stderr, flush=True)
            rows += [_row(folder.name, name, facts, method) for method in _measured(folder, name, args)]
    return rows


def _measured(folder: Path, name: str, args: argparse.Namespace) -> list[dict[str, Any]]:
    output = args.results / folder.name / name
    earlier = output / "bench.json"
    if args.keep and earlier.exists():
        return json.loads(earlier.read_text())["methods"]
    patterns = [str(folder / f"{part}.####.exr") for part in (name, "reference", "guides")]
    wish = Wish(output, args.methods, args.models, args.runs, args.device)
    return Bench(Sources(*patterns), wish).run()["methods"]


def _row(scene: str, name: str, facts: dict[str, Any], method: dict[str, Any]) -> dict[str, Any]:
    scores, render = method["scores"], facts["renders"][name]
    pairs = zip(method["frames"], facts["reference_noise"], strict=True)
    psnr = [without_noise(frame["psnr"], noise) for frame, noise in pairs]
    return {
        "scene": scene, "trait": facts["trait"], "style": facts["style"], "render": name, "scale": render["scale"],
        "spp": render["spp"], "method": method["name"], "family": method["family"],
        "wall_ms": method["time"]["wall_ms"], "psnr": mean(psnr), "psnr_late": mean(psnr[len(psnr) // 2 :]),
        **{key: scores[key] for figure in FIGURES for key in (figure, f"{figure}_late")},
        "psnr_frames": psnr, "reference_noise": facts["reference_noise"],
    }


def without_noise(psnr: float, noise: float) -> float:
    """PSNR against a reference without the noise (mean square) that this one has; raised by 10 dB at most."""
    error = 10 ** (-psnr / 10)
    return float(-10 * np.log10(max(error - noise, error / 10)))
