"""Errors: one tree, shown in the module's docstring, and they survive the way between processes."""

import ast
import errno
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx import errors
from postfx.colour.ocio import file_transform
from postfx.errors import CommandTimeout
from postfx.frame import Frame, Role
from postfx.io.profile import load_profile
from postfx.runs.manifest import MANIFEST_NAME, Manifest, Output, verify
from postfx.tools.report import capture_data

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


@pytest.mark.parametrize("call", [
    lambda name: postfx.read_sequence(name),
    lambda name: postfx.read_sequence(f"{name}/a.####.exr"),
    lambda name: postfx.write_frame(name, Frame({Role.COLOUR: np.ones((2, 2, 3), np.float32)})),
    postfx.Library, load_profile])
def test_names_in_errors_control_no_terminal_of_a_program(call):
    with pytest.raises(postfx.PostfxError) as caught:
        call("a\x1b[31m\x1b]0;title\x07\nb.txt")
    for error in (caught.value, pickle.loads(pickle.dumps(caught.value))):
        assert str(error).isprintable() and "a?[31m?]0;title??b" in str(error)


PICTURE = np.ones((2, 2, 3), np.float32)
GREY = Frame({Role.COLOUR: PICTURE})
OTHER_TYPES = {
    "half a jitter": lambda _: Frame({"colour": PICTURE}, jitter=(None, 0)),
    "a nested jitter": lambda _: Frame({"colour": PICTURE}, jitter=((1,), (2,))),
    "a jitter without a number": lambda _: Frame({"colour": PICTURE}, jitter=(0.1, np.nan)),
    "a list of exposures": lambda _: Frame({"colour": PICTURE}, exposure=[1]),
    "a number in words": lambda _: Frame({"colour": PICTURE}, number="a"),
    "half a number": lambda _: Frame({"colour": PICTURE}, number=1.5),
    "no encoding": lambda _: Frame({"colour": PICTURE}, encoding=None),
    "exposures of a pipeline": lambda _: postfx.Pipeline([], exposure=np.ones(2)),
    "no path": lambda _: postfx.write_frame(None, GREY),
    "bytes for a path": lambda folder: postfx.write_frame(bytes(folder / "a.exr"), GREY),
    "a list of bits": lambda folder: postfx.write_frame(folder / "a.exr", GREY, bits=[16]),
    "no compression": lambda folder: postfx.write_frame(folder / "a.exr", GREY, compression=None),
    "no input": lambda _: postfx.read_sequence(None),
    "bytes for an input": lambda _: postfx.read_sequence(b"a.exr"),
    "an empty list": lambda _: postfx.read_sequence([]),
    "planes in a word": lambda folder: postfx.read_sequence(folder / "a.exr", planes="colour"),
    "planes by number": lambda folder: postfx.read_sequence(folder / "a.exr", planes=[3]),
    "half a frame": lambda folder: postfx.read_sequence(folder / "a.exr", frames=1.5),
    "frames of two kinds": lambda folder: postfx.read_sequence(folder / "a.exr", frames=[1, "2"]),
    "a layer by number": lambda folder: postfx.read_sequence(folder / "a.exr", layer=3),
    "depth by number": lambda folder: postfx.read_sequence(folder / "a.exr", depth=3),
}


@pytest.mark.parametrize("kind", OTHER_TYPES)
def test_values_of_other_types_are_refused_in_one_line(kind: str, tmp_path: Path):
    postfx.write_frame(tmp_path / "a.exr", GREY)
    with pytest.raises(postfx.PostfxError, match="give |use ") as caught:
        OTHER_TYPES[kind](tmp_path)
    assert len(str(caught.value)) < 400 and "\n" not in str(caught.value)


@pytest.mark.parametrize("fields", [
    {"jitter": [0, 1]}, {"jitter": np.ones(2, np.float16)}, {"exposure": np.float32(2)},
    {"exposure": 1}, {"number": np.int64(3)}, {"world_to_camera": list(range(16))},
    {"world_to_camera": np.eye(4, dtype=np.float32)}])
def test_numbers_of_any_type_are_taken(fields: dict):
    frame = Frame({"colour": PICTURE}, **fields)
    for name, given in fields.items():
        np.testing.assert_array_equal(np.ravel(getattr(frame, name)), np.ravel(given))


def test_no_error_for_users_is_defined_elsewhere():
    for source in PACKAGE.rglob("*.py"):
        bases = [ast.unparse(base)
                 for node in ast.walk(ast.parse(source.read_text(encoding="utf-8")))
                 if isinstance(node, ast.ClassDef) for base in node.bases]
        # A build of the kernels runs before the package can be imported, so its error stands beside
        # it.
        own = source.name in ("errors.py", "build.py")
        assert own or not {"Exception", *vars(errors)} & {base.split(".")[-1] for base in bases}


def test_errors_with_attributes_can_be_pickled():
    error = pickle.loads(pickle.dumps(CommandTimeout("late", "denoise", ("frame 2",))))
    assert (str(error), error.running, error.waiting) == ("late", "denoise", ("frame 2",))


LOOKING = {
    "a folder of models": (postfx.Library, errors.ModelError),
    "a model": (lambda path: postfx.DenoiseUpscale(model=f"{path}/toy.onnx"), errors.PostfxError),
    "a folder to verify": (verify, errors.ManifestError),
    "a profile": (lambda path: load_profile(f"{path}/studio.toml"), errors.ProfileError),
    "a look-up table": (lambda path: file_transform(f"{path}/film.cube"), errors.ColourError),
    "a capture": (capture_data.read, errors.ReadError),
}


@pytest.mark.parametrize("what", LOOKING)
def test_what_may_not_be_looked_at_is_an_error_that_names_it(what, tmp_path, monkeypatch):
    look, kind = LOOKING[what]
    stat = os.stat

    def refuse(path, *words, **named):
        if str(path).startswith(str(tmp_path)):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, *words, **named)

    monkeypatch.setattr(os, "stat", refuse)
    with pytest.raises(kind, match=str(tmp_path)):
        look(tmp_path)


@pytest.mark.parametrize("look",
                         [verify, lambda path: file_transform(f"{path}/film.cube,input=ACEScct")])
def test_what_may_not_be_read_is_an_error_that_names_it(look, tmp_path, monkeypatch):
    (tmp_path / "film.cube").write_text("LUT_3D_SIZE 2")
    (tmp_path / MANIFEST_NAME).write_text(Manifest(
        {}, {"film.cube": Output("run", 1, "0" * 64, 13)}
    ).to_json())
    opened = open

    def refuse(path, *words, **named):
        if str(path).endswith(".cube"):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return opened(path, *words, **named)

    monkeypatch.setattr("builtins.open", refuse)
    monkeypatch.setattr("io.open", refuse)
    with pytest.raises(errors.PostfxError,
                       match="film.cube: .*cannot be read: Permission denied; check its rights"):
        look(tmp_path)


def test_an_unknown_user_is_no_home_folder():
    """Python's own way to look for it ends in a RuntimeError."""
    with pytest.raises(errors.ModelError, match="~nobody-here"):
        postfx.DenoiseUpscale(library="~nobody-here/models")
    with pytest.raises(errors.PostfxError, match="~nobody-here"):
        postfx.DenoiseUpscale(model="~nobody-here/toy.onnx")
