"""Pages of the reference that are made from the code, as a hook of mkdocs: options, profiles,
Python, JSON.

`make docs` builds the site. Nothing here is written into the source folder: the pages exist in the
site alone, so they cannot be out of date. `pages()` gives them as text, for the tests.
"""

from __future__ import annotations

import argparse
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
MODULES = {"postfx.integrate": "Helpers for renderers", "postfx.masks": "Masks",
           "postfx.testing": "Testing a pass"}
"""Public modules, each described as a whole, and their titles."""


def pages() -> dict[str, str]:
    """Path below docs/ -> Markdown of each page that is made."""
    return {"reference/options.md": options(), "reference/profiles.md": profiles(),
            "reference/api.md": api(), "reference/json.md": schemas()}


def options() -> str:
    """Every verb and every option, as the parser knows them."""
    from postfx.cli.main import VERBS, make_parser

    parser = make_parser()
    (verbs,) = (action.choices
                for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    lines = ["# Options", "",
             "Every option of every command, from the parser itself. `postfx COMMAND --help` "
             "prints the same, and the wheel has it as a man page.", "",
             "| command | |", "| --- | --- |"]
    lines += [f"| [`postfx {name}`](#postfx-{name}) | {_cell(summary)} |"
              for name, summary in VERBS.items()]
    for name, verb in verbs.items():
        more, examples = getattr(verb, "more", ("", ""))
        lines += ["", f"## postfx {name}", "", *_paragraphs(verb.description), *_paragraphs(more)]
        for group in verb._action_groups:
            actions = [action for action in group._group_actions
                       if action.dest not in ("help", "help_all")]
            if actions:
                title = (group.title or "options").capitalize()
                lines += ["", f"**{title}**", "", "| option | |", "| --- | --- |"]
                lines += [_option(verb, action) for action in actions]
        lines += ["", *_paragraphs(examples or verb.epilog)]
    return "\n".join(lines) + "\n"


def _option(verb: Any, action: argparse.Action) -> str:
    formatter = verb._get_formatter()
    invocation = formatter._format_action_invocation(action)
    return f"| <code>{_html(invocation)}</code> | {_cell(formatter._expand_help(action))} |"


def _html(text: str) -> str:
    return text.replace("&", "&amp;").replace("<",
                                              "&lt;").replace(">", "&gt;").replace("|", "&#124;")


def _cell(text: str) -> str:
    """A text for a cell of a table."""
    return re.sub(r"([*_])", r"\\\1", _html(" ".join(text.split())))


def _paragraphs(text: str | None) -> Iterator[str]:
    """Paragraphs of a help text; those with indented lines, and lists of commands, become code."""
    for paragraph in (text or "").strip("\n").split("\n\n"):
        lines = paragraph.splitlines()
        if any(line.startswith("  ") for line in lines):
            yield from ("```text", *lines, "```", "")
        elif lines:
            yield from (*(re.sub(r"([*_])", r"\\\1", _html(line)) for line in lines), "")


def profiles() -> str:
    """Every built-in profile: how it is found, and its planes."""
    lines = ["# Profiles", "",
             "What postfx knows of each renderer, from the TOML files in `postfx/io/profiles`. "
             "[Files, AOVs and renderers](renderers.md#renderers) says what to switch on, and how "
             "to [write your own](renderers.md#your-own-names). A profile that extends another one "
             "also reads that one's planes.", ""]
    for path in sorted((ROOT / "postfx/io/profiles").glob("*.toml")):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        extends = (f", extends [`{table['extends']}`](#{table['extends']})" if "extends" in table
                   else "")
        source = table.get("source") or "plain names"
        lines += [f"## {table['name']}", "", f"{table['title']}{extends}. Names from: {source}.",
                  ""]
        rows = [f"| {plane['role']} | {_names(plane)} | {_cell(plane.get('enable', ''))} |"
                for plane in table.get("plane", ())]
        lines += (["| plane | layers, best first | switched on by |", "| --- | --- | --- |", *rows,
                   ""]
                  if rows else [])
        groups = dict.fromkeys(part["group"] for part in table.get("part", ()))
        lines += [f"Parts for `--aov`: {', '.join(groups)}.", ""] if groups else []
    return "\n".join(lines)


def _names(plane: dict[str, Any]) -> str:
    return ", ".join(f"<code>{_html(name)}</code>" if name else "no layer"
                     for name in plane.get("names", ()))


def api() -> str:
    """The public names of postfx, described by their docstrings."""
    import postfx

    lines = ["# Python", "", "Everything public. Everything else may change between versions.", ""]
    functions = [name for name in postfx.__all__ if name[0].islower()]
    classes = [name for name in postfx.__all__ if name[0].isupper()]
    for title, names in (("Functions", functions), ("Classes", classes)):
        lines += [f"## {title}", ""]
        for name in names:
            home = postfx._HOMES[name] if name in postfx._HOMES else "postfx"
            lines += [f"::: {home}.{name}", ""]
    for module, title in MODULES.items():
        lines += [f"## {title}", "", f"::: {module}", "    options:",
                  "      show_root_heading: false", ""]
    return "\n".join(lines)


def schemas() -> str:
    """What --json prints, from the schemas that the tests hold it to."""
    found = json.loads((ROOT / "docs/reference/schemas.json").read_text(encoding="utf-8"))
    lines = ["# JSON", "",
             "What `--json` prints on standard output: one object. The tables come from "
             "[schemas.json](schemas.json), JSON Schemas that the tests hold the commands to. Keys "
             "may be added in any version; a key that goes, or changes its meaning, is named in "
             "the change log.", ""]
    for name, schema in found.items():
        lines += [f"## {name}", "", schema["description"], "", "| key | type | |",
                  "| --- | --- | --- |"]
        lines += [f"| <code>{key}</code> | {kind} | {_cell(words)} |"
                  for key, kind, words in _keys(schema)]
        lines.append("")
    return "\n".join(lines)


def _keys(schema: dict[str, Any], before: str = "") -> Iterator[tuple[str, str, str]]:
    """Key with those above it, type and meaning of everything in an object."""
    for key, value in schema.get("properties", {}).items():
        kinds = value.get("type", "any")
        kinds = kinds if isinstance(kinds, list) else [kinds]
        yield _html(before + key), " or ".join(kinds), value.get("description", "")
        inner = value.get("items", value) if "array" in kinds else value
        yield from _keys(inner, f"{before}{key}{'[]' if 'array' in kinds else ''}.")


def on_files(files: Any, config: Any) -> Any:
    """Called by mkdocs when it has found the files: adds the made ones."""
    from mkdocs.structure.files import File

    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


LAST = 1e-4
"""How much a hit in the laboratory counts in the site's search, so that pages for people come
first."""


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Called by mkdocs for each page: a link to a file outside docs/, which the site does not have,
    becomes its name. The search lists pages of the laboratory last."""
    if page.file.src_uri.startswith("lab/"):
        page.meta["search"] = {"boost": LAST}

    def plain(match: re.Match[str]) -> str:
        target = (ROOT / "docs" / page.file.src_uri).parent / match[2]
        return (match[0] if "://" in match[2] or (ROOT / "docs") in target.resolve().parents
                else match[1])

    return re.sub(r"\[([^\]]+)\]\(([^)#\s]+)(?:#[^)]*)?\)", plain, markdown)
