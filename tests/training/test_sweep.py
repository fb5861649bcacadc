"""The architecture sweep: its variants differ in what they say, and are trained and measured from the command line."""

from __future__ import annotations

import csv
import json
import signal
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from postfx.runtime import Device  # noqa: E402
from tests.training.small_denoiser import one_thread  # noqa: E402, F401
from tests.training.test_denoise_training import write_clips  # noqa: E402
from training.dataset import collate, load, to_batch  # noqa: E402
from training.export import PARITY  # noqa: E402
from training.export_denoise import load_trunk  # noqa: E402
from training.networks import ops  # noqa: E402
from training.networks.denoise_upscale import empty_state  # noqa: E402
from training.networks.trunk import BLEND, KERNEL, MEMORY, SHARPEN, Trunk  # noqa: E402
from training.sweep import jobs, report, timing  # noqa: E402
from training.sweep.__main__ import main  # noqa: E402
from training.sweep.export import export_variant  # noqa: E402
from training.sweep.trunk import SweepTrunk, build  # noqa: E402
from training.sweep.variants import VARIANTS, Variant  # noqa: E402
from training.train_denoise import ClipLoss  # noqa: E402


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip to validate on and one to train on."""
    folder = tmp_path_factory.mktemp("clips")
    write_clips(folder, 2)
    return folder


def heads(name: str, size: int = 64, spread: float = 0.1) -> tuple[torch.Tensor, ...]:
    """What a variant's network with random weights says."""
    torch.manual_seed(0)
    trunk = SweepTrunk(VARIANTS[name])
    with torch.no_grad():
        for head in (*trunk.heads, trunk.fine):
            head.weight += torch.randn_like(head.weight) * spread
        return trunk(torch.rand(2, trunk.features, size, size))


def kernels(found: tuple[torch.Tensor, ...]) -> list[torch.Tensor]:
    return [head[:, :KERNEL] for head in found]


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_learns_from_a_clip_all_over(name: str, clips: Path) -> None:
    torch.manual_seed(0)
    batch = to_batch(collate([load(clips / "clip0000.npz", torch.device("cpu"))], [0]))
    model = build(VARIANTS[name])
    loss = ClipLoss(model, flicker=1.0, reset=0.0)
    loss(batch)[0].backward()
    without = [key for key, value in model.named_parameters() if not value.grad.abs().sum() > 0]
    assert not without
    assert all(torch.isfinite(value.grad).all() for value in model.parameters())


@pytest.mark.parametrize("name", VARIANTS)
def test_heads_have_the_shapes_that_the_upscaler_reads(name: str) -> None:
    variant, (fine, *levels) = VARIANTS[name], heads(name)
    assert fine.shape == (2, MEMORY + variant.hidden, 64, 64)
    assert len(levels) == variant.levels
    for i, level in enumerate(levels, 1):
        assert level.shape == (2, KERNEL + (i < variant.levels), 64 >> i, 64 >> i)


def test_the_base_variant_is_the_default_network() -> None:
    torch.manual_seed(0)
    shipped = Trunk()
    torch.manual_seed(0)
    mine = SweepTrunk(VARIANTS["w64"])
    assert list(mine.state_dict()) == list(shipped.state_dict())
    features = torch.rand(1, mine.features, 32, 48)
    for a, b in zip(mine(features), shipped(features), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


@pytest.mark.parametrize("name", ["w16", "w32", "w96", "depth3"])
def test_a_variant_of_other_widths_can_be_exported_as_a_model(name: str) -> None:
    model = build(VARIANTS[name])
    weights = {key: value.half().float() for key, value in model.state_dict().items()}
    model.load_state_dict(weights)
    features = torch.rand(1, model.trunk.features, 16, 32)
    trunk = load_trunk({"config": model.config.as_dict(), "weights": weights})
    for a, b in zip(model.trunk(features), trunk(features), strict=True):
        torch.testing.assert_close(a, b)


def test_small_kernels_have_no_outer_taps() -> None:
    inner = torch.zeros(5, 5, dtype=torch.bool)
    inner[1:4, 1:4] = True
    for head in kernels(heads("kernel3")):
        assert (head[:, inner.flatten()] > 0).all() and not head[:, ~inner.flatten()].any()
    assert all((head > 0).all() for head in kernels(heads("w64")))


@pytest.mark.parametrize("hidden", [0, 4, 16])
def test_the_state_is_as_wide_as_the_variant_says(hidden: int, clips: Path) -> None:
    batch = to_batch(collate([load(clips / "clip0000.npz", torch.device("cpu"))], [0], 32))
    model = build(VARIANTS[f"hidden{hidden}"])
    state = empty_state(batch.frames[0], 64, 64)
    for frame in batch.frames:
        _, state, _ = model(frame, state)
        assert state.hidden.shape == (1, hidden, 32, 32)
    assert model.trunk.stem.in_channels == 27 + hidden


def test_what_a_variant_goes_without_does_nothing() -> None:
    assert (heads("no_blend")[0][:, BLEND:SHARPEN] == 1).all()
    assert heads("w64")[0][:, BLEND:SHARPEN].std() > 1e-3


def test_without_blending_the_last_output_is_not_mixed_in(clips: Path) -> None:
    batch = to_batch(collate([load(clips / "clip0000.npz", torch.device("cpu"))], [0], 32))
    frame = batch.frames[0]
    for name, same in (("no_blend", True), ("w64", False)):
        torch.manual_seed(0)
        model = build(VARIANTS[name])
        with torch.no_grad():
            model.trunk.stem.weight[:, 6:9] = 0  # else the network sees the last output, too
            _, state, _ = model(frame, empty_state(frame, 64, 64))
            outputs = [model(frame, type(state)(**{**vars(state), "output": state.output * factor}))[0]
                       for factor in (1.0, 2.0)]
        assert torch.allclose(*outputs) == same


@pytest.mark.parametrize("name", ["levels5", "levels3"])
def test_the_size_is_padded_as_the_pyramid_needs(name: str, clips: Path) -> None:
    batch = to_batch(collate([load(clips / "clip0000.npz", torch.device("cpu"))], [0]))
    frame = batch.frames[0]
    height, width = batch.references.shape[-2:]
    assert frame.colour.shape[-2:] == (48, 60)
    output, _, _ = build(VARIANTS[name])(frame, empty_state(frame, height, width))
    assert output.shape == (1, 3, height, width) and torch.isfinite(output).all()


@pytest.mark.parametrize("change", [{"stride": 1}, {"stride": 4, "hidden": 0}, {"taps": 3, "blend": False}], ids=str)
def test_the_exported_network_computes_the_same(change: dict, tmp_path: Path) -> None:
    torch.manual_seed(0)
    variant = Variant(widths=(8, 12), depth=1, **change)
    weights = {key: value + 0.1 * torch.randn_like(value) for key, value in build(variant).state_dict().items()}
    assert export_variant(variant, weights, tmp_path / "network.onnx") < PARITY


def test_the_small_filter_that_is_timed_filters() -> None:
    random = np.random.default_rng(0)
    mixed, weights = random.random((3, 20, 24), np.float32), random.random((1, 26, 20, 24), np.float32)
    found = np.empty_like(mixed)
    timing.small_rows(0, 20, mixed, weights, np.array([20, 24], np.float32), found)
    valid = torch.ones(1, 1, 20, 24)
    inner = torch.from_numpy(weights)[:, :9].unflatten(1, (3, 3))
    grown = torch.nn.functional.pad(inner, (0, 0, 0, 0, 1, 1, 1, 1)).flatten(1, 2)
    wanted = ops.filter_kernels(torch.from_numpy(mixed)[None], grown, valid)[0]
    np.testing.assert_allclose(found, wanted.numpy(), rtol=1e-4)


def test_filters_are_timed_as_the_variant_has_them() -> None:
    device = Device("cpu")
    found = {name: [step.kernel.name for step in timing.filter_steps(device, VARIANTS[name], 64, 96)]
             for name in ("w64", "levels3", "kernel3")}
    assert found["w64"].count("denoise_filter") == 5 and found["w64"].count("denoise_pool") == 4
    assert found["levels3"].count("denoise_filter") == 4
    assert found["kernel3"].count("sweep_filter") == 5


def test_the_front_holds_what_nothing_beats() -> None:
    rows = [{"name": name, "ms": ms, "psnr": psnr} for name, ms, psnr in
            (("slow", 9.0, 30.0), ("fast", 1.0, 28.0), ("worse", 2.0, 27.0), ("equal", 10.0, 30.0), ("mid", 3.0, 29.0))]
    report.mark_front(rows)
    assert {row["name"] for row in rows if row["front"]} == {"slow", "fast", "mid"}


@pytest.mark.slow
def test_two_variants_are_trained_and_measured(clips: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    runs, out = tmp_path / "runs", tmp_path / "out"
    train = ["train", f"--clips={clips}", f"--out={runs}", "--minutes=0.02", "--gpus=0,1", "--only=w16,depth1"]
    train += ["--crop=32", "--batch=1", "--wait=1", "--rate=0.001"]
    assert main(train) == 0
    before = {path: path.stat().st_mtime_ns for path in runs.glob("*/checkpoint.pt")}
    assert sorted(path.parent.name for path in before) == ["depth1", "w16"]
    assert all((path.with_name(name)).exists() for path in before for name in ("log.csv", "validation.csv"))
    assert main(train) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert "2 of 2 variants are there already" in capsys.readouterr().out

    assert main(["measure", str(runs), f"--out={out}", "--size=90x50", "--repeat=2"]) == 0
    said = capsys.readouterr().out
    rows = {row["name"]: row for row in csv.DictReader((out / "sweep.csv").open())}
    facts = json.loads((out / "sweep.json").read_text())
    assert facts["size"] == "90x50" and {row["name"] for row in facts["variants"]} == set(rows) == {"w16", "depth1"}
    for name, row in rows.items():
        assert f"| {name} |" in said
        assert 0 < float(row["ms_min"]) <= float(row["ms"]) <= float(row["ms_max"])
        assert float(row["network_ms"]) > 0 and float(row["filter_ms"]) > 0 and int(row["steps"]) > 0
        assert np.isfinite(float(row["psnr"]))
    assert int(rows["w16"]["parameters"]) < int(rows["depth1"]["parameters"])
    assert (out / "sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_a_variant_that_cannot_be_trained_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_clips(tmp_path, 2)
    (tmp_path / "clip0000.npz").unlink()
    assert main(["train", f"--clips={tmp_path}", f"--out={tmp_path}/runs", "--minutes=0.01", "--only=w16",
                 "--wait=1"]) == 1
    assert "w16: failed" in (said := capsys.readouterr().out) and "no clip to validate on" in said


def test_an_interrupted_sweep_ends_its_processes_and_begins_unfinished_variants_anew(
        clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, minutes in (("w16", 5.01), ("w32", 2.0)):
        (tmp_path / name).mkdir()
        torch.save({"notes": {"minutes": minutes}}, tmp_path / name / "checkpoint.pt")
        (tmp_path / name / "log.csv").write_text("old")
    queue = jobs.Queue(["w16", "w32", "w64"], tmp_path, ["0", "1"], 5.0, [f"--clips={clips}", "--wait=1"])
    started = []
    start = jobs.Queue._start
    monkeypatch.setattr(jobs.Queue, "_start", lambda *given: started.append(start(*given)) or started[-1])
    monkeypatch.setattr(jobs.Queue, "_collect", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        queue.run(pause=0.1)
    assert [job.name for job in started] == ["w32", "w64"]
    assert all(job.process.returncode == -signal.SIGKILL for job in started)
    assert (tmp_path / "w16" / "log.csv").read_text() == "old" and not (tmp_path / "w32" / "log.csv").exists()


def test_unknown_variants_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no variant 'huge': there are w16, w32"):
        main(["train", f"--clips={tmp_path}", f"--out={tmp_path}", "--only=w64,huge"])
