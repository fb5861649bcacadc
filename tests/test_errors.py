"""Errors: one tree, shown in the module's docstring, and they survive the way between processes."""

import ast
import pickle
from pathlib import Path

import postfx
from postfx import errors
from postfx.errors import CommandTimeout

PACKAGE = Path(postfx.__file__).parent


def test_the_docstring_shows_the_tree():
    kinds = {name: kind for name, kind in vars(errors).items()
             if isinstance(kind, type) and issubclass(kind, BaseException)}
    shown = [line for line in (errors.__doc__ or "").splitlines() if line.startswith("    ")]
    assert {line.split()[0] for line in shown} == set(kinds)
    above: list[str] = []
    for line in shown:
        depth, name = (len(line) - len(line.lstrip()) - 4) // 2, line.split()[0]
        above[depth:] = [name]
        assert depth == 0 or kinds[name].__bases__ == (kinds[above[depth - 1]],)


def test_no_error_for_users_is_defined_elsewhere():
    for source in PACKAGE.rglob("*.py"):
        bases = [ast.unparse(base) for node in ast.walk(ast.parse(source.read_text(encoding="utf-8")))
                 if isinstance(node, ast.ClassDef) for base in node.bases]
        assert source.name == "errors.py" or not {"Exception", *vars(errors)} & {base.split(".")[-1] for base in bases}


def test_errors_with_attributes_can_be_pickled():
    error = pickle.loads(pickle.dumps(CommandTimeout("late", "denoise", ("frame 2",))))
    assert (str(error), error.running, error.waiting) == ("late", "denoise", ("frame 2",))
