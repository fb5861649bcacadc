"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
LONGEST = (
    "test_quality.py", "test_samples.py", "training/tonemap/test_train.py", "doctor/test_breakages.py",
    "training/datagen/test_clip.py", "stress/test_precisions.py", "passes/test_denoise_fp16.py",
    "training/denoise/test_export.py", "training/datagen/test_render.py", "cli/test_bench.py",
    "stress/test_network_bounds.py", "passes/test_denoise_reactive.py", "training/denoise/test_train_processes.py",
    "training/measure/test_validation.py", "training/datagen/scenes/test_interior.py", "passes/test_denoise_int8.py",
    "passes/test_contract.py", "stress/test_kernel_bounds.py",
)
"""Files that take more than ten seconds of a core, longest first: begun last, one would keep a worker busy alone."""


def pytest_configure(config: pytest.Config) -> None:
    """Workers side by side compute on cores of their own: threads that wait for each other on one core take many times
    as long. Libraries that start threads when they are imported must not have been by now."""
    worker = getattr(config, "workerinput", None)
    if worker and hasattr(os, "sched_setaffinity"):
        number, cores = int(worker["workerid"].removeprefix("gw")), sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, cores[number::worker["workercount"]] or cores)
    config.pluginmanager.import_plugin("postfx.testing")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files come first, and tests of minutes run only when asked for."""
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.nodeid.partition("::")[0].removeprefix("tests/"), len(places)))
    if "soak" not in config.option.markexpr:
        for item in items:
            if item.get_closest_marker("soak"):
                item.add_marker(pytest.mark.skip("some minutes: give -m soak"))


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Folder `shared` beside the checkout, with sequences that other software rendered; skips where it is absent."""
    folder = REPOSITORY.parent / "shared"
    if not (folder / "sequences").is_dir():
        pytest.skip(f"{folder} is not there")
    return folder
