"""Mixtures of checkpoints."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from postfx.system import models_dir  # noqa: E402
from training.denoise.checkpoint import keep_levels, load_weights, main, read, save, widen  # noqa: E402


def write(path: Path, value: float, width: int = 2) -> str:
    save({"config": {"widths": (width,)}, "weights": {"a": torch.full((width,), value)},
          "notes": {"steps": 7}}, path)
    return str(path)


def test_a_mixture_is_the_weighted_mean(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other, odd = (write(tmp_path / f"{n}.pt", v, w)
                       for n, v, w in (("a", 1.0, 2), ("b", 2.0, 2), ("c", 0, 3)))
    mixed = tmp_path / "mixed.pt"
    main(["mix", f"{one}:0.6", f"{other}:0.4", "-o", str(mixed)])
    assert load_weights(mixed)["a"].tolist() == pytest.approx([1.4, 1.4])
    assert read(mixed)["notes"] == {"steps": 7, "weights": f"0.6 {one} + 0.4 {other}"}
    for words, said in (([f"{one}:0.6", f"{odd}:0.4"], "another layout"),
                        ([f"{one}:0.6"], "add up to 0.6, not to 1"), ([one], "is not FILE:SHARE"),
                        (["s.onnx:1"], "s.onnx: an exported network cannot be the first"),
                        ([f"{tmp_path / 'x.pt'}:1"], "No such file")):
        with pytest.raises(SystemExit):
            main(["mix", *words, "-o", str(mixed)])
        assert said in capsys.readouterr().err


def test_a_mixture_with_a_network_that_ships(tmp_path: Path) -> None:
    network = models_dir() / "denoise_upscale.m.1x.onnx"
    weights = {name: values + 1 for name, values in load_weights(network).items()}
    config = json.loads(network.with_suffix(".json").read_text())["config"]
    save({"config": config, "weights": weights, "notes": {}}, tmp_path / "a.pt")
    main(["mix", f"{tmp_path / 'a.pt'}:0.75", f"{network}:0.25", "-o", str(tmp_path / "mixed.pt")])
    for name, values in load_weights(tmp_path / "mixed.pt").items():
        torch.testing.assert_close(values, weights[name] - 0.25)


def test_a_wider_network_begins_as_the_narrow_one() -> None:
    from training.denoise.model import FEATURES, DenoiseUpscale, TrunkConfig

    torch.manual_seed(1)
    narrow, wide = (DenoiseUpscale(TrunkConfig(widths)) for widths in ((8, 12), (12, 16, 8, 8)))
    for values in narrow.parameters():
        torch.nn.init.normal_(values, std=0.1)
    start = widen(narrow.state_dict(), wide.state_dict())
    wide.load_state_dict(start)
    features = torch.rand(1, FEATURES, 32, 32)
    with torch.no_grad():
        for few, many in zip(narrow.trunk(features), wide.trunk(features), strict=True):
            torch.testing.assert_close(few.expand_as(many), many)
        cut = DenoiseUpscale(TrunkConfig((12, 16)))
        cut.load_state_dict(keep_levels(start, 2))
        for few, many in zip(narrow.trunk(features), cut.trunk(features), strict=True):
            torch.testing.assert_close(few, many)
    with pytest.raises(ValueError, match="must be the wider one"):
        widen(start, narrow.state_dict())
    with pytest.raises(ValueError, match="the network has 4 levels"):
        keep_levels(start, 5)


def test_a_network_begins_to_trust_planes_unless_it_predicts_its_trust(tmp_path: Path) -> None:
    doubting, plain = models_dir() / "denoise_upscale.s.onnx", tmp_path / "plain.onnx"
    shutil.copy(doubting, plain)
    card = json.loads(doubting.with_suffix(".json").read_text(encoding="utf-8"))
    del card["config"]["trust"]
    plain.with_suffix(".json").write_text(json.dumps(card), encoding="utf-8")
    last = slice(-4, None)  # four phases of the last hidden channel
    assert load_weights(plain)["trunk.fine.weight"][last].any()
    begun = load_weights(plain, trust=True)
    assert (not begun["trunk.fine.weight"][last].any()
            and (begun["trunk.fine.bias"][last] == 2).all())
    for name, values in load_weights(doubting).items():
        assert torch.equal(load_weights(doubting, trust=True)[name], values)
