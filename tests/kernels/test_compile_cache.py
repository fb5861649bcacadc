"""Compiled kernels that are kept: named by what they are made of, and unpickled, so nobody else may put them there."""

import hashlib
import importlib
import os
import pickle
import pkgutil
import subprocess
import sys
import time
from types import ModuleType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from postfx import kernels, system
from postfx.kernels import compile_cache, numeric
from postfx.kernels.compile_cache import digest
from postfx.kernels.native import CompileWatch

SOURCE = """
import numpy as np
from postfx.kernels import numeric
from postfx.kernels.numeric import compiled, inline, vectorised

GAIN, TABLE = 2.0, np.arange(3.0)

@inline
def helper(x):
    return x * GAIN

@compiled
def function(x):
    '''Doubles.'''
    return numeric.log(helper(x)) + TABLE[1]

@compiled
def other(x):
    return x
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Finds the folder anew, with a home and a folder for temporary files of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(system.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    return lambda: compile_cache.cache_folder.__wrapped__()


def load(text: str):
    """A module from a source text."""
    module = ModuleType("source")
    exec(text, module.__dict__)
    return module


def test_a_folder_of_our_own(folder, tmp_path):
    found = folder()
    assert found.parent == tmp_path / "cache/postfx" and found.stat().st_mode & 0o077 == 0
    assert folder() == found


def test_a_folder_that_everyone_may_write_to_is_not_used(folder, tmp_path):
    folder().chmod(0o777)
    assert folder().parent == tmp_path / f"tmp/postfx-{os.getuid()}"
    (tmp_path / f"tmp/postfx-{os.getuid()}").chmod(0o777)
    assert folder() is None


def test_a_folder_of_someone_else_is_not_used(folder, monkeypatch):
    folder()
    monkeypatch.setattr(system.os, "getuid", lambda: 54321)
    assert folder() is None


def test_without_a_home_it_lies_with_the_temporary_files(folder, tmp_path):
    (tmp_path / "cache").write_text("a file where the folder should be")
    assert folder().parent == tmp_path / f"tmp/postfx-{os.getuid()}"


@pytest.mark.parametrize(("old", "new", "same"), [
    ("@compiled", "# why\n\n@compiled", True),
    ("Doubles.", "Makes twice as much.", True),
    ("return x\n", "return x + 1\n", True),
    ("GAIN, TABLE = 2.0", "GAIN, TABLE = 3.0", False),
    ("arange(3.0)", "arange(4.0)", False),
    ("x * GAIN", "x + GAIN", False),
    ("numeric.log(", "numeric.exp(", False),
    ("@inline\ndef", "@vectorised\ndef", False),
])
def test_a_digest_tells_what_a_function_is_made_of(old, new, same):
    assert old in SOURCE
    before = digest(load(SOURCE).function)
    assert (digest(load(SOURCE.replace(old, new)).function) == before) == same


def test_constants_of_another_module_count(monkeypatch):
    text = SOURCE.replace("numeric.log(", "numeric.BRIGHTEST * (")
    before = digest(load(text).function)
    monkeypatch.setattr(numeric, "BRIGHTEST", 1.0)
    assert digest(load(text).function) != before


def test_all_kernels_have_digests():
    modules = [importlib.import_module(found.name)
               for found in pkgutil.walk_packages(kernels.__path__, f"{kernels.__name__}.")]
    functions = [value for module in modules for value in vars(module).values() if isinstance(value, Dispatcher)]
    assert len(functions) > 60 and all(map(digest, functions))


def test_what_is_compiled_is_counted_and_timed():
    text = f"function = kernel_jit()(lambda x: x + {time.time_ns()})"  # not in the cache of an earlier run
    function, told = load(f"from postfx.kernels.numeric import kernel_jit\n{text}").function, []
    with CompileWatch(told.append) as watch:
        assert function(np.float32(1)) > 4 and watch.count == 1 and watch.seconds > 0 and told == [0]
        function(np.float32(2))
    function(np.int8(2))
    assert watch.count == 1


def test_what_cannot_be_told_is_an_error():
    with pytest.raises(TypeError, match="a kernel uses <object object"):
        digest(load(SOURCE.replace("GAIN, TABLE = 2.0", "GAIN, TABLE = object()")).function)


def test_what_cannot_be_told_is_not_kept(monkeypatch, tmp_path):
    def refuse(function):
        raise TypeError

    monkeypatch.setattr(compile_cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(compile_cache, "digest", refuse)
    assert load(SOURCE).other(2) == 2 and not list(tmp_path.iterdir())


def test_compiled_functions_are_loaded_by_others_and_go_when_nobody_does(tmp_path, monkeypatch):
    folder, outdated = tmp_path / "postfx" / "kernels", tmp_path / "postfx" / "kernels-0123456789abcdef"
    unused = folder / f"unused-1{compile_cache.SUFFIX}"
    folder.mkdir(parents=True)
    outdated.mkdir()
    unused.touch()
    for path in (unused, outdated):
        os.utime(path, (0, time.time() - compile_cache.UNUSED - 60))
    monkeypatch.setattr(compile_cache, "cache_folder", lambda: folder)
    monkeypatch.setitem(sys.modules, "source", load(SOURCE))
    first, second = load(SOURCE).function, load(SOURCE).function
    expected = np.log(6.0) + 1
    assert first(3.0) == pytest.approx(expected) and first.stats.cache_misses
    assert len(list(folder.iterdir())) == 1 and not unused.exists() and not outdated.exists()
    assert second(3.0) == pytest.approx(expected) and not second.stats.cache_misses
    assert second(np.float32(3)) == pytest.approx(expected) and len(list(folder.iterdir())) == 2


def test_what_is_loaded_does_not_wait_for_the_compiler(tmp_path):
    source = tmp_path / "source.py"
    source.write_text("import numpy as np\nfrom postfx.kernels.numeric import compiled\n\n@compiled\n"
                      "def function(n):\n    return np.full(n, 2.0)\n")  # takes memory of Numba's
    code = "import sys, source; print(source.function(3).sum(), 'numba.np.arraymath' in sys.modules)"
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(tmp_path)}
    runs = [subprocess.run([sys.executable, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True,
                           check=True).stdout.split() for _ in range(2)]
    assert runs == [["6.0", "True"], ["6.0", "False"]]


DAMAGES = {
    "cut": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "a bit": lambda content: content[:100] + bytes([content[100] ^ 4]) + content[101:],
    "machine code": lambda content: content[: len(content) // 2] + bytes(64) + content[len(content) // 2 + 64:],
    "other bytes": lambda content: b"not a kernel",
    "a pickle of something else": lambda content: seal(pickle.dumps((1, 2, 3))),
}


def seal(content: bytes) -> bytes:
    return content + hashlib.sha256(content).digest()


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_made_again_in_silence(tmp_path, monkeypatch, capfd, damage):
    monkeypatch.setattr(compile_cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setitem(sys.modules, "source", load(SOURCE))
    expected = pytest.approx(1 + np.log(6))
    assert load(SOURCE).function(3.0) == expected
    (path,) = tmp_path.iterdir()
    content = path.read_bytes()
    path.write_bytes(DAMAGES[damage](content))
    again, later = load(SOURCE).function, load(SOURCE).function
    assert again(3.0) == expected and again.stats.cache_misses
    assert later(3.0) == expected and not later.stats.cache_misses
    assert list(tmp_path.iterdir()) == [path] and capfd.readouterr().err == ""
