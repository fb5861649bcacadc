"""The residual trunk: the interface of the plain one, and a stream whose scale does not matter."""

from dataclasses import replace

import pytest
import torch

from training.denoise.checkpoint import pack, save, unpack
from training.denoise.loss import error_loss
from training.denoise.model import DenoiseUpscale, Inputs, Trunk, TrunkConfig, mirrored_features
from training.denoise.residual import STEEPEST, ResidualConfig, ResidualTrunk, bound, normalise
from training.denoise.train import rate_at

SMALL = ResidualConfig((8, 8, 12, 12, 16), (1, 1, 1, 1, 2), (1, 1, 1, 1))


@pytest.fixture(scope="module")
def trunk():
    torch.manual_seed(1)
    return ResidualTrunk(SMALL).eval()


def test_heads_are_those_of_the_plain_trunk(trunk):
    features, mirrored = torch.rand(1, 35, 48, 64), torch.rand(1, 6, 48, 64)
    with torch.no_grad():
        *found, error = trunk(features, mirrored)
        expected = Trunk(TrunkConfig((8, 8, 8, 8)))(features)
    assert [head.shape for head in found] == [head.shape for head in expected]
    assert error.shape == (1, 1, 48, 64)


def test_the_predicted_error_finds_the_mean_of_the_squared_error():
    torch.manual_seed(0)
    reference = torch.zeros(1, 3, 64, 64)
    output = 0.1 * torch.randn(1, 3, 64, 64)
    predicted = torch.full((1, 1, 1, 1), -8.0, requires_grad=True)
    optimiser = torch.optim.Adam([predicted], lr=0.1)
    for _ in range(200):
        optimiser.zero_grad()
        error_loss(predicted.expand(-1, -1, 64, 64), output, reference).backward()
        optimiser.step()
    assert predicted.item() == pytest.approx(output.square().mean().log().item(), abs=0.02)


def test_planes_that_a_file_lacks_count_as_zeros():
    plane = torch.ones(1, 3, 4, 4)
    inputs = Inputs(*[plane] * 7, jitter=torch.zeros(1, 2))
    assert not mirrored_features(inputs).any()
    seen = mirrored_features(replace(inputs, denoising_albedo=0.5 * plane))
    assert seen[:, :3].eq(0.5).all() and not seen[:, 3:].any()


def test_logits_do_not_grow_with_the_stream(trunk):
    stream = torch.randn(1, 8, 16, 16)
    with torch.no_grad():
        once, thousandfold = (trunk.fine(normalise(scale * stream)) for scale in (1.0, 1e3))
    torch.testing.assert_close(thousandfold, once, rtol=1e-4, atol=1e-4)


def test_a_clamped_logit_keeps_its_gradient():
    logits = torch.tensor([-50.0, -1.0, 2.0, 50.0], requires_grad=True)
    held = bound(logits)
    held.sum().backward()
    assert held.tolist() == [-STEEPEST, -1.0, 2.0, STEEPEST]
    assert logits.grad.tolist() == [1.0] * 4


def test_a_layout_is_told_by_its_config_and_must_fit():
    assert ResidualConfig.from_dict(SMALL.as_dict()) == SMALL
    with pytest.raises(ValueError, match="5 widths"):
        ResidualConfig((8, 8))


def test_a_packed_checkpoint_goes_on_with_weights_average_and_steps(tmp_path, trunk):
    weights = DenoiseUpscale(trunk=trunk).state_dict()
    run = {"config": SMALL.as_dict(), "notes": {}, "step": 7, "seconds": 1.0, "seed": 0,
           "commit": "none",
           "arguments": {}, "live": weights, "weights": weights, "optimiser": {"large": weights}}
    save(pack(run), tmp_path / "packed.pt")
    found = unpack(tmp_path / "packed.pt")
    assert found["step"] == 7 and "optimiser" not in found
    for name, values in weights.items():
        torch.testing.assert_close(found["live"][name], values, rtol=1e-3, atol=1e-3)


def test_an_average_alone_is_no_state_to_go_on_from(tmp_path):
    save({"config": {}, "weights": {}, "notes": {}}, tmp_path / "weights.pt")
    with pytest.raises(ValueError, match="checkpoint pack"):
        unpack(tmp_path / "weights.pt")


def test_the_rate_stays_until_it_cools():
    rates = [rate_at(done, 1000, 1.0, cool=0.2) for done in (0.1, 0.79, 0.9, 1.0)]
    assert rates == pytest.approx([1.0, 1.0, 0.5, 1e-3])
