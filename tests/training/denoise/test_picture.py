"""The network that gives the picture itself: its curve, its start, its weights' rates, and its
pass."""

import hashlib
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from postfx import DenoiseUpscale, Device, Frame, Pipeline
from postfx.errors import PassOptionError
from postfx.frame import Role
from tests.conftest import REPOSITORY
from tests.made_once import copy_made_once
from training.denoise import open_weights
from training.denoise.checkpoint import PREFIX, graft, mix, save, widen
from training.denoise.export import card, export_trunk, load_trunk
from training.denoise.model import Inputs, empty_state
from training.denoise.picture import (
    ACCUMULATED,
    ADDED_LAYERS,
    FURTHER_INPUTS,
    GUIDED_INPUTS,
    HISTORY,
    LARGE,
    MOST_LIGHT,
    VALID,
    AlbedoFilter,
    Branch,
    DeepBranch,
    PictureConfig,
    PictureDenoiser,
    PictureNetwork,
    decode,
    encode,
    layout_from,
    with_guarded_history,
)
from training.denoise.train import parse, rate_groups

SMALL = PictureConfig(down=(8, 8, 8, 8, 8), up=(8, 8, 8, 8), last=8, gated=True,
                      detailed=True, averaged=True, filtered=True, guarded=True)
SIZE = 40, 56
EXPOSURE_STOPS = 1.0
JITTER = 0.25, -0.125
CLOSE = 2e-5  # after x / (1 + x)


@pytest.fixture(scope="module")
def denoiser():
    """A small network whose weights make all its outputs vary; a second one would have the same."""
    torch.manual_seed(3)
    found = PictureDenoiser(PictureNetwork(SMALL)).eval()
    with torch.no_grad():
        for weight in found.parameters():
            weight.copy_((weight + 0.05 * torch.randn_like(weight)).half())
    return found


@pytest.fixture(scope="module")
def models(denoiser, tmp_path_factory):
    """A folder with the network as `p`, exported for the render size."""
    def make(made):
        checkpoint = {"config": SMALL.as_dict(), "weights": denoiser.state_dict(), "notes": {}}
        first = made / "denoise_upscale.p.onnx"
        error = export_trunk(load_trunk(checkpoint), first)
        for name in (first.stem, f"{first.stem}.1x"):
            path = made / f"{name}.onnx"
            path.write_bytes(first.read_bytes())
            path.with_suffix(".json").write_text(json.dumps(card(
                checkpoint, name.split(".", 1)[1], error, {})))

    folder = tmp_path_factory.mktemp("models")
    sources = [*(REPOSITORY / "training").rglob("*.py"), Path(__file__)]
    copy_made_once("picture-models", sources, f"{torch.__version__} {weights_of(denoiser)}", make,
                   folder)
    return folder


def weights_of(network):
    """A hash of all weights."""
    digest = hashlib.sha256()
    for name, values in network.state_dict().items():
        digest.update(name.encode() + values.numpy().tobytes())
    return digest.hexdigest()


def shot(frames=3):
    """Noisy frames of a moving pattern. Their samples are jittered, so that no lost detail is
    looked for."""
    random = np.random.default_rng(5)
    height, width = SIZE
    y, x = np.mgrid[:height, :width].astype(np.float32)
    for number in range(frames):
        albedo = 0.5 + 0.4 * np.sin((x + 2 * number)
                                    / 5)[..., None] * np.array([1, 0.7, 0.4], np.float32)
        light = random.gamma(1.0, 1.0, (height, width, 1)).astype(np.float32)
        yield Frame({
            Role.COLOUR: albedo * light,
            Role.DIFFUSE_ALBEDO: albedo,
            Role.SPECULAR_ALBEDO: np.full((height, width, 3), 0.04, np.float32),
            Role.NORMAL: np.broadcast_to(np.array([0, 0, 1], np.float32), (height, width, 3))
                         .copy(),
            Role.ROUGHNESS: np.full((height, width, 1), 0.5, np.float32),
            Role.DEPTH: (2 + y / height)[..., None],
            Role.MOTION: np.broadcast_to(np.array([2, 0], np.float32), (height, width, 2)).copy(),
        }, number=number + 1, jitter=JITTER)


def image(plane):
    return torch.from_numpy(np.ascontiguousarray(plane, np.float32)).permute(2, 0, 1)[None]


def displayed(light):
    exposed = light * 2**EXPOSURE_STOPS
    return exposed / (1 + exposed)


def test_codes_are_inverted_over_all_light():
    light = torch.logspace(-8, 4.8, 3000)
    torch.testing.assert_close(decode(encode(light)), light, rtol=1e-5, atol=0)
    assert encode(torch.tensor(MOST_LIGHT)).item() == pytest.approx(1, abs=1e-6)
    assert encode(torch.tensor(0.0)).item() == decode(torch.tensor(0.0)).item() == 0


def test_the_codes_grow_with_light_across_the_joints_of_the_curve():
    codes = encode(torch.logspace(-7, 0, 5000))
    assert (codes.diff() > 0).all()


@pytest.mark.parametrize(("network", "config", "planes"), (
    pytest.param(open_weights.NETWORK, PictureConfig(), "raw", id="usual"),
    pytest.param(open_weights.LARGE_NETWORK, LARGE, "clean", id="large"),
))
def test_it_begins_as_the_published_network(network, config, planes):
    """With the published weights a first frame is Open Image Denoise's picture."""
    pytest.importorskip("pyoidn")
    from postfx.oidn import OpenImageDenoise

    weights = {PREFIX + name: values for name, values in open_weights.published(network).items()}
    denoiser = PictureDenoiser(PictureNetwork(config)).eval()
    denoiser.load_state_dict(widen(weights, denoiser.state_dict()))
    frame = next(shot())
    height, width = (side // 16 * 16 for side in SIZE)
    cut = {role: plane[:height, :width] for role, plane in frame.planes.items()}
    inputs = Inputs(*(image(cut[role]) for role in (
        Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL, Role.ROUGHNESS,
        Role.DEPTH, Role.MOTION)),
        jitter=torch.zeros(1, 2))
    with torch.no_grad():
        found = denoiser.step(inputs,
                              empty_state(inputs, height, width)).output[0].permute(1, 2, 0).numpy()
    expected = np.empty((height, width, 3), np.float32)
    albedo = np.clip(cut[Role.DIFFUSE_ALBEDO] + cut[Role.SPECULAR_ALBEDO], 0, 1)
    OpenImageDenoise("high", "cpu", 1, planes=planes)(
        cut[Role.COLOUR], {"albedo": albedo, "normal": cut[Role.NORMAL]}, expected)
    # Open Image Denoise brings the picture to a mean brightness of its own first, so codes are not
    # the same.
    np.testing.assert_allclose(displayed(found).mean(), displayed(expected).mean(), rtol=0.01)
    assert np.abs(displayed(found) - displayed(expected)).mean() < 0.01


def test_published_weights_get_their_own_rate(denoiser):
    own, published = rate_groups(denoiser, 0.05)
    assert own["share"] == 1 and published["share"] == 0.05
    assert len(own["params"]) + len(published["params"]) == len(list(denoiser.parameters()))
    frozen = PictureDenoiser(PictureNetwork(SMALL))
    only, = rate_groups(frozen, 0)
    assert all(weight.requires_grad for weight in only["params"])
    assert not any(weight.requires_grad for weight in frozen.trunk.published())


def test_some_layers_can_be_learnt_alone(capsys):
    chosen = PictureDenoiser(PictureNetwork(SMALL))
    (only,) = rate_groups(chosen, 0.05, ["gate", "detail"])
    learnt = [name for name, weight in chosen.trunk.named_parameters() if weight.requires_grad]
    assert learnt == ["gate.weight", "gate.bias", "detail.weight", "detail.bias"]
    assert len(only["params"]) == len(learnt)
    for words, said in ((["--only", "gate"], "--only is for --picture"),
                        (["--picture", "--large", "--only", "gates"], "--only gates: the")):
        with pytest.raises(SystemExit):
            parse(["--clips", ".", "--out", ".", *words])
        assert said in capsys.readouterr().err


def test_what_is_added_to_a_published_network_begins_as_nothing():
    torch.manual_seed(1)
    network = PictureNetwork(SMALL)
    assert not any(weight.any() for name, weight in network.named_parameters()
                   if name.startswith(ADDED_LAYERS))


def test_an_open_gate_reads_the_history_instead_of_the_noise():
    """Where a pixel has a history, and there alone."""
    torch.manual_seed(1)
    network = PictureNetwork(SMALL)
    guided, further = torch.rand(1, GUIDED_INPUTS, 16, 16), torch.rand(1, FURTHER_INPUTS, 16, 16)
    known = torch.rand(1, SMALL.beside[0], 16, 16)
    further[:, VALID] = 0
    further[:, VALID, :, 8:] = 1
    with torch.no_grad():
        network.gate.bias.copy_(torch.tensor([20.0, -20.0]))
        colour = guided[:, :3] + network.mixed_in(guided, further, known)
    torch.testing.assert_close(colour[..., 8:], further[:, ACCUMULATED:HISTORY, :, 8:])
    torch.testing.assert_close(colour[..., :8], guided[:, :3, :, :8])


def test_detail_that_the_picture_lost_comes_from_the_albedo():
    """A texture of single pixels in even light, from a picture without it; the first weights keep
    the picture nearly as it is."""
    torch.manual_seed(1)
    network = PictureNetwork(SMALL)
    albedo = torch.where(torch.rand(1, 1, 24, 24) < 0.5, 0.1, 0.7).expand(1, 3, 24, 24)
    light = 2.0 * albedo
    smooth = encode(torch.nn.functional.avg_pool2d(light, 5, 1, 2, count_include_pad=False))
    known = torch.rand(1, SMALL.beside[0], 24, 24)
    with torch.no_grad():
        kept = decode(network.with_detail(smooth, encode(light), albedo, known))
        network.detail.bias.fill_(20.0)
        found = decode(network.with_detail(smooth, encode(light), albedo, known))
    torch.testing.assert_close(kept, decode(smooth), rtol=0.15, atol=0.02)
    inner = slice(5, -5)
    assert (found - light)[..., inner, inner].abs().mean() < 0.15 * light.mean()
    assert (kept - light)[..., inner, inner].abs().mean() > 0.5 * light.mean()


def test_detail_of_black_surfaces_has_small_gradients():
    """Black and lit surfaces beside each other, in light of all strengths."""
    torch.manual_seed(2)
    network = PictureNetwork(SMALL)
    albedo = torch.where(torch.rand(1, 1, 24, 24) < 0.5, 0.0, 1.0).expand(1, 3, 24, 24).clone()
    codes = torch.rand(1, 3, 24, 24).requires_grad_()
    known = torch.rand(1, SMALL.beside[0], 24, 24)
    network.detail.bias.data.fill_(20.0)
    network.with_detail(codes, codes.detach(), albedo.requires_grad_(), known).sum().backward()
    assert codes.grad.abs().max() < 1e4
    assert albedo.grad.abs().max() < 1e3


def test_noise_of_planes_goes_where_means_are_chosen_and_texture_stays_elsewhere():
    """A closed level keeps what is finer, also where the coarser ones are open."""
    torch.manual_seed(4)
    network = PictureNetwork(SMALL)
    noise = torch.rand(1, 6, 64, 64)
    streams = tuple(torch.zeros(1, channels, 64 >> level, 64 >> level)
                    for level, channels in enumerate(SMALL.beside))
    spreads = []
    with torch.no_grad():
        for opened in range(len(streams) + 1):
            for level, layer in enumerate(network.coarser):
                layer.bias.fill_(30.0 if level < opened else -30.0)
            found = network.averaged_planes(noise, streams)
            torch.testing.assert_close(found.mean((2, 3)), noise.mean((2, 3)), rtol=0.02, atol=0.0)
            spreads.append(float(found.std() / noise.std()))
    assert spreads[0] == pytest.approx(1.0, abs=1e-4)
    assert all(after < 0.6 * before for before, after in pairwise(spreads))


def test_an_albedo_is_filtered_alone_as_its_library_does():
    pytest.importorskip("pyoidn")
    import pyoidn

    rng = np.random.default_rng(5)
    albedo = rng.uniform(0.1, 0.9, (48, 64, 3)).astype(np.float32)
    device = pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_CPU)
    device.commit()
    plane = pyoidn.Buffer(device, albedo.nbytes, pyoidn.OIDN_STORAGE_DEVICE)
    plane.write(0, albedo.nbytes, albedo)
    library = pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT)
    for name in ("albedo", "output"):
        library.set_image(name, plane, pyoidn.OIDN_FORMAT_FLOAT3, 64, 48)
    library.set_quality(pyoidn.OIDN_QUALITY_BALANCED)
    library.commit()
    library.execute()
    device.wait()
    expected = np.empty_like(albedo)
    plane.read(0, expected.nbytes, expected)
    network = AlbedoFilter()
    network.load_state_dict(open_weights.published(open_weights.ALBEDO_NETWORK))
    with torch.no_grad():
        found = network(image(albedo))[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_the_filtered_albedo_is_taken_where_it_is_chosen():
    torch.manual_seed(6)
    network = PictureNetwork(SMALL)
    inputs = torch.rand(1, 9, 32, 48)
    known = torch.rand(1, SMALL.beside[0], 32, 48)
    noisy = inputs[:, 3:6]
    with torch.no_grad():
        kept = network.with_filtered_albedo(inputs, noisy, known)
        network.choose.bias.fill_(30.0)
        found = network.with_filtered_albedo(inputs, noisy, known)
        filtered = network.alone(noisy)
    torch.testing.assert_close(kept, inputs, rtol=0.0, atol=0.06)
    torch.testing.assert_close(found[:, 3:6], filtered)
    torch.testing.assert_close(found[:, [0, 1, 2, 6, 7, 8]], inputs[:, [0, 1, 2, 6, 7, 8]])


def test_a_history_that_differs_as_a_whole_counts_less():
    controls = torch.zeros(1, 11, 32, 64)
    error = torch.full((1, 1, 32, 64), float(np.log(1e-4)))
    change = torch.zeros(1, 3, 32, 64)
    change[..., 32:] = 0.05
    change[..., 10, 10] = 0.05  # one pixel is noise
    found = with_guarded_history(controls, change, torch.ones_like(error), error)
    assert (found[:, 0, :, 48:] > 2).all()
    assert not found[:, 0, :, :24].any()
    assert not found[:, 1:].any()


def test_pixels_without_a_history_say_nothing_about_their_neighbours_history():
    controls = torch.zeros(1, 11, 32, 64)
    error = torch.full((1, 1, 32, 64), float(np.log(1e-4)))
    change = torch.zeros(1, 3, 32, 64)
    change[..., 32:] = 0.5
    valid = torch.ones_like(error)
    valid[..., 32:] = 0
    assert with_guarded_history(controls, change, torch.ones_like(error), error)[:, 0, :, 31].all()
    assert not with_guarded_history(controls, change, valid, error).any()


def test_a_deep_branch_begins_as_the_other_one():
    torch.manual_seed(3)
    shallow = Branch(9, SMALL.beside)
    deep = DeepBranch(9, SMALL.beside)
    deep.load_state_dict(deep.state_dict() | shallow.state_dict())
    inputs = torch.rand(1, 9, 32, 48)
    with torch.no_grad():
        torch.testing.assert_close(deep(inputs), shallow(inputs))
        before = deep(inputs)[0]
        deep.quarter_more.bias.fill_(1.0)
        assert not torch.allclose(deep(inputs)[0], before)


def test_it_keeps_the_size(denoiser):
    frame = next(shot())
    inputs = Inputs(*(image(plane) for plane in frame.planes.values()), jitter=torch.zeros(1, 2))
    with pytest.raises(ValueError, match="keeps the size 40x56"):
        denoiser.step(inputs, empty_state(inputs, 80, 112))


@pytest.mark.parametrize("config", (SMALL, LARGE), ids=("small", "large"))
def test_a_config_tells_its_layout(config):
    assert layout_from(json.loads(json.dumps(config.as_dict()))) == config


def test_the_large_layout_has_the_products_of_the_large_published_network():
    """312 thousand a pixel, without what is added."""
    published = sum(layer.inputs * layer.outputs * 9 / 4**layer.level
                    for layer in LARGE.published_layers().values())
    assert published == pytest.approx(312e3, rel=0.005)
    assert LARGE.products() > published


def test_a_layout_needs_all_levels():
    with pytest.raises(ValueError, match="5 channels down"):
        PictureConfig(down=(8, 8))


def test_the_pass_computes_what_training_does(denoiser, models):
    """Frame by frame, with the history."""
    pipeline = Pipeline([DenoiseUpscale(scale=1, model="p", library=models)], Device("cpu"),
                        EXPOSURE_STOPS, "none")
    state = None
    for frame in shot():
        inputs = Inputs(*(image(frame.planes[role]) for role in (
            Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL, Role.ROUGHNESS,
            Role.DEPTH, Role.MOTION)), jitter=torch.tensor([JITTER]))
        inputs = replace(inputs, colour=inputs.colour * 2**EXPOSURE_STOPS)
        state = empty_state(inputs, *SIZE) if state is None else state
        with torch.no_grad():
            step = denoiser.step(inputs, state)
        state = step.state
        expected = step.output[0].permute(1, 2, 0).numpy() / 2**EXPOSURE_STOPS
        found = pipeline(frame)[Role.COLOUR]
        assert np.abs(displayed(found) - displayed(expected)).max() < CLOSE


def test_its_error_is_written(models):
    pipeline = Pipeline([DenoiseUpscale(scale=1, model="p", library=models, error=True)],
                        Device("cpu"))
    error = pipeline(next(shot()))[Role.ERROR]
    assert error.shape == (*SIZE, 1) and (error > 0).all()


def test_it_cannot_enlarge_or_filter_parts(models):
    with pytest.raises(PassOptionError, match="does not enlarge: give scale 1"):
        Pipeline([DenoiseUpscale(scale=2, model="p", library=models)], Device("cpu"))(next(shot()))


def test_training_starts_from_a_checkpoint_of_published_weights(tmp_path, denoiser):
    weights = {name: values for name, values in denoiser.state_dict().items() if "_conv" in name}
    save({"config": SMALL.as_dict(), "weights": weights, "notes": {}}, tmp_path / "start.pt")
    args = parse(["--clips", str(tmp_path), "--out", str(tmp_path), "--picture", "--start",
                  str(tmp_path / "start.pt")])
    assert args.picture and args.published_rate == 0.05
    fresh = PictureDenoiser(PictureNetwork(SMALL))
    found = widen(weights, fresh.state_dict())
    assert all(torch.equal(found[name], values) for name, values in weights.items())


def test_a_mixture_with_published_weights_fades_what_was_added(tmp_path, denoiser):
    """Layers that add to the published network count as nothing in it; the others are the trained
    ones."""
    trained = denoiser.state_dict()
    published = {name: torch.zeros_like(values)
                 for name, values in trained.items() if "_conv" in name}
    for name, weights in (("trained", trained), ("published", published)):
        save({"config": SMALL.as_dict(), "weights": weights, "notes": {}}, tmp_path / f"{name}.pt")
    mixed = mix([(tmp_path / "trained.pt", 0.25), (tmp_path / "published.pt", 0.75)])["weights"]
    shares = {"correct.weight": 0.25, "join.bias": 0.25, "enc_conv1.weight": 0.25,
              "judge.0.weight": 1, "branch.full.bias": 1}
    for name, share in shares.items():
        torch.testing.assert_close(mixed[PREFIX + name], share * trained[PREFIX + name])
    newer = mix([(tmp_path / "trained.pt", 1.0)], newer=0.5)["weights"][PREFIX + "controls.bias"]
    changed = newer - trained[PREFIX + "controls.bias"]
    assert changed[0] == pytest.approx(0.5) and not changed[1:].any()


def test_a_graft_adds_the_layers_that_a_network_lacks(tmp_path, denoiser):
    trained = denoiser.state_dict()
    published = {name: torch.zeros_like(values)
                 for name, values in trained.items() if "_conv" in name}
    for name, weights in (("trained", trained), ("published", published)):
        save({"config": SMALL.as_dict(), "weights": weights, "notes": {}}, tmp_path / f"{name}.pt")
    found = graft(tmp_path / "published.pt", tmp_path / "trained.pt", ["branch"])["weights"]
    assert set(found) == set(published) | {name for name in trained
                                           if name.startswith(PREFIX + "branch.")}
    assert not any(found[name].any() for name in published)
    with pytest.raises(ValueError, match="no layer twig"):
        graft(tmp_path / "published.pt", tmp_path / "trained.pt", ["twig"])
