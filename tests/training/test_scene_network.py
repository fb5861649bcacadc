"""Networks of one scene: rendered, trained and run at a small size."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.training.llvm import require_mitsuba

torch = pytest.importorskip("torch")
require_mitsuba()

from training import scene_network  # noqa: E402
from training.datagen import make_sample  # noqa: E402
from training.scene_network import (  # noqa: E402
    STATE,
    SceneNetwork,
    Views,
    begun_with,
    codes_of,
    main,
    nearest_motion,
    to_codes,
    to_light,
    warp,
)

SAMPLES = Path(__file__).parents[2] / "samples"


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two views to learn from, and one that is held out."""
    folder = tmp_path_factory.mktemp("views")
    make_sample.main(["views", str(folder), "--width", "48", "--height", "32", "--views", "2",
                      "--spp", "4", "--held-out", "1", "--held-spp", "64", "--stack", "16"])
    return folder


@pytest.fixture(scope="module")
def views(rendered: Path) -> Views:
    return Views(sorted(rendered.glob("*.npz")), "cpu")


def test_more_samples_are_nearer_to_the_reference(rendered: Path) -> None:
    view = dict(np.load(rendered / "held.0000.npz"))
    truth = (view["reference_a"] + view["reference_b"]) / 2
    errors = [np.mean((np.tanh(mean.astype(float)) - np.tanh(truth)) ** 2)
              for mean in view["means"]]
    assert view["counts"][0] == 1 and view["counts"][-1] == 16 and errors[-1] < errors[0] / 4
    assert len({one.tobytes() for one in view["colour"]}) == len(view["colour"])


def test_places_lie_in_the_room_and_motion_leads_back_to_them(views: Views) -> None:
    """To the plane of the surface, as pixels of two frames are not at the same points of it."""
    network = SceneNetwork("temporal", *views.box())
    np.testing.assert_allclose(network.high - network.low, [5.2, 2.8, 6.0], atol=1.5)
    frames = views.crops(torch.tensor([[k, 0, 0, 0] for k in range(views.count)]),
                         (views.height, views.width), views.frames)
    states = []
    for frame in frames[-2:]:
        place = network.features(frame, frame["ray"])[1]
        assert (place.abs() < 1.1).float().mean() > 0.95
        states.append(torch.cat([place, place, torch.ones_like(place[:, :1])], 1))
    now = frames[-1]
    followed, wrong = (network.same_surface(warp(states[0], motion), states[1][:, 3:6], now).float()
                       .mean() for motion in (now["motion"], now["motion"] + 8))
    assert followed > 0.75 > wrong + 0.15


def test_noise_does_not_darken_the_targets() -> None:
    """The codes of noisy means are too dark by a hundredth, those of two halves by a fifth of that
    at most."""
    random, light = torch.distributions.Gamma(3.0, 6.0), torch.tensor(0.5)
    torch.manual_seed(0)
    halves = random.sample((200_000,)), random.sample((200_000,))
    plain, found = (float(codes.mean() - to_codes(light))
                    for codes in (to_codes(sum(halves) / 2), codes_of(*halves)))
    assert plain < -0.01 and abs(found) < -plain / 5


def test_history_is_of_no_use_where_there_is_none(views: Views) -> None:
    """The temporal network begins as the other one, and without a state it does what that one
    does."""
    torch.manual_seed(0)
    shading, box = SceneNetwork("shading", *views.box()), views.box()
    temporal = begun_with(SceneNetwork("temporal", *box), shading)
    (frame,) = views.crops(torch.tensor([[0, 0, 0, 0]]), (views.height, views.width), 1)
    frame["before"] = torch.zeros(1, STATE, views.height, views.width)
    with torch.no_grad():
        alone, state = temporal(frame, frame["ray"])
        torch.testing.assert_close(alone, shading(frame, frame["ray"])[0], rtol=1e-4, atol=1e-5)
        elsewhere = torch.ones(1, STATE, 1, 1)
        elsewhere[:, 3:6] *= torch.tensor([1.0, 0.7, 0.4])[None, :, None, None]
        frame["before"] = state + elsewhere  # another light of other places counts for nothing, too
        other, hit = temporal(frame, frame["ray"])[0], frame["depth"] < 1e6
        assert (other - alone).abs().amax(1, keepdim=True)[hit].lt(1e-4).float().mean() > 0.95
        frame["before"], frame["motion"] = state, torch.zeros_like(frame["motion"])
        frame["before"][:, :3] += 1
        brighter = temporal(frame, frame["ray"])[0]
    assert (brighter >= alone - 1e-6).all() and (brighter > alone).float().mean() > 0.9


def test_pictures_are_averaged_within_what_their_neighbours_show(views: Views) -> None:
    """Not without a history, nor while it learns. Codes and light are the other way round of each
    other."""
    network, kept = SceneNetwork("temporal", *views.box()).eval(), scene_network.KEPT
    light = torch.tensor([0.0, 1e-3, 0.3, 2.0, 60.0])
    torch.testing.assert_close(to_light(to_codes(light)), light, rtol=2e-3, atol=1e-6)
    stripes = (torch.arange(12) // 2 % 2 * 0.8 + 0.1).expand(1, 3, 9, 12)
    planes = {"motion": torch.zeros(1, 2, 9, 12), "depth": torch.ones(1, 1, 9, 12),
              "before": torch.zeros(1, STATE, 9, 12)}
    assert network.steadied(stripes, planes)[0] is not stripes
    torch.testing.assert_close(network.steadied(stripes, planes)[0], stripes)
    planes["before"][:, 6], planes["before"][:, 7:] = 1, 0.5
    codes, mixed = to_codes(stripes), network.steadied(stripes, planes)[1]
    inner = (..., slice(1, -1), slice(1, -1))
    torch.testing.assert_close(mixed[inner], (codes + (0.5 - codes) * kept)[inner])
    planes["before"][:, 7:] = 5.0
    assert (network.steadied(stripes, planes)[1] <= codes.max() + 1e-6).all()
    torch.testing.assert_close(network.train().steadied(stripes, planes)[0], stripes)


def test_the_nearest_neighbour_s_motion_counts() -> None:
    motion, depth = torch.zeros(1, 2, 5, 5), torch.full((1, 1, 5, 5), 9.0)
    motion[0, :, 2, 2], depth[0, 0, 2, 2] = torch.tensor([3.0, -1.0]), 1.0
    found = nearest_motion(motion, depth)
    assert (found[0, 0] == 3).sum() == 9 and (found[0, 1, 1:4, 1:4] == -1).all()


@pytest.mark.parametrize("kind", ["shading", "amplifier"])
def test_light_is_bounded_by_what_was_learnt_and_lamps_have_the_colour_given(kind: str,
                                                                             views: Views) -> None:
    """However sure a network is that a pixel is white."""
    network = SceneNetwork(kind, *views.box(), views.most)
    with torch.no_grad():
        network.last.bias.fill_(50.0)
    frame = views.crops(torch.tensor([[0, 0, 0, 0]]), (views.height, views.width), 1)[-1]
    frame["diffuse_albedo"][..., :8], frame["specular_albedo"][..., :8] = 0, 0
    frame["colour"][..., :8], frame["colour"][..., 0] = 0.75 * views.most, 10 * views.most
    with torch.no_grad():
        found, _ = network(frame, frame["ray"])
    assert float(found.max()) == pytest.approx(views.most) and views.most < 100
    if kind == "amplifier":
        torch.testing.assert_close(found[..., 1:8], frame["colour"][..., 1:8])


def test_a_network_is_trained_and_runs_in_a_command_buffer(rendered: Path, tmp_path: Path) -> None:
    """`amplifier` goes on from its own weights, and is measured against the stack."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("flip_evaluator")
    command = [str(rendered), str(tmp_path), "--kinds", "amplifier", "--steps", "12", "--batch",
               "2", "--crop", "24"]
    main([*command, "--report", "1"])
    told = run_sample(str(tmp_path / "a.png"), "--models", str(tmp_path), "--views", str(rendered),
                      "--runs", "1")
    ((name, found),) = re.findall(r"(?m)^(.{22}) +([\d.]+) dB, without", told)
    assert name.strip() == "amplifier" and float(found) > 8
    worth = float(re.search(r"equivalent samples: ([\d.]+)", told)[1])
    assert 0.5 < worth < 64 and (tmp_path / "a.png").stat().st_size > 20000


@pytest.mark.soak
def test_the_room_s_amplifier_is_worth_more_than_the_stack(tmp_path: Path) -> None:
    """At half the size that it has learnt from."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("flip_evaluator")
    make_sample.main(["views", str(tmp_path), "--width", "128", "--height", "72", "--views", "0",
                      "--held-out", "1", "--held-spp", "96", "--stack", "16"])
    begin = [str(SAMPLES / f"room/{name}.000[1-2].exr") for name in ("noisy", "reference")]
    told = run_sample(str(tmp_path / "a.png"), "--views", str(tmp_path), "--runs", "1", "--noisy",
                      begin[0], "--reference", begin[1])
    assert float(re.search(r"equivalent samples: ([\d.]+)", told)[1]) > 16


def run_sample(*arguments: str) -> str:
    """What samples/scene_network.py prints."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(sys, "argv", ["scene_network.py", *arguments])
        patch.syspath_prepend(SAMPLES)
        runpy.run_path(str(SAMPLES / "scene_network.py"), run_name="__main__")
    return printed.getvalue()
