"""The networks stay as good as they were by kinds of content, on a few clips of the generator that
trains them."""

from pathlib import Path

import numpy as np
import pytest

from postfx.colour.views import to_codes
from training.datagen.clip_file import load_clip
from training.measure.kinds import (
    halves,
    main,
    mean_gains,
    network_method,
    oidn_method,
    score_render,
    table,
)

CLIPS = Path(__file__).parent / "kinds"
# dB of s and m above the better Open Image Denoise and cubic interpolation at 2 samples, rounded
# down
GAINS = {
    "dof": (0.8, 0.8), "fog": (-1.5, -0.6), "foliage": (1.3, 1.7), "fur": (1.5, 2.1),
    "glass": (2.2, 2.3), "indirect": (1.3, 1.9), "interior": (1.1, 1.9), "motion_blur": (-0.5, 0.1),
    "outdoor": (0.0, 0.6), "product": (-0.2, 0.6), "text": (-0.5, 0.7),
}
SPREAD = 0.3  # dB: processors round integers differently


@pytest.mark.parametrize("kind", sorted(GAINS))
def test_networks_keep_their_lead_on_every_kind(kind):
    pytest.importorskip("pyoidn")
    clip = load_clip(CLIPS / f"{kind}.2.npz")
    size = clip["reference"].shape[1:3]
    free = max(score_render(clip, 0, oidn_method(size, planes))
               for planes in ("clean", "prefiltered"))
    for tag, gain in zip(("s", "m"), GAINS[kind], strict=True):
        assert score_render(clip, 0, network_method(tag, clip["scale"])) - free > gain - SPREAD, tag


def test_errors_are_measured_without_the_noise_of_the_reference():
    """A method that gives what both halves scatter around has hardly an error, however noisy they
    are."""
    clip = load_clip(CLIPS / "product.2.npz")
    rng = np.random.default_rng(0)
    true = np.full_like(clip["reference"].astype(np.float32), 0.2)
    noise = rng.normal(0, 0.02, (2, *true.shape)).astype(np.float32)
    clip |= {"reference": true + noise.mean(0), "half": true + noise[1]}
    first, second = halves(clip, 0)
    np.testing.assert_allclose(first, true + noise[0], atol=1e-3)
    plain = np.mean((to_codes(true, 1) - to_codes(second, 1)) ** 2)
    assert abs(np.mean((to_codes(true, 1) - to_codes(first, 1)) * (to_codes(true, 1) -
    to_codes(second, 1)))) < 0.02 * plain


def test_the_command_prints_a_table_and_refuses_an_empty_folder(tmp_path, capsys):
    rows = [{"kind": "fog", "oidn": 30.0, "oidn_prefiltered": 29.0, "m": 31.0},
            {"kind": "fog", "oidn": 30.0, "oidn_prefiltered": 32.0, "m": 31.5}]
    assert "| fog | 2 | 30.00 | 30.50 | +0.25 | -0.50 |" in table(rows, ["m"])
    with pytest.raises(SystemExit):
        main(["score", str(tmp_path)])
    assert "holds no clips" in capsys.readouterr().err
    assert mean_gains(rows, ["m"]) == {"fog": {"m": 0.25}}
    with pytest.raises(SystemExit):
        main(["score", str(CLIPS), "--log", str(tmp_path / "runs.jsonl")])
    assert "--log and --run go together" in capsys.readouterr().err


def test_a_packed_clip_keeps_its_middle_and_its_noisiest_render(tmp_path):
    assert main(["pack", str(CLIPS), str(tmp_path)]) == 0
    packed, whole = load_clip(tmp_path / "text.2.npz"), load_clip(CLIPS / "text.2.npz")
    assert packed["variants"] == 1 and packed["v0_spp"] == whole["v0_spp"]
    assert packed["reference"].shape == whole["reference"].shape  # it is as small already
    np.testing.assert_array_equal(packed["v0_colour"], whole["v0_colour"])
