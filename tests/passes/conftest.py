"""Networks of random weights for the upscaler's tests."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from postfx.passes.denoise import models
from postfx.runtime import Library
from tests.made_once import copy_made_once

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL_DENOISER = REPOSITORY / "tests/training/small_denoiser.py"


@pytest.fixture(autouse=True)
def unseen(no_first_look: None) -> None:
    """Passes are tested without the doctor."""


@pytest.fixture(scope="session")
def exported_models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the models 'denoise_upscale.small' and 'doubting', each with and without guides,
    'low', 'residual'."""
    torch = pytest.importorskip("torch")
    folder = tmp_path_factory.mktemp("models")
    sources = [*(REPOSITORY / "training").rglob("*.py"), SMALL_DENOISER, Path(__file__)]
    copy_made_once("small-models", sources, torch.__version__, _export, folder)
    return folder


def _export(folder: Path) -> None:
    from tests.training.small_denoiser import DOUBTING, LOW, RESIDUAL, small_model
    from training.denoise.export import card, example, export_trunk, exported
    from training.export import parity, write_card

    for guides, name in ((False, "denoise_upscale.small.onnx"),
                         (True, "denoise_upscale.small.guides.onnx")):
        export_trunk(small_model(guides).trunk, folder / name)
    configs = {"low": LOW, "doubting": DOUBTING, "doubting.guides": DOUBTING, "residual": RESIDUAL}
    for tag, config in configs.items():
        model = small_model(tag.endswith(".guides"), config)
        path = folder / f"denoise_upscale.{tag}.onnx"
        checkpoint = {"config": model.config.as_dict(), "weights": model.state_dict(), "notes": {}}
        if tag == "doubting":  # the same layers: its card alone says that it doubts
            shutil.copy(folder / "denoise_upscale.low.onnx", path)
            told = card(checkpoint, tag,
                        parity(exported(model.trunk), path, example(model.trunk, 32, 48)), {})
        else:
            told = card(checkpoint, tag, export_trunk(model.trunk, path), {})
        # random weights use it all
        write_card(path, told | ({"halo": RESIDUAL.sees} if config is RESIDUAL else {}))


@pytest.fixture
def small_models(exported_models: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The upscaler finds these models only."""
    monkeypatch.setattr(models, "Library", lambda: Library(exported_models))
    return exported_models
