"""Mixtures of checkpoints."""

from __future__ import annotations

from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from training.denoise.checkpoint import load_weights, main, read, save  # noqa: E402


def write(path: Path, value: float, width: int = 16) -> str:
    save({"config": {"widths": (width,)}, "weights": {"a": torch.full((2,), value)}, "notes": {"steps": 7}}, path)
    return str(path)


def test_a_mixture_is_the_weighted_mean(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other, odd = (write(tmp_path / f"{n}.pt", v, w) for n, v, w in (("a", 1.0, 16), ("b", 2.0, 16), ("c", 0, 8)))
    mixed = tmp_path / "mixed.pt"
    main(["mix", f"{one}:0.6", f"{other}:0.4", "-o", str(mixed)])
    assert load_weights(mixed)["a"].tolist() == pytest.approx([1.4, 1.4])
    assert read(mixed)["notes"] == {"steps": 7, "weights": f"0.6 {one} + 0.4 {other}"}
    for words, said in (([f"{one}:0.6", f"{odd}:0.4"], "another layout"), ([f"{one}:0.6"], "add up to 0.6, not to 1"),
                        ([one], "is not FILE:SHARE"), ([f"{tmp_path / 'x.pt'}:1"], "No such file")):
        with pytest.raises(SystemExit):
            main(["mix", *words, "-o", str(mixed)])
        assert said in capsys.readouterr().err
