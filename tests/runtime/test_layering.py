"""Arrows between the parts point one way."""

import ast
from pathlib import Path

import pytest

import postfx

PACKAGE = Path(postfx.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))


def imported(source: Path) -> set[str]:
    """Top-level names of everything that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(node.module.split(".")[0])
        elif isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) == "import_module":
            first = node.args[0]
            found |= {first.value.split(".")[0]} if isinstance(first, ast.Constant) else set()
    return found


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports(source):
    names = imported(source)
    assert not names & {"torch", "training", "tests"}
    if PACKAGE / "runtime" not in source.parents:
        assert "onnxruntime" not in names


def test_the_check_sees_imports(tmp_path):
    text = "def f():\n    import torch.nn\n    from onnxruntime import X\n    importlib.import_module('training.x')\n"
    (tmp_path / "m.py").write_text(text)
    assert imported(tmp_path / "m.py") == {"torch", "onnxruntime", "training"}
