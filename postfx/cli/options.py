"""How an option of the command line is declared, and everything that follows from its declaration.

A verb lists its options once, section by section, in the order of --help. The parser, the values
that are handed to the parts of a run, the pairs that do not go together, and the settings that a
manifest records are all read from that list.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, NoReturn

from postfx.errors import OptionError, offer, suggest

Changes = Literal["pixels", "rounding", "nothing"]
MEANT_VERBS = {
    "check": "inspect",
    "denoise": "run",
    "doctor": "inspect",
    "help": "--help",
    "tonemap": "run with --tonemap",
    "upscale": "run with --scale 2",
    "version": "--version",
}
"""Word that other programs have -> what it is here, behind `postfx`."""
MEANT_OPTIONS = {
    "--cpu": "--device cpu",
    "--cuda": "--device cuda",
    "--denoiser": "--model",
    "--factor": "--times",
    "--gpu": "--device cuda",
    "--look": "--tonemap",
    "--network": "--model",
    "--oidn": "--with oidn",
    "--quality": "--preset",
    "--upscale": "--scale",
    "--view-transform": "--tonemap",
}
"""Options that users may mean by others: the first word of the answer is told where the verb has
it."""


# not a dataclass, whose module would take longer to load than all of --help
class Option(NamedTuple):
    """An option and all that it means. With neither `metavar` nor `choices` it is a switch.

    Attributes:
        flag: as users write it, like "--run-up"; without dashes for a positional argument.
        short: a one-letter flag for the same.
        help, metavar, type, choices, default: as for argparse.
        bare: the value if the flag stands alone; None if it needs a value.
        either: a word shared by options of a section of which at most one may be given.
        sets: which part of a run gets the value, and as which parameter, like "denoiser.scale"; ""
            if the verb itself reads it.
        convert: makes the parameter of the value.
        also: other parameters that it sets, each with what makes it of the value.
        off: the value that asks for nothing, beside None and False.
        excludes: flag, or "flag=value", of another option -> the message if both are given; {flag}
            in it is this one.
        needs: flag of another option -> the message if that is missing.
        changes: "pixels" if frames look different with it, "rounding" if only by the last bits of a
            pixel, "nothing" if they are the same. A run goes on from another one only if all
            options of the first two kinds agree; files record those of the first kind.
        is_file: whether it names files, of which images record the name without the folder.
        several: whether it may be given more than one value, as when a shell replaces wildcards:
            the value is then a list.
        repeated: whether it may be given more than once: the value is then a list.
        shows: makes a text that is printed instead of doing anything.
        basic: whether --help shows it, which most people need; --help-all shows all.
        once: whether it says something about one command only, so that it has no place among the
            defaults of a studio.
    """

    flag: str
    help: str
    short: str = ""
    metavar: str | None = None
    type: Callable[[str], Any] | None = None
    choices: Sequence[str] = ()
    default: Any = None
    bare: Any = None
    either: str = ""
    sets: str = ""
    convert: Callable[[Any], Any] | None = None
    also: Mapping[str, Callable[[Any], Any]] = {}
    off: Any = None
    excludes: Mapping[str, str] = {}
    needs: Mapping[str, str] = {}
    changes: Changes = "pixels"
    is_file: bool = False
    several: bool = False
    repeated: bool = False
    shows: Callable[[], str] | None = None
    basic: bool = False
    once: bool = False

    @property
    def name(self) -> str:
        """The attribute of the parsed arguments."""
        return self.flag.lstrip("-").replace("-", "_")

    def value(self, arguments: argparse.Namespace) -> Any:
        """What the arguments say."""
        return getattr(arguments, self.name)

    def is_given(self, arguments: argparse.Namespace) -> bool:
        """Whether the arguments ask for it."""
        value = self.value(arguments)
        return value is not None and value is not False and (self.off is None or value != self.off)

    @property
    def is_switch(self) -> bool:
        """Whether it takes no value."""
        return self.metavar is None and not self.choices

    @property
    def default_value(self) -> Any:
        """Its value where nobody says anything."""
        return False if self.is_switch else self.default

    def parse(self, text: str) -> Any:
        """The value that a text stands for; ValueError with the reason where it stands for none."""
        if self.choices and text not in self.choices:
            raise ValueError(f"no choice '{text}'{offer(text, self.choices, 'give')}")
        try:
            return (self.type or str)(text)
        except argparse.ArgumentTypeError as error:
            raise ValueError(str(error)) from None
        except ValueError:
            raise ValueError(f"'{text}' is not a number") from None

    def add_to(self, group: argparse._ActionsContainer) -> None:
        """Add it to a parser or a group."""
        names = [name for name in (self.short, self.flag) if name]
        if self.shows is not None:
            group.add_argument(*names, action=_Show, help=self.help, const=self.shows)
            return
        if self.is_switch:
            group.add_argument(*names, action="store_true", help=self.help)
            return
        extra: dict[str, Any] = {} if self.bare is None else {"nargs": "?", "const": self.bare}
        extra |= {"nargs": "+", "action": _StoreOneOrMore} if self.several else {}
        extra |= {"action": "append"} if self.repeated else {}
        group.add_argument(*names, metavar=self.metavar, type=self.type or str,
                           choices=self.choices or None,
                           default=self.default, help=self.help, **extra)


class _StoreOneOrMore(argparse.Action):
    """Stores a single value as it is, and more of them as a list."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any,
                 option_string: str | None = None) -> None:
        setattr(namespace, self.dest, values[0] if len(values) == 1 else values)


class _Show(argparse.Action):
    """Prints a text and ends the process, as --help does."""

    def __init__(self, option_strings: Sequence[str], dest: str, const: Callable[[], str],
                 **rest: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, const=const, **rest)

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any,
                 option_string: str | None = None) -> None:
        print(self.const())
        parser.exit()


class Section(NamedTuple):
    """Options under one title of --help; without a title they stand first."""

    title: str
    options: tuple[Option, ...]


class Options:
    """The options of a verb, in the order of --help."""

    def __init__(self, *sections: Section) -> None:
        self.sections = sections

    def __iter__(self) -> Iterator[Option]:
        return (option for section in self.sections for option in section.options)

    def __getitem__(self, flag: str) -> Option:
        return next(option for option in self if option.flag == flag)

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Add all of them."""
        if any(option.basic for option in self):
            parser.add_argument("--help-all", action=_ShowAll, nargs=0, default=argparse.SUPPRESS,
                                help="show all options, in groups, and more examples")
        for section in self.sections:
            group = parser.add_argument_group(section.title) if section.title else parser
            rivals: dict[str, argparse._ActionsContainer] = {}
            for option in section.options:
                if option.either and option.either not in rivals:
                    rivals[option.either] = group.add_mutually_exclusive_group()
                option.add_to(rivals.get(option.either, group))

    def values_for(self, part: str, arguments: argparse.Namespace) -> dict[str, Any]:
        """Parameters of a part of the run, from the options that set one and are given."""
        found = {}
        for option in self:
            for sets, convert in {option.sets: option.convert, **option.also}.items():
                owner, _, parameter = sets.partition(".")
                if owner != part:
                    continue
                value = option.value(arguments)
                is_left_out = value is False or (value is None and option.default is None)
                if not is_left_out:
                    found[parameter] = convert(value) if convert else value
        return found

    def fill(self, arguments: argparse.Namespace, given: Collection[str],
             values: Mapping[str, Any]) -> list[str]:
        """Set options by name, but none that is `given` already, nor one that does not go with
        those; returns the names of those that were set."""
        trial = argparse.Namespace(**vars(arguments))
        for option in self:
            if option.name not in given and not option.shows:
                setattr(trial, option.name, option.default_value)
        found = []
        for option in self:
            if option.name not in values or option.name in given:
                continue
            setattr(trial, option.name, values[option.name])
            if self._fits(option, trial):
                setattr(arguments, option.name, values[option.name])
                found.append(option.name)
            setattr(trial, option.name, option.default_value)
        return found

    def _fits(self, option: Option, arguments: argparse.Namespace) -> bool:
        """Whether an option goes with the others that are given."""
        if self.exclusions(option, arguments):
            return False
        for section in self.sections:
            rivals = section.options if option in section.options and option.either else ()
            for rival in rivals:
                is_rival = rival.either == option.either and rival is not option
                if is_rival and rival.is_given(arguments):
                    return False
        for other in self:
            keys = [key for key in other.excludes if key.partition("=")[0] == option.flag]
            if other.is_given(arguments) and any(self._is_asked(key, arguments) for key in keys):
                return False
        return True

    def exclusions(self, option: Option, arguments: argparse.Namespace) -> list[str]:
        """Messages of the given options that this one does not go with."""
        return [message.replace("{flag}", option.flag) for other, message in option.excludes.items()
                if self._is_asked(other, arguments)]

    def refuse_conflicts(self, arguments: argparse.Namespace) -> None:
        """OptionError for options that do not go together, or lack one that they need."""
        for option in self:
            if not option.is_given(arguments):
                continue
            missing = [message for other, message in option.needs.items()
                       if not self._is_asked(other, arguments)]
            for message in self.exclusions(option, arguments) + missing:
                raise OptionError(message)

    def settings(self, arguments: argparse.Namespace,
                 changes: Changes = "pixels") -> dict[str, Any]:
        """Name -> value of the options that change this."""
        return {option.name: option.value(arguments)
                for option in self if option.changes == changes}

    def _is_asked(self, key: str, arguments: argparse.Namespace) -> bool:
        flag, _, value = key.partition("=")
        option = self[flag]
        return option.value(arguments) == value if value else option.is_given(arguments)


class _ShowAll(argparse.Action):
    """Prints the help with all options and ends the process."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(parser.format_help_all() if isinstance(parser, Parser) else parser.format_help(),
              end="")
        parser.exit()


class Parser(argparse.ArgumentParser):
    """A parser that knows which option or verb was meant, shows few options where there are many,
    and fills in what is not given.

    Attributes:
        declared: the options that were added, if they were declared together.
        more: what --help-all says after the description, and its examples in place of `epilog`.
        complete: is called with the arguments and the names of those that were given.
        hint: says of a verb's parser and an argument that it does not know where that belongs, or
            ''.
    """

    declared: Options | None = None
    more: tuple[str, str] = "", ""
    complete: Callable[[argparse.Namespace, set[str]], None] | None = None
    hint: Callable[[argparse.ArgumentParser, Sequence[str]], str] = staticmethod(
        lambda parser, words: "")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as the base class does, and record which options are given."""
        if self.declared is None or self.complete is None:
            return super().parse_known_args(args, namespace)
        options = [option for option in self.declared if not option.shows]
        # no value is one of these lists
        blanks: dict[str, list[Any]] = {option.name: [] for option in options}
        known = vars(namespace) if namespace else {}
        found, rest = super().parse_known_args(args, argparse.Namespace(**{**known, **blanks}))
        given = {name for name, blank in blanks.items() if getattr(found, name) is not blank}
        for option in options:
            if option.name not in given:
                setattr(found, option.name, option.default_value)
        self.complete(found, given)
        return found, rest

    def format_help(self) -> str:
        """The help: of the basic options alone, where some are."""
        basic = {option.name for option in self.declared or () if option.basic}
        if not basic:
            return super().format_help()
        shown = [action for action in self._actions
                 if action.dest in {"help", "help_all", "input", *basic}]
        return self._format([("options", shown)], self.description, self.epilog)

    def format_help_all(self) -> str:
        """The help with all options, in groups."""
        groups = [(group.title, group._group_actions) for group in self._action_groups]
        return self._format(groups, f"{self.description}\n{self.more[0]}", self.more[1])

    def _format(self, groups: list[tuple[str | None, list[argparse.Action]]],
                *texts: str | None) -> str:
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(texts[0])
        for title, actions in groups:
            formatter.start_section(title)
            formatter.add_arguments(actions)
            formatter.end_section()
        formatter.add_text(texts[1])
        return formatter.format_help()

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """The arguments; ends the process with a message for those that it does not know. Options
        may be written with 'color'."""
        words = [re.sub("^(--[^=]*)color", r"\1colour", word)
                 for word in (sys.argv[1:] if args is None else args)]
        found, unknown = self.parse_known_args(words, namespace)
        if unknown:
            used = getattr(found, "parser", self)
            flags = [flag for action in used._actions for flag in action.option_strings]
            word = unknown[0].partition("=")[0]
            meant = MEANT_OPTIONS.get(word, "")
            known = meant.split()[:1]
            hint = (self.hint(used, unknown)
                    or (f": did you mean {meant}?" if known and known[0] in flags else "")
                    or suggest(word, flags))
            used.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return found

    def error(self, message: str) -> NoReturn:
        """Print a line, with what a mistyped verb may have meant, and end the process with 2."""
        choice = re.search(r"argument COMMAND: no choice '([^']*)'", message)
        if choice:
            message = f"there is no command '{choice[1]}'{self._suggest_verb(choice[1])}"
        option = re.fullmatch(r"argument (\S*?/)?(--[\w-]+): expected one argument", message)
        if option:  # as for --frames -10-20, which looks like an option
            message += f"; a value that begins with a dash is given as {option[2]}=VALUE"
        help = "--help-all" if any(option.basic for option in self.declared or ()) else "--help"
        self.exit(2, f"error: {message} ('{self.prog} {help}' shows all)\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """ArgumentError that names the nearest choice for a value that is none, in the same words
        under every version of Python."""
        if action.choices is not None and value not in action.choices:
            there = offer(str(value), map(str, action.choices), "give")
            raise argparse.ArgumentError(action, f"no choice '{value}'{there}")

    def _suggest_verb(self, word: str) -> str:
        """Which verb somebody may have meant by a word, as the end of a message; '' for none."""
        if word in MEANT_VERBS:
            return f": did you mean postfx {MEANT_VERBS[word]}?"
        if re.search(r"[./]", word):
            return f": did you mean postfx run {word}?"
        verbs = [name for action in self._actions if isinstance(action, argparse._SubParsersAction)
                 for name in action.choices]
        return suggest(word, verbs)


def parse_path(text: str) -> str:
    """A path in which a leading ~ is the home folder, as argparse's `type`: shells leave it where
    it is quoted."""
    return os.path.expanduser(text)


def parse_number(text: str) -> float:
    """A number, as argparse's `type`."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number like 2 or 1.5") from None


def parse_from_zero(text: str) -> float:
    """A number from 0, as argparse's `type`."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not number >= 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number from 0")
    return number


def parse_count(text: str) -> int:
    """A whole number from 0, as argparse's `type`."""
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0")
    return int(text)


def parse_positive(text: str) -> int:
    """A whole number from 1, as argparse's `type`."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 1")
    return int(text)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height, as argparse's `type`."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"'{text}' is not a size like 1920x1080")
    return int(width), int(height)


CHUNK_FRAMES = 50
"""Frames of a chunk for a farm, if not given."""


def parse_ray(text: str) -> tuple[str, int]:
    """An address of Ray and the frames of a chunk, 'ADDRESS[,size=N]', as argparse's `type`."""
    address, _, rest = text.partition(",")
    name, _, number = rest.partition("=")
    if not address or (rest and name != "size"):
        raise argparse.ArgumentTypeError(f"'{text}' is not an address, with ,size=N for the frames "
                                         "of a chunk")
    return address, parse_positive(number) if rest else CHUNK_FRAMES
