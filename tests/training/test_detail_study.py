"""The panning plane of fine detail, and the measure of what comes back of it."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest

for module in ("flip_evaluator", "skimage", "matplotlib"):
    pytest.importorskip(module, reason="needs the extra 'bench'")
from postfx.bench.host_kernels import HostKernels  # noqa: E402
from postfx.bench.metrics import moved  # noqa: E402
from postfx.frame import Role  # noqa: E402
from postfx.runtime import Device  # noqa: E402
from training.detail_plots import FIGURES  # noqa: E402
from training.detail_scene import PARTS, SCALE, Kept, Scene, halton  # noqa: E402
from training.detail_study import LIMIT, detail, main, parts  # noqa: E402

CENTRE = (0.0, 0.0)
INNER = np.s_[4:-4, 4:-4]


def smooth(x, y):
    """A texture that interpolation between pixels hardly changes."""
    return 0.5 + 0.25 * np.sin(x / 5 + y / 7) + 0.2 * np.cos(y / 6)


@pytest.fixture(scope="module")
def scene():
    """All one part, smooth, fast."""
    return Scene(pan=(1.3, 0.7), noise=0.0, size=(48, 64), texture=smooth)


def worst(one, other):
    return np.abs(one[INNER] - other[INNER]).max()


def test_motion_leads_to_the_frame_before(scene):
    before, now = (scene.sampled(t, scene.size, CENTRE).colour for t in (4, 5))
    motion = scene.view(5).clean[Role.MOTION]
    right = worst(moved(before, motion), now)
    assert right < 0.005 and worst(before, now) > 10 * right < worst(moved(before, -motion), now)


def test_jitter_says_where_the_samples_lie(scene):
    kernels = HostKernels(Device("cpu"))
    for t in (2, 3):
        frame, centred = scene.view(t).clean, scene.sampled(t, scene.size, CENTRE)
        x, y = frame.jitter
        assert (x, y) == halton(t) and max(abs(x), abs(y)) > 0.1
        for role, wanted in ((Role.COLOUR, centred.colour), (Role.DIFFUSE_ALBEDO, centred.albedo)):
            right, wrong = (worst(kernels.resample(frame[role], *scene.size, at), wanted) for at in ((x, y), (-x, -y)))
            assert right < 2e-3 and wrong > 10 * right


def test_jittered_samples_average_to_the_box_filter():
    scene = Scene(noise=0.0)
    height, width = scene.size
    box = scene.reference(3).reshape(height, SCALE, width, SCALE, 3).mean((1, 3))
    samples = [scene.sampled(3, scene.size, halton(k)).colour for k in range(256)]
    few, many = (np.sqrt(np.square(np.mean(samples[:n], 0) - box).mean()) for n in (16, 256))
    assert many < 0.01 and many < few / 4


def test_each_part_has_its_detail_where_it_says():
    scene = Scene()
    view = scene.view(9)
    for part, (rows, columns) in parts(scene, 9).items():
        at = np.s_[rows.start // SCALE : rows.stop // SCALE, columns.start // SCALE : columns.stop // SCALE]
        albedo = view.clean[Role.DIFFUSE_ALBEDO][at]
        light = view.clean[Role.COLOUR][at] / (albedo + view.clean[Role.SPECULAR_ALBEDO][at])
        assert (albedo.std((0, 1)).min() > 0.1) == (part == "albedo")
        assert (light.std((0, 1)).min() > 0.2) == (part != "albedo")
        assert columns.start >= 0 and columns.stop - columns.start > 200
    assert set(parts(scene, 9)) == set(PARTS)


@pytest.mark.parametrize("noise", [1.0, 0.5])
def test_noise_is_of_the_light_alone_and_as_strong_as_asked(noise):
    view = Scene(noise=noise).view(2)
    ratio = view.noisy[Role.COLOUR] / view.clean[Role.COLOUR]
    assert ratio.mean() == pytest.approx(1, abs=0.02) and ratio.std() == pytest.approx(noise, rel=0.03)
    np.testing.assert_array_equal(view.noisy[Role.DIFFUSE_ALBEDO], view.clean[Role.DIFFUSE_ALBEDO])
    assert np.ptp(Scene(noise=noise).view(2).noisy[Role.COLOUR] - view.noisy[Role.COLOUR]) == 0


def test_samples_that_are_kept_come_to_the_reference():
    scene = Scene(pan=(0.31, 0.13), noise=0.0, size=(32, 48), texture=smooth)
    kept, empty = Kept(scene), np.zeros((64, 96, 3), np.float32)
    errors = []
    for t in range(24):
        view = scene.view(t)
        errors.append(worst(kept(view, empty), view.reference))
    assert errors[0] > 0.3 and errors[-1] < 0.03


def pictures(rng):
    """Noise of frequencies below three quarters of the limit, and beyond it; (H, W) each."""
    spectrum = np.fft.fft2(rng.standard_normal((160, 192)))
    y, x = (np.abs(np.fft.fftfreq(n)) for n in spectrum.shape)
    largest = np.maximum(y[:, None], x)
    return (np.fft.ifft2(spectrum * chosen).real for chosen in (largest < 0.75 * LIMIT, largest > LIMIT))


def test_the_measure():
    rng = np.random.default_rng(5)
    coarse, fine = pictures(rng)
    reference = 3 + coarse + fine
    assert detail(reference, reference) == pytest.approx((1, 1))
    assert detail(coarse + 0.4 * fine, reference) == pytest.approx((0.4, 1), abs=0.01)
    noisy = detail(reference + fine.std() * rng.standard_normal(fine.shape), reference)
    assert noisy.share == pytest.approx(1, abs=0.05) and 0.5 < noisy.coherence < 0.8
    assert detail(np.ones_like(fine), reference) == (0, 0)


def test_enlarging_a_band_limited_picture_brings_nothing_back():
    coarse, fine = pictures(np.random.default_rng(6))
    samples = np.ascontiguousarray(coarse[::SCALE, ::SCALE, None], np.float32)
    shift = 0.5 - 0.5 / SCALE  # every second pixel is a sample: off the centre of a render pixel by that much
    large = HostKernels(Device("cpu")).resample(samples, *coarse.shape, (-shift, -shift))[..., 0]
    assert np.corrcoef(large.ravel(), coarse.ravel())[0, 1] > 0.95
    found = detail(large, coarse + fine)
    assert abs(found.share) < 0.02 and abs(found.coherence) < 0.1


def test_a_short_run(tmp_path, capsys):
    main(["-o", str(tmp_path), "--model", "s", "--frames", "3", "--no-oidn", "--device", "cpu"])
    facts = json.loads((tmp_path / "detail.json").read_text())
    names = ["cubic", "perfect + cubic", "all samples kept", "accumulation", "s, alone", "s"]
    assert list(facts["late"]) == names and len(facts["rows"]) == 3 * len(names) * len(PARTS)
    assert all(np.isfinite(row[key]) for row in facts["rows"] for key in FIGURES)
    kept, perfect = (facts["late"][name]["albedo"]["share"] for name in ("all samples kept", "perfect + cubic"))
    assert kept > 0.4 > 0.2 > perfect
    for name in ("detail.png", "detail_crops.png"):
        assert np.ptp(oiio.ImageBuf(str(tmp_path / name)).get_pixels(oiio.UINT8)) == 255
    captured = capsys.readouterr()
    assert "frame 3 of 3" in captured.err and "shadow edges, second half" in captured.out
