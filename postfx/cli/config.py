"""Defaults of a studio: what postfx.toml and --preset say for `postfx run`, and `postfx config`,
which shows it."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from postfx.cli.options import Option, Options
from postfx.errors import OptionError, suggest

if TYPE_CHECKING:
    from pathlib import Path  # which --help does without

DESCRIPTION = """\
Show the defaults of 'postfx run' that files named postfx.toml set, and where each comes from. The
nearest such file counts, in this folder or above. What it does not set, the user's or the machine's
own file sets; 'postfx config' names their places. The variable POSTFX_CONFIG names one file to read
in place of all these. If it is empty, none is read.

A file holds options of 'postfx run' without their dashes:

  [run]
  preset = "final"
  compression = "dwaa:45"
  overwrite = true

Options on the command line come first, then its --preset, then the files. A default that conflicts
with an option that you give is left out. Options that belong to one command, such as --output or
--frames, cannot be set here; nor can --provider, which may load a library.
"""
EXAMPLES = """\
examples:
  postfx config
  postfx config --json
  POSTFX_CONFIG=/studio/postfx.toml postfx run shot/ -o out/
  POSTFX_CONFIG= postfx run shot/ -o out/
"""
DEFAULTS_FILE = "postfx.toml"
RUN_TABLE = "run"
DEFAULTS_VARIABLE = "POSTFX_CONFIG"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(arguments: argparse.Namespace) -> int:
    """Show the defaults; returns the exit code."""
    from pathlib import Path

    from postfx.cli.run_options import PRESETS, RUN

    found = read_defaults(RUN)
    facts = {"files": [str(path) for path in find_files()],
             "run": {name: {"value": default.text, "file": str(default.path)}
                     for name, default in found.items()},
             "presets": PRESETS}
    if arguments.json:
        print(json.dumps(facts))
        return 0
    lines = [f"file     {path}" for path in facts["files"]]
    lines += [f"default  {default.option.flag} {default.text_shown}    from {default.path}"
              for default in found.values()]
    if not lines:
        places = ([] if DEFAULTS_VARIABLE in os.environ
                  else [Path.cwd() / DEFAULTS_FILE, *_own_places()[::-1]])
        lines = [f"no {DEFAULTS_FILE}; it may be {' or '.join(map(str, places))}" if places
                 else f"{DEFAULTS_VARIABLE} asks for no file"]
    lines += [f"preset   {name}: {' '.join(_words(RUN, values))}"
              for name, values in PRESETS.items()]
    print("\n".join(lines))
    return 0


class Default(NamedTuple):
    """A default from a file.

    Attributes:
        value: as parsed arguments hold it.
        text: as the file has it.
    """

    option: Option
    value: Any
    text: Any
    path: Path

    @property
    def text_shown(self) -> str:
        """The text as people read it."""
        return ("" if self.text is True else ", ".join(self.text) if isinstance(self.text, list)
                else str(self.text))

    @property
    def words(self) -> list[str]:
        """The option and its value as words of a command line."""
        if self.option.is_switch:
            return [self.option.flag] if self.value else []
        texts = (self.text if isinstance(self.text, list)
                 else ["" if self.text is True else self.text])
        return [f"{self.option.flag}={text}" for text in texts]


def complete(options: Options, presets: Mapping[str, Mapping[str, Any]]) -> Any:
    """What fills in arguments that are not given, for `Parser.complete`. The arguments then have
    `filled`, the names of those that files set, `defaults`, the same as words of a command line,
    `default_files`, and `yielded`, words of the preset that do not go with what is given."""

    def fill_in(arguments: argparse.Namespace, given: set[str]) -> None:
        found = read_defaults(options)
        asked = presets.get(arguments.preset, {})
        more = options.fill(arguments, given, asked)
        arguments.yielded = _words(options, {name: value for name, value in asked.items()
                                             if name not in {*given, *more}})
        given |= {*more}
        filled = options.fill(arguments, given,
                              {name: default.value for name, default in found.items()})
        arguments.defaults = [word for name in filled for word in found[name].words]
        arguments.default_files = list(dict.fromkeys(str(found[name].path) for name in filled))
        if "preset" in filled:
            filled += options.fill(arguments, {*given, *filled}, presets[arguments.preset])
        arguments.filled = set(filled)

    return fill_in


def find_files() -> list[Path]:
    """Files of defaults that exist, the weakest first. OptionError if POSTFX_CONFIG names one that
    is not."""
    from pathlib import Path

    named = os.environ.get(DEFAULTS_VARIABLE)
    if named is not None:
        path = Path(os.path.expanduser(named))
        if named and not os.path.isfile(path):
            raise OptionError(f"{path}: {DEFAULTS_VARIABLE} names this file, which is not there: "
                              "correct or unset the variable")
        return [path] if named else []
    here = Path.cwd()
    near = next((folder / DEFAULTS_FILE
                 for folder in (here, *here.parents) if (folder / DEFAULTS_FILE).is_file()),
                None)
    return [path for path in (*_own_places(), near) if path and path.is_file()]


def _own_places() -> list[Path]:
    """Where the machine's file and the user's may be."""
    from platformdirs import site_config_path, user_config_path  # most commands can do without

    return [site_config_path("postfx", appauthor=False) / DEFAULTS_FILE,
            user_config_path("postfx", appauthor=False) / DEFAULTS_FILE]


def read_defaults(options: Options) -> dict[str, Default]:
    """Name -> default of options, from all files; OptionError for what a file must not hold."""
    found: dict[str, Default] = {}
    for path in find_files():
        found |= {default.option.name: default for default in _read(path, options)}
    return found


def _read(path: Path, options: Options) -> list[Default]:
    """Defaults that a file sets. OptionError where it is no TOML, or sets anything but options of
    `postfx run`."""
    from postfx.files import parse_toml, read_text

    try:
        content = parse_toml(read_text(path))
    except (OSError, ValueError) as error:
        raise OptionError(f"{path}: cannot be read: "
                          f"{getattr(error, 'strerror', None) or error}") from None
    for name in content:
        if name != RUN_TABLE or not isinstance(content[name], dict):
            raise OptionError(f"{path}: no table '{name}': options of 'postfx run' stand below "
                              f"[{RUN_TABLE}]")
    return [_default(path, options, key, value)
            for key, value in content.get(RUN_TABLE, {}).items()]


def _default(path: Path, options: Options, key: str, value: Any) -> Default:
    """The default that a key of a file sets; OptionError for one that is no option, or a value that
    it cannot have."""
    known = {option.name.replace("_", "-"): option
             for option in options if not (option.once or option.shows)}
    option = known.get(key.replace("_", "-"))
    if option is None:
        why = ("belongs on the command line" if key in {each.flag.lstrip("-") for each in options}
               else "is no option")
        raise OptionError(f"{path}: {key} "
                          f"{why}{suggest(key, known) if why == 'is no option' else ''}")
    try:
        return Default(option, _parse(option, value), value, path)
    except ValueError as error:
        raise OptionError(f"{path}: {key}: {error}") from None


def _parse(option: Option, value: Any) -> Any:
    """A value of a file in the form that arguments hold; ValueError if the option has no such
    value."""
    if option.is_switch or (value is True and option.bare is not None):
        if not isinstance(value, bool):
            raise ValueError(f"'{value}' is neither true nor false")
        return value if option.is_switch else option.bare
    if option.repeated and isinstance(value, list):
        return [option.parse(str(one)) for one in value]
    if isinstance(value, bool | list | dict):
        raise ValueError("give one number or text")
    return [option.parse(str(value))] if option.repeated else option.parse(str(value))


def _words(options: Options, values: Mapping[str, Any]) -> list[str]:
    """Options with values, as on a command line."""
    flags = {option.name: option.flag for option in options}
    return [flags[name] + ("" if value is True else f" {value}") for name, value in values.items()]
