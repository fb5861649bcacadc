"""Arrows between the parts point one way, and no modules import each other in a circle."""

import ast
from graphlib import CycleError, TopologicalSorter
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
        elif (isinstance(node, ast.Call)
              and getattr(node.func, "id", getattr(node.func, "attr", "")) == "import_module"):
            first = node.args[0]
            found |= {first.value.split(".")[0]} if isinstance(first, ast.Constant) else set()
    return found


def test_only_the_runtime_imports_onnx_runtime_and_nothing_imports_torch():
    for source in SOURCES:
        names = imported(source)
        assert not names & {"torch", "training", "tests"}, source
        if PACKAGE / "runtime" not in source.parents:
            assert "onnxruntime" not in names, source


def test_the_check_sees_imports(tmp_path):
    text = ("def f():\n    import torch.nn\n    from onnxruntime import X\n    "
            "importlib.import_module('training.x')\n")
    (tmp_path / "m.py").write_text(text)
    assert imported(tmp_path / "m.py") == {"torch", "onnxruntime", "training"}


def module_of(source: Path, root: Path) -> str:
    """Dotted name of a source file; root: the folder that holds the package."""
    parts = source.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def import_graph(package: Path) -> dict[str, set[str]]:
    """Module -> modules of the same package that it imports: anywhere in it, also for type checking
    only."""
    modules = {module_of(source, package.parent): source for source in package.rglob("*.py")}
    graph = {}
    for name, source in modules.items():
        graph[name] = set()
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                graph[name] |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                full = {alias.name: f"{node.module}.{alias.name}" for alias in node.names}
                graph[name] |= {path if path in modules else node.module for path in full.values()}
        graph[name] &= modules.keys() - {name}
    return graph


def test_files_know_neither_kernels_nor_what_is_made_of_frames():
    graph = import_graph(PACKAGE)
    rooms = {name: {".".join(one.split(".")[:2]) for one in found} for name, found in graph.items()}
    above = {"postfx.kernels", "postfx.interpolate", "postfx.passes", "postfx.runtime",
             "postfx.pipeline"}
    for name in ("postfx.compiled", "postfx.motion", "postfx.io"):
        found = {one for module in graph if f"{module}.".startswith(f"{name}.")
                 for one in rooms[module]}
        assert not found & above, name
        assert name != "postfx.motion" or "postfx.io" not in found


def test_only_the_command_line_takes_tools():
    looking = {name for name, found in import_graph(PACKAGE).items()
               if room_of(name) not in ("cli", "tools")
               and "tools" in {room_of(one) for one in found}}
    assert not looking


def test_tools_know_one_another_in_one_direction():
    """A tool is a folder of them, or a file."""
    graph = {name.removeprefix("postfx."): {one.removeprefix("postfx.") for one in found}
             for name, found in import_graph(PACKAGE).items()}
    pairs = {(module.split(".")[1], one.split(".")[1]) for module, found in graph.items()
             for one in found if module.startswith("tools.") and one.startswith("tools.")}
    assert not {(one, other) for one, other in pairs if one != other and (other, one) in pairs}


def test_no_two_rooms_import_each_other():
    """A room is a folder of the package."""
    pairs = set()
    for module, found in import_graph(PACKAGE).items():
        for one in found:
            pairs.add((room_of(module), room_of(one)))
    both = {(one, other) for one, other in pairs if one != other and (other, one) in pairs}
    assert not {pair for pair in both if None not in pair}


def room_of(module: str) -> str | None:
    """The folder that a module lies in; None for one that lies in none."""
    name = module.split(".")[1] if "." in module else ""
    return name if (PACKAGE / name / "__init__.py").exists() and name else None


def test_no_imports_run_in_a_circle():
    TopologicalSorter(import_graph(PACKAGE)).prepare()


def test_the_check_sees_circles_of_type_checking_imports(tmp_path):
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "__init__.py").touch()
    (tmp_path / "p" / "a.py").write_text("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
                                         "    from p import b\n")
    (tmp_path / "p" / "b.py").write_text("def f():\n    from p.a import g\n")
    assert import_graph(tmp_path / "p") == {"p": set(), "p.a": {"p.b"}, "p.b": {"p.a"}}
    with pytest.raises(CycleError):
        TopologicalSorter(import_graph(tmp_path / "p")).prepare()
