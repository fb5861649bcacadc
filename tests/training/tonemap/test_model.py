"""The tone mapper's network, its export and its training."""

from __future__ import annotations

import copy
import hashlib
import itertools
import json

import numpy as np
import onnxruntime
import pytest

from postfx.system import models_dir

torch = pytest.importorskip("torch")

from training.export import export  # noqa: E402
from training.tonemap import examples as examples_module  # noqa: E402
from training.tonemap import model as network  # noqa: E402
from training.tonemap import train  # noqa: E402
from training.tonemap.examples import Views  # noqa: E402
from training.tonemap.export import STEADY, STEADY_EXPOSURE, export_look  # noqa: E402
from training.tonemap.looks import (  # noqa: E402
    LOOKS,  # noqa: E402
    compress,
    local_laplacian,
)
from training.tonemap.model import (  # noqa: E402
    CUBE,
    FARTHEST,
    SHAPER,
    SHARES,
    Exposure,
    default_shaper,
    lattice,
    levels,
    look_up,
    shape,
)
from training.tonemap.pictures import LARGEST, Pictures  # noqa: E402
from training.tonemap.train import Recipe, start_network  # noqa: E402

AXES = [torch.linspace(0, 1, CUBE)] * 3
RAMP = torch.stack(torch.meshgrid(*AXES, indexing="ij"), -1)  # the cube that changes nothing


def random_net(seed: int = 1) -> network.HDRNet:
    """A network whose grid differs from place to place."""
    torch.manual_seed(seed)
    net = network.HDRNet(RAMP.clone()).eval()
    torch.nn.init.normal_(net.coefficients.head.weight, std=0.02)
    for name, parameter in net.named_parameters():
        if name.endswith("bias"):
            torch.nn.init.normal_(parameter, std=0.1)
    return net


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def test_network_has_the_papers_size_and_a_histogram() -> None:
    net = network.HDRNet(RAMP)
    assert sum(p.numel() for p in net.parameters() if p is not net.cube) == 488_352


def test_a_fresh_network_shows_its_cube() -> None:
    cube, colour = torch.rand(CUBE, CUBE, CUBE, 3), torch.rand(1, 3, 40, 60) * 4
    with torch.no_grad():
        found = network.HDRNet(cube).render(colour, default_shaper())
    torch.testing.assert_close(found, look_up(shape(colour, *default_shaper()), cube), atol=1e-4,
                               rtol=0)


def test_greys_stay_greys_before_the_cube() -> None:
    net, grey = random_net(), torch.rand(1, 1, 40, 60).expand(1, 3, 40, 60) * 4
    with torch.no_grad():
        found = net.render(grey, default_shaper())
    assert found.std() > 0.01
    torch.testing.assert_close(found.amax(1), found.amin(1), atol=1e-5, rtol=0)


def test_exported_network_gives_what_torch_gives(tmp_path) -> None:
    net, low = random_net(), torch.rand(1, 3, 256, 256)
    export(net, (low,), ["lowres"], ["grid", "guide", "cube"], tmp_path / "net.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "net.onnx")
    grid, guide, cube = session.run(["grid", "guide", "cube"], {"lowres": low.numpy()})
    with torch.no_grad():
        wanted = net(low)
    assert relative(grid, wanted[0].numpy()) <= 1e-3
    np.testing.assert_array_equal(guide, wanted[1].numpy())
    np.testing.assert_array_equal(cube, wanted[2].numpy())


@pytest.mark.parametrize("net", [None, Exposure(RAMP.clone()), random_net()],
                         ids=["global", "exposure", "local"])
def test_an_exported_look_has_a_card_and_can_be_started_from(net, tmp_path) -> None:
    facts = {"look": {}, "history": [], "pictures": [], "psnr": {}}
    path = export_look({"cube": RAMP, "weights": net and net.state_dict(), **facts}, "mine",
                       tmp_path, {})
    card = json.loads(path.with_suffix(".json").read_text())
    assert card["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert card["parameters"] == {type(None): 0, Exposure: 4737, network.HDRNet: 488_352}[type(net)]
    if isinstance(net, network.HDRNet):
        again = network.weights_of(path, network.HDRNet(RAMP).state_dict())
        for name, value in net.state_dict().items():
            torch.testing.assert_close(again[name], value, msg=name)
        other = torch.rand(CUBE, CUBE, CUBE, 3)
        torch.testing.assert_close(start_network(str(path), other).cube.data, other)
    else:
        with pytest.raises(SystemExit, match="not a look with a grid"):
            start_network(str(path), RAMP)


def test_shipped_models_are_those_on_their_cards() -> None:
    cards = sorted(models_dir().glob("tonemap.*.json"))
    assert {path.name.split(".")[1] for path in cards} >= {"aces2", "agx", "pbr_neutral", "local"}
    for path in cards:
        card = json.loads(path.read_text())
        assert hashlib.sha256(path.with_suffix(".onnx").read_bytes()).hexdigest() == card["sha256"]
        assert (card["shaper"]["toe"], card["shaper"]["scale"]) == SHAPER
        steady = STEADY_EXPOSURE if card["look"]["key"] else STEADY if card["parameters"] else {}
        assert {name: card[name] for name in ("keep", "follow") if name in card} == steady


def test_training_form_of_slicing_equals_the_kernels() -> None:
    torch.manual_seed(2)
    shaped = shape(torch.rand(2, 3, 37, 53) * 4, *default_shaper(exposure=1.3))
    guide = network.Guide()()
    grid = torch.randn(2, 16, 16, 8, 12)
    dense = network.slice_grid_dense(shaped, guide, grid)
    torch.testing.assert_close(dense, network.slice_grid(shaped, guide, grid), atol=1e-5, rtol=0)


def test_slicing_can_be_trained_through() -> None:
    net, colour, shaper = random_net(), torch.rand(1, 3, 40, 60), default_shaper()
    net.cube.requires_grad_()
    grid, guide, cube = net(network.lowres(colour, shaper))
    look_up(network.slice_grid_dense(shape(colour, *shaper), guide, grid),
            cube).square().sum().backward()
    for name, p in net.named_parameters():
        assert p.grad is not None and torch.isfinite(p.grad).all(), name


def test_the_lattice_is_what_the_shaper_takes_to_the_corners() -> None:
    light = torch.from_numpy(lattice(9)).reshape(1, -1, 1, 3).permute(0, 3, 1, 2)
    found = shape(light, *default_shaper())[0, :, :, 0].T
    corners = torch.stack(torch.meshgrid(*[torch.linspace(0, 1, 9)] * 3, indexing="ij"),
                          -1).reshape(-1, 3)
    torch.testing.assert_close(found, corners, atol=1e-3, rtol=0)


def test_local_operator_makes_no_halo_at_an_edge() -> None:
    edge = torch.zeros(1, 1, 128, 256)
    edge[..., 128:] = 6.0
    out = local_laplacian(edge, sigma=1.0, alpha=1.0, beta=0.5)[0, 0, 64]
    assert out.diff().min() > -0.05
    assert 0.4 * 6 < float(out[-1] - out[0]) < 0.7 * 6


def test_local_operator_favours_no_side() -> None:
    torch.manual_seed(4)
    x = torch.nn.functional.interpolate(torch.randn(1, 1, 6, 8), size=(96, 128), mode="nearest") * 3
    out = local_laplacian(x, sigma=1.0, alpha=0.95, beta=0.7)
    mirrored = local_laplacian(x.flip(-1, -2), sigma=1.0, alpha=0.95, beta=0.7).flip(-1, -2)
    torch.testing.assert_close(mirrored, out, atol=2e-3, rtol=0)


def test_local_operator_leaves_all_as_it_is_with_neutral_settings() -> None:
    rgb = torch.exp2(torch.rand(1, 3, 64, 96) * 8 - 5)
    torch.testing.assert_close(compress(rgb, sigma=1.0, alpha=1.0, beta=1.0), rgb, rtol=2e-3,
                               atol=1e-5)


def test_views_are_finite_exposed_and_sometimes_wide() -> None:
    """Also without any picture: charts are made from nothing."""
    views = Views(Pictures(), LOOKS["local"], RAMP, torch.device("cpu"))
    colours = [views.batch(4, 0.15) for _ in range(12)]
    assert all(torch.isfinite(x).all() and x.abs().max() <= LARGEST for batch in colours
               for x in batch)
    assert any((colour < 0).any() for colour, _, _ in colours)


@pytest.mark.soak
def test_training_comes_nearer_to_the_look() -> None:
    """Some steps of one flat lesson: twice as bright."""
    class Brighter:
        random = np.random.default_rng(0)

        def batch(self, size: int,
                  scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
            colour = torch.rand(size, 3, 40, 40,
                                generator=torch.Generator()
                                          .manual_seed(int(self.random.integers(99))))
            shaped = shape(colour * 2, *default_shaper())
            return colour, shaped, shaped

    torch.manual_seed(3)
    held = {"flat": np.full((32, 32, 3), 0.3, np.float32)}
    light = torch.from_numpy(held["flat"] * 2).permute(2, 0, 1)[None]
    wanted = {"flat": shape(light, *default_shaper())[0].permute(1, 2, 0).numpy()}
    recipe, steps = Recipe(seconds=60, batch=2, rate=3e-3, every=20), itertools.count()
    reports = []
    train.train_grid(network.HDRNet(RAMP.clone()), Brighter(), recipe, held, wanted, reports.append,
                     clock=lambda: float(next(steps)))
    psnr = [report.psnr["flat"] for report in reports]
    assert psnr[-1] > psnr[0] + 3


def test_only_the_parts_that_are_named_change() -> None:
    torch.manual_seed(3)
    net, steps = network.HDRNet(RAMP.clone()), itertools.count()
    before = copy.deepcopy(net.state_dict())
    source = Views(Pictures(), LOOKS["local"], RAMP, torch.device("cpu"))
    recipe = Recipe(seconds=3, batch=1, scale=0.1, only=("head", "histogram_dense"))
    after = train.train_grid(net, source, recipe, {}, {}, print, clock=lambda: float(next(steps)))
    changed = {name
               for name, value in after["weights"].items() if not torch.equal(value, before[name])}
    assert changed and all("head" in name or "histogram_dense" in name for name in changed)


def test_a_part_that_is_not_there_is_named() -> None:
    recipe = Recipe(seconds=1, only=("tail",))
    with pytest.raises(SystemExit, match="no part 'tail'"):
        train.train_grid(network.HDRNet(RAMP),
                         Views(Pictures(), LOOKS["local"], RAMP, torch.device("cpu")), recipe, {},
                         {}, print)


def test_guide_by_two_convolutions_is_the_guide() -> None:
    shaped, net = torch.rand(2, 3, 20, 30), random_net()
    guide = net.guide()
    found = network.guide_of_copy(shaped, guide)
    assert found.std() > 0.01
    torch.testing.assert_close(found, network.guide_map(shaped, guide), atol=1e-5, rtol=0)


def test_cells_borrow_what_they_have_no_pixels_of() -> None:
    """Dark on the left, bright on the right: the first bright cells have the dark cells' matrix of
    the dark level."""
    low = torch.full((1, 3, 256, 256), 0.2)
    low[..., 128:] = 0.8
    guide = network.Guide()().detach()
    level = int(round(0.2 * network.DEPTH - 0.5))
    grid = torch.zeros(1, network.DEPTH, network.COEFFICIENTS, 16, 16)
    grid[..., :8], grid[..., 8:] = 1.0, 9.0
    found = network.borrow(grid.flatten(1, 2), low, guide).unflatten(1, (network.DEPTH,
                                                                         network.COEFFICIENTS))
    dark = found[0, level, 0, 8]
    assert dark[:8] == pytest.approx(1.0, abs=0.01)
    assert dark[8] == pytest.approx(1.0, abs=0.02) and dark[9:] == pytest.approx(9.0, abs=0.01)


def test_levels_are_those_of_the_light() -> None:
    """Grey light whose logarithms are evenly spread over 8 stops about 2 ** -1."""
    stops = torch.linspace(-5, 3, 256).expand(1, 3, 256, 256)
    mean, found = levels(shape(torch.exp2(stops), *default_shaper()))
    assert float(mean) == pytest.approx(-1, abs=0.03)
    assert found[0].tolist() == pytest.approx([8 * share - 4 for share in SHARES], abs=0.04)


def test_an_exposure_that_is_off_is_put_right() -> None:
    torch.manual_seed(5)
    net, light = Exposure(RAMP.clone()), torch.exp2(torch.randn(1, 3, 90, 120) * 2 - 2)
    with torch.no_grad():
        plain, brighter, black = (net(network.lowres(x, default_shaper()))[0]
                                  for x in (light, light * 4, light * 0))
    torch.testing.assert_close(brighter, plain - 2, atol=0.02, rtol=0)
    assert abs(float(black)) == FARTHEST


def test_the_key_of_charts_is_learnt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any picture: a hundred small views explain most of the difference between scenes, and
    the consistency term holds down the difference between two views of a scene."""
    monkeypatch.setattr(examples_module, "SHAPES",
                        tuple((h // 4, w // 4) for h, w in examples_module.SHAPES))
    monkeypatch.setattr(train, "EXPOSURE_BATCH", 64)
    torch.manual_seed(6)
    found = train.levels_of_views(Views(Pictures(), LOOKS["auto"], RAMP, torch.device("cpu")), 100)
    keys = found.stops + found.means
    left = {}
    for weight in (0.0, train.CONSISTENCY):
        torch.manual_seed(6)
        monkeypatch.setattr(train, "CONSISTENCY", weight)
        left[weight] = wrong, between = train.fit_exposure(Exposure(RAMP.clone()), found, seed=1,
                                                           steps=300)
        assert wrong < 0.2 * float((keys - keys.mean()).abs().mean())
    assert between < 0.9 * left[0][1]
