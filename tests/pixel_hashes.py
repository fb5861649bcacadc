"""Hashes of what the product writes, so that a change of its structure can be shown to change no
pixel.

    python -m tests.pixel_hashes write FILE [--only PATTERN]
    python -m tests.pixel_hashes check FILE [--only PATTERN]

`write` runs every case below and stores hashes as JSON; `check` runs the cases again and lists what
differs. Files are decoded first: pixels, channel names, windows and header entries count,
compressed bytes and dates do not. Hashes hold for one machine and one set of library versions, so
write them there from the commit to compare with.

Only the command line and the public library API are used. Sequences that other software rendered
are read from $POSTFX_SHARED or the folder `shared` beside the checkout; their cases are skipped by
name where it is absent.
"""

from __future__ import annotations

import argparse
import fnmatch
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

REPOSITORY = Path(__file__).resolve().parent.parent
ROOM = REPOSITORY / "samples" / "room"
SHARED = Path(os.environ.get("POSTFX_SHARED", REPOSITORY.parent / "shared"))
LIBRARIES = ("numpy", "onnxruntime", "OpenImageIO")
IGNORED = {"DateTime", "Software", "postfx:version", "oiio:SourcePath", "oiio:SourceFileFormat"}
TWO_CORES = ("--device", "cpu", "--threads", "2", "--run-up", "0")

Hashes = dict[str, Any]
Planes = dict[str, np.ndarray]


@dataclass(frozen=True)
class Case:
    """One command line, whose output files go to a folder of their own.

    Attributes:
        name: unique, for messages and patterns.
        source: the frames: a made sequence's name, 'room', or a path below the shared folder.
        options: of `postfx run`, after the input; '{made}' stands for the folder of made sequences,
            '{shared}' for the shared one.
        output: name of the output files.
        frames: to process.
        environment: variables to set.
        code: exit code to expect.
    """

    name: str
    source: str
    options: str = ""
    output: str = "clean.####.exr"
    frames: str = "1-3"
    environment: Mapping[str, str] = field(default_factory=dict)
    code: int = 0


def list_cases() -> Iterator[Case]:
    """All command lines, the quick and most telling ones first."""
    for model in ("s", "m", "l"):
        for precision in ("int8", "fp32"):
            yield Case(f"{model}.{precision}-2x", "room", f"--model {model}.{precision}")
    for model in ("s.int8", "s.fp32", "m.int8", "m.fp32", "l.int8"):
        yield Case(f"{model}-1x", "room", f"--model {model} --scale 1", frames="1-2")
    for model, scale in (("s.int8", 1.5), ("m.int8", 1.5), ("m.fp32", 1.5), ("l.fp32", 1.5),
                         ("s.fp32", 3)):
        yield Case(f"{model}-{scale}x", "room", f"--model {model} --scale {scale}", frames="1-2")
    yield Case("odd-size-2x", "odd", "--model m.int8")
    yield Case("odd-size-1.7x", "odd", "--model s.fp32 --scale 1.7")
    yield Case("fixed-size", "room", "--size 500x281 --model s")
    yield Case("changing-size", "changing", "--size 480x270 --model s", frames="1-4")
    for model in ("m.int8", "m.fp32", "s.int8"):
        yield Case(f"guides-{model}", "room", f"--guides {{made}}/guides.####.exr --model {model}")
    yield Case("guides-memory", "room", "--guides {made}/guides.####.exr --memory 465M",
               frames="1-2")
    yield Case("strength-0", "room", "--strength 0", frames="1")
    yield Case("strength-0.5", "room", "--strength 0.5 --model s")
    for model in ("m.int8", "m.fp32", "l.int8"):
        yield Case(f"window-{model}", "window", f"--model {model}")
    yield Case("window-1.5x", "window", "--model s.int8 --scale 1.5")
    yield Case("window-1x", "window", "--model s.int8 --scale 1", frames="1-2")
    yield Case("window-guides", "window", "--guides {made}/guides.####.exr")
    yield Case("leave-auto", "window", "--leave auto --model s")
    yield Case("leave-id", "masks", "--leave 7@id,3-4@id=0.5 --model s")
    yield Case("leave-cryptomatte", "masks", "--leave logo,wall_*=0.25 --model m")
    yield Case("leave-converged", "masks", "--leave converged:0.05 --model s")
    yield Case("leave-samples", "masks", "--leave converged:16spp --model s")
    yield Case("reactive-plane", "reactive", "--reactive plane --model m")
    yield Case("reactive-difference", "opaque", "--reactive auto,scale=8 --model s")
    yield Case("reflections", "mirror", "--model m")
    yield Case("reflections-window", "mirror", "--model s --leave 7@id")
    yield Case("memory", "room", "--memory 425M --model m")
    yield Case("memory-l.fp32", "room", "--memory 410M --model l.fp32", frames="1-2")
    yield Case("memory-window", "window", "--memory 425M --model s --run-up 2")
    yield Case("memory-1x", "room", "--memory 425M --model s --scale 1", frames="1-2")
    yield Case("both-ways", "room", "--both-ways --model m")
    yield Case("both-ways-fp32-png", "room", "--both-ways --model s.fp32 --scale 1.5", "p.####.png",
               "2-4")
    yield Case("run-up", "room", "--run-up 3 --model m", frames="2-3")
    yield Case("run-up-cuts", "room", "--run-up 2 --model s --cuts 1,4", frames="3-5")
    yield Case("preroll", "room", "--preroll 2 --model s --exposure smooth", "p.####.png", "4-5")
    yield Case("overlay", "overlay", "--model s")
    yield Case("overlay-separate", "overlay", "--model s --overlay separate")
    yield Case("overlay-ignore-png", "overlay", "--model s --overlay ignore", "p.####.png", "1-2")
    yield Case("overlay-png", "overlay", "--model s --scale 1.5", "p.####.png", "1-2")
    yield Case("keep-none", "masks", "--keep none --model s", frames="1")
    yield Case("keep-all-no-denoise", "masks", "--no-denoise", frames="1")
    yield Case("no-denoise-exr-look", "room", "--no-denoise --tonemap", frames="1")
    for look in ("aces2", "agx", "pbr_neutral", "local", "auto", "reinhard", "neutral", "ocio:"):
        yield Case(f"look-{look.strip(':')}", "room", f"--no-denoise --tonemap {look}",
                   "p.####.png", "1-2")
    yield Case("look-table", "room", "--no-denoise --tonemap {made}/film.cube,input=ACEScct",
               "p.####.png", "1")
    yield Case("look-denoised", "room", "--model s --tonemap local", "p.####.png")
    yield Case("look-memory", "room", "--model s --memory 425M --tonemap auto", "p.####.png", "1-2")
    for name, options in {"p3": "p3 --tonemap agx", "rec2020": "rec2020 --no-tonemap",
                          "pq": "pq,peak=600",
                          "hlg": "hlg --tonemap ocio:", "rec709": "rec709 --dither static"}.items():
        yield Case(f"display-{name}", "room", f"--no-denoise --display {options}", "p.####.png",
                   "1")
    yield Case("dither-none-tiff", "room", "--no-denoise --dither none --exposure 0.5",
               "p.####.tif", "1")
    yield Case("jpeg", "room", "--no-denoise --exposure metadata", "p.####.jpg", "1")
    yield Case("colourspace", "room", "--model s --colourspace acescg", frames="1")
    yield Case("exposure-tool", "room", "--model s", "p.####.png", "1-2",
               {"POSTFX_EXPOSURE_TOOL": "1"})
    yield Case("broken-copy", "broken", "--on-error copy --model s", frames="1-4", code=3)
    yield Case("broken-skip", "broken", "--on-error skip --model s", frames="1-4", code=3)
    yield Case("nonfinite", "nonfinite", "--model m")
    yield Case("shared-living-room", "sequences/living_room/noisy.####.exr", "--model m.fp32",
               frames="1-2")
    yield Case("shared-living-room-guides", "sequences/living_room/noisy.####.exr",
               "--guides {shared}/sequences/living_room/guides.####.exr --both-ways", frames="1-2")
    yield Case("shared-staircase-guides", "sequences/staircase/noisy.####.exr",
               "--guides {shared}/sequences/staircase/guides.####.exr --model m.fp32", frames="1-2")
    yield Case("shared-staircase-1x", "sequences/staircase/noisy.####.exr",
               "--model m.fp32 --scale 1", frames="1-2")
    yield Case("shared-garage", "sequences/garage/noisy.####.exr", "--model m", frames="3-4")
    yield Case("shared-garage-part", "sequences/garage/interleaved.0001.exr", "--model l",
               "p.####.png", "1")
    yield Case("shared-mist", "sequences/mist/noisy.####.exr", "--model l.int8 --leave auto",
               frames="1-2")
    yield Case("shared-doorway", "sequences/doorway/noisy.####.exr", "--model s", "p.####.png",
               "1-2")
    yield Case("shared-names", "exr/gaffer/weirdPartNames.exr", "--no-denoise", "clean.exr", "")
    yield Case("shared-deep", "exr/gaffer/representativeDeepImage.exr", "--no-denoise", "clean.exr",
               "", code=2)


def run_case(case: Case, made: Path, output: Path) -> None:
    """Run a command line in a process of its own.

    Raises RuntimeError when it ends with another code than the case expects.
    """
    source = {"room": ROOM / "noisy.####.exr"}.get(case.source)
    source = source or (SHARED / case.source if "/" in case.source
                        else made / f"{case.source}.####.exr")
    options = case.options.format(made=made, shared=SHARED).split()
    frames = ("--frames", case.frames) if case.frames else ()
    command = (sys.executable, "-m", "postfx", "run", str(source), "-o", case.output, *frames,
               *TWO_CORES, *options)
    run(command, output, case.code, dict(case.environment))


def run(command: tuple[str, ...], folder: Path, code: int = 0,
        environment: Mapping[str, str] | None = None) -> None:
    done = subprocess.run(command, cwd=folder, env={**os.environ, **(environment or {})}, text=True,
                          capture_output=True)
    if done.returncode != code:
        raise RuntimeError(f"exit code {done.returncode}, not {code}: {' '.join(command)}\n"
                           f"{done.stderr}")


# Sequences made of the sample room. They are written without the product, so that they do not
# change with it.

def make_sequences(folder: Path) -> None:
    """Write all sequences that the cases read, and a look-up table."""
    for number in range(1, 5):
        channels, header = read_room(number)
        height, width = channels["R"].shape
        rows, columns = np.mgrid[:height, :width].astype(np.float32)

        def write(name: str, extra: Planes, header: oiio.ImageSpec = header,
                  channels: Planes = channels, number: int = number) -> None:
            write_exr(folder / f"{name}.{number:04d}.exr", channels | extra, header)

        random = np.random.default_rng(number)
        left, top = 40 + 8 * number, 30 + 4 * number
        inside = ((rows >= top) & (rows < top + 64) & (columns >= left)
                  & (columns < left + 90)).astype(np.float32)
        ramp = np.clip((columns - left) / 60, 0, 1) * inside
        write("window", {"strength.Y": ramp})
        write("masks", make_masks(inside, random, channels))
        write("reactive",
              {"reactive.Y": np.clip(1.5 - np.hypot(rows - 90, columns - 20 * number) / 30, 0, 1)})
        write("opaque",
              {f"opaque_colour.{name}": channels[name] * (1 - 0.5 * inside) for name in "RGB"})
        distance = 1 + 4 * np.abs(np.sin(rows / 40) * np.cos(columns / 60)).astype(np.float32)
        rough = np.where(columns < 200, 0.02, channels["roughness.Y"]).astype(np.float32)
        write("mirror",
              {"specular_hit_distance.Y": distance, "roughness.Y": rough, "id.Y": 7 * (1 - inside)})
        cover = (0.7 * np.exp(-((rows - 80) ** 2 + (columns - 90 - 3 * number) ** 2)
                              / 1800)).astype(np.float32)
        colour = {"R": 2, "G": 0.4, "B": 0.1, "A": 1}
        write("overlay", {f"overlay.{name}": cover * share for name, share in colour.items()})
        bad = {name: channels[name].copy() for name in "RGB"}
        bad["R"][50:53, 60], bad["G"][100, 10:14], bad["B"][70, 200] = np.nan, np.inf, -np.inf
        write("nonfinite", bad)
        odd = {name: plane[:91, :161] for name, plane in channels.items()}
        write_exr(folder / f"odd.{number:04d}.exr", odd, header)
        part = np.s_[:180, :320] if number != 3 else np.s_[:162, :288]
        changing = {name: plane[part] for name, plane in channels.items()}
        write_exr(folder / f"changing.{number:04d}.exr", changing, header)
        write_exr(folder / f"broken.{number:04d}.exr", channels, header)
        guides = {name: plane.repeat(2, 0).repeat(2, 1) for name, plane in channels.items()
                  if name.partition(".")[0] in ("albedo", "normal", "roughness", "depth",
                                                "specular_albedo")}
        write_exr(folder / f"guides.{number:04d}.exr", guides, header)
    broken = folder / "broken.0003.exr"
    broken.write_bytes(broken.read_bytes()[:60_000])
    write_table(folder / "film.cube")


def make_masks(inside: np.ndarray, random: np.random.Generator, channels: Planes) -> Planes:
    """Ids, a Cryptomatte of one rank pair, variance and sample counts."""
    ids = np.where(inside > 0, 7, 2 + np.arange(inside.shape[1]) // 80).astype(np.float32)
    names = {"logo": hash_name("logo"), "wall_a": hash_name("wall_a"), "floor": hash_name("floor")}
    left = (np.arange(inside.shape[1]) < 100).astype(np.float32) * np.ones_like(inside)
    first = np.where(inside > 0, names["logo"],
                     np.where(left > 0, names["wall_a"], names["floor"])).astype(np.float32)
    share = (0.5 + 0.5 * random.random(inside.shape)).astype(np.float32)
    planes = {"id.Y": ids, "CryptoObject00.R": first, "CryptoObject00.G": share,
              "CryptoObject00.B": np.full_like(first, names["floor"]),
              "CryptoObject00.A": 1 - share}
    spread = (random.random(inside.shape) * 0.02 * (1 - inside)).astype(np.float32)
    planes |= {f"sample_variance.{name}": spread * channels[name] ** 2 for name in "RGB"}
    return planes | {"sample_count.Y": np.where(inside > 0, 32, 4).astype(np.float32)}


def hash_name(name: str) -> np.float32:
    """An object's id in a Cryptomatte: MurmurHash3 of its name as a float that is finite."""
    return np.uint32(murmur(name.encode())).view(np.float32)


def murmur(data: bytes) -> int:
    """MurmurHash3, 32 bits, seed 0, without the exponents of infinity and zero (Cryptomatte
    1.2.0)."""
    mask, state = 0xFFFFFFFF, 0
    for start in range(0, len(data), 4):
        block = data[start : start + 4]
        word = int.from_bytes(block, "little") * 0xCC9E2D51 & mask
        word = ((word << 15 | word >> 17) & mask) * 0x1B873593 & mask
        state ^= word
        if len(block) == 4:
            state = ((state << 13 | state >> 19) & mask) * 5 + 0xE6546B64 & mask
    state ^= len(data)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        state = (state ^ state >> shift) * factor & mask
    state ^= state >> 16
    return state ^ 1 << 23 if state >> 23 & 255 in (0, 255) else state


def read_room(number: int) -> tuple[Planes, oiio.ImageSpec]:
    picture = oiio.ImageBuf(str(ROOM / f"noisy.{number:04d}.exr"))
    pixels = picture.get_pixels(oiio.FLOAT)
    assert pixels is not None, number
    return ({name: pixels[..., i] for i, name in enumerate(picture.spec().channelnames)},
            picture.spec())


def write_exr(path: Path, channels: Planes, header: oiio.ImageSpec) -> None:
    height, width = channels[next(iter(channels))].shape
    spec = oiio.ImageSpec(width, height, len(channels), "float")
    spec.channelnames = tuple(channels)
    for attribute in header.extra_attribs:
        if attribute.name.startswith("postfx:") or attribute.name == "worldToCamera":
            spec.attribute(attribute.name, attribute.type, attribute.value)
    if "CryptoObject00.R" in channels:
        spec.attribute("cryptomatte/abcdef0/name", "CryptoObject")
        spec.attribute("cryptomatte/abcdef0/hash", "MurmurHash3_32")
        spec.attribute("cryptomatte/abcdef0/conversion", "uint32_to_float32")
        spec.attribute("cryptomatte/abcdef0/manifest", json.dumps(
            {name: f"{murmur(name.encode()):08x}" for name in ("logo", "wall_a", "floor")}))
    output = oiio.ImageOutput.create(str(path))
    assert output is not None, path
    if not (output.open(str(path), spec)
            and output.write_image(np.stack(list(channels.values()), axis=-1).astype(np.float32))):
        raise RuntimeError(output.geterror())
    output.close()


def write_table(path: Path) -> None:
    """A warm look with more contrast, as a table of 9 by 9 by 9 colours."""
    axis = np.linspace(0, 1, 9)
    blue, green, red = np.meshgrid(axis, axis, axis, indexing="ij")
    colours = np.stack([red**1.2, green**1.3, 0.9 * blue**1.4], -1).reshape(-1, 3)
    path.write_text("LUT_3D_SIZE 9\n" + "".join(f"{r:.6f} {g:.6f} {b:.6f}\n"
                                                for r, g, b in colours))


# The library, as scripts use it.

def hash_library(made: Path) -> Iterator[tuple[str, Hashes]]:
    """Planes that pipelines return, by case."""
    for name, run_frames in LIBRARY_CASES.items():
        yield name, {f"frame {index}": {str(role): hash_array(plane) for role, plane in
                                        sorted({**frame.planes, **frame.parts}.items())}
                     for index, frame in enumerate(run_frames(made), 1)}


def run_picture(made: Path) -> Iterator[Any]:
    import postfx

    passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=1.5), postfx.ToneMap()], exposure="auto")
    return map(passes, postfx.read_sequence(ROOM / "noisy.####.exr", frames="1-3"))


def run_windows(made: Path) -> Iterator[Any]:
    import postfx

    passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=2, model="s", strength=0.8)])
    return map(passes, postfx.read_sequence(made / "window.####.exr", frames="1-3"))


def run_both_ways(made: Path) -> Iterator[Any]:
    import postfx

    shot = postfx.read_sequence(ROOM / "noisy.####.exr", frames="1-4")
    later = postfx.Backwards(shot, model="s")
    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="s"), postfx.BothWays()])
    return (passes(later(frame)) for frame in shot)


def run_overlay(made: Path) -> Iterator[Any]:
    import postfx

    shot = postfx.read_sequence(made / "overlay.####.exr", frames="1-3")
    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="s"), postfx.Overlay()],
                             run_up=postfx.RunUp(shot))
    return map(passes, shot)


def run_with_states(made: Path) -> Iterator[Any]:
    """A pipeline that is reset in the middle, and sees a frame without motion."""
    import postfx

    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="m.fp32")])
    for frame in postfx.read_sequence(ROOM / "noisy.####.exr", frames="1-4"):
        if frame.number == 3:
            frame.reset = True
        if frame.number == 2:
            frame.planes[postfx.Role.MOTION] = np.zeros_like(frame.planes[postfx.Role.MOTION])
        yield passes(frame)


def run_parts(**options: Any) -> Callable[[Path], Iterator[Any]]:
    """Parts of each kind and noisy alpha beside the picture, with these options of the denoiser."""
    def run_frames(_: Path) -> Iterator[Any]:
        import postfx
        from postfx.frame import Part, Role

        parts = ("key", "fill", Part("diffuse", "diffuse", "kinds", "albedo"),
                 Part("gloss", "specular", "kinds"), Part("lamps", "emission", "kinds"),
                 Part("mist", "mist"), Part("z", "depth"), Part("place", "position"),
                 Part("n", "normal"), Part("albedo", "factor"))
        passes = postfx.Pipeline([postfx.DenoiseUpscale(parts=parts, **options)], exposure=0.5)
        for frame in postfx.read_sequence(ROOM / "noisy.####.exr", frames="1-3"):
            colour, random = frame.planes[Role.COLOUR], np.random.default_rng(frame.number)
            shares = random.random((5, *colour.shape[:2], 1), np.float32)
            shares[1, :, : colour.shape[1] // 3] = 0
            albedo = frame.planes[Role.DIFFUSE_ALBEDO]
            frame.parts = {"key": colour * shares[0], "fill": colour * (1 - shares[0]),
                           "diffuse": colour * shares[1] * albedo, "gloss": colour * shares[2],
                           "lamps": colour * (shares[1] > 0.9), "mist": shares[3],
                           "z": frame.planes[Role.DEPTH], "place": colour - 0.5,
                           "n": frame.planes[Role.NORMAL], "albedo": albedo}
            frame.planes[Role.ALPHA] = (shares[4] * (shares[3] > 0.5)).astype(np.float32)
            frame.jitter = (0.0, 0.0) if options.get("scale") == 1 else frame.jitter
            yield passes(frame)
    return run_frames


def run_denoiser(change: Callable[[Any], None] = lambda _: None,
                 **options: Any) -> Callable[[Path], Iterator[Any]]:
    """The denoiser with these options over changed frames of the sample room."""
    def run_frames(_: Path) -> Iterator[Any]:
        import postfx

        passes = postfx.Pipeline([postfx.DenoiseUpscale(**options)])
        for frame in postfx.read_sequence(ROOM / "noisy.####.exr", frames="1-3"):
            change(frame)
            yield passes(frame)
    return run_frames


def hold_still(frame: Any) -> None:
    """Samples spread over the pixel, and many of them, so that detail may come back."""
    frame.jitter, frame.samples = (0.0, 0.0), 256


def take_outside(frame: Any) -> None:
    """Light outside of the gamut, as of a saturated lamp in wider primaries."""
    from postfx.frame import Role

    frame.planes[Role.COLOUR] = frame.planes[Role.COLOUR] * np.array((1.2, 1, -0.3), np.float32)


def leave_half(frame: Any) -> None:
    """Strength that varies in a box, is 1 below and 0 above."""
    from postfx.frame import Role

    hold_still(frame)
    height, width = frame.planes[Role.COLOUR].shape[:2]
    strength = np.zeros((height, width, 1), np.float32)
    strength[height // 4:] = np.linspace(0, 1, width, dtype=np.float32)[:, None]
    strength[height // 3:] = 1
    frame.planes[Role.STRENGTH] = strength


LIBRARY_CASES: dict[str, Callable[[Path], Iterator[Any]]] = {
    "library-picture": run_picture, "library-window": run_windows,
    "library-both-ways": run_both_ways,
    "library-overlay": run_overlay, "library-reset": run_with_states,
    "library-parts": run_parts(model="s"),
    "library-parts-fp32": run_parts(model="s.fp32", scale=1.5),
    "library-parts-1x": run_parts(model="m", scale=1),
    "library-parts-own": run_parts(model="s", part_filters="own"),
    "library-parts-strength": run_parts(model="s", strength=0.5),
    "library-parts-strength-0": run_parts(model="s", strength=0),
    "library-detail": run_denoiser(hold_still, model="m"),
    "library-detail-strength": run_denoiser(leave_half, model="s"),
    "library-wider": run_denoiser(take_outside, model="s", scale=2),
    "library-classic": run_denoiser(model="classic", scale=2),
    "library-error": run_denoiser(model="l", error=True)}


# Hashes.

def hash_array(array: np.ndarray) -> str:
    held = np.ascontiguousarray(array)
    return hashlib.sha256(f"{held.dtype} {held.shape} ".encode() + held.tobytes()).hexdigest()[:20]


def hash_text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def hash_files(folder: Path) -> Hashes:
    """Every picture below a folder, decoded, by its name."""
    return {str(path.relative_to(folder)): hash_file(path) for path in sorted(folder.rglob("*"))
            if path.suffix in (".exr", ".png", ".tif", ".jpg")}


def hash_file(path: Path) -> Hashes:
    """Each part of a file: its window, channels, pixels and header entries."""
    found: Hashes = {}
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise RuntimeError(f"{path}: {oiio.geterror()}")
    part = 0
    while source.seek_subimage(part, 0):
        spec = source.spec()
        window = (spec.x, spec.y, spec.width, spec.height, spec.full_x, spec.full_y,
                  spec.full_width, spec.full_height)
        formats = map(str, spec.channelformats or (spec.format,) * spec.nchannels)
        channels = " ".join(f"{name}:{kind}"
                            for name, kind in zip(spec.channelnames, formats, strict=True))
        found[f"part {part}"] = {"window": " ".join(map(str, window)), "channels": channels,
                                 "pixels": "deep" if spec.deep else hash_pixels(source, part, spec),
                                 "header": {entry.name: hash_text(f"{entry.type} {entry.value}")
                                            for entry in spec.extra_attribs
                                            if entry.name not in IGNORED}}
        part += 1
    source.close()
    return found


def hash_pixels(source: oiio.ImageInput, part: int, spec: oiio.ImageSpec) -> Hashes:
    """Each channel in its own type, so that a message can name it."""
    kinds = spec.channelformats or (spec.format,) * spec.nchannels
    return {name: hash_array(np.asarray(source.read_image(part, 0, index, index + 1, kind)))
            for index, (name, kind) in enumerate(zip(spec.channelnames, kinds, strict=True))}


def list_differences(stored: Any, found: Any, place: str = "") -> Iterator[str]:
    """Places where two trees of hashes differ."""
    if not (isinstance(stored, dict) and isinstance(found, dict)):
        if stored != found:
            yield f"{place}: was {stored}, is {found}"
        return
    for key in sorted({*stored, *found}):
        if key not in stored or key not in found:
            yield f"{place} / {key}: {'is new' if key in found else 'is gone'}"
        else:
            yield from list_differences(stored[key], found[key],
                                        f"{place} / {key}" if place else key)


def hash_all(pattern: str) -> Hashes:
    """All cases whose names fit a pattern; a case that fails has its error in place of hashes."""
    import postfx

    if not Path(postfx.__file__).is_relative_to(REPOSITORY):
        raise SystemExit(f"postfx is imported from {postfx.__file__}, not from {REPOSITORY}")
    results: Hashes = {}
    with tempfile.TemporaryDirectory(prefix="pixel-hashes-") as folder:
        made = Path(folder) / "made"
        made.mkdir()
        make_sequences(made)
        for case in list_cases():
            if not fnmatch.fnmatch(case.name, pattern):
                continue
            if "/" in case.source and not SHARED.is_dir():
                print(f"skipped {case.name}: {SHARED} is absent")
                continue
            output, begun = Path(folder) / case.name, time.perf_counter()
            output.mkdir()
            try:
                run_case(case, made, output)
                results[case.name] = hash_files(output)
            except RuntimeError as error:
                results[case.name] = {"error": str(error)}
                print(f"FAILED {case.name}: {error}", file=sys.stderr)
            print(f"{time.perf_counter() - begun:5.1f} s  {case.name}", flush=True)
        if any(fnmatch.fnmatch(name, pattern) for name in LIBRARY_CASES):
            results |= {name: hashes
                        for name, hashes in hash_library(made) if fnmatch.fnmatch(name, pattern)}
    return results


def describe_machine() -> dict[str, str]:
    return {"processor": platform.processor() or platform.machine(),
            **{name: version(name) for name in LIBRARIES}}


def check(stored: Mapping[str, Any], results: Hashes, pattern: str) -> int:
    """Print what differs; returns the number of differences."""
    machine = describe_machine()
    if stored["machine"] != machine:
        print(f"warning: hashes were written with {stored['machine']}, this is {machine}")
    known = {name: hashes
             for name, hashes in stored["cases"].items() if fnmatch.fnmatch(name, pattern)}
    known = {name: hashes
             for name, hashes in known.items() if name in results or not name.startswith("shared-")}
    differences = list(list_differences(known, results))
    print("\n".join(differences[:60]))
    cases = {line.partition(" / ")[0].lstrip(" /") for line in differences}
    print(f"{len(results)} cases, {len(differences)} differences in "
          f"{', '.join(sorted(cases)) or 'none'}")
    return len(differences)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("verb", choices=("write", "check"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", default="*", metavar="PATTERN",
                        help="cases by name, e.g. 'window-*'")
    arguments = parser.parse_args()
    results = hash_all(arguments.only)
    if arguments.verb == "check":
        return 1 if check(json.loads(arguments.file.read_text()), results, arguments.only) else 0
    held = {"machine": describe_machine(), "cases": results}
    arguments.file.write_text(json.dumps(held, indent=1, sort_keys=True) + "\n")
    print(f"{len(results)} cases in {arguments.file}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
