"""Fixtures shared by all tests."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import pytest

os.environ.setdefault("POSTFX_CONFIG", "")  # no defaults of this machine or user

REPOSITORY = Path(__file__).resolve().parent.parent
LONGEST = (
    "test_types.py", "training/denoise/test_picture.py", "training/test_remake.py",
    "test_quality.py",
    "kernels/test_library.py", "training/datagen/test_clip.py", "training/denoise/test_tune.py",
    "doctor/test_breakages.py", "training/denoise/test_train_processes.py", "test_windows.py",
    "test_samples.py", "training/test_scene_network.py", "test_docs.py", "test_site.py",
    "training/datagen/test_render.py",
    "training/datagen/scenes/test_interior.py", "training/measure/test_validation.py",
    "doctor/test_unbroken.py", "training/denoise/test_export.py", "cli/test_bench.py",
    "fuzz/test_fuzz.py", "passes/test_denoise_reactive.py",
    "passes/test_denoise_fp16.py", "exposure/test_debugger.py", "stress/test_precisions.py",
    "passes/test_denoise_tiles.py", "training/tonemap/test_flicker.py",
    "training/tonemap/test_train.py", "training/tonemap/test_model.py",
    "kernels/test_denoise_definitions.py", "cli/test_streams.py", "test_shared_memory.py",
    "bench/test_measure.py", "cli/test_inspect.py", "passes/test_contract.py",
    "stress/test_network_bounds.py", "stress/test_kernel_bounds.py", "passes/test_denoise_int8.py",
)
"""Files that take about ten seconds of a core and more, longest first: begun last, one would keep a
worker busy alone. Those that need no compiled kernel come early: on a new machine the first worker
compiles them meanwhile."""


def pytest_configure(config: pytest.Config) -> None:
    """Workers side by side compute on cores of their own: threads that wait for each other on one
    core take many times as long. Libraries that start threads when they are imported must not have
    been by now."""
    worker = getattr(config, "workerinput", None)
    if worker:
        number, count = int(worker["workerid"].removeprefix("gw")), worker["workercount"]
        if hasattr(os, "sched_setaffinity"):
            cores = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, cores[number::count] or cores)
        if config.args == config.getini("testpaths"):
            config.args[:] = in_turn(number, count)
    config.pluginmanager.import_plugin("postfx.testing")


def in_turn(number: int, count: int) -> list[str]:
    """All folders and files of tests, begun elsewhere by each worker: in a new checkout it finds
    compiled to bytecode what another one has collected meanwhile."""
    parts = sorted(str(path) for path in (REPOSITORY / "tests").iterdir()
                   if path.match("test_*.py") or any(path.rglob("test_*.py")))
    begin = number * len(parts) // count
    return parts[begin:] + parts[:begin]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files come first, the others by name, whatever the order they were found in.
    Tests marked soak run only when asked for."""
    places = {f"tests/{name}": place for place, name in enumerate(LONGEST)}

    def place(item: pytest.Item) -> tuple[int, str]:
        file = item.nodeid.partition("::")[0]
        return places.get(file, len(places)), file

    items.sort(key=place)
    if "soak" not in config.option.markexpr:
        for item in items:
            if item.get_closest_marker("soak"):
                item.add_marker(pytest.mark.skip("long, or one more of its kind: give -m soak"))


def pytest_collection_finish() -> None:
    """Modules and tests stay until the end: what a test collects as garbage is looked for among
    later objects only."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish() -> None:
    gc.unfreeze()


@pytest.fixture(scope="session", autouse=True)
def no_pauses() -> Iterator[None]:
    """A frame that cannot be read is tried again at once: half a second for each would be minutes
    in all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("postfx.files.PAUSES", (0.0, 0.0))
        yield


@pytest.fixture(scope="session", autouse=True)
def models_parsed_once() -> Iterator[None]:
    """What follows from the bytes of a model's file alone is found once: tests make the same
    networks ready anew."""
    with pytest.MonkeyPatch.context() as patch:
        for place in ("postfx.runtime.models.parse_model", "postfx.passes.scene.parse_model",
                      "postfx.runtime.device.take_products"):
            module, _, name = place.rpartition(".")
            patch.setattr(place, lru_cache(64)(getattr(import_module(module), name)))
        yield


@pytest.fixture(scope="session")
def every_level() -> None:
    """Kernels are compiled for every level of this processor, in whole libraries."""
    from tests.made_once import compile_levels

    compile_levels()


@pytest.fixture
def no_first_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """The doctor does not look at the first frames of a run, which took a tenth of the time of
    tests of passes. Its own tests, those of the command line, and those of frames of any content
    have it look."""
    monkeypatch.setattr("postfx.pipeline.Pipeline._look", lambda *_: None)


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Folder `shared` beside the checkout, with sequences that other software rendered; skips where
    it is absent."""
    folder = REPOSITORY.parent / "shared"
    if not (folder / "sequences").is_dir():
        pytest.skip(f"{folder} is not there")
    return folder


@pytest.fixture(autouse=True)
def quick_network(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What nobody chose a network for takes `m` in this process: `xl` takes seven times as long.
    Modules with `CHOOSES_NETWORK` test that choice."""
    if not getattr(request.module, "CHOOSES_NETWORK", False):
        monkeypatch.setattr("postfx.passes.denoise.default_network.BEST_NETWORK", "m")
