"""Clips that Blender's Cycles renders: a Blender process renders EXR files, and the project's own
reader reads them.

A clip has some noisy renders with drawn sample counts. At whole scales a further one comes for
free: half of the reference's samples, averaged down to the render size and compared with the other,
independent half.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import postfx
from training.datagen.clip_file import MIRRORED, first_only
from training.datagen.cycles.exchange import half_file, noisy_file, read_pass, vectors_file

ROOT = Path(__file__).parents[3]
START = ("import sys; sys.path.insert(0, sys.argv[1]); from training.datagen.cycles.blender.worker "
         "import main; main()")
NAMES = ("colour", "diffuse_albedo", "specular_albedo", "normal", "depth", "motion", *MIRRORED)
NO_ROUGHNESS = 0.5  # stands in for roughness, which Cycles does not write


@dataclass(frozen=True)
class CyclesOptions:
    """Sizes and counts. `half_samples` are camera samples a render pixel in each half of the
    reference, at most; `renders` are noisy ones."""

    width: int = 128
    height: int = 128
    frames: int = 8
    most_spp: int = 64
    half_samples: int = 256
    renders: int = 2
    scales: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0)
    scale_chances: tuple[float, ...] = (0.25, 0.1, 0.5, 0.15)
    kind: str | None = None


class Blender:
    """A Blender process that renders one clip after another. `python` is a Python with the module
    `bpy`."""

    def __init__(self, python: Path, library: Path | None):
        self.library = library
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        self.process = subprocess.Popen([str(python), "-c", START, str(ROOT)],
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                        stderr=sys.stderr, text=True, env=environment)
        self._answer()

    def render(self, **request: object) -> dict[str, Any]:
        """Facts of a rendered clip. Raises RuntimeError with Blender's message if it fails."""
        line = json.dumps({"library": self.library and str(self.library), **request})
        print(line, file=self.process.stdin, flush=True)
        answer = self._answer()
        if "error" in answer:
            raise RuntimeError(answer["error"])
        return answer["facts"]

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None, "it is a pipe"
        for line in self.process.stdout:
            if line.startswith("{"):  # Blender itself may print other lines
                return json.loads(line)
        raise RuntimeError(f"Blender ended with status {self.process.wait()}")


def make_clip(blender: Blender, options: CyclesOptions, seed: int,
              index: int) -> tuple[np.ndarray, list[dict[str, Any]], dict[str, Any]]:
    """Reference (T, H, W, 3), noisy renders and facts for `save_clip`; the same seed and index give
    the same clip."""
    rng = np.random.default_rng([seed, index, 1])
    scale = float(rng.choice(options.scales, p=options.scale_chances))
    spp = [round(2 ** rng.uniform(0, np.log2(options.most_spp))) for _ in range(options.renders)]
    if scale != int(scale):
        spp.append(round(2 ** rng.uniform(np.log2(options.most_spp), 8)))
    half_spp = max(round(options.half_samples / scale**2), 16)
    folder = Path(tempfile.mkdtemp(prefix="cycles.",
                                   dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        facts = blender.render(clip=index, seed=seed, folder=str(folder), kind=options.kind,
                               frames=options.frames, width=options.width, height=options.height,
                               scale=scale, spp=spp, half_spp=half_spp)
        # Files often hold the albedo for Cycles' denoiser alone, and with motion blur they have no
        # vectors.
        plain, still = rng.random() < 0.3, facts["blur"] and rng.random() < 0.5
        numbers = range(options.frames)
        vectors = ([vectors_file(folder, n) for n in numbers] if facts["blur"] and not still
                   else None)
        variants = [read_render([noisy_file(folder, k, n) for n in numbers], plain, vectors)
                    | {"spp": count} for k, count in enumerate(spp)]
        halves = [read_render([half_file(folder, k, n) for n in numbers], plain) for k in range(2)]
        if scale == int(scale):
            fine = halves[0] | {"motion": read_motion(folder, facts, options.frames, halves[0],
                                                      still, scale)}
            variants.append(shrink(fine, int(scale))
                            | {"spp": int(half_spp * scale**2), "half": True})
    finally:
        shutil.rmtree(folder)
    style = {"jitter": np.zeros((options.frames, 2), np.float32),
             "style": "box" if facts["filter"] == "BOX" else "blackman-harris"}
    reset = np.ones(options.frames, np.uint8) if still else first_only(options.frames)
    colour = [half["colour"] for half in halves]
    meta = {**facts, "renderer": "cycles", "reference_spp": 2 * half_spp,
            "planes": "denoising" if plain else "light"}
    return ((colour[0] + colour[1]) / 2, [variant | style for variant in variants],
            {"scale": scale, "seed": index, "scene": f"cycles.{facts['kind']}", "meta": meta,
             "reset": reset, "half": colour[1]})


def read_render(paths: list[Path], plain: bool,
                vectors: list[Path] | None = None) -> dict[str, np.ndarray]:
    """Planes (T, h, w, C) of a render, a file a frame; depth and roughness (T, h, w).

    ``plain``: the albedo is the one for Cycles' denoiser. ``vectors``: files that motion is read
    from instead.
    """
    found: dict[str, list[np.ndarray]] = {key: [] for key in NAMES}
    for number, path in enumerate(paths):
        planes = read_planes(path) | {"denoising_albedo": np.clip(
            read_pass(path, "Denoising Albedo"), 0, 1
        ), "denoising_normal": read_pass(path, "Denoising Normal")}
        if plain:
            planes |= {"diffuse_albedo": planes["denoising_albedo"],
                       "specular_albedo": np.zeros_like(planes["colour"])}
        if vectors:
            planes["motion"] = read_planes(vectors[number])["motion"]
        for key, values in found.items():
            values.append(planes[key] if key in planes
                          else np.zeros((*planes["colour"].shape[:2], 2), np.float32))
    stacked = {key: np.stack(values) for key, values in found.items()}
    stacked["depth"] = stacked["depth"][..., 0]
    return stacked | {"roughness": np.full(stacked["depth"].shape, NO_ROUGHNESS, np.float32)}


def read_motion(folder: Path, facts: dict[str, Any], frames: int, render: dict[str, Any],
                still: bool, scale: float) -> np.ndarray:
    """Motion (T, H, W, 2) at output size, in its pixels."""
    if not facts["blur"] or still:
        return render["motion"]
    small = np.stack([read_planes(vectors_file(folder, n))["motion"] for n in range(frames)])
    return scale * small.repeat(int(scale), 1).repeat(int(scale), 2)


def read_planes(path: Path) -> dict[str, np.ndarray]:
    """Planes (h, w, C) by name, through the project's own reader."""
    frame, = postfx.read_sequence(str(path))
    return {role.value: np.asarray(values, np.float32) for role, values in frame.planes.items()}


def shrink(render: dict[str, np.ndarray], scale: int) -> dict[str, np.ndarray]:
    """A render averaged over `scale` x `scale` pixels; depth and motion are picked from one of
    them, never mixed."""
    middle = scale // 2
    result = {}
    for name, values in render.items():
        t, h, w = values.shape[:3]
        cells = values.reshape(t, h // scale, scale, w // scale, scale, -1)
        one = cells[:, :, middle, :, middle] / (scale if name == "motion" else 1)
        result[name] = (one if name in ("depth", "motion") else cells.mean((2, 4))).reshape(
            t, h // scale, w // scale, *values.shape[3:])
    return result
