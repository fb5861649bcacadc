"""The public names, pinned: a change here is a change for users."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import postfx

REPOSITORY = Path(__file__).resolve().parent.parent
PUBLIC = [
    "Backwards",
    "Between",
    "BothWays",
    "DenoiseUpscale",
    "Device",
    "DeviceInterpolator",
    "Frame",
    "FrameSpec",
    "Interpolator",
    "Library",
    "MixPartner",
    "Oidn",
    "Overlay",
    "Partner",
    "Pipeline",
    "PostfxError",
    "Presenter",
    "ROLES",
    "RenderSize",
    "Role",
    "RunUp",
    "Sequence",
    "ToneMap",
    "__version__",
    "denoise",
    "models_dir",
    "read_sequence",
    "write_frame",
]


def test_public_names():
    assert sorted(postfx.__all__) == PUBLIC


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_is_there(name):
    assert getattr(postfx, name) is not None


def test_unknown_names_are_refused():
    with pytest.raises(AttributeError, match="no attribute 'Denoise'"):
        postfx.Denoise  # noqa: B018


def test_importing_everything_needs_no_torch():
    code = "import sys; sys.modules['torch'] = None; import postfx; [getattr(postfx, n) for n in postfx.__all__]"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_each_public_name_has_a_home():
    assert {*postfx.__all__} == {*postfx._HOMES, "__version__"}


def test_type_checkers_are_told_of_the_types():
    assert Path(postfx.__file__).with_name("py.typed").is_file()


def taken_names(path: Path) -> Iterator[tuple[str, str]]:
    """Modules of the package and the names that a file imports from them."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "postfx":
            yield from ((node.module, name.name) for name in node.names)


@pytest.mark.parametrize("folder", ["training", "samples", "hosts", "web"])
def test_names_that_other_folders_import_are_there(folder):
    """Tools that few tests run lose their imports first."""
    files = sorted((REPOSITORY / folder).rglob("*.py"))
    assert files
    lost = [f"{path.relative_to(REPOSITORY)}: {module}.{name}" for path in files for module, name in taken_names(path)
            if not hasattr(import_module(module), name) and find_spec(f"{module}.{name}") is None]
    assert not lost
