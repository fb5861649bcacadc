"""Recipes of the shipped models, and models that are made anew by them."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("PyOpenColorIO")

import OpenImageIO as oiio  # noqa: E402

from postfx.system import models_dir  # noqa: E402
from tests.training.denoise.test_train import write_clips  # noqa: E402
from training.remake import GIVEN, RecipeError, Step, chain, check, follow, main, shrink, steps_of  # noqa: E402

CARDS = sorted(models_dir().glob("*.json"))
PLACES = {"work": "WORK", "models": "MODELS", "gpus": "0", "variant": "llvm_ad_rgb",
          **{name: name for name in GIVEN}}


def test_every_shipped_model_has_a_recipe_that_its_commands_understand() -> None:
    assert ([card.with_suffix(".onnx") for card in CARDS] == sorted(models_dir().glob("*.onnx"))
            and CARDS)
    checked = set()
    for card in CARDS:
        for name, recipe in chain(card, models_dir()):
            for step in steps_of(name, recipe, PLACES):
                if step not in checked:
                    check(step)
                    check(shrink(step, 0.01))
                    checked.add(step)
            made = " ".join(step["run"] for step in recipe["steps"])
            assert "{models}" in made, f"{name}: nothing is written"
    assert len(checked) > 30


def test_weights_go_where_the_network_of_the_card_can_take_them() -> None:
    """Channels of the trainings are the card's, but for levels that were cut."""
    for card in CARDS:
        facts = json.loads(card.read_text())
        if "config" not in facts or "base" in facts["recipe"]:
            continue
        trainings = [step.words for step in steps_of(card.stem, facts["recipe"], PLACES)
                     if step.module == "training.denoise.train"]
        for words in trainings:
            args = importlib.import_module("training.denoise.train").parse(list(words))
            if args.picture or facts["config"].get("picture"):
                assert args.picture and facts["config"]["picture"]
                continue
            widths = facts["config"]["widths"]
            assert args.widths[:len(widths)] == widths and args.guides == facts["config"]["guides"]
            assert (args.stem, args.reach) == (facts["config"].get("stem"),
                                               facts["config"].get("reach", 4))


@pytest.mark.parametrize(("recipe", "said"), [
    ({"steps": []}, "'steps' is a list of objects"),
    ({"steps": [{"run": "training.denoise.train --clips a --out b --colour red"}]}, "--colour red"),
    ({"steps": [{"run": "training.denoise.nothing"}]}, "no such command"),
    ({"steps": [{"run": "training.denoise.fp16 a --models {scenes}"}]}, "give --scenes"),
    ({"steps": [{"run": "training.denoise.fp16 a --models {there}"}]},
     "nothing is known as {there}"),
    ({"steps": [{"run": "training.denoise.fp16 a"}], "seed": 1}, "'seed' is not one of"),
    ({"steps": [{"run": "training.denoise.fp16 a"}], "base": "x"}, "made from itself"),
    ([], "no recipe"),
])
def test_a_recipe_that_cannot_be_followed_is_refused(
    recipe: object, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.json").write_text(json.dumps({"recipe": recipe}))
    with pytest.raises(SystemExit):
        main([str(tmp_path / "x.json"), "--work", str(tmp_path)],
             run=lambda step: pytest.fail("nothing may run"))
    assert said in capsys.readouterr().err


def test_a_dry_run_shows_the_steps_and_what_is_not_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(models_dir() / "denoise_upscale.m.int8.json"), "--dry-run", "--work", str(tmp_path),
          "--scale", "0.01"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "# denoise_upscale.m" and "# denoise_upscale.m.int8" in lines
    assert sum(line.startswith("python -m training.denoise.train ") for line in lines) == 6
    assert "--minutes 0.22" in lines[2] and "--clips 10 --reference-spp 16" in lines[1]
    assert any(line.startswith("# not recorded: seeds") for line in lines)
    assert not list(tmp_path.iterdir())


def test_a_remake_goes_on_where_it_was_ended(tmp_path: Path) -> None:
    ran, record = [], tmp_path / "done.txt"
    steps = [Step("a", ("1",)), Step("b", ()), Step("c", (), 2)]

    def fail_once(step: Step) -> None:
        ran.append(step.module)
        if ran == ["a", "b"]:
            raise SystemExit(1)

    with pytest.raises(SystemExit):
        follow(steps, record, fail_once)
    follow(steps, record, fail_once)
    assert ran == ["a", "b", "b", "c"]
    assert str(steps[2]) == "python -m torch.distributed.run --standalone --nproc-per-node 2 -m c"
    with pytest.raises(RecipeError):
        check(steps[0])


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> object:
    """Runs a step in this process: a start of Python and PyTorch for each would take most of the
    time."""
    def run(step: Step) -> None:
        monkeypatch.setattr(sys, "argv", [step.module, *step.words])
        importlib.import_module(step.module).main()

    return run


def test_a_denoiser_is_made_anew(tmp_path: Path, here: object) -> None:
    """Two trainings, a mixture, export, cut and half precision, all of them small."""
    clips = tmp_path / "clips"
    clips.mkdir()
    write_clips(clips, 3)
    train = ("training.denoise.train --clips {clips.1} --steps 20 --crop 32 --widths 16 16 16 "
             "--depth 1 --wait 2")
    steps = [f"{train} --out {{work}}/1",
             f"{train} --out {{work}}/2 --start {{work}}/1/checkpoint.pt",
             "training.denoise.checkpoint mix {work}/1/checkpoint.pt:0.5 "
             "{work}/2/checkpoint.pt:0.5 -o {work}/mixed.pt",
             "training.denoise.export {work}/mixed.pt --tag tiny --models {models} --network-only",
             "training.denoise.prune levels denoise_upscale.tiny --clips {clips.1} --models "
             "{models}"]
    render = "training.datagen.render --out {clips.1} --clips 100 --real {scenes}"
    recipe = {"steps": [{"run": run} for run in (render, *steps)], "not recorded": ["the weather"]}
    small = {"base": "denoise_upscale.tiny",
             "steps": [{"run": "training.denoise.fp16 denoise_upscale.tiny --models {models}"}]}
    (tmp_path / "denoise_upscale.tiny.json").write_text(json.dumps(recipe))
    (tmp_path / "denoise_upscale.tiny.fp16.json").write_text(json.dumps(small))
    words = [str(tmp_path / "denoise_upscale.tiny.fp16.json"), "--work", str(tmp_path / "work"),
             "--clips", str(clips),
             "--scale", "0.1", "--with", "training.denoise.train", "--seed 3"]
    main(words, run=here)
    models = tmp_path / "work" / "models"
    card = json.loads((models / "denoise_upscale.tiny.json").read_text())
    assert card["recipe"] == recipe | {"scale": 0.1} and card["config"]["widths"][:2] == [16, 16]
    assert "mixed" not in card["training"] and card["training"]["weights"].startswith("0.5 ")
    assert json.loads((models / "denoise_upscale.tiny.fp16.json")
                      .read_text())["recipe"] == small | {"scale": 0.1}
    assert torch.load(tmp_path / "work/denoise_upscale.tiny/2/checkpoint.pt",
                      weights_only=True)["seed"] == 3
    main(words, run=lambda step: pytest.fail("all is done"))


def test_a_shipped_look_is_made_anew_in_small(tmp_path: Path, here: object,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    from training.tonemap import examples

    random = np.random.default_rng(0)
    for name in ("hdr/Bonita", "hdr/Desk", "env/pedestrian_overpass_1k", "env/other"):
        path = tmp_path / f"{name}.exr"
        path.parent.mkdir(exist_ok=True)
        light = np.exp2(random.normal(-2, 2, (6, 12, 1))) * random.uniform(0.2, 1, (6, 12, 3))
        assert oiio.ImageBuf(light.repeat(8, 0).repeat(8, 1).astype(np.float32)).write(str(path))
    monkeypatch.setattr(examples, "SHAPES", ((96, 144),))
    main([str(models_dir() / "tonemap.auto.json"), "--work", str(tmp_path / "work"), "--scale",
          "0.01", "--photos", str(tmp_path / "hdr/*.exr"), "--panoramas",
          str(tmp_path / "env/*.exr"), "--with", "training.tonemap.train", "--views 16"], run=here)
    card = json.loads((tmp_path / "work/models/tonemap.auto.json").read_text())
    assert card["recipe"]["scale"] == 0.01 and card["recipe"]["steps"] == chain(
        models_dir() / "tonemap.auto.json", models_dir())[0][1]["steps"]
    assert (card["training"]["runs"][0]["steps"] == 16
            and set(card["training"]["pictures"]) == {"Desk", "other"})
    assert (tmp_path / "work/models/tonemap.auto.onnx").stat().st_size > 10_000
