"""No pickle: neither in the sources of postfx nor while it runs; nothing that a file holds is ever
executed."""

import ast
import subprocess
import sys
from pathlib import Path

import postfx

PACKAGE = Path(postfx.__file__).parent
REPOSITORY = PACKAGE.parent
FORBIDDEN = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal",
             "torch", "yaml"}
CALLS = {"eval", "exec", "compile"}

RUN = """
import sys, traceback
seen = []
def hook(event, arguments):
    if event == "pickle.find_class":
        seen.append((arguments, [frame.filename for frame in traceback.extract_stack()]))
sys.addaudithook(hook)
from postfx.cli.main import main
code = main(["run", {noisy!r}, "-o", {out!r}, "--frames", "1-2", "--model", "s", "--tonemap"])
assert code == 0 and not seen, seen
"""


def misuses(source: str) -> list[str]:
    """What a source imports or calls that reads code from data."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] in FORBIDDEN]
        elif (isinstance(node, ast.ImportFrom) and not node.level
              and node.module.split(".")[0] in FORBIDDEN):
            found.append(node.module)
        elif (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
              and node.func.id in CALLS):
            found.append(node.func.id)
        elif (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
              and node.func.attr == "load"):
            if isinstance(node.func.value, ast.Name) and node.func.value.id in ("np", "numpy"):
                refuses = [item.value for item in node.keywords if item.arg == "allow_pickle"]
                if not refuses or getattr(refuses[0], "value", True) is not False:
                    found.append("np.load")
    return found


def test_sources_have_no_pickle():
    for source in sorted(PACKAGE.rglob("*.py")):
        assert misuses(source.read_text(encoding="utf-8")) == [], source


def test_the_check_sees_them():
    source = ("import pickle\nfrom torch import load\nnp.load(f)\nnp.load(f, allow_pickle=True)\n"
              "eval('1')\n")
    assert misuses(source) == ["pickle", "torch", "np.load", "np.load", "eval"]
    assert misuses("np.load(f, allow_pickle=False)\njson.load(f)\nre.compile('x')\n") == []


def test_a_run_unpickles_nothing(tmp_path):
    code = RUN.replace("{noisy!r}", repr(str(REPOSITORY / "samples/room/noisy.####.exr"))).replace(
        "{out!r}", repr(str(tmp_path / "out.####.exr")))
    subprocess.run([sys.executable, "-c", code], check=True, cwd=REPOSITORY, capture_output=True,
                   timeout=300)
