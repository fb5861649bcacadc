"""`postfx VERB ...`: picks the verb and turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from postfx.cli import bench, capture_compare, exposure, inspect, lut, models, run, verify
from postfx.cli.options import Parser
from postfx.errors import PostfxError
from postfx.version import __version__

VERBS = (run, verify, inspect, exposure, bench, models, lut, capture_compare)
EXIT_ERROR = 2
EXIT_INTERRUPTED = 130
EXIT_PIPE = 141


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code: 0 done, 1 what was checked is not well, 2 something the user can fix,
    130 interrupted by Ctrl-C, 143 ended by SIGTERM."""
    arguments = make_parser().parse_args(argv)
    _read_and_write_by(getattr(arguments, "threads", None))
    try:
        code: int = arguments.execute(arguments)
        sys.stdout.flush()
        return code
    except PostfxError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_ERROR
    except BrokenPipeError:  # whoever reads has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        print(f"error: {name}{error.strerror or error}: check the path and its rights", file=sys.stderr)
        return EXIT_ERROR
    except MemoryError:
        print("error: out of memory: give postfx run --memory, e.g. --memory 4G", file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt as interrupt:
        print("interrupted: finished frames are kept", file=sys.stderr)
        return getattr(interrupt, "exit_code", EXIT_INTERRUPTED)


def _read_and_write_by(threads: int | None) -> None:
    """Have files read and written by so many threads; None: by all that this process may use."""
    import OpenImageIO as oiio  # here, as --help does without

    from postfx.system import usable_cores

    for name in ("threads", "exr_threads"):
        oiio.attribute(name, threads or usable_cores())


def make_parser() -> argparse.ArgumentParser:
    """Parser of all verbs."""
    parser = Parser(
        prog="postfx",
        description="Post-processing of rendered image sequences: denoise, upscale, tone-map.",
        epilog="'postfx VERB --help' explains a verb and gives examples.",
    )
    parser.add_argument("--version", action="version", version=f"postfx {__version__}")
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)
    for verb in VERBS:
        name = verb.__name__.rpartition(".")[2].replace("_", "-")
        added = verbs.add_parser(
            name,
            help=verb.HELP,
            description=verb.DESCRIPTION,
            epilog=verb.EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        verb.add_arguments(added)
        added.set_defaults(execute=verb.execute, parser=added)
    return parser


if __name__ == "__main__":
    sys.exit(main())
