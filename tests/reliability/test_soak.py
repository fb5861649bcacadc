"""Many frames, a slow disk, reads that fail, a worker that is killed again and again: every frame
comes out right."""

import random
import signal
from pathlib import Path

import pytest

from tests.reliability.conftest import Runs, write_frame
from tests.reliability.faulty import WRITE

PASSES = ("--model", "s", "--scale", "1.5", "--tonemap", "--threads", "1")
READ = "postfx.io.sequence.Sequence.read"
NETWORK = "postfx.flow.Flow._run"
PLACES = (WRITE, NETWORK, "postfx.io.writer.write_exr")
RARE = ("postfx.runs.folder.save_checkpoint", "postfx.runs.manifest.write_atomically")
"""Called once a second or so."""


def soak(folder: Path, frames: int, kills: int, capsys) -> None:
    """Runs `frames` frames with faults, killed `kills` times, and compares with an undisturbed
    run."""
    (folder / "in").mkdir()
    for number in range(1, frames + 1):
        write_frame(folder / f"in/in.{number:04d}.exr", number % 16 + 1, reset=number % 150 == 0)
    whole = Runs(str(folder / "in/in.####.exr"), folder / "whole", capsys)
    assert whole(passes=PASSES)[0] == 0
    broken = Runs(whole.shot, folder / "broken", capsys)
    chance = random.Random(frames)
    code, killed, rounds = -signal.SIGKILL, 0, 0
    while code:
        rounds += 1
        faults = [{"at": READ, "do": "fail",
                   "calls": chance.sample(range(1, frames), frames // 20)},
                  {"at": WRITE, "do": "sleep", "seconds": 0.05,
                   "calls": chance.sample(range(1, frames), frames // 20)}]
        if killed < kills:
            at = chance.choice(PLACES + RARE)
            call = chance.randint(1, 3 if at in RARE else frames // kills)
            faults.append({"at": at, "do": "kill", "calls": [call],
                           "when": chance.choice(("before", "after"))})
        code, said = broken.fail(*faults, passes=PASSES,
                                 more=("--skip-existing", "--checkpoint", "0.5"))
        assert code in (0, 2, -signal.SIGKILL), said
        assert code != 2 or "a read that failed for once" in said, said
        killed += code == -signal.SIGKILL
        assert rounds < 4 * kills + 10
    assert broken.files() == whole.files() and len(whole.files()) == frames
    assert broken.verify()[0] == 0
    assert killed == kills and len(broken.events("retry")) >= frames // 40
    (manifest,) = broken.folder.glob("*.json*")
    assert sorted(path.name for path in broken.folder.iterdir()) == sorted([*whole.files(),
                                                                            manifest.name])


def test_soak_of_100_frames(tmp_path, capsys):
    soak(tmp_path, frames=100, kills=4, capsys=capsys)


@pytest.mark.soak
def test_soak_of_1000_frames(tmp_path, capsys):
    soak(tmp_path, frames=1000, kills=12, capsys=capsys)
