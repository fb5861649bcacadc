"""Help, completion and the man page: all from the one place where options are declared."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from postfx.cli.main import SHELLS, VERBS, main, make_parser
from postfx.cli.options import Options
from postfx.cli.run_options import PRESETS, RUN

ROOT = Path(__file__).resolve().parents[2]
FEW = {"--output", "--frames", "--preset", "--scale", "--denoise-only", "--model", "--both-ways",
       "--tonemap", "--exposure", "--overwrite", "--skip-existing", "--dry-run"}


def shown(*words: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    return capsys.readouterr().out


def flags(text: str) -> set[str]:
    """Options that a help lists, without those of its examples."""
    return set(re.findall(r"^  (?:-\w(?: \w+)?, )?(--[\w-]+)", text, re.MULTILINE))


def test_help_shows_the_twelve_options_that_people_need(capsys):
    help = shown("run", "--help", capsys=capsys)
    assert flags(help) - {"--help", "--help-all"} == FEW and len(FEW) == 12
    assert "postfx run --help-all" in help and "ffmpeg" in help
    assert len(help.splitlines()) < 70


def test_help_all_shows_every_option_in_its_group(capsys):
    help = shown("run", "--help-all", capsys=capsys)
    assert flags(help) - {"--help", "--help-all"} == {option.flag
                                                      for option in RUN if option.flag != "input"}
    places = [help.index(f"\n{section.title}:\n") for section in RUN.sections]
    assert places == sorted(places) and all(len(section.options) <= 14 for section in RUN.sections)


def test_presets_set_options_that_there_are():
    names = {option.name for option in RUN}
    assert set(RUN["--preset"].choices) == set(PRESETS)
    for values in PRESETS.values():
        assert set(values) <= names
    for name, values in PRESETS.items():
        for option, value in values.items():  # what the help says in words
            told = RUN["--preset"].help.split(f"{name}: ")[1].split(";")[0]
            flag = "--" + option.replace("_", "-")
            assert f"{flag} {value}" in told or (value is True and flag in told)


@pytest.mark.parametrize("shell", SHELLS)
def test_shells_are_told_how_to_complete(shell, capsys):
    assert "postfx" in shown("--completion", shell, capsys=capsys)


@pytest.mark.parametrize(("line", "expected"), [
    ("postfx run --dry", "--dry-run"), ("postfx ch", "chunks"),
    ("postfx run --preset an", "animation"), ("postfx verify --fr", "--frames"),
])
def test_lines_are_completed(line, expected, tmp_path):
    answer = tmp_path / "answer"
    environment = {**os.environ, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
                   "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n"}
    subprocess.run([sys.executable, "-m", "postfx"], env=environment, check=True)
    assert expected in answer.read_text().split()


def test_the_man_page_holds_every_verb_and_option(tmp_path):
    page = tmp_path / "postfx.1"
    subprocess.run([sys.executable, "-S", str(ROOT / "hatch_build.py"), str(page)], check=True)
    text = page.read_text().replace("\\-", "-")  # -S: an isolated build has no packages
    assert all(f".SH POSTFX {verb.upper()}\n" in text for verb in VERBS)
    assert all(re.search(rf"^\.B .*{option.flag}\b", text, re.MULTILINE)
               for option in RUN if option.flag != "input")
    if shutil.which("groff"):
        done = subprocess.run(["groff", "-man", "-ww", "-z", str(page)], capture_output=True,
                              text=True)
        assert (done.returncode, done.stderr) == (0, "")


def test_the_readme_of_the_package_index_names_no_file_beside_it():
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(build)
    text, address = (ROOT / "README.md").read_text("utf-8"), "https://example.org/owner/postfx"
    plain = build.readme_of_the_index(text)
    linked = build.readme_of_the_index(text, address + "/", "1.2.3")
    assert "](" not in plain and "[Start]" not in plain and "Start: Blender" in plain
    found = re.findall(r"(!?)\[[^\]]*\]\(([^)]+)\)", linked)
    assert len(found) == len(re.findall(r"\]\(", text)) > 20
    for mark, target in found:
        folder = f"{address}/{'raw' if mark else 'blob'}/v1.2.3/"
        assert (target.startswith(folder)
                and (ROOT / target.removeprefix(folder).partition("#")[0]).exists())


def test_every_verb_declares_its_options_for_help():
    """What is in no help is in no completion and no man page either."""
    parser = make_parser()
    assert isinstance(RUN, Options) and importlib.util.find_spec("argcomplete")
    (verbs,) = (action.choices
                for action in parser._actions if action.dest == "==SUPPRESS==" and action.choices)
    for name, verb in verbs.items():
        for action in verb._actions:
            assert action.help, (name, action.dest)
