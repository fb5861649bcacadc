"""Pages that open from the disk: one file of HTML that needs nothing beside it and asks no network."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_PARTS = Path(__file__).parent


def page(title: str, name: str, scripts: Sequence[str], data: dict[str, Any]) -> str:
    """The file's text: the elements of `name`.html with the style of page.css and `name`.css, and the scripts.

    page.js runs before the `scripts`, files of this folder; they find `data`, of types that JSON has, in `data`.
    """
    parts = {
        "title": html.escape(title),
        "style": _part("page.css") + _part(f"{name}.css"),
        "body": _part(f"{name}.html"),
        "script": "".join(map(_part, ("page.js", *scripts))),
        "data": _as_script(data),
    }
    return _filled(_part("page.html"), parts)


def _as_script(data: dict[str, Any]) -> str:
    """JSON that cannot end the element it stands in."""
    text = json.dumps(data, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _filled(template: str, parts: dict[str, str]) -> str:
    """The template with `{{name}}` replaced; what is put in is not looked at again."""
    pieces = template.split("{{")
    return pieces[0] + "".join(parts[name] + rest for name, _, rest in (piece.partition("}}") for piece in pieces[1:]))


def _part(name: str) -> str:
    return (_PARTS / name).read_text(encoding="utf-8")
