"""Albedo and roughness against integrals over the hemisphere, jitter and exposure against their
definitions."""

import numpy as np
import pytest

from postfx import Frame, Role, integrate, read_sequence
from postfx.errors import WriteError


def split_sum(alpha: float, cosine: float, n: int = 300) -> tuple[float, float]:
    """Scale and bias of GGX with separable Smith masking and Schlick's Fresnel, by half vectors
    drawn from D cos."""
    u, v = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)
    height = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))
    across = np.sqrt(1 - height**2)
    half = np.stack([across * np.cos(2 * np.pi * v), across * np.sin(2 * np.pi * v), height], -1)
    view = np.array([np.sqrt(1 - cosine**2), 0, cosine])
    along = half @ view
    out = 2 * along * height - cosine
    lit = (out > 0) & (along > 0)

    def masking(c: np.ndarray | float) -> np.ndarray | float:
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 - c**2) / c**2))

    weight = np.where(lit,
                      masking(np.where(lit, out, 1)) * masking(cosine) * along / (height * cosine),
                      0)
    fresnel = (1 - np.clip(along, 0, 1)) ** 5
    return (weight * (1 - fresnel)).mean(), (weight * fresnel).mean()


def test_specular_albedo_is_the_integral_of_ggx():
    steps, errors = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0), []
    for roughness in steps:
        for cosine in steps:
            scale, bias = split_sum(roughness**2, cosine)
            f0 = np.array([[[0.04, 0.5, 1.0]]])
            found = integrate.specular_albedo(f0, np.array([[roughness]]), np.array([[-cosine]]))
            errors.append(np.abs(found - (f0 * scale + bias)))
    # 0.039 and 0.0068 with 16 times the directions
    assert (np.max(errors) < 0.043 and np.mean(errors) < 0.0072)


def test_no_reflection_without_f0():
    assert integrate.specular_albedo(np.zeros((1, 1, 3)), np.zeros((1, 1)),
                                     np.full((1, 1), 0.05)).max() == 0


def test_metals_have_no_diffuse_albedo():
    base, metallic = np.full((1, 3, 3), (0.9, 0.6, 0.3)), np.array([[0.0, 0.5, 1.0]])
    np.testing.assert_allclose(integrate.diffuse_albedo(base, metallic)[0, :, 1], [0.6, 0.3, 0])
    np.testing.assert_allclose(integrate.f0_of(base, metallic[..., None])[0, :, 0],
                               [0.04, 0.47, 0.9])


@pytest.mark.parametrize("exponent", [2.0, 20.0, 300.0])
def test_phong_exponents_give_the_peak_of_ggx(exponent):
    theta = (np.arange(200000) + 0.5) / 200000 * np.pi / 2
    lobe = (2 * np.pi * (np.cos(theta) ** (exponent + 1) * np.sin(theta))
            .sum() * (theta[1] - theta[0]))
    alpha = integrate.roughness_from_exponent(np.array(exponent)) ** 2
    # D(0) of GGX and of the normalised lobe
    assert 1 / (np.pi * alpha**2) == pytest.approx(1 / lobe, rel=1e-6)


def test_roughness_of_other_parameters():
    assert integrate.roughness_from_smoothness(np.array(0.75)) == 0.25
    assert integrate.roughness_from_alpha(np.array(0.09)) == pytest.approx(0.3)


def test_jitter_covers_every_cell():
    assert integrate.halton(6, 2) == 0.375 and integrate.halton(5, 3) == pytest.approx(7 / 9)
    jitter = integrate.jitter_sequence(36) + 0.5
    cells = {(int(x * 4 + 1e-9), int(y * 9 + 1e-9)) for x, y in jitter}
    assert len(cells) == 36  # 2^2 and 3^2 columns and rows: one sample in each
    assert integrate.jitter_length(2) == 32 and integrate.jitter_length(1.5) == 18


def test_exposure_hints():
    hint = integrate.exposure_hint(np.full((64, 64, 3), 0.5, np.float32))
    assert 2.0**hint == pytest.approx(0.36, rel=1e-5)
    assert integrate.exposure_hint(np.zeros((64, 64, 3))) is None
    sunny = integrate.exposure_of_camera(16, 1 / 125, 100)  # EV100 of 14.97
    assert -sunny - np.log2(1.2) == pytest.approx(np.log2(256 * 125), abs=1e-9)
    with pytest.raises(integrate.IntegrationError, match="positive"):
        integrate.exposure_of_camera(0, 1)


def test_written_planes_are_read_back(tmp_path):
    rng = np.random.default_rng(0)
    channels = {Role.COLOUR: 3, Role.ALPHA: 1, Role.DEPTH: 1, Role.MOTION: 2, Role.NORMAL: 3,
                Role.DIFFUSE_ALBEDO: 3, Role.SPECULAR_ALBEDO: 3, Role.ROUGHNESS: 1,
                Role.SPECULAR_HIT_DISTANCE: 1, Role.STRENGTH: 1,
                Role.REACTIVE: 1, Role.OPAQUE_COLOUR: 3, Role.OVERLAY: 4, Role.VARIANCE_OF_MEAN: 3,
                Role.SAMPLE_VARIANCE: 3, Role.SECOND_MOMENT: 3, Role.SAMPLE_COUNT: 1}
    planes = {role: rng.random((5, 7, count)).astype(np.float16).astype(np.float32)
              for role, count in channels.items()}
    planes[Role.DEPTH][0, 0] = 1e10
    matrix = np.arange(16.0).reshape(4, 4)
    frame = Frame(planes, 3, (0.25, -0.125), exposure=np.float32(1), reset=True,
                  samples=np.int64(4), world_to_camera=matrix, fov_x=np.float32(40))
    integrate.write_planes(tmp_path / "a.0003.exr", frame)
    (read,) = read_sequence(tmp_path / "a.####.exr", without=[Role.OVERLAY])
    (covered,) = read_sequence(tmp_path / "a.####.exr")
    np.testing.assert_array_equal(covered[Role.OVERLAY], planes.pop(Role.OVERLAY))
    # what the overlay goes over
    np.testing.assert_array_equal(covered[Role.COLOUR], planes[Role.OPAQUE_COLOUR])
    assert set(read.planes) == set(planes)
    for role, plane in planes.items():
        np.testing.assert_array_equal(read[role], plane)
    assert (read.jitter, read.exposure, read.reset, read.samples) == ((0.25, -0.125), 1.0, True, 4)
    assert read.fov_x == 40.0
    np.testing.assert_array_equal(read.world_to_camera, matrix)
    with pytest.raises(WriteError, match=r"a\.png: planes can only be written as OpenEXR"):
        integrate.write_planes(tmp_path / "a.png", frame)
