"""What the package's code is like, in numbers that say where a reader has to stop.

`python -m tests.code_table` prints the table; `--list` also says where each thing stands, `--frame`
also runs the sample room and counts what one steady frame passes, by the package's parts (half a
minute), `--kernels` what the lines of kernels are. Nothing here is a limit.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import re
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import postfx

PACKAGE = Path(postfx.__file__).parent
WIDEST_COLUMNS = 100
MOST_PARAMETERS = 8

Function = ast.FunctionDef | ast.AsyncFunctionDef
Places = dict[str, list[str]]
"""What was found -> where, as 'io/sequence.py:12'."""


class Source(NamedTuple):
    """One module: its path below the package, its lines and its syntax."""

    path: str
    lines: list[str]
    tree: ast.Module


def read_sources(package: Path = PACKAGE) -> list[Source]:
    """All Python modules of a package, sorted by path."""
    found = []
    for path in sorted(package.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        found.append(Source(str(path.relative_to(package)), text.splitlines(), ast.parse(text)))
    return found


def find_wide_lines(sources: list[Source]) -> list[str]:
    """Where lines are wider than 100 columns."""
    return [f"{source.path}:{number}" for source in sources
            for number, line in enumerate(source.lines, 1) if len(line) > WIDEST_COLUMNS]


def count_parameters(function: Function) -> int:
    """Parameters that a caller can give: all but `self` and `cls`; *args and **options count as one
    each."""
    given = function.args
    plain = [argument.arg for argument in (*given.posonlyargs, *given.args)]
    own = len(plain) - (plain[:1] in (["self"], ["cls"]))
    return own + len(given.kwonlyargs) + (given.vararg is not None) + (given.kwarg is not None)


def find_functions_with_many_parameters(sources: list[Source]) -> Places:
    """Functions with more than 8 parameters, as 'path:line' -> name and number."""
    found: Places = {}
    for source in sources:
        for node in ast.walk(source.tree):
            if isinstance(node, Function) and (count := count_parameters(node)) > MOST_PARAMETERS:
                found[f"{source.path}:{node.lineno}"] = [f"{node.name} has {count}"]
    return found


def list_constants(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Names in capitals that a module gives a value at its top level, and their lines."""
    for node in tree.body:
        targets: list[ast.expr]
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        else:
            continue
        for target in targets:
            for name in ast.walk(target):
                if (isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)
                    and name.id.isupper()):
                    yield name.id, name.lineno


def find_shared_constants(sources: list[Source]) -> Places:
    """Names of constants that more than one module gives a value, and where."""
    found: Places = defaultdict(list)
    for source in sources:
        for name, line in dict(list_constants(source.tree)).items():
            found[name].append(f"{source.path}:{line}")
    return {name: places for name, places in sorted(found.items()) if len(places) > 1}


def find_crowded_lines(sources: list[Source]) -> Places:
    """Lines at the top level that give several constants values, and which."""
    found: Places = defaultdict(list)
    for source in sources:
        for name, line in list_constants(source.tree):
            found[f"{source.path}:{line}"].append(name)
    return {place: names for place, names in found.items() if len(names) > 1}


def count_kernel_lines(repository: Path = PACKAGE.parent) -> dict[str, str]:
    """Lines of kernels by the language that they are written in."""
    forms = {"C++": ("postfx", (".h", ".cpp")), "CUDA": ("postfx", (".cuh", ".cu")),
             "PyTorch": ("training/kernels", (".py",))}
    found = {}
    for language, (folder, endings) in forms.items():
        texts = [path.read_text("utf-8") for path in (repository / folder).rglob("*")
                 if path.suffix in endings]
        found[language] = sum(len(text.splitlines()) for text in texts)
    return {"lines of kernels": f"{sum(found.values())}",
            **{f"lines of kernels in {language}": f"{lines}" for language, lines in found.items()}}


KERNEL_FAMILIES = {
    "denoiser": ("kernels/denoise/", "kernels/pixel_filter"),
    "frames between": ("kernels/interpolate/", "interpolate/"),
    "networks": ("kernels/convolution", "kernels/products", "kernels/neural", "kernels/mlp",
                 "kernels/gelu", "kernels/occlusion", "kernels/scene", "kernels/winograd",
                 "kernels/operators"),
    "colour and pictures": ("kernels/colour", "kernels/tonemap", "kernels/image", "kernels/partner",
                            "kernels/accumulate", "kernels/views"),
    "files and what is looked at": ("kernels/statistics", "kernels/pixel_formats"),
    "numbers and rows": ("kernels/",),
}
"""Family -> how the paths of its files below the package begin; the first that fits counts."""
PORTABLE_FAMILIES = {"denoise.py": "denoiser", "extras.py": "denoiser", "parts.py": "denoiser",
                     "partner.py": "colour and pictures", "tonemap.py": "colour and pictures"}
"""Files of portable definitions and their families."""
KERNEL_FORMS = {".h": "pixels", ".cpp": "CPU", ".cuh": "CUDA", ".cu": "CUDA", ".py": "PyTorch"}
_CUDA_DEFINITION = re.compile(r"^(?:FN .*?(\w+)\("
                              r"|struct (?:alignas\(\d+\) )?(\w+) \{)")
_CPU_DEFINITION = re.compile(r"\bstruct (\w+)|\b(\w+)\(")


def count_kernel_families(repository: Path = PACKAGE.parent) -> dict[str, dict[str, int]]:
    """Family -> form -> lines."""
    found: dict[str, dict[str, int]] = {}
    for path in sorted((repository / "postfx").rglob("*")):
        if path.suffix in (".h", ".cpp", ".cuh", ".cu"):
            name = path.relative_to(repository / "postfx").as_posix()
            family = next(family for family, starts in KERNEL_FAMILIES.items()
                          if name.startswith(starts))
            _add_lines(found, family, path)
    for path in sorted((repository / "training/kernels").glob("*.py")):
        _add_lines(found, PORTABLE_FAMILIES[path.name], path)
    return found


def _add_lines(found: dict[str, dict[str, int]], family: str, path: Path) -> None:
    forms, form = found.setdefault(family, {}), KERNEL_FORMS[path.suffix]
    forms[form] = forms.get(form, 0) + len(path.read_text("utf-8").splitlines())


def count_twins(repository: Path = PACKAGE.parent) -> int:
    """Lines of structures and functions in CUDA, kernels themselves apart, whose name one on the
    CPU has, too: all that a common header could hold."""
    package = repository / "postfx"
    on_cpu = {name for path in package.rglob("*") if path.suffix in (".h", ".cpp")
              for line in path.read_text("utf-8").splitlines()
              if line.startswith(("FN ", "ONCE ", "static ", "struct ", "template"))
              for match in [_CPU_DEFINITION.search(line)] if match
              for name in match.groups() if name}
    count = 0
    for path in package.rglob("*"):
        lines = path.read_text("utf-8").splitlines() if path.suffix in (".cuh", ".cu") else []
        for at, line in enumerate(lines):
            match = _CUDA_DEFINITION.match(line)
            if match and on_cpu & {*match.groups()}:
                ends = (place for place, later in enumerate(lines[at:], 1)
                        if later.startswith("}") or (place == 1 and later.endswith("}")))
                count += next(ends)
    return count


def print_kernels() -> None:
    """What the lines of kernels are, as a table."""
    forms = list(dict.fromkeys(KERNEL_FORMS.values()))
    found = count_kernel_families()
    print(f"| lines | {' | '.join(forms)} |")
    print("| --- " * (len(forms) + 1) + "|")
    sums = {form: sum(counts.get(form, 0) for counts in found.values()) for form in forms}
    for family, counts in {**{family: found[family] for family in KERNEL_FAMILIES},
                           "all": sums}.items():
        print(f"| {family} | {' | '.join(f'{counts.get(form, 0)}' for form in forms)} |")
    print(f"of CUDA, functions whose name the CPU has, too: {count_twins()} lines")


PARTS_OF_A_PATH = ("cli/", "compiled/", "io/", "kernels/", "passes/", "runs/", "runtime/")
"""Parts of the package whose functions on a frame's path are told apart."""


def measure_frame() -> dict[str, str]:
    """What a steady frame of the sample room passes on its way into an EXR."""
    from tests.test_frame_path import OUTPUTS, counted, watch_run

    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()), \
            contextlib.redirect_stderr(io.StringIO()):
        watch = watch_run(Path(folder), *OUTPUTS["EXR"])
    parts = {part: watch.count_functions(part) for part in PARTS_OF_A_PATH}
    return {
        "files on a steady frame's path": f"{len(counted(watch.found))}",
        "functions on a steady frame's path": f"{watch.count_functions()}",
        **{f"functions on it in {part}": f"{count}" for part, count in parts.items()},
        "functions on it beside these": f"{watch.count_functions() - sum(parts.values())}",
        "calls of a steady frame": f"{watch.count_calls():.0f}",
        "calls of it in io/": f"{watch.count_calls('io/'):.0f}",
    }


def make_table(sources: list[Source]) -> dict[str, str]:
    """The numbers that need no run."""
    total = sum(len(source.lines) for source in sources)
    wide = len(find_wide_lines(sources))
    return {
        "modules": f"{len(sources)}",
        "lines": f"{total}",
        "lines over 100 columns": f"{wide} ({100 * wide / total:.1f} %)",
        "functions with more than 8 "
        "parameters": f"{len(find_functions_with_many_parameters(sources))}",
        "constants named in several modules": f"{len(find_shared_constants(sources))}",
        "lines with several constants": f"{len(find_crowded_lines(sources))}",
    }


def main() -> None:
    """Print the table, and what was found where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--list", action="store_true", help="say where each thing stands")
    parser.add_argument(
        "--frame", action="store_true", help="also count what a steady frame passes"
    )
    parser.add_argument(
        "--under", default="", metavar="FOLDER", help="look only at modules below it, such as io"
    )
    parser.add_argument(
        "--kernels", action="store_true", help="also say what the lines of kernels are"
    )
    arguments = parser.parse_args()
    sources = [source for source in read_sources() if source.path.startswith(arguments.under)]
    if arguments.list:
        print(*find_wide_lines(sources), sep="\n")
        for found in (find_functions_with_many_parameters(sources), find_shared_constants(sources),
                      find_crowded_lines(sources)):
            for key, values in found.items():
                print(f"{key}  {', '.join(values)}")
    table = make_table(sources) | count_kernel_lines()
    for what, value in (table | (measure_frame() if arguments.frame else {})).items():
        print(f"{what:<44}{value:>14}")
    if arguments.kernels:
        print_kernels()


if __name__ == "__main__":
    main()
