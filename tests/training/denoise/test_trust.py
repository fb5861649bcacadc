"""Trust in planes, texture at the render size, and light that is kept: what noisy planes and lamps
need."""

import torch

from training.denoise.checkpoint import begin_trust
from training.denoise.loss import light_loss
from training.denoise.model import (
    FINE,
    DenoiseUpscale,
    Inputs,
    TrunkConfig,
    empty_state,
    trust_reflectance,
)


def model(seed: int = 0) -> DenoiseUpscale:
    torch.manual_seed(seed)
    return DenoiseUpscale(TrunkConfig(widths=(16, 16), trust=True)).eval()


def inputs(size: int, albedo: torch.Tensor, jitter: float = 0.0) -> Inputs:
    plane = torch.ones(1, 1, size, size)
    up = plane * torch.tensor([0, 0, 1.0])[:, None, None]
    still = torch.zeros(1, 2, size, size)
    return Inputs(albedo + 0.01, albedo, 0 * albedo, up, plane, plane, still,
                  torch.full((1, 2), jitter))


def test_trusted_planes_stay_and_doubted_ones_become_smooth():
    factor = torch.rand(1, 3, 32, 32) + 0.1
    assert torch.equal(trust_reflectance(factor, torch.ones(1, 1, 32, 32)), factor)
    doubted = trust_reflectance(factor, -torch.ones(1, 1, 32, 32))
    assert doubted.std() < 0.3 * factor.std()
    torch.testing.assert_close(doubted.mean(), factor.mean(), rtol=0.02, atol=0)


def test_speckle_at_the_render_size_survives_where_planes_are_exact():
    """Reflectance of one pixel is multiplied after everything that resamples, if nothing is
    jittered."""
    torch.manual_seed(1)
    speckle = torch.where(torch.rand(1, 1, 48, 48) < 0.5, 0.1,
                          0.8).expand(1, 3, -1, -1).contiguous()
    net = model()
    net.load_state_dict(begin_trust(net.state_dict()))
    net.trunk.fine.bias.data[4 * (FINE - 1):] = 8  # trusts all planes
    with torch.no_grad():
        still, _, _ = net(inputs(48, speckle), empty_state(inputs(48, speckle), 48, 48))
        moved, _, _ = net(inputs(48, speckle, 0.3), empty_state(inputs(48, speckle), 48, 48))
    assert (still - speckle - 0.01).abs().max() < 0.02
    # samples that lie elsewhere are resampled with their texture
    assert (moved - speckle - 0.01).abs().max() > 0.1


def test_light_of_a_lamp_that_fades_costs_more_than_noise():
    reference = torch.full((1, 3, 32, 32), 0.2)
    reference[..., 4:12, 4:12] = 20.0
    faded = reference.clone()
    noisy = reference + 0.02 * torch.randn(1, 3, 32, 32, generator=torch.Generator())
    faded[..., 4:12, 4:12] = 10.0
    assert light_loss(reference, reference) < 1e-6
    assert light_loss(faded, reference) > 20 * light_loss(noisy, reference)


def test_a_wide_knee_finds_the_mean_of_rare_light():
    """One cell in four has a tenth more light: squared errors ask for a quarter of it, absolute
    ones for none."""
    light = torch.ones(1, 3, 64, 64)
    light[..., :32, :32] += 0.1

    def best(knee: float) -> float:
        losses = {share: float(light_loss(torch.full_like(light, 1 + share), light, knee))
                  for share in (0.0, 0.01, 0.025, 0.04)}
        return min(losses, key=losses.__getitem__)

    assert best(0.5) == 0.025
    assert best(0.0005) == 0.0
