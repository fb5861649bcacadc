"""Errors of input and results as samples rise, on a view that is made up."""

import csv
import json

import numpy as np
import OpenImageIO as oiio
import pytest

for module in ("flip_evaluator", "skimage", "matplotlib"):
    pytest.importorskip(module, reason="needs the extra 'bench'")
from training.measure.convergence import INPUT, main, shrunk, steps  # noqa: E402
from training.measure.equivalent_samples import PLANES, load_view, prefix_counts  # noqa: E402

COUNT = 64
CHANNELS = {"roughness": 1, "depth": 1, "motion": 2}


@pytest.fixture
def view(tmp_path):
    """A view whose planes have the number of their image in them, and whose noise is mild."""
    rng = np.random.default_rng(2)
    picture = (0.5 + 0.3 * np.sin(np.arange(80) / 9))[None, :, None] * np.ones((48, 1, 3))
    noisy = picture * (1 + 0.2 * rng.standard_normal((COUNT, 48, 80, 3)))
    counts = prefix_counts(COUNT)
    means = np.stack([noisy[:n].mean(0) for n in counts]).astype(np.float32)
    planes = {name: np.ones((4, 48, 80, CHANNELS.get(name, 3)), np.float32)
              for name in PLANES if name != "colour"}
    planes["roughness"] *= np.arange(4, dtype=np.float32)[:, None, None, None]
    path = tmp_path / "view.npz"
    np.savez(path, colour=noisy[:4].astype(np.float32), reference_a=picture, reference_b=picture,
             counts=counts,
             means=means, facts=json.dumps({"scene": "made up", "seed": 9000}), **planes)
    return path


def test_inputs_are_means_of_the_first_images(view):
    given = load_view(view)
    full, half = list(steps(given, 1)), list(steps(given, 2))
    assert [step.samples for step in full] == [1, 2, 4, 8, 16, 32, 64]
    assert [step.samples for step in half] == [4, 8, 16, 32, 64, 128, 256]
    assert [step.planes["roughness"].max() for step in full] == [0, 0.5, 1.5, 1.5, 1.5, 1.5, 1.5]
    np.testing.assert_array_equal(full[-1].planes["colour"], given["means"][-1])
    assert half[0].planes["colour"].shape == (24, 40, 3) and half[0].planes["motion"].max() == 0.5
    np.testing.assert_allclose(half[2].planes["colour"], shrunk(full[2].planes["colour"], 2),
                               rtol=1e-6)


def test_rows_for_every_scale_count_and_method(view, tmp_path, capsys):
    main([str(view), "-o", str(tmp_path / "out"), "--no-oidn", "--device", "cpu"])
    with (tmp_path / "out/convergence.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert (len(rows) == 2 * 7 * 2
            and json.loads((tmp_path / "out/convergence.json").read_text())["rows"])
    of_input = [float(row["psnr"]) for row in rows if (row["scale"], row["method"]) == ("1", INPUT)]
    assert np.diff(of_input) == pytest.approx(10 * np.log10(2), abs=0.3)
    gains = [float(row["gain"]) for row in rows if (row["scale"], row["method"]) == ("1", "m")]
    assert gains[0] > 5 and min(gains) > -0.1
    out = capsys.readouterr().out
    assert "m at 1x: at least +" in out or "m at 1x: at least -0.0" in out
    last = [float(row["psnr"]) for row in rows[-2:]]
    assert "2x, 256 samples: input {:.2f}, m {:.2f}".format(*last) in out
    assert (np.ptp(oiio.ImageBuf(str(tmp_path / "out/convergence.png")).get_pixels(oiio.UINT8))
            == 255)
