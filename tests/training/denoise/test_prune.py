"""Channels that are never active get another start, silent levels are cut: the network computes
what it did."""

from __future__ import annotations

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch")

from tests.training.small_denoiser import small_model  # noqa: E402
from training.denoise.dataset import Batch  # noqa: E402
from training.denoise.model import DenoiseUpscale, Inputs, TrunkConfig, empty_state  # noqa: E402
from training.denoise.prune import active_channels, cut, first_unused, observe, revive, table  # noqa: E402

CONFIG = TrunkConfig((16, 16, 16, 16), 2)
KILLED = ("down.0.0", "down.1.0", "down.1.2", "down.3.2", "up.2.0", "up.2.2", "up.0.2")
COUNT = 5
WIDE = replace(CONFIG, widths=(16, 24, 32, 40))


@pytest.fixture
def batch() -> Batch:
    generator = torch.Generator().manual_seed(1)
    new = lambda channels: torch.rand(1, channels, 32, 48, generator=generator)  # noqa: E731
    frames = [Inputs(new(3), new(3), new(3), new(3) - 0.5, new(1), 1 + new(1), new(2),
                     torch.zeros(1, 2))
              for _ in range(2)]
    return Batch(frames, *[torch.zeros(2, 1, 3, 64, 96)] * 2, torch.ones(2, 1, 1, 1, 1))


@pytest.fixture
def model() -> DenoiseUpscale:
    """With channels that a large negative bias keeps at zero."""
    torch.manual_seed(2)
    model = DenoiseUpscale(CONFIG)
    with torch.no_grad():
        for name in KILLED:
            model.trunk.get_parameter(f"{name}.bias")[:COUNT] = -1e4
    return model.eval()


def outputs(model: DenoiseUpscale, batch: Batch) -> torch.Tensor:
    with torch.no_grad():
        return model(batch.frames[0], empty_state(batch.frames[0], 64, 96))[0]


def revived(model: DenoiseUpscale, batch: Batch) -> DenoiseUpscale:
    other = DenoiseUpscale(CONFIG).eval()
    other.load_state_dict(revive(CONFIG, model.state_dict(), active_channels(model, [batch])))
    return other


def test_dead_channels_are_found(model, batch):
    active = active_channels(model, [batch])
    assert len(active) == 13
    for name in KILLED:
        block, number = name.rsplit(".", 1)
        assert not active[f"{block}.{int(number) + 1}"][:COUNT].any()
    assert active["up.1.1"].sum() > 8
    assert "down.1.3" in table(active) and "of   16 active" in table(active)


def test_the_network_computes_what_it_did_and_all_of_it_is_alive(model, batch):
    other = revived(model, batch)
    wanted, found = outputs(model, batch), outputs(other, batch)
    assert float((found - wanted).abs().max()) < 0.01 * float(wanted.abs().max())
    before, after = (active_channels(each, [batch]) for each in (model, other))
    killed = [f"{name.rsplit('.', 1)[0]}.{int(name.rsplit('.', 1)[1]) + 1}" for name in KILLED]
    assert sum(int(after[name][:COUNT].sum()) for name in killed) > 0.5 * COUNT * len(killed)
    assert sum(int(x.sum()) for x in after.values()) > sum(int(x.sum()) for x in before.values())


def test_both_sides_of_a_revived_channel_learn(model, batch):
    other = revived(model, batch).train()
    state = empty_state(batch.frames[0], 64, 96)
    other(batch.frames[0], state)[0].square().mean().backward()
    assert other.trunk.get_parameter("down.1.2.weight").grad[:, :COUNT].abs().sum() > 0
    assert model.trunk.get_parameter("down.1.2.weight")[:, :COUNT].abs().sum() > 0


def test_what_is_alive_is_left_alone(batch):
    model = small_model()
    active = {name: torch.ones_like(channels)
              for name, channels in active_channels(model, [batch]).items()}
    weights = model.state_dict()
    found = revive(model.config, weights, active)
    assert all(torch.equal(value, weights[name]) for name, value in found.items())


def model_with(silent: tuple[str, ...]) -> DenoiseUpscale:
    """A network in which a large negative bias keeps some layers at zero, and whose coarsest
    filters are alike."""
    torch.manual_seed(2)
    model = DenoiseUpscale(WIDE)
    with torch.no_grad():
        for name in silent:
            model.trunk.get_parameter(f"{name}.bias")[:] = -1e4
        model.trunk.heads[3].weight.zero_()
        model.trunk.heads[3].bias += torch.randn(25)
        model.trunk.heads[2].bias += torch.randn(26)
    return model.eval()


def test_a_silent_level_and_those_behind_it_are_cut(batch):
    model = model_with(("up.2.2",))
    active, means = observe(model, [batch])
    assert first_unused(WIDE, active) == 2
    smaller = DenoiseUpscale(trunk=cut(WIDE, model.state_dict(), 2, means))
    assert smaller.config.widths == WIDE.widths[:2] and smaller.trunk.align == 4
    wanted, found = outputs(model, batch), outputs(smaller.eval(), batch)
    assert float((found - wanted).abs().max()) < 1e-5 * float(wanted.abs().max())
    assert float(wanted.std()) > 0.01, "a picture with something in it"


def test_what_was_cut_can_be_cut_again(batch):
    """Further down, and filters stay what they are."""
    model = model_with(("up.2.2", "up.1.2"))
    once = DenoiseUpscale(trunk=cut(WIDE, model.state_dict(), 2, observe(model, [batch])[1]))
    active, means = observe(once.eval(), [batch])
    assert first_unused(once.config, active) == 1
    twice = DenoiseUpscale(trunk=cut(once.config, once.state_dict(), 1, means))
    wanted, found = outputs(model, batch), outputs(twice.eval(), batch)
    assert float((found - wanted).abs().max()) < 1e-4 * float(wanted.abs().max())
    torch.testing.assert_close(twice.trunk.alike[2], once.trunk.alike[1], rtol=1e-4, atol=1e-4)


def test_the_finest_of_several_silent_levels_is_found(batch):
    active, _ = observe(model_with(("up.2.2", "up.1.2")), [batch])
    assert first_unused(WIDE, active) == 1


def test_a_network_that_uses_all_its_levels_is_left_alone(batch):
    active, _ = observe(model_with(()), [batch])
    assert first_unused(WIDE, active) is None
