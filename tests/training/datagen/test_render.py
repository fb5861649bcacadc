"""Rendering spread over workers: all clips are made, what dies or hangs is left out, and the job
can go on later."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.training.llvm import require_llvm
from training.datagen.render import Farm, arguments

STUB = """
import json, os, sys, time
folder, bad = sys.argv[1], sys.argv[2]
if bad == "start":
    sys.exit(3)
print(json.dumps({"ready": True}), flush=True)
for line in sys.stdin:
    if line.strip() == "2" and bad == "die":
        open(f"{folder}/.clip.00002.npz.{os.getpid()}.partial.npz", "w").close()
        os._exit(5)
    if line.strip() == "2" and bad == "hang":
        time.sleep(60)
    open(f"{folder}/clip.{int(line):05d}.npz", "w").write(os.environ["CUDA_VISIBLE_DEVICES"])
    if bad == "mute":
        time.sleep(60)
    print(json.dumps({"clip": int(line), "samples": 10}), flush=True)
"""


def farm(folder: Path, bad: str, *options: str) -> Farm:
    args, _ = arguments([f"--out={folder}", "--clips=6", "--gpus=0,3", "--processes-per-gpu=1",
                         *options])
    return Farm(args, [sys.executable, "-c", STUB, str(folder), bad])


def made(folder: Path) -> list[int]:
    return sorted(int(path.name.split(".")[1]) for path in folder.glob("clip.*.npz"))


def test_every_clip_is_made_once_and_gpus_share(tmp_path: Path) -> None:
    (tmp_path / "clip.00004.npz").write_text("old")
    job = farm(tmp_path, "none")
    assert job.run() and (job.there, job.made, job.samples, job.lost) == (1, 5, 50, 0)
    assert (made(tmp_path) == [0, 1, 2, 3, 4, 5]
            and (tmp_path / "clip.00004.npz").read_text() == "old")
    assert {(tmp_path / f"clip.0000{k}.npz").read_text() for k in (0, 1)} == {"0", "3"}
    assert "made 5 clips" in job.summary() and "6 of 6" in job.summary()


@pytest.mark.parametrize("bad", ["die", "hang"])
def test_a_clip_that_kills_its_worker_is_left_out(tmp_path: Path, bad: str) -> None:
    job = farm(tmp_path, bad, "--clip-minutes=0.03")
    assert job.run() and (job.made, job.lost) == (5, 1)
    assert made(tmp_path) == [0, 1, 3, 4, 5]
    assert (tmp_path / "failed.txt").read_text().startswith("2 ")
    assert not list(tmp_path.glob(".*partial*"))
    again = farm(tmp_path, bad)
    assert again.run() and again.made == 0


def test_workers_that_cannot_start_end_the_job(tmp_path: Path) -> None:
    job = farm(tmp_path, "start")
    assert not job.run() and job.made == 0
    assert not (tmp_path / "failed.txt").exists()


def test_no_clip_is_begun_after_the_time(tmp_path: Path) -> None:
    assert farm(tmp_path, "none", "--minutes=0").run() and made(tmp_path) == []


def test_a_clip_counts_that_its_worker_had_not_told_of_at_the_end(tmp_path: Path) -> None:
    job = farm(tmp_path, "mute")

    def stop_when_there() -> None:
        while len(made(tmp_path)) < 2:
            time.sleep(0.01)
        job.stop()

    threading.Thread(target=stop_when_there).start()
    assert job.run() and job.made == 2 and "2 of 6" in job.summary()


def test_a_real_job_at_toy_size_ends_on_sigterm_and_goes_on(tmp_path: Path) -> None:
    require_llvm()
    command = [sys.executable, "-m", "training.datagen.render", f"--out={tmp_path}",
               "--processes-per-gpu=1", "--width=16", "--height=16", "--frames=1", "--variants=1",
               "--reference-spp=4", "--variant=llvm_ad_rgb"]
    first = subprocess.Popen([*command, "--clips=500"], stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not made(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.2)
    first.send_signal(signal.SIGTERM)
    said, _ = first.communicate(timeout=300)
    there = made(tmp_path)
    assert first.returncode == 0 and 0 < len(there) < 500 and f"{len(there)} of 500" in said
    assert not list(tmp_path.glob(".*partial*"))
    wanted = max(there) + 2
    done = subprocess.run([*command, f"--clips={wanted}"], stdout=subprocess.PIPE, text=True,
                          timeout=300)
    assert (done.returncode == 0 and f"{wanted} of "
            f"{wanted}" in done.stdout and made(tmp_path) == list(range(wanted)))
