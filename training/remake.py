"""Make a shipped model again from the recipe in its card.

    python -m training.remake models/denoise_upscale.m.json --dry-run                 show the steps
    python -m training.remake models/denoise_upscale.m.json --scenes real --gpus 0,1  do them
    python -m training.remake models/tonemap.auto.json --photos 'hdr/*.exr' --panoramas 'env/*.hdr'
    python -m training.remake models/denoise_upscale.s.json --scale 0.01 --clips CLIPS    a trial

Results go to WORK/models and are not compared with anything: copy the ones that you want to ship.
An interrupted command continues at its step. A recipe may also be a file of its own, for a model
that does not exist yet.

The recipe is the object `recipe` of a card:

    base          name of the model that this one is made from; its recipe runs first. Optional.
    steps         a list of objects: `run`, a module of `training` and its arguments; `processes`,
                  if torchrun shares
                  the step between GPUs.
    differs       how the shipped weights were made differently. Optional.
    not recorded  facts of the shipped weights that nobody wrote down; the steps make a choice
                  instead.

Arguments may hold {models}, the folder of results; {work} and {base}, folders of this model's and
the base's runs; {clips.NAME}, folders of clips; and arguments of the command line: {scenes},
{blender}, {library}, {photos}, {panoramas}, {kinds}, {gpus}, {variant}.
"""

from __future__ import annotations

import argparse
import importlib
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Never

from training.export import MODELS, check_recipe, parser

ROOT = Path(__file__).resolve().parents[1]
GIVEN = {name: f"--{name}"
         for name in ("scenes", "blender", "library", "photos", "panoramas", "kinds")}
# Amounts that --scale changes, by module: option -> the least of it.
AMOUNTS: Mapping[str, Mapping[str, float]] = {
    "training.datagen.render": {"--clips": 10, "--reference-spp": 16, "--even-spp": 4,
                                "--half-samples": 16},
    "training.datagen.formula": {"--clips": 4},
    "training.denoise.train": {"--minutes": 0.02, "--batch": 1},
    "training.tonemap.train": {"--minutes": 0.02, "--batch": 1, "--scale": 0.1, "--views": 16},
    "training.tonemap.pictures": {"--side": 64},
}
MAKERS = "training.datagen.render", "training.datagen.formula"  # of clips


class RecipeError(ValueError):
    """A recipe that cannot be followed; the message names the file and the fix."""


@dataclass(frozen=True)
class Step:
    """A module of `training` and its arguments, which torchrun may share between processes."""

    module: str
    words: tuple[str, ...]
    processes: int = 1

    @property
    def command(self) -> list[str]:
        """Words behind `python -m`."""
        if self.processes == 1:
            return [self.module, *self.words]
        torchrun = ["torch.distributed.run", "--standalone", "--nproc-per-node",
                    str(self.processes), "-m"]
        return [*torchrun, self.module, *self.words]

    def __str__(self) -> str:
        return f"python -m {shlex.join(self.command)}"


# Recipes ------------------------------------------------------------------------------------------

def read_recipe(path: Path) -> dict[str, Any]:
    """The recipe of a card, or of a file of its own. Raises RecipeError."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        raise RecipeError(f"{path}: {fault}") from fault
    recipe = found.get("recipe", found) if isinstance(found, dict) else found
    wrong = check_recipe(recipe)
    if wrong:
        raise RecipeError(f"{path}: {wrong}")
    return recipe


def chain(path: Path, library: Path) -> list[tuple[str, dict[str, Any]]]:
    """Names and recipes of a model and of its bases, the first base first.

    Cards of bases lie beside the model's own, or in the library.
    """
    found = [(path.stem, read_recipe(path))]
    while base := found[0][1].get("base"):
        if base in [name for name, _ in found]:
            raise RecipeError(f"{path}: is made from itself, through {base}")
        card = path.with_name(f"{base}.json")
        found.insert(0, (base, read_recipe(card if card.exists() else library / card.name)))
    return found


def steps_of(name: str, recipe: Mapping[str, Any], places: Mapping[str, str],
             clips: Path | None = None) -> list[Step]:
    """The steps of a recipe with all folders filled in; with your own ``clips`` nothing is
    rendered."""
    own = dict(places) | {"work": f"{places['work']}/{name}",
                          "base": f"{places['work']}/{recipe.get('base')}"}

    def fill(match: re.Match[str]) -> str:
        key = match[1]
        if key.startswith("clips."):
            return str(clips or Path(places["work"]) / key)
        if key not in own:
            raise RecipeError(f"{name}: its recipe needs {{{key}}}: give {GIVEN[key]}"
                              if key in GIVEN else
                              f"{name}: nothing is known as {{{key}}}: see training.remake --help")
        return own[key]

    steps = []
    for step in recipe["steps"]:
        module, *words = shlex.split(step["run"])
        if not (clips and module in MAKERS):
            filled = tuple(re.sub(r"\{([\w.]+)\}", fill, word) for word in words)
            steps.append(Step(module, filled, step.get("processes", 1)))
    return steps


def shrink(step: Step, scale: float) -> Step:
    """The step with smaller amounts of everything that takes time; defaults are scaled, too."""
    if scale >= 1 or step.module not in AMOUNTS:
        return step
    words, defaults = list(step.words), vars(options_of(step.module).parse_args(list(step.words)))
    for option, least in AMOUNTS[step.module].items():
        value = defaults.get(option.lstrip("-").replace("-", "_"))
        if value is not None:
            less = max(scale * value, least)
            words += [option, str(round(less) if isinstance(value, int) else less)]
    return Step(step.module, tuple(words))  # one process: a small step gains nothing by more


def options_of(module: str) -> argparse.ArgumentParser:
    """The parser of a module's command."""
    if module == "training.denoise.export":
        return parser(None, "m")
    return importlib.import_module(module).options()


def check(step: Step) -> None:
    """Check a step against its module's current parser. Raises RecipeError if it does not take
    these arguments."""
    try:
        made = options_of(step.module)
    except (ImportError, AttributeError) as fault:
        raise RecipeError(f"{step}: no such command: {fault}") from fault

    def refuse(message: str) -> Never:
        raise RecipeError(f"{step}: {message}")

    for one in parsers(made):
        one.error = refuse  # type: ignore[method-assign]
    made.parse_args(list(step.words))


def parsers(made: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """A parser and those of its commands."""
    commands = [action
                for action in made._actions if isinstance(action, argparse._SubParsersAction)]
    return [made, *(one for action in commands for one in action.choices.values())]


# Running them -------------------------------------------------------------------------------------

def run_step(step: Step) -> None:
    """Run a step in its own process; ends the program with its status if it fails."""
    done = subprocess.run([sys.executable, "-m", *step.command], cwd=ROOT, check=False)
    if done.returncode:
        raise SystemExit(f"training.remake: {step} ended with status {done.returncode}: start the "
                         "same command again")


def follow(steps: Sequence[Step], record: Path, run: Callable[[Step], None] = run_step) -> None:
    """Run steps that the record does not have yet, and record each finished one."""
    done = record.read_text(encoding="utf-8").splitlines() if record.exists() else []
    for number, step in enumerate(steps, 1):
        already = str(step) in done
        print(f"[{number}/{len(steps)}] {step}{' - done before' if already else ''}", flush=True)
        if not already:
            run(step)
            with record.open("a", encoding="utf-8") as file:
                file.write(f"{step}\n")


def add_recipe(card: Path, recipe: Mapping[str, Any], scale: float) -> None:
    """Write a recipe into a new model's card, with the scale if it is not 1."""
    facts = json.loads(card.read_text(encoding="utf-8"))
    facts["recipe"] = dict(recipe) | ({"scale": scale} if scale < 1 else {})
    card.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")


def options() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__,
                                   formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("card", type=Path, help="card of a model, or a JSON file of a recipe alone")
    made.add_argument("--dry-run", action="store_true",
                      help="only show the steps, and what is not recorded")
    made.add_argument("--work", type=Path, default=Path("runs/remake"),
                      help="folder of all results (%(default)s)")
    made.add_argument("--scale", type=float, default=1.0,
                      help="factor on clips, samples, minutes: 0.01 for a trial")
    made.add_argument("--clips", type=Path, help="train on these clips; nothing is rendered")
    made.add_argument("--scenes",
                      help="folder of real scenes and environments, from "
                      "training/datagen/pack_scenes.sh")
    made.add_argument("--blender", help="a Python with the module bpy, which renders with Cycles")
    made.add_argument("--library",
                      help="folder of scenes and environments for Cycles, see "
                      "docs/lab/training_data.md")
    made.add_argument("--photos", help="HDR photographs (a pattern)")
    made.add_argument("--kinds", help="folder of validation kinds with two references, which "
                      "training/measure/validation/render_scenes.py makes")
    made.add_argument("--panoramas", help="equirectangular HDR environments (a pattern)")
    made.add_argument("--gpus", default="0",
                      help="numbers of the GPUs that render, separated by commas")
    made.add_argument("--variant", default="cuda_ad_rgb",
                      help="Mitsuba variant; llvm_ad_rgb renders on the CPU")
    made.add_argument("--with", nargs=2, action="append", default=[], dest="more",
                      metavar=("MODULE", "OPTIONS"),
                      help="further options of all steps of a module, as --with "
                      "training.denoise.train '--seed 2'")
    return made


def main(argv: Sequence[str] | None = None, run: Callable[[Step], None] = run_step) -> None:
    made = options()
    args = made.parse_args(argv)
    work = args.work.resolve()
    places = {"work": str(work), "models": str(work / "models"), "gpus": args.gpus,
              "variant": args.variant}
    given = {name: getattr(args, name) or (name.upper() if args.dry_run else None)
             for name in GIVEN}
    places |= {name: str(value) for name, value in given.items() if value}
    try:
        recipes = chain(args.card, MODELS)
        steps = [(name, recipe,
                  [complete(step, args) for step in steps_of(name, recipe, places, args.clips)])
                 for name, recipe in recipes]
        for _, _, some in steps:
            for step in some:
                check(step)
    except RecipeError as fault:
        made.error(str(fault))
    if args.dry_run:
        for name, recipe, some in steps:
            print(f"# {name}", *some, sep="\n")
            for key in ("differs", "not recorded"):
                for line in recipe.get(key, []):
                    print(f"# {key}: {line}")
        return
    (work / "models").mkdir(parents=True, exist_ok=True)
    for name, recipe, some in steps:
        (work / name).mkdir(exist_ok=True)
        print(f"{name}: {len(some)} steps", flush=True)
        follow(some, work / "done.txt", run)
        add_recipe(work / "models" / f"{name}.json", recipe, args.scale)
        print(f"{work / 'models' / name}.onnx is made", flush=True)


def complete(step: Step, args: argparse.Namespace) -> Step:
    """A step with the options of --with, scaled by --scale."""
    more = [word for module, words in args.more if module == step.module
            for word in shlex.split(words)]
    return shrink(Step(step.module, (*step.words, *more), step.processes), args.scale)


if __name__ == "__main__":
    main()
