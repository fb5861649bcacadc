"""Levels that pass nothing on are cut, and the network goes on computing what it did."""

from __future__ import annotations

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch")

from tests.training.denoise.test_revive import CONFIG, batch, outputs  # noqa: E402, F401
from training.denoise.cut import cut, first_unused, looked_at  # noqa: E402
from training.denoise.model import DenoiseUpscale  # noqa: E402

WIDE = replace(CONFIG, widths=(16, 24, 32, 40))


def model_with(silent: tuple[str, ...]) -> DenoiseUpscale:
    """A network in which a large negative bias keeps some layers at zero, and whose coarsest filters are alike."""
    torch.manual_seed(2)
    model = DenoiseUpscale(WIDE)
    with torch.no_grad():
        for name in silent:
            model.trunk.get_parameter(f"{name}.bias")[:] = -1e4
        model.trunk.heads[3].weight.zero_()
        model.trunk.heads[3].bias += torch.randn(25)
        model.trunk.heads[2].bias += torch.randn(26)
    return model.eval()


def test_a_silent_level_and_those_behind_it_are_cut(batch):  # noqa: F811
    model = model_with(("up.2.2",))
    active, means = looked_at(model, [batch])
    assert first_unused(WIDE, active) == 2
    smaller = DenoiseUpscale(trunk=cut(WIDE, model.state_dict(), 2, means))
    assert smaller.config.widths == WIDE.widths[:2] and smaller.trunk.align == 4
    wanted, found = outputs(model, batch), outputs(smaller.eval(), batch)
    assert float((found - wanted).abs().max()) < 1e-5 * float(wanted.abs().max())
    assert float(wanted.std()) > 0.01, "a picture with something in it"


def test_what_was_cut_can_be_cut_again(batch):  # noqa: F811
    """Further down, and filters stay what they are."""
    model = model_with(("up.2.2", "up.1.2"))
    once = DenoiseUpscale(trunk=cut(WIDE, model.state_dict(), 2, looked_at(model, [batch])[1]))
    active, means = looked_at(once.eval(), [batch])
    assert first_unused(once.config, active) == 1
    twice = DenoiseUpscale(trunk=cut(once.config, once.state_dict(), 1, means))
    wanted, found = outputs(model, batch), outputs(twice.eval(), batch)
    assert float((found - wanted).abs().max()) < 1e-4 * float(wanted.abs().max())
    torch.testing.assert_close(twice.trunk.alike[2], once.trunk.alike[1], rtol=1e-4, atol=1e-4)


def test_the_finest_of_several_silent_levels_is_found(batch):  # noqa: F811
    active, _ = looked_at(model_with(("up.2.2", "up.1.2")), [batch])
    assert first_unused(WIDE, active) == 1


def test_a_network_that_uses_all_its_levels_is_left_alone(batch):  # noqa: F811
    active, _ = looked_at(model_with(()), [batch])
    assert first_unused(WIDE, active) is None
