"""The differentiable colour difference against FLIP itself."""
import pytest

pytest.importorskip("torch")
flip_evaluator = pytest.importorskip("flip_evaluator")

import numpy as np  # noqa: E402
import torch  # noqa: E402

from training.denoise import loss as losses  # noqa: E402


def image(picture: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(picture, np.float32)).movedim(-1, 0)[None]


def flip(a: np.ndarray, b: np.ndarray) -> float:
    return float(flip_evaluator.evaluate(a.astype(np.float32), b.astype(np.float32), "LDR")[1])


@pytest.mark.parametrize(("first", "second"), [
    ((0.2, 0.5, 0.3), (0.25, 0.45, 0.3)), ((0.05, 0.05, 0.06), (0.1, 0.08, 0.06)),
    ((0.8, 0.7, 0.6), (0.7, 0.7, 0.7))])
def test_flat_colours_differ_as_in_flip(first: tuple[float, ...],
                                        second: tuple[float, ...]) -> None:
    pictures = [np.broadcast_to(np.float32(colour), (32, 40, 3)) for colour in (first, second)]
    measured = float(losses.difference(*map(image, pictures)))
    assert measured == pytest.approx(flip(*map(np.ascontiguousarray, pictures)), abs=0.005)


def test_smooth_pictures_differ_nearly_as_in_flip() -> None:
    """Only nearly: edges, which are left out, count in FLIP, and small differences are softened."""
    y, x = np.mgrid[0:64, 0:96] / 96
    picture = np.stack((0.3 + 0.2 * x, 0.4 + 0.2 * np.sin(6 * y), 0.5 - 0.3 * x * y), -1)
    other = np.clip(picture * (1 + 0.1 * np.sin(20 * x + 9 * y)[..., None]) + 0.02 * x[..., None],
                    0, 1)
    assert (float(losses.difference(image(picture), image(other)))
            == pytest.approx(flip(picture, other), rel=0.25))


def test_fine_noise_counts_less_than_blotches_of_the_same_error() -> None:
    generator = np.random.default_rng(0)
    fine = generator.normal(0, 0.03, (96, 96, 1))
    coarse = np.kron(generator.normal(0, 0.03, (12, 12, 1)), np.ones((8, 8, 1)))
    grey = np.full((96, 96, 3), 0.5)
    seen = [float(losses.difference(image(grey + error), image(grey))) for error in (fine, coarse)]
    assert seen[0] < 0.7 * seen[1]


def test_gradient_is_finite_where_pictures_are_black_white_or_alike() -> None:
    reference = torch.cat((torch.zeros(1, 3, 16, 16), torch.ones(1, 3, 16, 16),
                           torch.full((1, 3, 16, 16), 0.4)))
    output = reference.clone().requires_grad_()
    losses.difference(output, reference).backward()
    assert torch.isfinite(output.grad).all()
