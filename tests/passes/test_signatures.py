"""Options of passes are keywords with types: a checker finds a wrong one before anything runs."""

from __future__ import annotations

from inspect import Parameter, signature

import pytest

from postfx.passes import registry

IMPORTS = "import postfx; from postfx.passes.display import Display"
CASES = {
    'postfx.DenoiseUpscale(scale=1.5, size=None, model="s", strength=1, budget=40, reactive="none")': None,
    "postfx.DenoiseUpscale(size=(640, 360))": None,
    'postfx.ToneMap(look="aces2", keep=0.5)': None,
    'postfx.ToneMap("agx")': None,
    'Display("pq")': None,
    'postfx.DenoiseUpscale(scale="two")': "scale",
    "postfx.DenoiseUpscale(scle=2.0)": "scle",
    'postfx.DenoiseUpscale(scle="two")': "scle",
    "postfx.ToneMap(look=1)": "look",
    "Display(peak=1000)": "peak",
    "postfx.Overlay(over=True)": "over",
}
"""Calls -> the option that they get wrong."""


@pytest.mark.parametrize("name", registry.names())
def test_the_signature_names_every_option_with_its_default(name):
    found = registry.load(name)
    named = {option.name: option.default for option in signature(found).parameters.values()
             if option.kind in (Parameter.KEYWORD_ONLY, Parameter.POSITIONAL_OR_KEYWORD)}
    assert named == dict(found.defaults)


def test_a_type_checker_finds_wrong_options(tmp_path):
    api = pytest.importorskip("mypy.api")
    path = tmp_path / "calls.py"
    path.write_text("\n".join((IMPORTS, *CASES, "")))
    report, _, _ = api.run(["--strict", "--config-file", "", "--follow-imports", "silent", "--cache-dir",
                            str(tmp_path / "cache"), str(path)])
    found = [line for line in report.splitlines() if "calls.py" in line]
    for number, (call, wrong) in enumerate(CASES.items(), 2):
        here = [line for line in found if f"calls.py:{number}: error" in line]
        assert bool(here) == bool(wrong), (call, report)
        assert wrong is None or f'"{wrong}"' in here[0]
