"""postfx as nodes of ComfyUI: a rendered sequence in, denoise, upscale, look, files or images out.

Put this folder into ComfyUI's `custom_nodes`, or a link to it, and install postfx where ComfyUI
runs. The type POSTFX_FRAMES is a shot and what is to be done with it; the work is done frame by
frame where files or images are made, so that a long shot never lies in memory. Paths are in
ComfyUI's input and output folders.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import postfx
from postfx import Frame, Pipeline, Role
from postfx.colour.displays import srgb_decode, srgb_encode
from postfx.errors import OptionError
from postfx.frame import LINEAR
from postfx.io.pattern import parse_pattern

FRAMES = "POSTFX_FRAMES"


@dataclass(frozen=True)
class Shot:
    """Frames, and the passes that they will go through; iterating runs them."""

    frames: Callable[[], Iterable[Frame]]
    count: int
    passes: tuple[Callable[[], Any], ...] = ()

    def __iter__(self) -> Iterator[Frame]:
        pipeline, bar = Pipeline([make() for make in self.passes]), _progress(self.count)
        for frame in self.frames():
            yield pipeline(frame)
            bar()


def _progress(count: int) -> Callable[[], None]:
    """Moves ComfyUI's bar by a frame, and raises its error when the user has stopped the work."""
    try:
        from comfy.model_management import throw_exception_if_processing_interrupted
        from comfy.utils import ProgressBar
    except ImportError:  # the nodes are used without ComfyUI
        return lambda: None
    bar = ProgressBar(count)

    def step() -> None:
        bar.update(1)
        throw_exception_if_processing_interrupted()

    return step


def _path(kind: str, path: str) -> str:
    """A path in ComfyUI's "input" or "output" folder, which no path may leave: workflows come from
    other people."""
    try:
        import folder_paths
    except ImportError:  # the nodes are used without ComfyUI
        return os.path.expanduser(path)
    folder = (folder_paths.get_input_directory() if kind == "input"
              else folder_paths.get_output_directory())
    found = os.path.abspath(os.path.join(folder, os.path.expanduser(path)))
    folder = os.path.abspath(folder)
    if found != folder and not found.startswith(os.path.join(folder, "")):
        raise OptionError(f"'{path}' is outside of ComfyUI's {kind} folder: give "
                          f"one inside {folder}")
    return found


class LoadSequence:
    """Frames of a rendered sequence with all planes that the files hold."""

    CATEGORY, FUNCTION, RETURN_TYPES = "postfx", "load", (FRAMES,)

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {"required": {
            "pattern": ("STRING", {"default": "shot/noisy.####.exr", "tooltip": "####, %04d, a "
                                   "folder or one file; relative to ComfyUI's input folder"}),
            "frames": ("STRING", {"default": "", "tooltip": "such as 1-100x2; empty for all"})}}

    @classmethod
    def IS_CHANGED(cls, pattern: str | None, frames: str | None) -> str | float:
        """What the files are: a renderer may have written some anew."""
        if pattern is None:  # another node will give it
            return float("nan")
        files = postfx.read_sequence(_path("input", pattern), frames=frames or None).all_files()
        stamps = [(str(file), file.stat().st_mtime_ns, file.stat().st_size)
                  for file in sorted(files)]
        return hashlib.sha256(repr(stamps).encode()).hexdigest()

    def load(self, pattern: str, frames: str) -> tuple[Shot]:
        sequence = postfx.read_sequence(_path("input", pattern), frames=frames or None)
        sequence.refuse_holes(sequence.numbers)
        return (Shot(lambda: sequence, len(sequence)),)


class ImagesToFrames:
    """A batch of images as the frames of a shot. Pictures in sRGB are decoded to light."""

    CATEGORY, FUNCTION, RETURN_TYPES = "postfx", "convert", (FRAMES,)

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {"required": {"images": ("IMAGE",), "encoding": (["srgb", "linear"],)},
                "optional": {"albedo": ("IMAGE", {"tooltip": "reflectance, 0 to 1, linear"}),
                             "normals": ("IMAGE", {"tooltip": "0 to 1, for -1 to 1"})}}

    def convert(self, images: Any, encoding: str, albedo: Any = None,
                normals: Any = None) -> tuple[Shot]:
        for name, other in (("albedo", albedo), ("normals", normals)):
            if other is not None and len(other) != len(images):
                raise OptionError(f"there are {len(images)} images and {len(other)} of {name}: "
                                  "give one for each")

        def frames() -> Iterator[Frame]:
            for index in range(len(images)):
                picture = _array(images[index])[..., :3]
                planes = {Role.COLOUR: srgb_decode(picture) if encoding == "srgb" else picture}
                if albedo is not None:
                    planes[Role.DIFFUSE_ALBEDO] = _array(albedo[index])[..., :3]
                if normals is not None:
                    planes[Role.NORMAL] = 2 * _array(normals[index])[..., :3] - 1
                yield Frame(planes, number=index + 1)

        return (Shot(frames, len(images)),)


class Denoise:
    """Denoise and enlarge; frames before the present one help along their motion."""

    CATEGORY, FUNCTION, RETURN_TYPES = "postfx", "add", (FRAMES,)

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {"required": {
            "frames": (FRAMES,),
            "scale": ("FLOAT", {"default": 1.0, "min": 1.0, "max": 3.0, "step": 0.25}),
            "model": (["m", "s", "l", "xl"], {"tooltip": "s is the fastest, xl the cleanest"}),
            "strength": ("FLOAT", {"default": 1.0, "min": 0.0, "max": 1.0, "step": 0.05})}}

    def add(self, frames: Shot, scale: float, model: str, strength: float) -> tuple[Shot]:
        def make() -> Any:
            return postfx.DenoiseUpscale(scale=scale, model=model, strength=strength)

        make()  # wrong options are told here, not when frames are made
        return (replace(frames, passes=(*frames.passes, make)),)


class Look:
    """Tone-map light to a picture in sRGB."""

    CATEGORY, FUNCTION, RETURN_TYPES = "postfx", "add", (FRAMES,)

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        looks = [name.partition(".")[2]
                 for name in postfx.Library().names() if name.startswith("tonemap.")]
        return {"required": {"frames": (FRAMES,), "look": (looks, {"default": "aces2"})}}

    def add(self, frames: Shot, look: str) -> tuple[Shot]:
        return (replace(frames, passes=(*frames.passes, lambda: postfx.ToneMap(look=look))),)


class SaveFrames:
    """Write files, over those of the same names: EXR holds light, other formats pictures."""

    CATEGORY, FUNCTION, RETURN_TYPES, RETURN_NAMES = "postfx", "save", ("STRING",), ("files",)
    OUTPUT_NODE = True

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {"required": {"frames": (FRAMES,), "output": ("STRING", {
            "default": "clean/clean.####.exr", "tooltip": "relative to ComfyUI's output folder"})}}

    def save(self, frames: Shot, output: str) -> dict[str, Any]:
        pattern = parse_pattern(_path("output", output))
        if frames.count > 1 and not pattern.is_numbered:
            raise OptionError(f"output '{output}' has no place for the number of {frames.count} "
                              "frames: write ####")
        files = [str(postfx.write_frame(pattern.path(frame.number), frame)) for frame in frames]
        return {"ui": {"text": files}, "result": (str(pattern),)}


class FramesToImages:
    """A batch of images of all frames, for ComfyUI's other nodes; light is shown in sRGB, clipped
    at 1."""

    CATEGORY, FUNCTION, RETURN_TYPES = "postfx", "convert", ("IMAGE",)

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {"required": {"frames": (FRAMES,)}}

    def convert(self, frames: Shot) -> tuple[Any]:
        import torch

        pictures = []
        for frame in frames:
            colour = frame[Role.COLOUR]
            pictures.append(srgb_encode(np.clip(colour, 0, 1)) if frame.encoding in LINEAR
                            else colour)
        return (torch.from_numpy(np.stack(pictures).astype(np.float32)),)


def _array(image: Any) -> np.ndarray:
    found: np.ndarray = image.detach().cpu().float().numpy()
    return found


NODE_CLASS_MAPPINGS = {
    "PostfxLoadSequence": LoadSequence,
    "PostfxImagesToFrames": ImagesToFrames,
    "PostfxDenoise": Denoise,
    "PostfxLook": Look,
    "PostfxSaveFrames": SaveFrames,
    "PostfxFramesToImages": FramesToImages,
}
for _node in NODE_CLASS_MAPPINGS.values():
    setattr(_node, "DESCRIPTION", _node.__doc__)  # noqa: B010 the class does not declare it

NODE_DISPLAY_NAME_MAPPINGS = {
    "PostfxLoadSequence": "Load EXR sequence (postfx)",
    "PostfxImagesToFrames": "Images to frames (postfx)",
    "PostfxDenoise": "Denoise and upscale (postfx)",
    "PostfxLook": "Look (postfx)",
    "PostfxSaveFrames": "Save frames (postfx)",
    "PostfxFramesToImages": "Frames to images (postfx)",
}
