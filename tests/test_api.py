"""The public names, pinned: a change here is a change for users."""

import subprocess
import sys
from pathlib import Path

import pytest

import postfx

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
