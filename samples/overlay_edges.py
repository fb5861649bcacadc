"""How overlays are enlarged to twice their size, against other ways: what is lost, what rings, what
becomes too bright.

python samples/overlay_edges.py [PICTURE.png]

Prints, for overlays whose coverage is known: the RMS error of premultiplied RGBA, how far colour or
alpha leave the range of the four nearest pixels, and by how much colours are brighter than the
nearest straight colours at the coverage that comes out, each the largest, and the share of the
pixels where that is more than 0.001. PICTURE: the last frame of the sample room under an overlay,
and a part of it by cubic interpolation without limits and by postfx.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import postfx
from postfx import Role
from postfx.kernels.image import ENLARGE_OVERLAY, RESAMPLE, positions
from postfx.thumbnails import png

ROOM = Path(__file__).parent / "room" / "noisy.####.exr"
SIZE, FINE = 64, 8


def over(front: np.ndarray, behind: np.ndarray) -> np.ndarray:
    return front + (1 - front[..., 3:]) * behind


def layer(alpha: np.ndarray, colour: tuple[float, ...]) -> np.ndarray:
    return alpha[..., None] * np.array([*colour, 1.0])


def disc(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return layer(0.8 * (np.hypot(x - 0.5, y - 0.5) < 0.3), (1.0, 0.5, 0.2))


def letters(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """White with a dark, half transparent outline."""
    form = np.sin(60 * x) * np.sin(47 * y + 10 * x)
    return over(layer(form > 0.3, (1, 1, 1)), layer(0.7 * (form > 0), (0, 0, 0)))


def particles(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Soft and hard ones of all colours, some of them eight times as bright."""
    random = np.random.default_rng(3)
    found = np.zeros((*np.broadcast_shapes(x.shape, y.shape), 4))
    for number in range(200):
        left, top, radius = random.random(), random.random(), random.uniform(0.008, 0.06)
        # beyond it is 1e-14
        rows, columns = (slice(*np.searchsorted(axis.ravel(), (at - 4 * radius, at + 4 * radius)))
                         for axis, at in ((y, top), (x, left)))
        distance = np.hypot(x[:, columns] - left, y[rows] - top) / radius
        alpha = random.random() * (np.exp(-2 * distance**2) if number % 2 else distance < 1)
        front = layer(alpha, tuple(random.random(3) ** 2 * random.choice([1, 8])))
        found[rows, columns] = over(front, found[rows, columns])
    return found


def rendered(shape: Callable, height: int, width: int) -> np.ndarray:
    """Mean over each pixel of a picture (height, width, 4)."""
    y, x = ((np.arange(side * FINE) + 0.5) / (side * FINE) for side in (height, width))
    return shape(x[None], y[:, None]).reshape(height, FINE, width, FINE,
                                              4).mean((1, 3)).astype(np.float32)


def gathered(image: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The 4x4 pixels around each pixel of twice the size, and how far it is from the second ones,
    down and across."""
    index, offset = [], []
    for size in image.shape[:2]:
        at = positions(size, 2 * size)
        index.append(np.clip(np.floor(at) + np.arange(-1, 3)[:, None], 0, size - 1).astype(int))
        offset.append(at - np.floor(at))
    pixels = image.astype(np.float64)[index[0][:, None, :, None], index[1][None, :, None, :]]
    return pixels, offset[0], offset[1]


def weighted(image: np.ndarray, weights: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    pixels, down, across = gathered(image)
    return np.einsum("jy,ix,jiyxc->yxc", weights(down), weights(across), pixels)


def bilinear(image: np.ndarray) -> np.ndarray:
    return weighted(image, lambda t: np.stack([0 * t, 1 - t, t, 0 * t]))


def cubic(image: np.ndarray) -> np.ndarray:
    return weighted(image,
                    lambda t: np.stack([((-t + 2) * t - 1) * t / 2, (1.5 * t - 2.5) * t * t + 1,
                                        ((-1.5 * t + 2) * t + 0.5) * t, (t - 1) * t * t / 2]))


def by_kernel(kernel) -> Callable[[np.ndarray], np.ndarray]:
    def enlarge(image: np.ndarray) -> np.ndarray:
        h, w = image.shape[:2]
        output = np.empty((2 * h, 2 * w, 4), np.float32)
        kernel.rows(0, 2 * h, image, positions(h, 2 * h), positions(w, 2 * w), output)
        return output

    return enlarge


WAYS = {"bilinear": bilinear, "cubic": cubic, "cubic, each channel held": by_kernel(RESAMPLE),
        "and held to coverage": by_kernel(ENLARGE_OVERLAY)}


def faults(image: np.ndarray, result: np.ndarray) -> tuple[float, float, float]:
    """How far values leave the range of the four nearest pixels, and colours what coverage allows;
    its share."""
    nearest = gathered(image)[0][1:3, 1:3].reshape(4, *result.shape)
    outside = np.maximum(result - nearest.max(0), nearest.min(0) - result).max()
    straight = np.divide(nearest[..., :3], nearest[..., 3:], out=0 * nearest[..., :3],
                         where=nearest[..., 3:] > 0)
    excess = np.maximum(result[..., :3] - straight.max(0) * result[..., 3:], 0)
    return outside, excess.max(), 100 * (excess.max(2) > 1e-3).mean()


def draw(path: str) -> None:
    def overlay(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        x = x * 16 / 9
        far = np.hypot(x - 1.25, y - 0.42)
        found = layer(0.5 * np.exp(-((x - 0.35) ** 2 + (y - 0.4) ** 2) / 0.03), (0.6, 0.62, 0.66))
        found = over(layer(0.6 * (far < 0.2), (0.02, 0.25, 0.4)), found)
        return over(layer(0.95 * (np.abs(far - 0.16) < 0.012), (1.6, 1.2, 0.3)), found)

    def shown(enlarge: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The last frame under the overlay, enlarged in this way, as code values."""
        enlarged = enlarge(front).astype(np.float32)
        passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=2), postfx.Overlay(),
                                  postfx.ToneMap()])
        for frame in postfx.read_sequence(ROOM):
            last = passes(replace(frame, guides={Role.OVERLAY: enlarged}))
        return np.rint(255 * np.clip(last[Role.COLOUR], 0, 1)).astype(np.uint8)

    front = rendered(overlay, 180, 320)
    ringing, mine = shown(WAYS["cubic"]), shown(WAYS["and held to coverage"])
    parts = [picture[66:156, 356:446].repeat(2, 0).repeat(2, 1) for picture in (ringing, mine)]
    Path(path).write_bytes(png(np.concatenate([mine, np.concatenate(parts)], axis=1)))


def main() -> None:
    print("overlay    way                       RMS error  outside  too bright")
    for shape in (disc, letters, particles):
        image, wanted = rendered(shape, SIZE, SIZE), rendered(shape, 2 * SIZE, 2 * SIZE)
        for name, enlarge in WAYS.items():
            result = enlarge(image)
            error = np.sqrt(np.square(result - wanted).mean())
            outside, excess, share = faults(image, result)
            print(f"{shape.__name__:10} {name:25} {error:9.4f}  {outside:7.4f}  {excess:.4f} at "
                  f"{share:.1f} %")
    if len(sys.argv) > 1:
        draw(sys.argv[1])


if __name__ == "__main__":
    main()
