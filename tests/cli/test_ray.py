"""`postfx run --ray`: the chunks of `postfx chunks` on machines of a Ray cluster, of which one
dies."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import threading
import time
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from postfx.cli.chunks import ChunkActor, _connect, _share_of_machine
from postfx.errors import FarmError
from postfx.io.sequence import Sequence
from postfx.runs.locks import Claim
from postfx.version import __version__, pip_install

RUN = ("--scale", "1", "--model", "s", "--threads", "1")
IMPATIENT = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 300,
             "health_check_failure_threshold": 2}
"""Ray gives a machine up after a second; by default it waits for 15."""

SIZE = (128, 192)
"""Of frames, 20 of which take longer than a process takes to notice that its machine died."""


@pytest.fixture
def here(monkeypatch) -> None:
    """Puts the folder and the command line of this process back, which an actor changes."""
    monkeypatch.setattr(sys, "argv", sys.argv)
    monkeypatch.chdir(os.getcwd())


@pytest.mark.parametrize(("words", "message"), [
    (("--ray", "auto", "--json"),
     "--ray has other machines run the sequence, in chunks: leave --json"),
    (("--ray", "auto,size=0"), "'0' is not a whole number from 1"),
    (("--ray", "auto,5"), "'auto,5' is not an address, with ,size=N"),
    (("--ray", "127.0.0.1:1"),
     "error: --ray 127.0.0.1:1: cannot be reached: Connection refused: give the address"),
])
def test_what_cannot_be_handed_out_is_said_in_a_line(postfx, noise, monkeypatch, words, message):
    monkeypatch.setitem(sys.modules, "ray", ModuleType("ray"))  # it is not asked
    done = postfx("run", "in/", "-o", "out/", *words)
    assert done.code == 2 and message in done.err and "Traceback" not in done.err


def test_without_ray(postfx, noise, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    done = postfx("run", "in/", "-o", "out/", "--ray", "auto")
    assert (done.code, done.err) == (
        2, f"error: --ray needs Ray, which is not installed here: {pip_install('ray')}\n")


def test_ray_is_given_the_address_and_what_it_answers_is_said(monkeypatch):
    asked = []

    def init(address, **_):
        asked.append(address)
        raise ConnectionError("no cluster runs here\nand much more")

    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(init=init))
    with pytest.raises(FarmError,
                       match="--ray local: cannot be reached: no cluster runs here: give the "
                       "address"):
        _connect("local")
    assert asked == ["local"]


def test_an_actor_says_what_its_machine_lacks(tmp_path):
    with pytest.raises(FarmError, match="has postfx .*, not 9.9: install the same everywhere"):
        ChunkActor().run(str(tmp_path), "9.9", [])
    with pytest.raises(FarmError, match="no folder /nowhere: frames must be at the same place"):
        ChunkActor().run("/nowhere", __version__, [])


def test_an_actor_waits_for_files_of_a_process_that_may_be_dead(here, noise, monkeypatch):
    monkeypatch.setattr("postfx.cli.chunks.CLAIM_PAUSE_SECONDS", 0.05)
    work = noise / "out/.postfx"
    work.mkdir(parents=True)
    claim = Claim(work, "dying", ["shot.0002.exr"])
    ending = threading.Timer(0.5, claim.release)
    begin = time.monotonic()
    ending.start()
    words = ["postfx", "run", "in/shot.####.exr", "-o", "out/", "--no-denoise", "--ray", "auto",
             "--frames=1-3"]
    _, _, faults = ChunkActor().run(str(noise), __version__, words)
    assert time.monotonic() - begin >= 0.5 and not faults
    assert len(list((noise / "out").glob("shot.*.exr"))) == 3


@pytest.mark.parametrize(("machines", "device", "share"), [
    ([{"CPU": 16.0}, {"CPU": 8.0}, {"node:x": 1.0}], "auto", {"num_cpus": 8, "num_gpus": 0}),
    ([{"CPU": 4.0}, {"CPU": 64.0, "GPU": 8.0}], "auto", {"num_cpus": 8, "num_gpus": 1}),
    ([{"CPU": 4.0}, {"CPU": 64.0, "GPU": 8.0}], "cpu", {"num_cpus": 4, "num_gpus": 0}),
])
def test_every_machine_that_fits_can_take_a_chunk(machines, device, share):
    nodes = [{"Alive": True, "Resources": each} for each in machines]
    ray = SimpleNamespace(nodes=lambda: [*nodes, {"Alive": False, "Resources": {"CPU": 1.0}}])
    assert _share_of_machine(ray, "auto", SimpleNamespace(device=device)) == share


def test_two_machines_of_which_one_dies(postfx, write_exr, tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_AUTH_MODE", "token")  # it runs whatever anyone sends to its ports
    monkeypatch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
    pytest.importorskip("ray", reason="Ray is no part of the extra 'dev': pip install '.[ray]'")
    from ray.cluster_utils import Cluster

    rng = np.random.default_rng(8)
    for number in range(1, 41):
        planes = {name: rng.exponential(size=SIZE) for name in "RGB"}
        planes |= {"depth.Z": np.full(SIZE, 3.0), "motion.X": np.zeros(SIZE),
                   "motion.Y": np.zeros(SIZE)}
        write_exr(f"in/shot.{number:04d}.exr", planes)
    cluster = Cluster(initialize_head=True, head_node_args={
        "num_cpus": 1, "include_dashboard": False, "_system_config": IMPATIENT})
    try:
        machine = cluster.add_node(num_cpus=1)
        words = ["run", "in/shot.####.exr", "-o", "parts/a.####.exr", *RUN, "--ray",
                 f"{cluster.address},size=20"]
        run = subprocess.Popen([sys.executable, "-m", "postfx", *words], cwd=tmp_path, text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        firsts = [tmp_path / f"parts/a.{number:04d}.exr" for number in (1, 21)]
        while run.poll() is None and not all(path.exists() for path in firsts):
            time.sleep(0.02)
        cluster.remove_node(machine, allow_graceful=False)
        written = len(list((tmp_path / "parts").glob("a.*.exr")))
        out, err = run.communicate(timeout=120)
    finally:
        cluster.shutdown()
    assert run.returncode == 0, out + err
    assert (written < 40 and "was killed" in out and "40 whole, 0 altered, 0 missing, 0 "
            "unfinished" in out)
    assert postfx("run", "in/shot.####.exr", "-o", "one/a.####.exr", *RUN).code == 0
    for path in sorted((tmp_path / "one").glob("*.exr")):
        one, other = Sequence(path), Sequence(tmp_path / "parts" / path.name)
        assert (one.read(one.numbers[0])["colour"]
                == other.read(one.numbers[0])["colour"]).all(), path.name
