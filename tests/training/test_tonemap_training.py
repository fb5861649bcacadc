"""The tone mapper's network, looks and training."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys

import numpy as np
import onnxruntime
import pytest

from postfx.paths import models_dir

torch = pytest.importorskip("torch")

from training.agx import agx  # noqa: E402
from training.export_tonemap import export  # noqa: E402
from training.local_laplacian import compress, local_laplacian  # noqa: E402
from training.looks import LOOKS, apply_cube, bake_cube, exact_target, exact_view, find_look  # noqa: E402
from training.networks import hdrnet  # noqa: E402


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def test_network_has_the_papers_size() -> None:
    assert sum(p.numel() for p in hdrnet.HDRNet().parameters()) == 482_080


def test_exported_network_gives_what_torch_gives(tmp_path) -> None:
    torch.manual_seed(1)
    net = hdrnet.HDRNet().eval()
    low = torch.rand(1, 3, 256, 256)
    export(net, (low,), ["lowres"], ["grid", "guide"], tmp_path / "net.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "net.onnx")
    grid, guide = session.run(["grid", "guide"], {"lowres": low.numpy()})
    with torch.no_grad():
        wanted = net(low)
    assert relative(grid, wanted[0].numpy()) <= 1e-3
    np.testing.assert_array_equal(guide, wanted[1].numpy())


def test_shipped_model_is_the_one_on_its_card() -> None:
    for card_path in models_dir().glob("tonemap.*.json"):
        card = json.loads(card_path.read_text())
        assert hashlib.sha256(card_path.with_suffix(".onnx").read_bytes()).hexdigest() == card["sha256"]
        assert (card["shaper"]["toe"], card["shaper"]["scale"]) == hdrnet.SHAPER
        assert card["quality"]["held_out_psnr"]


def test_training_form_of_slicing_equals_the_kernels() -> None:
    torch.manual_seed(2)
    colour = torch.rand(2, 3, 37, 53) * 4
    params, guide = hdrnet.default_params(1.3), hdrnet.Guide()()
    grid = torch.randn(2, 16, 16, 8, 12)
    dense = hdrnet.slice_apply_dense(hdrnet.shape(colour, params), guide, grid).clamp(0, 1)
    torch.testing.assert_close(dense, hdrnet.slice_apply(colour, params, guide, grid), atol=1e-5, rtol=0)


def test_slicing_can_be_trained_through() -> None:
    net = hdrnet.HDRNet()
    colour, params = torch.rand(1, 3, 40, 60), hdrnet.default_params()
    grid, guide = net(hdrnet.lowres(colour, params))
    hdrnet.slice_apply_dense(hdrnet.shape(colour, params), guide, grid).sum().backward()
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in net.parameters())


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
    torch.testing.assert_close(compress(rgb, sigma=1.0, alpha=1.0, beta=1.0), rgb, rtol=2e-3, atol=1e-5)


def test_agx_is_grey_for_grey_rising_and_white_at_most() -> None:
    ramp = np.exp2(np.linspace(-10, 8, 200, dtype=np.float32))[:, None].repeat(3, 1)
    out = agx(ramp)
    assert np.ptp(out, axis=1).max() < 2e-3
    assert np.diff(out[:, 1]).min() > -1e-3
    assert out.min() >= 0 and out.max() <= 1 and out[-1].min() > 0.95


def test_aces_view_is_the_configs_own() -> None:
    """ACES 2.0 SDR puts scene mid grey 0.18 at 10 cd/m2 of 100, which is 0.349 of the sRGB signal."""
    pytest.importorskip("PyOpenColorIO")
    grey = exact_view(LOOKS["aces2"], np.full((1, 1, 3), 0.18, np.float32))
    np.testing.assert_allclose(grey, 0.3492, atol=1e-3)


@pytest.mark.parametrize("name", sorted(LOOKS))
def test_baked_cube_stands_for_the_view(name: str) -> None:
    pytest.importorskip("PyOpenColorIO")
    random = np.random.default_rng(5)
    stops = random.uniform(-7, 6, (1, 1000, 1)) + random.normal(0, 0.7, (1, 1000, 3))
    rgb = np.exp2(stops).astype(np.float32)
    cube = torch.from_numpy(bake_cube(LOOKS[name]).astype(np.float32))
    found = apply_cube(torch.from_numpy(rgb).permute(2, 0, 1)[None], cube)[0].permute(1, 2, 0).numpy()
    error = np.abs(found - exact_view(LOOKS[name], rgb))
    assert error.mean() < 0.5 / 255
    assert np.quantile(error, 0.99) < 3 / 255


def test_looks_come_by_name_or_from_a_file(tmp_path) -> None:
    pytest.importorskip("PyOpenColorIO")
    assert find_look("aces2") is LOOKS["aces2"]
    view = LOOKS["aces2"].view
    keys = "".join(f'{key} = "{value}"\n' for key, value in vars(view).items())
    path = tmp_path / "mine.toml"
    path.write_text(f"gain = 1.0\nsigma = 1.0\nalpha = 1.0\nbeta = 0.8\n[view]\n{keys}")
    look = find_look(str(path))
    assert (look.gain, look.beta, look.view) == (1.0, 0.8, view)
    path.write_text("gain = 1.0\n")
    with pytest.raises(SystemExit, match=r"mine\.toml: 'view': give gain"):
        find_look(str(path))
    with pytest.raises(SystemExit, match="no look 'sepia'"):
        find_look("sepia")


@pytest.mark.slow
def test_a_pack_can_be_made_and_trained_on(tmp_path) -> None:
    pytest.importorskip("PyOpenColorIO")
    oiio = pytest.importorskip("OpenImageIO")
    random = np.random.default_rng(0)
    for name in ("one", "two", "held"):
        picture = np.exp2(random.normal(0, 2, (12, 16, 3))).repeat(8, 0).repeat(8, 1).astype(np.float32)
        oiio.ImageBuf(picture).write(str(tmp_path / f"{name}.exr"))
    run = [sys.executable, "-m"]
    pack = tmp_path / "set.npz"
    make = ["training.make_tonemap_set", "-o", str(pack), "--photos", str(tmp_path / "*.exr"), "--hold-out", "held"]
    subprocess.run([*run, *make], check=True, capture_output=True)
    packed = np.load(pack)
    assert list(packed["names"]) == ["one", "two"] and list(packed["validation_names"]) == ["held"]
    wanted = exact_target(packed["validation_input_0"].astype(np.float32), LOOKS["aces2"])
    np.testing.assert_allclose(packed["validation_target_0"] / 65535, wanted, atol=1e-4)
    train = ["training.train_tonemap", "--data", str(pack), "--out", str(tmp_path / "run"), "--minutes", "0.05"]
    subprocess.run([*run, *train, "--batch", "2", "--scale", "0.2"], check=True, capture_output=True)
    checkpoint = torch.load(tmp_path / "run" / "checkpoint.pt")
    assert checkpoint["history"][0]["steps"] > 0 and checkpoint["psnr"]["held"] > 5
    hdrnet.HDRNet().load_state_dict(checkpoint["weights"])
