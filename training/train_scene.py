"""Trains the networks of one scene that the passes `scene_shading` and `irradiance` run.

    python -m training.train_scene points FRAMES REFERENCE MODEL.onnx [--steps 4000] [--hidden 64]
    python -m training.train_scene unet VIEWS MODELS ...
    python -m training.train_scene irradiance FRAMES REFERENCE MODEL.onnx [--steps 1000] ...

points: a network that sees each pixel alone, 33-64-64-64-3 by default. It reads place, normal and
mirrored view direction. It writes MODEL.onnx, and MODEL.json, which holds the scene's box.
irradiance: light by the normal alone (training.irradiance).
unet: all kinds of U-Net, with history and without (training.scene_network).

The first two read the planes of FRAMES, such as 'room.####.exr'. They learn the light of REFERENCE,
the same frames without noise, of the same size or a multiple of it, on the CPU without PyTorch.
Every fourth frame is held out, and the error there is printed.

    postfx run FRAMES -o OUT --pass scene_shading,model=MODEL.onnx
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import postfx
from postfx import Device, Frame, Pipeline, Role
from postfx.colour.views import to_codes
from postfx.errors import FrameError, PostfxError
from postfx.frame import ALBEDOS, DEPTH_MISS
from postfx.kernels.scene import POINT
from postfx.neural import Learner, Network
from postfx.passes.scene import SceneShading, camera_of
from postfx.passes.scene_points import (
    SceneBox,
    light_to_learn,
    places_of,
    points_of,
    reflectance_of,
)
from training import irradiance

BANDS = 4
"""Fourier features of a number: frequencies."""
ENCODED = 3
"""Numbers of a point, from the first on, that have them: its place."""
RATE = 4e-3
HELD_OUT = 4
"""Every so many frames one is held out."""
NEEDED = (Role.COLOUR, Role.DEPTH, Role.NORMAL, *ALBEDOS)


class Words(argparse.ArgumentParser):
    """The words of a network that sees each pixel alone."""

    def __init__(self, kind: str, steps: int, hidden: Sequence[int]) -> None:
        super().__init__(prog=f"python -m training.train_scene {kind}")
        self.add_argument("frames", help="sequence whose planes are read, such as 'room.####.exr'")
        self.add_argument("reference", help="the same frames without noise, whose light is learnt")
        self.add_argument("model", type=self._model, help="ONNX file to write")
        self.add_argument("--steps", type=int, default=steps, help="(default: %(default)s)")
        self.add_argument("--hidden", type=int, nargs="+", default=list(hidden),
                          help="widths of the layers between (default: %(default)s)")

    @staticmethod
    def _model(text: str) -> Path:
        path = Path(text)
        if path.suffix != ".onnx" or not path.parent.is_dir():
            raise argparse.ArgumentTypeError(f"{text}: give a file of the kind .onnx, in a folder "
                                             "that is there")
        return path


class Shown(NamedTuple):
    """Frames, each with its reference."""

    frames: list[Frame]
    references: list[Frame]

    @classmethod
    def read(cls, frames: str, reference: str) -> tuple[Shown, Shown]:
        """The frames to learn from, and those that are held out.

        Raises SequenceError if there is no such sequence, MissingFrameError if a frame has no
        reference.
        """
        planes = postfx.read_sequence(frames)
        every = cls(list(planes), list(postfx.read_sequence(reference, frames=planes.numbers)))
        at = range(len(every.frames))
        held = at[HELD_OUT - 1::HELD_OUT] or at[-1:]
        return every._of([k for k in at if k not in held] or at), every._of(held)

    def _of(self, picked: Iterable[int]) -> Shown:
        return Shown(*([frames[k] for k in picked] for frames in self))

    def lit(self) -> list[Frame]:
        """The frames with the light of their references."""
        return [replace(frame, planes={**frame.planes, Role.COLOUR: light_at(reference, frame)})
                for frame, reference in zip(*self, strict=True)]


def light_at(reference: Frame, frame: Frame) -> np.ndarray:
    """A reference's light at a frame's size: means over the pixels in each of its own.

    Raises FrameError if its size is no multiple.
    """
    (height, width), light = frame[Role.COLOUR].shape[:2], reference[Role.COLOUR]
    by = max(light.shape[0] // height, 1)
    if light.shape[:2] != (height * by, width * by):
        raise FrameError(f"reference {reference.number} is {light.shape[1]}x{light.shape[0]}, no "
                         f"multiple of its frame's {width}x{height}: render both for one size")
    means: np.ndarray = light.reshape(height, by, width, by, 3).mean((1, 3))
    return means


def box_of(frames: Sequence[Frame]) -> SceneBox:
    """Where the scene of some frames lies. FrameError if they lack planes or show nothing."""
    places = []
    for frame in frames:
        lacking = [str(role) for role in NEEDED if role not in frame.planes]
        if lacking:
            raise FrameError(f"frame {frame.number} has no {', '.join(lacking)}: render these "
                             "planes, too")
        is_hit = frame[Role.DEPTH][..., 0] < DEPTH_MISS
        places.append(places_of(camera_of(frame), frame[Role.DEPTH])[is_hit])
    found = np.concatenate(places)
    if not len(found):
        raise FrameError("no frame shows any surface: check the plane depth")
    return SceneBox.around(found)


def train_points(
    frames: Sequence[Frame], references: Sequence[Frame], hidden: Sequence[int], steps: int,
    model: Path
) -> Network:
    """Train a network of points and write its model and card; returns the network."""
    box, device = box_of(frames), Device("cpu")
    points = np.concatenate([points_of(camera_of(frame), frame[Role.DEPTH], frame[Role.NORMAL], box)
                             for frame in frames])
    targets = np.concatenate([
        light_to_learn(light_at(reference, frame),
                       reflectance_of(frame[Role.DIFFUSE_ALBEDO], frame[Role.SPECULAR_ALBEDO]))
        for frame, reference in zip(frames, references, strict=True)])
    network = Network(POINT, tuple(hidden), 3, "gelu", bands=BANDS, encoded=ENCODED)
    learner = Learner(device, network, seed=0)
    learner.fit(points, targets, steps, RATE)
    network.save_onnx(model, learner.parameters.download())
    model.with_suffix(".json").write_text(json.dumps(box.card(), indent=1) + "\n", encoding="utf-8")
    return network


def psnr(found: np.ndarray, truth: np.ndarray) -> float:
    """In dB, of code values of a display."""
    return float(-10 * np.log10(np.mean((to_codes(found, 1.0) - to_codes(truth, 1.0)) ** 2)))


def rel_mse(found: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared error of radiance in parts of the truth's square, with 0.01 added."""
    return float(np.mean((found - truth) ** 2 / (truth ** 2 + 0.01)))


def main_points(words: list[str]) -> None:
    """Train a network of points, and tell how near it is in frames that it has not seen."""
    given = Words("points", 4000, (64, 64, 64)).parse_args(words)
    seen, held = Shown.read(given.frames, given.reference)
    network = train_points(*seen, given.hidden, given.steps, given.model)
    way = Pipeline([SceneShading(model=str(given.model))], exposure=1.0)
    print(f"{len(seen.frames)} frames, {network.count} parameters")
    for frame, reference in zip(*held, strict=True):
        truth, shaded = light_at(reference, frame), way(frame)[Role.COLOUR]
        ways = ("held out", shaded), ("the render", frame[Role.COLOUR])
        told = (f"{name} {psnr(light, truth):.2f} dB, relMSE {rel_mse(light, truth):.4f}"
                for name, light in ways)
        print(f"frame {frame.number}: {'; '.join(told)}")


def main_unet(words: list[str]) -> None:
    """Train the U-Nets, which needs PyTorch."""
    from training import scene_network

    scene_network.main(words)


def main_irradiance(words: list[str]) -> None:
    """Train a network of normals, and tell its error in frames that it has not seen."""
    given = Words("irradiance", 1000, (16, 16)).parse_args(words)
    seen, held = (shown.lit() for shown in Shown.read(given.frames, given.reference))
    network, parameters = irradiance.train(seen, tuple(given.hidden), given.steps)
    network.save_onnx(given.model, parameters)
    usual, targets = (np.concatenate([irradiance.examples(frame)[1] for frame in frames])
                      for frames in (seen, held))
    print(f"{len(seen)} frames, {network.count} parameters; squared error of log light in "
          f"{len(held)} held out: {irradiance.error(network, parameters, held):.4f}, of the mean "
          f"irradiance {np.mean((targets - usual.mean(0)) ** 2):.4f}")


KINDS = {"points": main_points, "unet": main_unet, "irradiance": main_irradiance}


def main(words: list[str] | None = None) -> None:
    """Run the trainer of a kind with the words after it."""
    words = sys.argv[1:] if words is None else words
    as_written = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=as_written)
    parser.add_argument("kind", choices=KINDS)
    kind = parser.parse_args(words[:1]).kind
    try:
        KINDS[kind](words[1:])
    except PostfxError as error:
        parser.exit(2, f"error: {error}\n")


if __name__ == "__main__":
    main()
