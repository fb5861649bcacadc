"""`postfx COMMAND ...`: picks the verb and turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Collection, Sequence
from importlib import import_module

from postfx.cli.options import Parser
from postfx.errors import OptionError, PostfxError
from postfx.streams import safe_streams
from postfx.version import __version__

VERBS = {
    "run": "denoise, upscale and tone-map a sequence",
    "interpolate": "make frames between the frames of a sequence",
    "watch": "preview frames while a renderer writes them",
    "merge": "merge renders that differ in their seed",
    "samples": "say where a shot needs more samples",
    "tune": "adapt a network to a shot",
    "loop": "render, denoise, and render again where that pays",
    "chunks": "cut a sequence into chunks for the machines of a farm",
    "verify": "check that the files of a run are there, whole and unaltered",
    "inspect": "find what is wrong with a sequence's AOVs",
    "config": "show the defaults that postfx.toml sets",
    "exposure": "measure whether the exposure is right and steady",
    "bench": "compare networks and Open Image Denoise on frames with references",
    "models": "list the trained models",
    "lut": "write a look as a .cube look-up table",
    "capture-compare": "find the first tensor in which two captures differ",
}
"""Verb -> what it does, as in `postfx --help`. The module of its name is loaded when it is
called."""
FORWARDING = ("watch", "loop", "chunks")
"""Verbs that hand options of `postfx run` on, which stand behind --."""
SHELLS = ("bash", "zsh", "fish", "powershell")
LONG_DASHES = ("\u2012", "\u2013", "\u2014", "\u2212")
"""What text processors make of a hyphen."""
EXIT_ERROR = 2
EXIT_INTERRUPTED = 130
"""As shells have it: 128 and the number of SIGINT."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code: 0 done, 1 a check found something wrong, 2
    something the user can fix, 130 interrupted by Ctrl-C, 143 ended by SIGTERM."""
    if "_ARGCOMPLETE" in os.environ:  # a shell asks for completions
        import argcomplete

        argcomplete.autocomplete(make_parser())
    # the summary says so, once
    warnings.filterwarnings("ignore", "the package onnxruntime is missing")
    with safe_streams():
        return _run(list(sys.argv[1:] if argv is None else argv))


def _run(words: list[str]) -> int:
    """Run a command line; returns the exit code."""
    own = (words.index("--") if words[:1] and words[0] in FORWARDING and "--" in words
           else len(words))
    try:
        _refuse_long_dashes(words)
        if not words:
            print(make_parser().format_help(), end="", file=sys.stderr)
            return EXIT_ERROR
        arguments = make_parser([word for word in words
                                 if not word.startswith("-")][:1]).parse_args(words[:own])
        arguments.words, arguments.forwarded = words, words[own + 1:]
        read_and_write_by(getattr(arguments, "threads", None))
        code: int = arguments.execute(arguments)
        return code
    except PostfxError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_ERROR
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        print(f"error: {name}{error.strerror or error}: check the path and its rights",
              file=sys.stderr)
        return EXIT_ERROR
    except MemoryError:
        print("error: out of memory: give postfx run --memory, e.g. --memory 4G", file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt as interrupt:
        print("interrupted: finished frames are kept", file=sys.stderr)
        return getattr(interrupt, "exit_code", EXIT_INTERRUPTED)


def _refuse_long_dashes(words: Sequence[str]) -> None:
    """OptionError for an option that was copied from a text with typographic dashes."""
    for word in words:
        if word.startswith(LONG_DASHES) and not os.path.lexists(word):
            raise OptionError(f"'{word}' begins with a long dash: type - or --")


class _Completion(argparse.Action):
    """Prints what a shell has to run once, as by eval "$(postfx --completion bash)", and ends the
    process."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: object, option_string: str | None = None) -> None:
        from argcomplete.shell_integration import shellcode

        print(shellcode(["postfx"], shell=str(values)))
        parser.exit()


def read_and_write_by(threads: int | None) -> None:
    """Set the number of threads that read and write files, all with one heap; None: all that this
    process may use."""
    import OpenImageIO as oiio  # here, as --help does without

    from postfx.system import share_one_heap, usable_cores

    share_one_heap()
    for name in ("threads", "exr_threads"):
        oiio.attribute(name, threads or usable_cores())


def _place_of_run_options(parser: argparse.ArgumentParser, words: Sequence[str]) -> str:
    """For verbs that hand options of `postfx run` on."""
    from postfx.cli.run_options import RUN

    verb, flag = parser.prog.split()[-1], words[0].partition("=")[0]
    if verb not in FORWARDING or flag not in {name for option in RUN
                                              for name in (option.flag, option.short)}:
        return ""
    return (f": options of 'postfx run' go after --, as in: postfx {verb} ... -- "
            f"{' '.join(words)}")


def make_parser(used: Collection[str] = tuple(VERBS)) -> argparse.ArgumentParser:
    """Parser that lists all verbs and knows the arguments of those in `used`, whose modules it
    loads."""
    parser = Parser(
        prog="postfx",
        description="Post-processing of rendered image sequences: denoise, upscale, tone-map.",
        epilog="'postfx COMMAND --help' explains a command and gives examples.",
    )
    parser.add_argument("--version", action="version", version=f"postfx {__version__}")
    parser.add_argument("--completion", metavar="SHELL", choices=SHELLS, action=_Completion,
                        help=f"print a script that completes commands in {', '.join(SHELLS[:-1])} "
                        f"or {SHELLS[-1]}")
    parser.hint = _place_of_run_options
    verbs = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, summary in VERBS.items():
        added = verbs.add_parser(name, help=summary,
                                 formatter_class=argparse.RawDescriptionHelpFormatter)
        if name in used:
            verb = import_module(f"postfx.cli.{name.replace('-', '_')}")
            added.description, added.epilog = verb.DESCRIPTION, verb.EXAMPLES
            added.more = getattr(verb, "MORE", ""), getattr(verb, "MORE_EXAMPLES", "")
            verb.add_arguments(added)
            added.set_defaults(execute=verb.execute, parser=added)
    return parser


if __name__ == "__main__":
    sys.exit(main())
