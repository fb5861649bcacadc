"""Model packages: folders of ONNX files with JSON cards."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from postfx.errors import ModelError
from postfx.files import parse_json, read_text
from postfx.runtime.model_check import MOST_BYTES, check_model
from postfx.system import is_plain_name, models_dir

_PARTS = {"inputs": dict, "outputs": dict, "weights": str}
_WORDS = {dict: "objects", str: "texts"}
_MOST_CARD = 1 << 20  # bytes


class Library:
    """The models of one or more folders: `<name>.onnx`, each with an optional card `<name>.json`.

    Where two folders hold a model of the same name, the folder given first wins. Without a folder, the models that
    come with postfx. Raises ModelError when a folder does not exist.
    """

    def __init__(self, *folders: str | Path) -> None:
        self.folders = tuple(Path(folder) for folder in folders) or (models_dir(),)
        for folder in self.folders:
            if not folder.is_dir():
                raise ModelError(f"model folder '{folder}' does not exist")

    def names(self) -> tuple[str, ...]:
        """Names of all models, sorted."""
        return tuple(sorted({path.stem for folder in self.folders for path in folder.glob("*.onnx")}))

    def path(self, name: str) -> Path:
        """The model's file. Raises ModelError that lists the models there are."""
        for folder in self.folders:
            if (folder / f"{name}.onnx").is_file():
                return folder / f"{name}.onnx"
        where = ", ".join(str(folder) for folder in self.folders)
        known = self.names()
        alike = [other for other in known if other.split(".")[0] == name.split(".")[0]] or known
        raise ModelError(f"no model '{name}' in {where}: there are {', '.join(alike) or 'none'}")

    def card(self, name: str) -> dict[str, Any]:
        """The model's card, empty when it has none. Raises ModelError when the card is not a JSON object."""
        path = self.path(name).with_name(f"{name}.json")
        if not path.exists():
            return {}
        try:
            card = parse_json(read_text(path, _MOST_CARD))
        except (OSError, ValueError) as error:
            raise ModelError(f"card '{path}' cannot be read: {error}") from error
        if not isinstance(card, dict):
            raise ModelError(f"card '{path}' is not a JSON object")
        for key, kind in _PARTS.items():
            if not isinstance(card.get(key, {}), dict) or not all(type(v) is kind for v in card.get(key, {}).values()):
                raise ModelError(f"card '{path}': '{key}' must be an object of {_WORDS[kind]}")
        for facts in (*card.get("inputs", {}).values(), *card.get("outputs", {}).values()):
            if not isinstance(facts.get("shape", []), list):
                raise ModelError(f"card '{path}': a 'shape' must be a list of numbers and names")
        return card

    def constants(self, name: str) -> tuple[str, ...]:
        """Outputs that the card marks as `"constant": true`: they depend on no input."""
        return tuple(output for output, facts in self.card(name).get("outputs", {}).items() if facts.get("constant"))

    def sha256(self, name: str) -> str:
        """The model's hash: the card's, which `load` holds the file to, or the file's own where the card gives none."""
        return self.card(name).get("sha256") or hashlib.sha256(_content(self.path(name))).hexdigest()

    def load(self, name: str) -> bytes:
        """The model's content. Raises ModelError when it, or a file beside it that it has weights in, is not the one
        whose `sha256` the card gives, and when it is refused by `postfx.runtime.model_check`."""
        path, card = self.path(name), self.card(name)
        for file, expected in card.get("weights", {}).items():
            if not is_plain_name(file):
                raise ModelError(f"card of '{path}' has weights in '{file}': name a file of the same folder")
            _checked(path.with_name(file), expected)
        content = _checked(path, card.get("sha256"))
        check_model(path, content, card)
        return content


def _checked(path: Path, sha256: str | None) -> bytes:
    content = _content(path)
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise ModelError(f"model '{path}' is not the file that its card describes (sha256 differs): get it again")
    return content


def _content(path: Path) -> bytes:
    """A file's bytes; of what is no file, such as a device that never ends, or is too large, none is read."""
    try:
        if not path.is_file():
            raise ModelError(f"model '{path}' is not a file")
        if path.stat().st_size > MOST_BYTES:
            size = f"{path.stat().st_size >> 20} MB"
            raise ModelError(f"model '{path}' is refused: it has {size}, more than {MOST_BYTES >> 20} MB")
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f"model '{path}' cannot be read: {error}") from error
