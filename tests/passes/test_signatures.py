"""Options of passes are keywords with types."""

from __future__ import annotations

from inspect import Parameter, signature

import pytest

from postfx.passes import registry


@pytest.mark.parametrize("name", registry.names())
def test_the_signature_names_every_option_with_its_default(name):
    found = registry.load(name)
    named = {option.name: option.default for option in signature(found).parameters.values()
             if option.kind in (Parameter.KEYWORD_ONLY, Parameter.POSITIONAL_OR_KEYWORD)}
    assert named == dict(found.defaults)
