"""Write measurements into docs/lab/quality.md: its tables and pictures.

python -m training.measure.quality_report RESULTS [--doc docs/lab/quality.md] \\
    [--images docs/images/quality] [--check | --print]

RESULTS holds the output of these commands:

    RESULTS/SEQUENCE/              postfx bench ... -o RESULTS/SEQUENCE
    RESULTS/SEQUENCE-ablations/    postfx bench ... --ablations (or in RESULTS/SEQUENCE, in one go)
    RESULTS/validation/    python -m training.measure.validation compare CLIPS -o RESULTS/validation
    RESULTS/equivalent/           python -m training.measure.equivalent_samples measure VIEW \\
                                      -o RESULTS/equivalent
    RESULTS/convergence/          python -m training.measure.convergence VIEW -o RESULTS/convergence
    RESULTS/curves.png            python -m training.measure.runs curves RUN -o RESULTS/curves.png

Lines between `<!-- table: NAME ARGUMENTS -->` and `<!-- end -->` are replaced; everything else is
written by hand. Arguments are folders of RESULTS, so the document itself chooses its sequences and
their order:

    conditions SEQUENCE...         conditions of the measurement
    gains SEQUENCE...              ours against the best of the others, figure by figure
    methods SEQUENCE               all figures of all methods
    frames SEQUENCE...             single frames against OIDN's
    history SEQUENCE...            with history against without
    front psnr|flicker SEQUENCE... run time against error
    times SEQUENCE                 run time and memory
    ablations MODEL SEQUENCE...    networks without some planes
    scales                         the validation set, scale by scale
    equal_rays                     the validation set, as many light paths spent in two ways
    equivalent FOLDER...           equivalent sample counts
    convergence FOLDER...          least gain over the input at any sample count
    networks                       cards of models/*.json
    picture FILE WORDS...          RESULTS/FILE, reduced, with WORDS as alternative text

A block with missing data stays unchanged and is named on standard error. --check writes nothing and
ends with 1 if a block or a picture is out of date. --print writes nothing and prints the tables: so
`training.measure.record` can keep what a page's figures are from.
"""

from __future__ import annotations

import argparse
import sys
from inspect import Parameter, signature
from pathlib import Path

from training.measure.quality_report.document import (
    Album,
    Block,
    Missing,
    ReportError,
    Results,
    compose,
    parse,
)
from training.measure.quality_report.tables import MAKERS

REPOSITORY = Path(__file__).resolve().parents[3]


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, metavar="RESULTS")
    parser.add_argument("--doc", type=Path, default=REPOSITORY / "docs/lab/quality.md")
    parser.add_argument("--images", type=Path, default=REPOSITORY / "docs/images/quality")
    parser.add_argument("--models", type=Path, default=REPOSITORY / "models",
                        help="folder of the networks' cards")
    only = parser.add_mutually_exclusive_group()
    only.add_argument("--check", action="store_true",
                      help="write nothing; only check that everything is up to date")
    only.add_argument("--print", action="store_true", help="write nothing; print the tables")
    return parser.parse_args(argv)


def make(block: Block, results: Results, album: Album) -> str:
    """Lines of a block; raises Missing or ReportError."""
    maker = album.add if block.name == "picture" else MAKERS[block.name]
    wanted = list(signature(maker).parameters.values())[1:]
    endless = any(parameter.kind is Parameter.VAR_POSITIONAL for parameter in wanted)
    if len(block.arguments) < len(wanted) or not endless and len(block.arguments) > len(wanted):
        takes = " ".join(parameter.name.upper() for parameter in wanted) + ("..." if endless
                                                                            else "")
        raise ReportError(f"'{block.title}' takes {takes or 'nothing'}")
    try:
        return maker(results, *block.arguments)
    except KeyError as error:
        raise ReportError(f"'{block.title}': the results lack {error}: measure again") from error


def report(args: argparse.Namespace) -> int:
    """Returns the exit code; raises ReportError."""
    if not args.results.is_dir():
        raise ReportError(f"{args.results} is not a folder: name the one that holds the results")
    text = args.doc.read_text(encoding="utf-8")
    parts = parse(text, args.doc, {*MAKERS, "picture"})
    results, album = Results(args.results, args.models), Album(args.images, args.doc.parent)
    made: dict[int, str] = {}
    blocks = [part for part in parts if isinstance(part, Block)]
    for block in blocks:
        try:
            made[block.line] = make(block, results, album)
        except Missing as missing:
            print(f"unchanged: {args.doc}:{block.line} '{block.title}': {missing}", file=sys.stderr)
        except ReportError as error:
            raise ReportError(f"{args.doc}:{block.line}: {error}") from error
    album.check_size()
    if args.print:
        print("\n".join(f"{block.title}\n\n{made[block.line]}" for block in blocks
                        if block.line in made and block.name != "picture"), end="")
        return 0
    if args.check:
        old = [block for block in blocks if made.get(block.line, block.text) != block.text]
        stale = [f"{args.doc}:{block.line} '{block.title}'" for block in old] + album.stale()
        print("\n".join(f"out of date: {what}" for what in stale) or "up to date")
        return 1 if stale else 0
    args.doc.write_text(compose(parts, made), encoding="utf-8")
    album.write()
    print(f"wrote {len(made)} blocks of {args.doc}")
    return 0


def main(argv: list[str] | None = None) -> int:
    try:
        return report(arguments(argv))
    except (ReportError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
