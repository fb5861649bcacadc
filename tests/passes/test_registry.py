"""Passes are found by name, from entry points and from the folder."""

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from postfx.errors import PassOptionError
from postfx.passes import registry
from postfx.passes.base import Pass

ROOT = Path(__file__).resolve().parents[2]


def test_every_pass_has_its_entry_point():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["entry-points"][registry.GROUP] == registry.BUILT_IN
    for name, target in registry.BUILT_IN.items():
        assert registry.load(name).__name__ == target.partition(":")[2] and registry.load(name).name == name


def test_works_without_being_installed(monkeypatch):
    monkeypatch.setattr(registry, "_installed", dict)
    assert {"denoise_upscale", "tonemap"} <= set(registry.names())
    assert registry.load("tonemap").name == "tonemap"


def test_unknown_name_lists_the_known():
    with pytest.raises(registry.RegistryError, match="no pass 'sharpen': there are .*denoise_upscale.*tonemap"):
        registry.load("sharpen")


def test_create_passes_options_on():
    assert registry.create("denoise_upscale", scale=1.5).options["scale"] == 1.5
    with pytest.raises(PassOptionError, match="no option 'sacle'"):
        registry.create("denoise_upscale", sacle=1.5)


def point(target: str) -> dict[str, EntryPoint]:
    return {"foreign": EntryPoint("foreign", target, registry.GROUP)}


def test_a_pass_of_another_package(monkeypatch):
    monkeypatch.setattr(registry, "_installed", lambda: point("postfx.passes.base:Pass"))
    assert "foreign" in registry.names() and registry.load("foreign") is Pass


@pytest.mark.parametrize(("target", "message"), [
    ("postfx_nowhere:Pass", "pass 'foreign' cannot be loaded: No module named"),
    ("postfx.passes.base:Nothing", "pass 'foreign' cannot be loaded: .*Nothing"),
    ("postfx.frame:Frame", "pass 'foreign' points to .*Frame.*, which is no subclass"),
])
def test_broken_entry_points_are_reported_when_they_are_asked_for(monkeypatch, target, message):
    monkeypatch.setattr(registry, "_installed", lambda: point(target))
    assert "tonemap" in registry.names()
    with pytest.raises(registry.RegistryError, match=message):
        registry.load("foreign")


def test_other_peoples_code_that_fails_is_reported_too(monkeypatch, tmp_path):
    (tmp_path / "postfx_broken.py").write_text("raise RuntimeError('no licence')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "_installed", lambda: point("postfx_broken:Pass"))
    with pytest.raises(registry.RegistryError, match="pass 'foreign' cannot be loaded: no licence"):
        registry.load("foreign")
