"""The public names, pinned: a change here is a change for users."""

import ast
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.frame import Frame, Role

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
    "Irradiance",
    "Library",
    "MixPartner",
    "Occlusion",
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
    "SceneShading",
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
    code = ("import sys; sys.modules['torch'] = None; import postfx; [getattr(postfx, n) for n in "
            "postfx.__all__]")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_each_public_name_has_a_home():
    assert {*postfx.__all__} == {*postfx._HOMES, "__version__"}


def test_type_checkers_are_told_of_the_types():
    assert Path(postfx.__file__).with_name("py.typed").is_file()


def taken_names(path: Path) -> Iterator[tuple[str, str]]:
    """Modules of the package and the names that a file imports from them."""
    for node in ast.walk(ast.parse(path.read_text())):
        if (isinstance(node, ast.ImportFrom) and node.module
            and node.module.split(".")[0] == "postfx"):
            yield from ((node.module, name.name) for name in node.names)


@pytest.mark.parametrize("folder", ["training", "samples", "hosts", "web", "tests"])
def test_names_that_other_folders_import_are_there(folder):
    """Tools that few tests run lose their imports first."""
    files = sorted((REPOSITORY / folder).rglob("*.py"))
    assert files
    lost = [f"{path.relative_to(REPOSITORY)}: {module}.{name}" for path in files
            for module, name in taken_names(path)
            if not hasattr(import_module(module), name) and find_spec(f"{module}.{name}") is None]
    assert not lost


def test_exposure_is_in_stops_wherever_it_is_called_exposure():
    """A factor is called `exposure_factor`: no function and no field takes one as `exposure`."""
    found, seen = [], 0
    for module in pkgutil.walk_packages(postfx.__path__, "postfx."):
        if (module.name.startswith(("postfx.cli", "postfx.kernels"))
            or module.name.endswith("__main__")):
            continue
        for name, thing in inspect.getmembers(import_module(module.name)):
            is_class = inspect.isclass(thing)
            own = getattr(thing, "__module__", "") == module.name
            if not own or not (is_class or inspect.isfunction(thing)):
                continue
            methods = ([item for item in vars(thing).values() if inspect.isfunction(item)]
                       if is_class else [])
            for part in [thing, *methods]:
                try:
                    takes = "exposure" in inspect.signature(part).parameters
                except ValueError:
                    continue
                seen += takes
                told = " ".join(filter(None, (inspect.getdoc(part), inspect.getdoc(thing))))
                is_told = (re.search(r"\bstops\b|as for a `Pipeline`", told)
                           or part.__name__.startswith("_"))
                if takes and not is_told:
                    found.append(f"{module.name}.{name}: {part.__qualname__}")
    assert seen > 10 and found == []


def test_one_stop_is_one_stop_in_every_call():
    """Twice the light at one stop less is the same picture; what is told back is in stops, too."""
    light = np.random.default_rng(0).random((24, 32, 3), np.float32)
    look = postfx.Pipeline([postfx.ToneMap()], exposure=1.0)
    shown = look(Frame({"color": light}))[Role.COLOUR]
    assert look.exposure == 1.0 and look.exposure_factor == 2.0
    lit = postfx.Pipeline([postfx.ToneMap()], exposure="lit")
    np.testing.assert_array_equal(lit(Frame({"color": light}, exposure=1.0))[Role.COLOUR], shown)
    np.testing.assert_array_equal(lit(Frame({"color": 2 * light}, exposure=0.0))[Role.COLOUR],
                                  shown)
    np.testing.assert_array_equal(look.on_device({"color": light},
                                                 exposure=1.0)[Role.COLOUR].download(), shown)
    assert look.exposure == 1.0
