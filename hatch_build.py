"""What a build makes: the kernels' libraries, the man page from the parser, and the README of the
package index.

`python hatch_build.py FILE` writes the man page alone. POSTFX_URL, a page like
https://github.com/OWNER/postfx, becomes a link of the project, and the README's links lead there;
without it pictures and links to files are left out.

POSTFX_TARGET names the machine that a wheel's kernels are compiled for, such as linux-aarch64; by
default it is this one.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent
PAGE = ROOT / "build" / "postfx.1"


def load_kernel_build() -> Any:
    """The module that compiles kernels, without the package around it, which needs what is
    installed with it."""
    spec = importlib.util.spec_from_file_location("kernel_build",
                                                  ROOT / "postfx" / "compiled" / "build.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def man_page() -> str:
    """The page as roff, man(7): what `postfx --help` says, and then all options of each verb."""
    sys.path.insert(0, str(ROOT))
    from postfx.cli.main import VERBS, make_parser
    from postfx.version import __version__

    parser = make_parser()
    (verbs,) = (action.choices
                for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    lines = [f'.TH POSTFX 1 "" "postfx {__version__}" "User Commands"', ".SH NAME",
             "postfx \\- denoise, upscale and tone-map rendered image sequences", ".SH SYNOPSIS",
             ".B postfx", ".I VERB", "[\\fIOPTIONS\\fR]", ".SH VERBS"]
    for name, summary in VERBS.items():
        lines += [".TP", f".B {_escape(name)}", _escape(summary)]
    for name, verb in verbs.items():
        lines += [f".SH POSTFX {_escape(name.upper())}", *_text(verb.description),
                  *_text(verb.more[0]), *_options(verb), *_verbatim(verb.more[1] or verb.epilog)]
    return "\n".join(lines) + "\n"


def _options(verb: Any) -> Iterator[str]:
    formatter = verb._get_formatter()
    for group in verb._action_groups:
        actions = [action
                   for action in group._group_actions if action.dest not in ("help", "help_all")]
        if actions and group.title:
            yield f".SS {_escape(group.title)}"
        for action in actions:
            yield from (".TP", f".B {_escape(formatter._format_action_invocation(action))}",
                        _escape(formatter._expand_help(action)))


def _text(text: str | None) -> Iterator[str]:
    """Paragraphs; lines that begin with two spaces stay as they are."""
    for paragraph in (text or "").strip("\n").split("\n\n"):
        if paragraph.startswith("  "):
            yield from _verbatim(paragraph)
        else:
            yield from (".PP", *map(_escape, paragraph.splitlines()))


def _verbatim(text: str) -> Iterator[str]:
    yield from (".PP", ".nf", *map(_escape, text.strip("\n").splitlines()), ".fi")


def readme_of_the_index(text: str, address: str = "", version: str = "") -> str:
    """The README for the package index, which has no files beside it.

    address: page of the repository, under which `raw/v<version>/` and `blob/v<version>/` hold its
    files; without it, pictures are dropped and links to files become plain text.
    """
    def link(match: re.Match[str]) -> str:
        is_picture, words, target = match.groups()
        if re.match("[a-z]+:|#", target):
            return match[0]
        if not address:
            return "" if is_picture else words
        shown = "raw" if is_picture else "blob"
        return f"{is_picture}[{words}]({address.rstrip('/')}/{shown}/v{version}/{target})"

    return re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", link, text)


def _escape(line: str) -> str:
    """A line of text: without control characters of roff, and with hyphens that can be copied."""
    line = line.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{line}" if line.startswith((".", "'")) else line


def write(path: Path) -> None:
    """Write the page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(man_page(), encoding="utf-8")


try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
    from hatchling.metadata.plugin.interface import MetadataHookInterface
except ImportError:  # it is called by hand
    pass
else:

    class BuildHook(BuildHookInterface):
        """Compiles the kernels, and puts their libraries and the man page into a wheel."""

        def initialize(self, version: str, build_data: dict[str, Any]) -> None:
            """Make them before the wheel is put together."""
            if self.target_name != "wheel":
                return
            kernels = load_kernel_build()
            target = os.environ.get("POSTFX_TARGET") or kernels.this_target()
            if version == "editable":
                kernels.build_here()
            else:
                for path in kernels.build_all(target, kernels.PACKAGED / target):
                    build_data["force_include"][str(path)] = f"postfx/_native/{target}/{path.name}"
                build_data.update(tag=f"py3-none-{kernels.TARGETS[target].tag}", pure_python=False)
            write(PAGE)
            build_data["shared_data"][str(PAGE)] = "share/man/man1/postfx.1"


    class ReadmeHook(MetadataHookInterface):
        """Sets the README of the package index and, with POSTFX_URL, the project's links."""

        def update(self, metadata: dict[str, Any]) -> None:
            """Add `readme` and `urls`."""
            address, version = os.environ.get("POSTFX_URL", ""), metadata["version"]
            text = readme_of_the_index((ROOT / "README.md").read_text("utf-8"), address, version)
            metadata["readme"] = {"content-type": "text/markdown", "text": text}
            changes = f"{address}/blob/v{version}/CHANGELOG.md"
            metadata["urls"] = {"Source": address, "Changes": changes} if address else {}


if __name__ == "__main__":
    write(Path(sys.argv[1]))
