"""Passes are found by name, from entry points and from the folder."""

import re
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest

from postfx.errors import OptionError, PassOptionError, PostfxError
from postfx.passes import Pass, registry


def test_every_pass_has_the_name_that_it_is_listed_by():
    for name, target in registry.BUILT_IN.items():
        assert (registry.load(name).__name__ == target.partition(":")[2]
                and registry.load(name).name == name)


def test_works_without_being_installed(monkeypatch):
    monkeypatch.setattr(registry, "_installed", dict)
    assert {"denoise_upscale", "tonemap"} <= set(registry.names())
    assert registry.load("tonemap").name == "tonemap"


def test_unknown_name_lists_the_known():
    with pytest.raises(registry.RegistryError,
                       match="no pass 'sharpen': there are .*denoise_upscale.*tonemap"):
        registry.load("sharpen")


def test_create_passes_options_on():
    assert registry.create("denoise_upscale", scale=1.5).options["scale"] == 1.5
    with pytest.raises(PassOptionError, match="no option 'sacle'"):
        registry.create("denoise_upscale", sacle=1.5)


def points(target: str, name: str = "foreign", count: int = 1) -> dict[str, tuple[EntryPoint, ...]]:
    return {name: (EntryPoint(name, target, registry.ENTRY_POINT_GROUP),) * count}


class Foreign(Pass):
    """Of another package: has a size, a flag, a way.

    Lists show the first line only.
    """

    name = "foreign"
    defaults = {"size": 3, "share": 0.5, "flag": False, "way": "up", "lut": None}


@pytest.fixture
def foreign(monkeypatch) -> None:
    monkeypatch.setattr(registry, "_installed", lambda: points(f"{__name__}:Foreign"))
    monkeypatch.setitem(sys.modules, __name__, SimpleNamespace(Foreign=Foreign))


def test_a_pass_of_another_package(foreign):
    assert "foreign" in registry.names() and registry.load("foreign") is Foreign
    assert registry.plug_ins() == {"foreign": "a package without a name"}
    listed = registry.describe_passes()
    assert ("foreign  (a package without a name)\n    Of another package: has a size, a flag, a "
        "way.\n    options: size=3, share=0.5, flag=false, way=up, lut=none" in listed)
    assert "tonemap  (postfx " in listed
    assert [line for line in re.findall(r"^    (?!options)(.*)$", listed, re.MULTILINE)
            if not line.endswith(".")] == []


@pytest.mark.parametrize(("target", "message"), [
    ("postfx_nowhere:Pass", "pass 'foreign' cannot be loaded: No module named"),
    ("postfx.passes:Nothing", "pass 'foreign' cannot be loaded: .*Nothing"),
    ("postfx.frame:Frame", "pass 'foreign' points to .*Frame.*, which is not a subclass"),
    ("postfx.passes.tonemap:ToneMap",
     "pass 'foreign' points to a class whose name is 'tonemap': set name = "),
])
def test_broken_entry_points_are_reported_when_they_are_asked_for(monkeypatch, target, message):
    monkeypatch.setattr(registry, "_installed", lambda: points(target))
    assert "tonemap" in registry.names() and "foreign" in registry.describe_passes()
    with pytest.raises(registry.RegistryError, match=message):
        registry.load("foreign")


def test_other_peoples_code_that_fails_is_reported_too(monkeypatch, tmp_path):
    (tmp_path / "postfx_broken.py").write_text("raise RuntimeError('no licence')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "_installed", lambda: points("postfx_broken:Pass"))
    with pytest.raises(registry.RegistryError, match="pass 'foreign' cannot be loaded: no licence"):
        registry.load("foreign")


def test_a_pass_that_cannot_be_made_is_named(foreign, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("no licence")

    monkeypatch.setattr(Foreign, "__init__", fail)
    with pytest.raises(PassOptionError, match="pass 'foreign' cannot be made: no licence"):
        registry.create("foreign")


def test_our_names_cannot_be_taken_and_no_name_means_two_passes(monkeypatch):
    monkeypatch.setattr(registry, "_installed", lambda: points(f"{__name__}:Foreign", "tonemap"))
    assert (registry.load("tonemap").__module__ == "postfx.passes.tonemap"
            and registry.plug_ins() == {})
    assert ("a pass of this name in a package without a name is not used: rename "
            "it" in registry.describe_passes())
    monkeypatch.setattr(registry, "_installed", lambda: points(f"{__name__}:Foreign", count=2))
    with pytest.raises(registry.RegistryError,
                       match="comes with a package .* and with a package .*: uninstall all"):
        registry.load("foreign")


def test_an_option_that_says_a_place_is_refused(foreign, monkeypatch):
    monkeypatch.setattr(Foreign, "defaults", {"after": 1})
    with pytest.raises(registry.RegistryError,
                       match="has an option 'after', which says where a pass stands: rename"):
        registry.load("foreign")


def test_values_are_read_as_the_defaults_are(foreign):
    words = "foreign,size=4,share=1,flag=yes,way=3,lut=[1, 2]"
    assert dict(registry.make_asked(registry.parse_pass(words)).options) == {
        "size": 4, "share": 1.0, "flag": True, "way": "3", "lut": [1, 2]}
    assert (registry.make_asked(registry.parse_pass("foreign,lut=a,b.cube"))
            .options["lut"] == "a,b.cube")


@pytest.mark.parametrize(("words", "message"), [
    ("foreign,size=big", "pass 'foreign': size=big is not a whole number"),
    ("foreign,share=", "pass 'foreign': share= is not a number"),
    ("foreign,flag=maybe", "pass 'foreign': flag=maybe is not true or false"),
    ("foreign,siez=4",
     "pass 'foreign' has no option 'siez': did you mean size[?] its options are size, share"),
    ("foreing", "no pass 'foreing': did you mean foreign. there are "),
    ("foreign,size=1,size=2", "'size' is given twice"),
    ("foreign,before=a,after=b", "before or after another one, not both"),
    (",size=1", "give a name and options, e.g. vignette"),
])
def test_words_that_ask_for_nothing_that_is(foreign, words, message):
    with pytest.raises(PostfxError, match=message):
        registry.make_asked(registry.parse_pass(words))


def test_passes_stand_where_they_are_asked_for(foreign):
    chain = [registry.create("overlay"), registry.create("tonemap")]

    def order(*words: str) -> list[str]:
        asked = [registry.parse_pass(text) for text in words]
        return [f"{one.name}{one.options.get('size', '')}"
                for one in registry.insert_passes(chain, asked, 1)]

    assert order("foreign,size=1", "foreign,size=2") == ["overlay", "foreign1", "foreign2",
                                                         "tonemap"]
    assert order("foreign,size=1,after=tonemap",
                 "foreign,size=2,after=tonemap")[2:] == ["foreign1", "foreign2"]
    assert order(*(f"foreign,size={size},after=overlay" for size in (1, 2, 3))) == [
        "overlay", "foreign1", "foreign2", "foreign3", "tonemap"]
    assert order("foreign,size=1,before=overlay",
                 "foreign,size=2,before=overlay")[:2] == ["foreign1", "foreign2"]
    assert order("display,before=foreign",
                 "foreign,size=1,after=tonemap")[2:] == ["display", "foreign1"]
    assert order("foreign,size=1", "occlusion") == ["occlusion", "overlay", "foreign1", "tonemap"]
    with pytest.raises(OptionError,
                       match="no pass 'overlai' runs here: did you mean overlay. there are "
                       "overlay, tone"):
        order("foreign,after=overlai")
    with pytest.raises(OptionError, match="--pass display: no pass 'a' runs here"):
        order("display,after=a", "foreign,after=b")
