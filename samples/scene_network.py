"""Networks that know one scene shade its frames from planes, in a command buffer, and are measured.

python samples/scene_network.py [PICTURE] [--models FOLDER] \\
    [--noisy PATTERN --reference PATTERN] [--views FOLDER]

The networks are those of `python -m training.scene_network`: shading.onnx from planes alone,
temporal.onnx from planes and its state of the frame before, and amplifier.onnx from planes and one
sample a pixel. On a sequence: PSNR after x/(1+x) and the sRGB curve, relMSE of light, and flicker,
also of temporal.onnx without history. On held-out views, by `python -m training.datagen.make_sample
views`: both, as they are and without the noise of the reference, which its two halves tell, also of
the mean of what shading.onnx makes of planes through several positions in the pixel; and how many
samples a pixel have the relMSE of amplifier.onnx, by a stack of independent one-sample images.
Prints milliseconds a frame; draws frames. Needs matplotlib, the extra 'bench'.
"""
import argparse
import statistics
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from sky import cleaned, shown

import postfx
from postfx import Device, Frame, Library, Role
from postfx.runtime import ArgumentTable
from postfx.tools.bench.metrics import Pictures, flicker

ROOM = Path(__file__).parent / "room"
WAYS = ("shading", "temporal", "temporal, no history", "amplifier")


class Shader:
    """A network of a scene at one size, and its state."""

    def __init__(self, device: Device, library: Library, kind: str, size: tuple[int, int]) -> None:
        self._device, self._size, self.times = device, size, []
        self._network = device.pipeline_state(library, kind,
                                              dict(zip(("height", "width"), size, strict=True)))
        self._shaded = device.heap.tensor("shaded", (*size, 3))
        self._states = [device.heap.tensor(name, self._network.shapes[name])
                        for name in ("before", "after") if name in self._network.shapes]
        self._given, self._kind = {}, kind
        self.forget()

    def forget(self) -> None:
        """Begin without history."""
        for state in self._states[:1]:
            state.fill(0)

    @property
    def taken(self) -> float:
        """Milliseconds of a frame, without the first one."""
        return statistics.median(self.times[1:] or self.times)

    def __call__(self, planes: dict[str, np.ndarray]) -> np.ndarray:
        """Shaded frame (H, W, 3) of planes (H, W, C) and camera (16,)."""
        bound = {"shaded": self._shaded}
        if self._kind == "temporal":
            bound |= dict(zip(("before", "after"), self._states, strict=True))
        for name in {one.name for one in self._network.bindings} - set(bound):
            if name not in self._given:
                self._given[name] = self._device.heap.tensor(name, planes[name].shape)
            self._given[name].upload(np.ascontiguousarray(planes[name], np.float32))
            bound[name] = self._given[name]
        commands = self._device.command_buffer("shade")
        with commands.machine_learning_encoder("shade") as encoder:
            encoder.dispatch_network(self._network, ArgumentTable(self._network, bound))
        commands.commit()
        commands.wait()
        self.times.append(sum(taken for _, taken in commands.timings))
        self._states.reverse()
        return self._shaded.download()


def planes_of(frame: Frame) -> dict[str, np.ndarray]:
    """What the networks read of a frame."""
    height, width = frame[Role.DEPTH].shape[:2]
    to_world, tangent = np.linalg.inv(frame.world_to_camera.T), np.tan(np.radians(frame.fov_x) / 2)
    camera = [*to_world[:3, :4].T.ravel(), tangent, tangent * height / width, *frame.jitter]
    return {role.value: frame[role] for role in frame.planes} | {"camera": np.float32(camera)}


def decibels(error: float) -> float:
    return float(-10 * np.log10(max(error, 1e-12)))


DARK = 0.01
"""Added to the squared reference in relMSE, so that black pixels do not decide it."""


def errors_of(light: np.ndarray, other: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Mean squared difference of codes, which hide what is near white, and relMSE of light, of all
    pixels."""
    codes = np.mean((shown(np.maximum(light, 0)) - shown(np.maximum(other, 0))) ** 2)
    difference = light.astype(np.float64) - other
    return np.array([codes, np.mean(difference**2 / (reference.astype(np.float64)**2 + DARK))])


def equivalent_samples(own: float, counts: np.ndarray, curve: np.ndarray) -> float:
    """How many samples a pixel have this error, by that of the means of `counts` images; beyond the
    last by 1/n."""
    if own <= curve[-1]:
        return float(counts[-1] * curve[-1] / own)
    falling = np.minimum.accumulate(curve)
    return float(np.exp(np.interp(-np.log(own), -np.log(falling), np.log(counts))))


parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
parser.add_argument("picture", nargs="?", type=Path,
                    default=Path(tempfile.gettempdir()) / "scene_network.png")
parser.add_argument("--models", type=Path, default=ROOM,
                    help="folder of the networks, or of some of them")
parser.add_argument("--noisy", default=str(ROOM / "noisy.####.exr"), help="whose planes are read")
parser.add_argument("--reference", default=str(ROOM / "reference.####.exr"))
parser.add_argument("--clean", action="store_true",
                    help="denoise the reference by OIDN: its noise flickers, too")
parser.add_argument("--views", type=Path, help="folder of held-out views, held.NNNN.npz")
parser.add_argument("--device", default="cpu")
parser.add_argument("--threads", type=int, default=1)
parser.add_argument("--runs", type=int, default=5, help="more runs of a frame, for the times")
chosen = parser.parse_args()

device = (Device(chosen.device, threads=chosen.threads) if chosen.device == "cpu"
          else Device(chosen.device))
library, pictures = Library(chosen.models), []
frames = list(postfx.read_sequence(chosen.noisy))
size = frames[0][Role.DEPTH].shape[:2]
lights = [frame[Role.COLOUR] for frame in postfx.read_sequence(chosen.reference)]
lights = [cleaned(light) for light in lights] if chosen.clean else lights
truths = [light.reshape(size[0], -1, size[1], light.shape[1] // size[1], 3).mean((1, 3))
          for light in lights]
print(f"{len(frames)} frames of {size[1]}x{size[0]}: {chosen.noisy}" + ", reference "
      "denoised" * chosen.clean)
ways = [way for way in WAYS if way.split(",")[0] in library.names()]
for way in [way for way in ways if way != "amplifier"]:
    shader = Shader(device, library, way.split(",")[0], size)
    errors = []
    flickers = []
    before = None
    for frame, truth in zip(frames, truths, strict=True):
        if "no history" in way or frame.reset:
            shader.forget()
        found = shader(planes_of(frame))
        now = Pictures(shown(np.maximum(found, 0)), shown(truth))
        errors.append(errors_of(found, truth, truth))
        if before:
            flickers.append(flicker(before, now, frame[Role.MOTION]))
        before = now
    pictures += ([("reference", truth)] * (way == ways[0])
                 + [(f"{way}, {decibels(errors[-1][0]):.1f} dB", found)])
    for _ in range(chosen.runs):
        shader(planes_of(frame))
    codes, relative = np.mean(errors, 0)
    print(f"{way:22} {decibels(codes):6.2f} dB  relMSE {relative:.5f}  flicker "
          f"{np.mean(flickers):6.2f}  {shader.taken:8.2f} ms a frame, {1000 / shader.taken:.0f} "
          f"frames a second on {chosen.device}")

views = [path for path in sorted(chosen.views.glob("held.????.npz"))] if chosen.views else []
errors, noises, equals, shaders = {way: [] for way in ways}, [], [], {}
for path in views:
    view = dict(np.load(path))
    halves, size = (view["reference_a"], view["reference_b"]), view["depth"].shape[1:3]
    truth = (halves[0] + halves[1]) / 2
    noises.append(errors_of(*halves, truth) / 4)
    moments = [{name: view[name][k] for name in ("diffuse_albedo", "specular_albedo", "normal",
                                                 "roughness", "depth", "motion", "camera")}
               for k in range(len(view["depth"]))]
    for way in ways:
        kind = way.split(",")[0]
        shaders[kind] = shader = shaders.get(kind) or Shader(device, library, kind, size)
        shader.forget()
        if way == "temporal":
            for planes in moments[:-1]:
                shader(planes)
        colours = view["colour"] if kind == "amplifier" else view["colour"][:1]
        results = [shader(moments[-1] | {"colour": colour}) for colour in colours]
        errors[way].append(np.mean([errors_of(one, truth, truth) for one in results], 0))
        if path == views[0]:
            pictures += [("held-out view: reference", truth)] * (way == ways[0])
            pictures += [("one sample a pixel", view["colour"][0])] * (kind == "amplifier")
            pictures += ([(f"{way}, {decibels(errors[way][-1][0]):.1f} dB", results[0])]
                         * ("no" not in way))
    if "pass_depth" in view and "shading" in ways:
        passes = [{name[5:]: view[name][k] for name in view if name.startswith("pass_")}
                  for k in range(len(view["pass_depth"]))]
        found = np.mean([shaders["shading"](planes) for planes in passes], 0)
        errors.setdefault(f"shading, {len(passes)} planes",
                          []).append(errors_of(found, truth, truth))
    if "means" in view and "amplifier" in errors:
        curve = np.array([errors_of(mean, truth, truth)
                          for mean in view["means"].astype(np.float32)]) - noises[-1]
        own = errors["amplifier"][-1] - noises[-1]
        equals.append([equivalent_samples(own[k], view["counts"], curve[:, k]) for k in range(2)])
        print(f"{path.name}: relMSE of the amplifier {own[1]:.5f}, of the mean of "
              f"{view['counts'][-1]} images {curve[-1, 1]:.5f}, of 1 {curve[0, 1]:.5f}: worth "
              f"{equals[-1][1]:.1f} samples; by codes {equals[-1][0]:.1f}")
if views:
    noise = np.mean(noises, 0)
    print(f"{len(views)} held-out views of {size[1]}x{size[0]}; the references' noise is "
          f"{decibels(noise[0]):.1f} dB, relMSE {noise[1]:.5f}")
    for way, of_views in errors.items():
        found, relative = np.array(of_views).T
        print(f"{way:22} {decibels(found.mean()):6.2f} dB, without the noise "
              f"{decibels(found.mean() - noise[0]):6.2f}; views from {decibels(found.max()):.2f} "
              f"to {decibels(found.min()):.2f}, their mean "
              f"{np.mean([decibels(one) for one in found]):.2f}; relMSE {relative.mean():.5f}, "
              f"without the noise {relative.mean() - noise[1]:.5f}")
    for kind, shader in shaders.items():
        print(f"{kind}: {shader.taken:.2f} ms")
if equals:
    codes, relative = np.array(equals).T
    print(f"equivalent samples: {relative.mean():.1f} by relMSE, from {relative.min():.1f} to "
          f"{relative.max():.1f}; {codes.mean():.1f} by codes")

rows = -(-len(pictures) // 4)
figure = Figure((14, 2.2 * rows), layout="constrained")
for panel in figure.subplots(rows, 4).ravel():
    panel.axis("off")
for panel, (name, picture) in zip(figure.axes, pictures, strict=False):
    panel.imshow(shown(np.maximum(picture.astype(np.float32), 0)))
    panel.set_title(name, fontsize=9)
figure.savefig(chosen.picture, dpi=80)
print(f"wrote {chosen.picture}")
