"""The documentation site: pages, links, commands, made pages, pictures, and the ten tasks."""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import postfx
from postfx.cli.main import VERBS, main, make_parser
from postfx.io.profile import load_profile

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
TASKS = DOCS / "howto/tasks.md"
BLENDER = os.environ.get("POSTFX_BPY_PYTHON")
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
MADE_BY_US = {"try/index.html"}
"""Files of the site that are neither pages nor in docs/."""


@cache
def made_pages() -> dict[str, str]:
    """The pages that the site has beside those in docs/."""
    spec = importlib.util.spec_from_file_location("site_hook", DOCS / "site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.pages()


def pages() -> dict[str, str]:
    return {path.relative_to(DOCS).as_posix(): path.read_text("utf-8")
            for path in DOCS.rglob("*.md")} | made_pages()


def code_blocks(text: str) -> Iterator[tuple[str, str]]:
    """Language and text of each code block; those that are only indented have none."""
    yield from re.findall(r"```(\w*)\n(.*?)```", text, re.DOTALL)
    plain = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    for block in re.findall(r"(?:^|\n\n)((?:    .*(?:\n|$))+)", plain):
        yield "", re.sub("^    ", "", block, flags=re.MULTILINE)


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as GitHub and the site make them."""
    plain = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    heads = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", head)
             for head in re.findall(r"^#+ (.*)$", plain, re.MULTILINE)]
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_every_page_is_in_the_navigation():
    text = (ROOT / "mkdocs.yml").read_text("utf-8")
    named = re.findall(r"([\w/]+\.md)$", text[text.index("\nnav:"):], re.MULTILINE)
    assert sorted(named) == sorted(pages()) and len(named) > 30


def test_links_lead_somewhere():
    dead, known = [], pages()
    for page, text in known.items():
        for link in LINK.findall(re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)):
            if "://" in link or link.startswith("mailto:"):
                continue
            target, _, anchor = link.partition("#")
            path = (DOCS / page).parent.joinpath(target).resolve() if target else DOCS / page
            inside = path.relative_to(DOCS).as_posix() if path.is_relative_to(DOCS) else ""
            if not path.exists() and inside not in (known | dict.fromkeys(MADE_BY_US)):
                dead.append(f"{page}: {link}")
            elif anchor and inside in known and anchor not in anchors(known[inside]):
                dead.append(f"{page}: {link}: no such heading")
    for page in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md",
                 "samples/README.md"):
        for link in LINK.findall((ROOT / page).read_text("utf-8")):
            target, _, anchor = link.partition("#")
            path = (ROOT / page).parent / target
            if "://" not in link and not (path.exists() and (not anchor or anchor
                                                             in anchors(path.read_text("utf-8")))):
                dead.append(f"{page}: {link}")
    assert dead == []


def test_files_that_pages_name_are_there():
    """Modules move; a page that names one must move with it."""
    named = [(page, path) for page, text in pages().items()
             for path in re.findall(r"`((?:postfx|training|tests|samples|models)/[\w/.]+\.\w+)`",
                                    text)]
    assert ([(page, path) for page, path in named if not (ROOT / path).exists()] == []
            and len(named) > 40)


def words_of(line: str) -> list[str]:
    """A line of a shell as words; a comment begins with a word, not with any #."""
    return shlex.split(re.sub(r"(?:^|\s)#.*", "", line))


def commands(text: str) -> Iterator[list[str]]:
    """The commands of postfx in code blocks, as words."""
    for language, block in code_blocks(text):
        if language not in ("", "sh", "console", "text"):
            continue
        for line in block.replace("\\\n", " ").splitlines():
            with contextlib.suppress(ValueError):
                words = words_of(line)
                while words and re.fullmatch(r"\w+=.*", words[0]):
                    del words[0]
                is_real = not {"...", "COMMAND"} & set(words)
                if words[:1] == ["postfx"] and len(words) > 1 and is_real:
                    yield words[1:]


def test_every_command_is_one(capsys):
    """The parser takes each of them, so no page names an option or a verb that does not exist."""
    parser, wrong, count = make_parser(), [], 0
    for page, text in {**pages(), "README.md": (ROOT / "README.md").read_text("utf-8")}.items():
        # made of the parser; its examples are checked with the help texts
        if page == "reference/options.md":
            continue
        for words in commands(text):
            at = words.index("--") if "--" in words else len(words)
            forwarded = [["run", "in.####.exr", "-o", "out/", *words[at + 1:]]] * (at < len(words))
            for line in [words[:at], *forwarded]:
                count += 1
                try:
                    parser.parse_args([re.sub(r"^\[|\]$", "", word)
                                       for word in line if word != "|"])
                except SystemExit as end:
                    if end.code:
                        wrong.append(f"{page}: {' '.join(line)}: {capsys.readouterr().err.strip()}")
    assert wrong == [] and count > 100


def test_code_is_code():
    """Every block of Python compiles, and every block of TOML or JSON is some."""
    checks = {"python": ast.parse, "toml": tomllib.loads, "json": json.loads}
    checked = [checks[language](block) for text in pages().values()
               for language, block in code_blocks(text) if language in checks]
    assert len(checked) > 20


def test_made_pages_name_everything():
    made = made_pages()
    for name, verb in make_parser()._actions[-1].choices.items():
        section = re.search(rf"## postfx {name}\n(.*?)(?=\n## |\Z)", made["reference/options.md"],
                            re.DOTALL)[1]
        flags = [flag for action in verb._actions
                 for flag in action.option_strings if action.dest not in ("help", "help_all")]
        assert [flag for flag in flags if flag not in section] == []
    assert set(VERBS) == set(make_parser()._actions[-1].choices)
    for path in (ROOT / "postfx/io/profiles").glob("*.toml"):
        assert f"## {path.stem}\n" in made["reference/profiles.md"]
    assert [name for name in postfx._HOMES
            if not re.search(rf"::: \S*\.{name}\n", made["reference/api.md"])] == []


def test_pictures_are_made_by_what_the_gallery_says():
    text = (DOCS / "gallery.md").read_text("utf-8")
    rows = re.findall(r"^\| (`[^|]+`) \| (.+) \|$", text, re.MULTILINE)
    patterns = [pattern for names, _ in rows for pattern in re.findall(r"`([^`]+)`", names)]
    pictures = [path for path in (DOCS / "images").rglob("*") if path.is_file()]
    missing = [path.name for path in pictures
               if not any(path.match(f"images/{pattern}") for pattern in patterns)]
    assert missing == []
    for _, made_by in rows:
        for script in re.findall(r"python (samples/\w+\.py)", made_by):
            assert (ROOT / script).is_file(), script
        for module in re.findall(r"python -m ([\w.]+)", made_by):
            assert importlib.util.find_spec(module), module


@pytest.mark.parametrize("page", ["start/blender.md", "start/mitsuba.md", "start/arnold.md",
                                  "start/others.md"])
def test_blocks_of_the_start_pages_are_right(page, tmp_path):
    """Profiles load, Mitsuba takes its integrator, and Blender its passes, where the package bpy
    is."""
    for language, block in code_blocks((DOCS / page).read_text("utf-8")):
        if language == "toml":
            path = tmp_path / "studio.toml"
            path.write_text(block)
            assert load_profile(str(path)).name and "extends" in tomllib.loads(block)
        if language == "python":
            if "bpy" in block and BLENDER:
                told = ("print(layer.use_pass_vector, layer.use_pass_glossy_color, "
                        "settings.file_format)")
                done = subprocess.run([BLENDER, "-c", f"{block}\n{told}"], capture_output=True,
                                      text=True)
                assert "True True OPEN_EXR_MULTILAYER" in done.stdout, done.stderr
            if "mitsuba" in block:
                mitsuba = pytest.importorskip("mitsuba")
                # other tests of this process may have chosen one
                before, names = mitsuba.variant(), {}
                exec(block, names)
                if before:
                    mitsuba.set_variant(before)
                wanted = {"albedo.R", "albedo.G", "albedo.B", "nn.X", "nn.Y", "nn.Z", "depth.T"}
                assert wanted < set(names["integrator"].aov_names())


def tasks() -> dict[str, str]:
    """Title -> text of each of the ten tasks."""
    parts = re.split(r"^## \d+\. ", TASKS.read_text("utf-8"), flags=re.MULTILINE)[1:]
    return {part.partition("\n")[0]: part.partition("\n")[2] for part in parts}


@pytest.mark.parametrize("title", tasks())
def test_a_task_is_done_as_written(title, tmp_path, monkeypatch):
    """Its blocks run in turn in a folder of their own. What it says one gets is there, what it
    prints is printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("POSTFX_CONFIG", raising=False)
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    text, printed = tasks()[title], ""
    for language, block in code_blocks(text):
        if language == "sh":
            printed += "".join(map(run_line, block.splitlines()))
        elif language == "python":
            exec(block, {})
        elif language == "text":
            assert [line for line in block.splitlines() if line.strip() not in printed] == []
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    files = re.findall(r"`([\w/.]+\.(?:exr|png|html|json))`", prose)
    assert files or "```text" in text or "farm" in text
    assert [name for name in files
            if not (tmp_path / name).is_file() or not (tmp_path / name).stat().st_size] == []


def run_line(line: str) -> str:
    """What a line of a shell block prints. Commands of postfx run in this process, to save starts
    of Python."""
    words = words_of(line)
    if words[:1] != ["postfx"]:
        return subprocess.run(line, shell=True, check=True, capture_output=True, text=True).stdout
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = main(words[1:])
    assert code == 0, printed.getvalue()
    return printed.getvalue()


def test_there_are_ten_tasks():
    assert len(tasks()) == 10


# What --json prints, held to docs/reference/schemas.json ------------------------------------------

KINDS = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float),
         "boolean": bool, "null": type(None)}


def faults(value: Any, schema: dict[str, Any], where: str = "") -> Iterator[str]:
    """Where a value is not what a JSON Schema says; of the keywords that ours use."""
    kinds = schema.get("type", list(KINDS))
    kinds = kinds if isinstance(kinds, list) else [kinds]
    fits = [kind for kind in kinds
            if isinstance(value, KINDS[kind]) and (kind == "boolean") >= isinstance(value, bool)]
    if not fits:
        yield f"{where}: {value!r} is no {' or '.join(kinds)}"
    elif isinstance(value, dict):
        known, further = schema.get("properties", {}), schema.get("additionalProperties", True)
        yield from (f"{where}: lacks {key}"
                    for key in schema.get("required", ()) if key not in value)
        yield from (f"{where}: has {key}" for key in value if key not in known and further is False)
        for key, inner in value.items():
            yield from faults(inner, known.get(key, further if isinstance(further, dict) else {}),
                              f"{where}.{key}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from faults(inner, schema.get("items", {}), f"{where}[{i}]")


def test_json_is_what_the_schemas_say(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    room = str(ROOT / "samples/room/noisy.####.exr")
    schemas = json.loads((DOCS / "reference/schemas.json").read_text())
    small = [room, "-o", "out/c.####.exr", "--frames", "1-2", "--model", "s", "--run-up", "0"]
    lines = {
        "postfx run": ["run", *small],
        "postfx run --explain": ["run", *small, "--explain", "--overwrite"],
        "postfx verify": ["verify", "out"], "postfx inspect": ["inspect", room, "--frames", "1-2"],
        "postfx chunks": ["chunks", room, "--size", "4", "-o", "farm/c.####.exr"],
        "postfx config": ["config"],
        "postfx interpolate": ["interpolate", "out/c.####.exr", "-o", "between/c.####.exr"],
        "postfx watch": ["watch", "out/c.####.exr", "-o", "seen/", "--until", "1", "--settle", "0"],
        "postfx exposure": ["exposure", room, "--frames", "1-2"],
    }
    assert set(lines) == set(schemas)
    wrong = {}
    for name, line in lines.items():
        forwarded = ["--", "--no-denoise"] if line[0] == "watch" else []
        main([*line, "--json", *forwarded])
        found = json.loads(capsys.readouterr().out.strip())
        if told := [*faults(found, schemas[name])]:
            wrong[name] = told
    assert wrong == {}


def test_a_schema_finds_faults():
    schema = {"type": "object", "properties": {"a": {"type": "integer"}}, "required": ["a"],
              "additionalProperties": False}
    assert [*faults({"a": 1}, schema)] == []
    assert [*faults({"a": True}, schema)] == [".a: True is no integer"]
    assert [*faults({"b": 1}, schema)] == [": lacks a", ": has b"]


def test_the_site_is_built_without_a_warning(tmp_path):
    """Where mkdocs is installed, which the extra docs does."""
    pytest.importorskip("mkdocs")
    pytest.importorskip("material")
    done = subprocess.run([sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d",
                           str(tmp_path)],
                          cwd=ROOT, capture_output=True, text=True,
                          env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "reference/options.html").stat().st_size > 20000
