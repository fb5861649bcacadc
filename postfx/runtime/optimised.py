"""Optimised networks, kept between runs.

ONNX Runtime optimises a network for the machine whenever a session is made of it. What comes of it on the CPU is kept
in a file of the user's own, named by all that it depends on: the model's content, the sizes of its dimensions, ONNX
Runtime's version and the processor. It computes the same bits.
"""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import onnxruntime as ort

from postfx.files import atomic_file
from postfx.system import private_folder

FOLDER = "networks"
MOST = 256 << 20
"""Bytes that all files may have together; those last used are kept."""
LARGEST = 2 << 20
"""Bytes of models that are kept: what comes of larger ones takes as long to read and to check as to make."""
CHECKED = hashlib.sha256().digest_size
"""Bytes of the hash that a file begins with."""
ELSEWHERE = b"location"
"""Stands in every model with weights in other files, which its content does not tell."""
PROCESSOR = ("model name", "flags", "Features")


def make_session(model: bytes, dims: Mapping[str, int],
                 options: Callable[[], ort.SessionOptions]) -> ort.InferenceSession:
    """A session on the CPU, of what is kept of the model, or of the model itself. Raises what ONNX Runtime does."""
    folder = None if len(model) > LARGEST or ELSEWHERE in model else private_folder(FOLDER)
    if folder is None:
        return _session(model, options())
    path = folder / f"{_key(model, dims)}.onnx"
    return _kept(path, options()) or _kept_anew(path, model, options()) or _session(model, options())


def _session(model: bytes, options: ort.SessionOptions) -> ort.InferenceSession:
    return ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def _kept(path: Path, options: ort.SessionOptions) -> ort.InferenceSession | None:
    """A session of a kept file; None where there is none, or none that is whole."""
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[CHECKED:]).digest() != content[:CHECKED]:
            return None
        os.utime(path)
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        return _session(content[CHECKED:], options)
    except Exception:  # the model itself tells what is wrong, if it is that
        return None


def _kept_anew(path: Path, model: bytes, options: ort.SessionOptions) -> ort.InferenceSession | None:
    """A session of a model, of which a file is kept; None where that fails, for lack of room, say."""
    try:
        with atomic_file(path, durable=False) as part:
            options.optimized_model_filepath = str(part)
            session = _session(model, options)
            content = part.read_bytes()
            part.write_bytes(hashlib.sha256(content).digest() + content)
        _forget_oldest(path.parent)
        return session
    except Exception:  # likewise
        return None


def _forget_oldest(folder: Path) -> None:
    facts = {file: file.stat() for file in folder.iterdir()}
    total = 0
    for file in sorted(facts, key=lambda file: facts[file].st_mtime, reverse=True):
        total += facts[file].st_size
        if total > MOST:
            file.unlink(missing_ok=True)


def _key(model: bytes, dims: Mapping[str, int]) -> str:
    known = hashlib.sha256(repr((ort.__version__, _processor(), sorted(dims.items()))).encode())
    known.update(model)
    return known.hexdigest()


@cache
def _processor() -> str:
    """What tells processors apart for which networks are optimised differently."""
    found = [platform.machine(), platform.processor()]
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    for name in PROCESSOR:
        found += [line for line in lines if line.startswith(name)][:1]
    return "\n".join(found)
