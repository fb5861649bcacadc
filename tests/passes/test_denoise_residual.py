"""Networks whose last level has the render size: what they read and give, as the recurrent step in
torch does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.errors import MemoryBudgetError, PassOptionError
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.passes.denoise import DenoiseUpscale, models
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.cli.conftest import noise  # noqa: F401
from tests.passes.denoise_frames import noisy
from tests.passes.test_denoise_strength import masked

torch = pytest.importorskip("torch")

from tests.training.conftest import one_thread  # noqa: E402, F401
from tests.training.small_denoiser import RESIDUAL, small_model  # noqa: E402
from training.denoise import model as network  # noqa: E402

TOLERANCE = 1e-4
MIRRORED = (Role.DENOISING_ALBEDO, Role.DENOISING_NORMAL)
SEAM = 1e-5
"""Of the largest value: sums in another order."""


def seen(number: int, height: int, width: int, mirrored: bool = True, **kept) -> Frame:
    """A noisy frame, with planes that follow mirrors and glass, some of it broken."""
    frame = noisy(number, height, width, **{"exposure": 1.0, **kept})
    random = np.random.default_rng([7, number])
    if not mirrored:
        return frame
    albedo, normal = 1.5 * random.random((2, height, width, 3), np.float32) - 0.2
    normal[3, 4], albedo[5, 6] = np.inf, np.nan
    return replace(frame, planes={**frame.planes, Role.DENOISING_ALBEDO: albedo,
                                  Role.DENOISING_NORMAL: 2 * normal - 1})


def in_torch(frames: list[Frame], size: tuple[int, int]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Colour and expected error of the torch definition; the error has the render size."""
    model, results, state, last = small_model(config=RESIDUAL).eval(), [], None, None
    for frame in frames:
        gain = None if last is None else torch.full((1, 1, 1, 1), frame.exposure_factor / last)
        planes = {str(role): torch.from_numpy(plane).permute(2, 0, 1)[None]
                  for role, plane in frame.planes.items()}
        planes["colour"] = planes["colour"] * frame.exposure_factor
        inputs = network.Inputs(**planes, jitter=torch.tensor([frame.jitter], dtype=torch.float32),
                                gain=gain)
        state = state or network.empty_state(inputs, *size)
        with torch.no_grad():
            step = model.step(inputs, state)
        state, last = step.state, frame.exposure_factor
        results.append((step.output[0].permute(1, 2, 0).numpy() / frame.exposure_factor,
                        step.error[0].permute(1, 2, 0).exp().numpy()))
    return results


def chain(device: Device, **options) -> Pipeline:
    return Pipeline([DenoiseUpscale(**{"model": "residual", "scale": 1, "error": True, **options})],
                    device, exposure="metadata", cuts="none", checks=False)


def apart(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "portable"])
@pytest.mark.parametrize("mirrored", [True, False], ids=["all planes", "no mirrored planes"])
@pytest.mark.parametrize(("size", "scale"), [((48, 64), 1), ((37, 50), 1), ((37, 50), 1.5)])
def test_pass_gives_what_torch_gives(
    size: tuple[int, int], scale: float, mirrored: bool, compiled: bool, small_models: Path
) -> None:
    frames = [seen(i, *size, mirrored, exposure=np.log2(exposure))
              for i, exposure in enumerate((1.0, 1.0, 2.5))]
    frames[1].jitter = (0.0, 0.0)
    output = tuple(round(side * scale) for side in size)
    pipeline = chain(Device("cpu", threads=2, compiled_kernels=compiled), scale=scale)
    for frame, (colour, error) in zip(frames, in_torch(frames, output), strict=True):
        found = pipeline(frame)
        assert apart(found[Role.COLOUR], colour) <= TOLERANCE
        if scale == 1:
            assert apart(found[Role.ERROR], error) <= TOLERANCE
        else:
            assert found[Role.ERROR].shape == (*output, 1)
            assert (0.999 * error.min() < found[Role.ERROR].min()
                    and found[Role.ERROR].max() < 1.001 * error.max())
    assert set(MIRRORED) <= set(pipeline.plan.planes) or not mirrored


def test_each_mirrored_plane_counts_and_only_such_networks_read_them(small_models: Path,
                                                                     device: Device) -> None:
    frame = seen(1, 32, 48)
    whole = chain(device)(frame)
    for role in MIRRORED:
        without = replace(frame, planes={key: plane
                                         for key, plane in frame.planes.items() if key is not role})
        assert not np.allclose(chain(device)(without)[Role.COLOUR], whole[Role.COLOUR], rtol=1e-3)
    plain = Pipeline([DenoiseUpscale(model="doubting", scale=1)], device)
    plain(frame)
    assert not set(MIRRORED) & set(plain.plan.planes)


def test_a_volume_keeps_its_planes(small_models: Path, device: Device) -> None:
    """Depth and albedo are left out for other networks, which the report says."""
    frame, random = seen(1, 32, 48), np.random.default_rng(3)
    depth = np.where(random.random((32, 48, 1)) < 0.5, 1e10, frame[Role.DEPTH]).astype(np.float32)
    fog = replace(frame, planes={**frame.planes, Role.DEPTH: depth})
    for model, told in (("residual", False), ("doubting", True)):
        pipeline = chain(device, model=model, error=False)
        pipeline(fog)
        assert any("depth is noise" in item.why for item in pipeline.explain().skips) is told
    (colour, _), = in_torch([fog], (32, 48))
    assert apart(chain(device)(fog)[Role.COLOUR], colour) <= TOLERANCE


def test_windows_around_a_mask_are_as_the_whole_frame(small_models: Path, device: Device) -> None:
    """The halo holds all that the network sees. Where it did not run, no error is expected."""
    mask = np.zeros((40, 900), np.float32)
    mask[:, 420:470] = 1
    whole, parts = chain(device), chain(device)
    for number in range(3):
        frame = seen(number, 40, 900, samples=1)
        wanted, found = whole(frame), parts(masked(frame, mask))
        inside = np.s_[:, 422:468]
        limit = 1e-3 if number else SEAM  # what lies beyond the window has no history later
        for role in (Role.COLOUR, Role.ERROR):
            assert apart(found[role][inside], wanted[role][inside]) <= limit
        assert not found[Role.ERROR][:, :200].any() and found[Role.ERROR][inside].all()
    assert any("strength is 0 there" in item.why for item in parts.explain().skips)


def test_a_frame_of_strength_0_expects_no_error(small_models: Path, device: Device) -> None:
    pipeline = chain(device)
    assert pipeline(seen(1, 32, 48))[Role.ERROR].all()
    assert not pipeline(masked(seen(2, 32, 48), 0))[Role.ERROR].any()


@pytest.mark.soak
def test_tiles_within_a_memory_budget_are_as_the_whole_frame(small_models: Path,
                                                             device: Device) -> None:
    frames = [seen(number, 40, 1200) for number in range(3)]
    with pytest.raises(MemoryBudgetError) as refused:
        chain(Device("cpu", threads=2, memory="260M"))(frames[0])
    least = str(refused.value).split()[-3]
    whole, tiled = chain(device), chain(Device("cpu", threads=2, memory=least))
    for frame in frames:
        wanted, found = whole(frame), tiled(frame)
        assert apart(found[Role.COLOUR], wanted[Role.COLOUR]) <= SEAM
        assert apart(found[Role.ERROR], wanted[Role.ERROR]) <= SEAM


def test_frames_may_change_their_size(small_models: Path, device: Device) -> None:
    pipeline, whole = chain(device, scale=None, size=(96, 64)), chain(device)
    first = pipeline(seen(0, 64, 96))
    assert pipeline(seen(1, 48, 72))[Role.ERROR].shape == (64, 96, 1)
    np.testing.assert_array_equal(first[Role.ERROR], whole(seen(0, 64, 96))[Role.ERROR])


def test_networks_that_do_not_predict_their_error_say_so(small_models: Path,
                                                         device: Device) -> None:
    for model in ("doubting", "low"):
        with pytest.raises(PassOptionError, match=f"model '{model}' does not predict its error"):
            chain(device, model=model)(seen(1, 32, 48))
    with pytest.raises(PassOptionError, match="strength 0 runs no network"):
        chain(device, strength=0)(seen(1, 32, 48))


def test_a_budget_takes_only_networks_that_predict_their_error(small_models: Path,
                                                               device: Device) -> None:
    assert chain(device, budget=1000)(seen(1, 32, 48))[Role.ERROR].all()


def run_with_error(postfx, folder: Path, *options: str, output: str = "out/a.####.exr"):
    return postfx("run", "in/shot.####.exr", "--model",
                  str(folder / "denoise_upscale.residual.onnx"), "--run-up", "0",
                  "--aov", "error", "-o", output, *options)


@pytest.mark.usefixtures("noise")
@pytest.mark.parametrize("options", [(), ("--keep", "all"), ("--tonemap", "aces2"),
                                     ("--scale", "1.5"), ("--both-ways",)])
def test_the_command_writes_it_beside_the_picture(options, postfx, tmp_path: Path,
                                                  exported_models: Path) -> None:
    done = run_with_error(postfx, exported_models, *options, "--exposure", "0", "--frames", "1-2")
    assert done.code == 0, done.err
    picture = oiio.ImageBuf(str(tmp_path / "out/a.0002.exr"))
    names, pixels = picture.spec().channelnames, picture.get_pixels(oiio.FLOAT)
    found = pixels[..., names.index("error.V")]
    scale = 1.5 if "--scale" in options else 1
    frames = list(read_sequence(str(tmp_path / "in/shot.####.exr"), "1-2"))
    denoise = DenoiseUpscale(model=str(exported_models / "denoise_upscale.residual.onnx"),
                             scale=scale, error=True)
    library = Pipeline([denoise], Device("cpu", threads=2), exposure=0.0)
    wanted = [library(frame)[Role.ERROR] for frame in frames][-1]
    np.testing.assert_allclose(found, wanted[..., 0], rtol=2e-3)


@pytest.mark.usefixtures("noise")
def test_a_picture_for_a_display_holds_none(postfx, exported_models: Path) -> None:
    done = run_with_error(postfx, exported_models, output="out/a.####.png")
    assert (done.code and done.err.strip() == (
        "error: out/a.####.png: pictures for a display hold no AOV 'error': write EXR, or leave "
        "error out of --aov"))


def test_the_error_is_predicted_beside_parts_as_without_them() -> None:
    """Another network filters them."""
    given = noisy(1, 32, 44)
    given = replace(given, parts={"key": 0.5 * given[Role.COLOUR]})
    with_parts, alone = (
        Pipeline([DenoiseUpscale(1, model="xl", error=True, parts=parts)], Device("cpu"))(given)
        for parts in (["key"], []))
    np.testing.assert_array_equal(with_parts[Role.ERROR], alone[Role.ERROR])


@pytest.mark.usefixtures("noise")
def test_the_command_names_a_network_that_predicts_none(postfx) -> None:
    done = postfx("run", "in/shot.####.exr", "--model", "s", "--aov", "error", "-o",
                  "out/a.####.exr")
    assert (done.code
            and done.err.startswith("error: model 's' does not predict its error at this size"))
    assert done.err.count("\n") == 1


def test_the_halo_of_a_card_comes_before_that_of_the_name(small_models: Path) -> None:
    model = ["denoise_upscale.residual"]
    assert models.halo_of(model) == models.seamless(model) == RESIDUAL.sees
