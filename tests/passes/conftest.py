"""Networks of random weights for the upscaler's tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from postfx.passes import _denoise_graph
from postfx.runtime import Library


@pytest.fixture(scope="session")
def exported_models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the models 'denoise_upscale.small' and 'denoise_upscale.small.guides'."""
    pytest.importorskip("torch")
    from tests.training.small_denoiser import small_model
    from training.export_denoise import export_trunk

    folder = tmp_path_factory.mktemp("models")
    for guides, name in ((False, "denoise_upscale.small.onnx"), (True, "denoise_upscale.small.guides.onnx")):
        export_trunk(small_model(guides).trunk, folder / name)
    return folder


@pytest.fixture
def small_models(exported_models: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The upscaler finds these models only."""
    monkeypatch.setattr(_denoise_graph, "Library", lambda: Library(exported_models))
    return exported_models
