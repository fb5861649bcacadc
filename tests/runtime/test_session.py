"""Networks optimised once and kept: the same bits, never an old or a damaged file, and no file is
no harm."""

import os
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest

from postfx.runtime import Device, Library, ModelError, session
from postfx.runtime.session import Placement, providers_of
from postfx.system import models_dir

WINDOW = {"height": 16, "width": 32}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache/postfx/networks"


def made(model: bytes, dims: dict[str, int]) -> ort.InferenceSession:
    def options() -> ort.SessionOptions:
        found = ort.SessionOptions()
        for name, size in dims.items():
            found.add_free_dimension_override_by_name(name, size)
        return found

    return session.make_session(model, dims, options)


def content(name: str = "denoise_upscale.s") -> bytes:
    return (models_dir() / f"{name}.onnx").read_bytes()


def results(ready: ort.InferenceSession) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    return ready.run(None, {value.name: random.random(value.shape, np.float32)
                            for value in ready.get_inputs()})


@pytest.mark.parametrize("name", ["denoise_upscale.s", "tonemap.agx", "tonemap.auto"])
def test_same_bits_from_the_file(folder, name, monkeypatch):
    anew = results(made(content(name), WINDOW))
    monkeypatch.setattr(session, "_optimise", lambda *_: pytest.fail("it is not kept"))
    for one, other in zip(results(made(content(name), WINDOW)), anew, strict=True):
        np.testing.assert_array_equal(one, other)
    monkeypatch.setattr(session, "private_folder", lambda _: None)
    for one, other in zip(results(made(content(name), WINDOW)), anew, strict=True):
        np.testing.assert_array_equal(one, other)


def test_file_for_all_that_it_depends_on(folder, monkeypatch):
    made(content(), WINDOW)
    made(content(), WINDOW)
    assert len(list(folder.iterdir())) == 1
    made(content(), {"height": 32, "width": 32})
    made(content("tonemap.agx"), {})
    assert len(list(folder.iterdir())) == 3
    monkeypatch.setattr(ort, "__version__", "another")
    made(content(), WINDOW)
    monkeypatch.setattr(session, "_processor", lambda: "another")
    made(content(), WINDOW)
    assert len(list(folder.iterdir())) == 5


@pytest.mark.parametrize("damage", [
    lambda file: file.write_bytes(file.read_bytes()[:-1]),
    lambda file: file.write_bytes(b""),
    lambda file: file.write_bytes(bytes([file.read_bytes()[0] ^ 1]) + file.read_bytes()[1:]),
    pytest.param(lambda file: (file.unlink(), os.mkfifo(file)), marks=pytest.mark.skipif(
        not hasattr(os, "mkfifo"), reason="there are no named pipes here")),
    lambda file: (file.unlink(), file.symlink_to("nowhere")),
])
def test_damaged_file_is_made_anew(folder, damage, monkeypatch):
    wanted = results(made(content(), WINDOW))
    (file,) = folder.iterdir()
    damage(file)
    for one, other in zip(results(made(content(), WINDOW)), wanted, strict=True):
        np.testing.assert_array_equal(one, other)
    assert list(folder.iterdir()) == [file]
    monkeypatch.setattr(session, "_optimise", lambda *_: pytest.fail("it is not kept"))
    made(content(), WINDOW)


def test_large_models_are_not_kept(folder, monkeypatch):
    monkeypatch.setattr(session, "LARGEST_MODEL", len(content()) - 1)
    assert results(made(content(), WINDOW)) and not folder.exists()


def test_nothing_is_kept_where_others_may_write(folder, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "none"))
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    made(content(), WINDOW)
    assert not list(folder.iterdir())


def test_full_disk_is_no_harm(folder, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(session, "atomic_file", full)
    assert results(made(content(), WINDOW)) and not list(folder.iterdir())


def test_last_used_files_are_kept(folder, monkeypatch):
    made(content(), WINDOW)
    (file,) = folder.iterdir()
    monkeypatch.setattr(session, "MOST_CACHE_BYTES", 3 * file.stat().st_size)
    for width in (48, 64, 80, 96):
        made(content(), {"height": 16, "width": width})
    kept = list(folder.iterdir())
    assert file not in kept and 2 <= len(kept) <= 3 and all(one.suffix == ".onnx" for one in kept)


def test_model_that_is_none(folder, tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models/bad.onnx").write_bytes(b"no model")
    with pytest.raises(ModelError):
        Device("cpu").pipeline_state(Library(tmp_path / "models"), "bad")
    assert not list(Path(folder).glob("*"))


def test_model_that_would_run_elsewhere(monkeypatch):
    """Where a provider cannot be had, ONNX Runtime warns and takes the CPU."""
    real = ort.InferenceSession
    monkeypatch.setattr(ort, "InferenceSession", lambda model, options, **_: real(
        model, options, providers=["CPUExecutionProvider"]))
    with pytest.raises(ModelError,
                       match="model 'net' cannot run on CUDAExecutionProvider: see ONNX Runtime's "
                       "warning"):
        session.Session(content(), "net", session.Placement("CUDAExecutionProvider", "cuda", 0, 1),
                        WINDOW)


def test_weights_in_other_files_are_not_kept(folder, tmp_path):
    onnx = pytest.importorskip("onnx")
    onnx.save(onnx.load(models_dir() / "denoise_upscale.s.onnx"), tmp_path / "apart.onnx",
              save_as_external_data=True, location="apart.bin", size_threshold=4096)
    state = Device("cpu").pipeline_state(Library(tmp_path), "apart", WINDOW)
    assert state.bindings and not folder.exists()


def test_the_first_gpu_is_not_named() -> None:
    """ONNX Runtime prints a warning for every session whose options name a device of a provider
    that is no plug-in."""
    first, second = (providers_of(Placement("CUDAExecutionProvider", "cuda", index, 1), False)
                     for index in (0, 1))
    assert "device_id" not in first[0][1] and second[0][1]["device_id"] == "1"
