"""Files that version 0.1.0 wrote are read by this one, and what this one writes has the formats
that 0.1.0 reads. `make_version_before` made the samples, and runs 0.1.0 over files of this one."""

import json
import math
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from postfx import DenoiseUpscale, Device, Pipeline, read_sequence
from postfx.cli.main import main
from postfx.exposure import ExposureMeter
from postfx.frame import Role
from postfx.runs.folder import load_checkpoint, read_about
from postfx.runs.manifest import MANIFEST_NAME, load_manifest
from postfx.runtime import Library
from postfx.tools.report.capture_data import compare
from postfx.tools.report.capture_data import read as read_capture
from tests.files.exr_files import headers_of

SAMPLES = Path(__file__).parent / "version_before"
SECONDS_SILENT = 3600
"""How long ago the killed run of the samples gave its last sign of life."""
RUN = ("in/shot.####.exr", "-o", "run/shot.####.exr", "--exposure", "metadata", "--model", "s",
       "--scale", "1", "--device", "cpu", "--checkpoint", "0")
"""What the killed run of the samples was given."""


CAPTURE = ("in/shot.0001.exr", "-o", "shown/shot.####.png", "--exposure", "metadata",
           "--no-denoise", "--no-tonemap", "--display", "srgb", "--device", "cpu", "--capture",
           "now", "--capture-tensors", "all")
"""What makes the capture of the samples."""


@pytest.fixture
def before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The samples in a folder of the test's own, as old as they were where they were made."""
    shutil.copytree(SAMPLES, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    for output in load_manifest(tmp_path / "run").outputs.values():
        for path, (_, changed) in output.inputs.items():
            os.utime(path, ns=(changed, changed))
    silent = time.time() - SECONDS_SILENT
    for path in Path("run/.postfx").iterdir():
        os.utime(path, (silent, silent))
    return tmp_path


def fail_after_two(capsys: pytest.CaptureFixture[str]) -> None:
    """A run of this version that ends at a third frame which cannot be read."""
    shutil.rmtree("run")
    whole = Path("in/shot.0003.exr").read_bytes()
    Path("in/shot.0003.exr").write_bytes(whole[:300])
    assert main(["run", *RUN]) == 2
    Path("in/shot.0003.exr").write_bytes(whole)
    capsys.readouterr()


def keys_of(facts: object) -> object:
    """The keys of nested dictionaries; those of a list are its first entry's."""
    if isinstance(facts, dict):
        return {key: keys_of(value) for key, value in facts.items()}
    return keys_of(facts[0]) if isinstance(facts, list) and facts else None


def test_headers_of_the_version_before_are_read(before: Path) -> None:
    (frame,) = read_sequence("run/shot.0001.exr")
    assert frame.exposure == 1.0  # a factor of 2 there
    assert frame.fov_x == pytest.approx(40)
    assert frame.metadata["postfx:version"] == "0.1.0"
    (written,) = read_sequence("in/shot.0001.exr")
    assert written.samples == 1


def test_exposure_that_a_run_used(before: Path) -> None:
    """The header of the author may be lost on the way; the factor that the run used tells it."""
    (frame,) = read_sequence("run/shot.0001.exr")
    assert frame.metadata["postfx:exposureUsed"] == 2.0
    frame.exposure = None
    assert ExposureMeter("metadata")(frame) == 2.0


def test_a_manifest_of_the_version_before_is_verified(before: Path,
                                                      capsys: pytest.CaptureFixture[str]) -> None:
    manifest = load_manifest(before / "run")
    (run,) = manifest.runs.values()
    assert run["versions"]["postfx"] == "0.1.0" and len(run["fingerprint"]) == 64
    assert main(["verify", "run", "--json"]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert [facts[name] for name in ("whole", "altered", "missing", "unfinished")] == [
        ["shot.0001.exr", "shot.0002.exr"], [], [], ["shot.0003.exr"]]


def test_checkpoint(before: Path) -> None:
    (path,) = Path("run/.postfx").glob("*.checkpoint")
    about = read_about(path)
    assert (about.pattern, about.frame) == ("shot.####.exr", 2)
    (run,) = load_manifest(before / "run").runs.values()
    assert about.fingerprint == run["fingerprint"]
    history = load_checkpoint(path)
    assert history and all(np.isfinite(array).all() for array in history.values())


def test_a_killed_run_is_finished(before: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its frames are kept, its checkpoint is of other networks and not used, and its books go."""
    kept = {name: Path("run", name).read_bytes() for name in ("shot.0001.exr", "shot.0002.exr")}
    assert main(["run", *RUN, "--skip-existing", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert any("made with other settings, models or versions: frames 1-2" in text
               for text in told["warnings"])
    assert {name: Path("run", name).read_bytes() for name in kept} == kept
    assert not Path("run/.postfx").exists()
    assert main(["verify", "run"]) == 0
    (frame,) = read_sequence("run/shot.0003.exr")
    assert frame.exposure == 1.0 and math.isfinite(frame[Role.COLOUR].sum())


def test_a_capture_of_the_version_before_is_compared(before: Path,
                                                     capsys: pytest.CaptureFixture[str]) -> None:
    """It is read, and what this version captures in its place is the same to rounding."""
    assert read_capture("capture")[0]["postfx"] == "0.1.0"
    assert compare("capture", "capture", tolerance=0.0).first is None
    assert main(["run", *CAPTURE]) == 0
    capsys.readouterr()
    assert main(["capture-compare", "capture", "now"]) == 0


def test_a_network_of_the_version_before_runs(before: Path) -> None:
    """A denoiser that another version exported runs by its card, which lacks newer entries."""
    card = Library(before).card("denoise_upscale.tiny")
    assert card["config"]["widths"] == [8]
    denoise = DenoiseUpscale(scale=1.0, model=str(before / "denoise_upscale.tiny.onnx"))
    pipeline = Pipeline([denoise], Device("cpu"))
    for frame in read_sequence("in/shot.####.exr"):
        noisy = frame[Role.COLOUR].copy()
        clean = pipeline(frame)[Role.COLOUR]
        assert np.isfinite(clean).all() and clean.std() < noisy.std()


def test_books_have_the_formats_of_the_version_before(before: Path,
                                                      capsys: pytest.CaptureFixture[str]) -> None:
    """It refuses other formats and other keys of a file's entry, and reads no other arrays."""
    old = json.loads(Path("run", MANIFEST_NAME).read_text())
    (old_path,) = Path("run/.postfx").glob("*.checkpoint")
    old_lines = old_path.read_bytes().split(b"\n", 2)
    fail_after_two(capsys)
    new = json.loads(Path("run", MANIFEST_NAME).read_text())
    assert (new["format"], new["version"]) == (old["format"], old["version"])
    assert keys_of(new["outputs"]).keys() == keys_of(old["outputs"]).keys()
    assert all(keys_of(new["outputs"][name]) == keys_of(facts)
               for name, facts in old["outputs"].items())
    (new_run,), (old_run,) = new["runs"].values(), old["runs"].values()
    assert new_run.keys() >= old_run.keys() - {"models"}
    (path,) = Path("run/.postfx").glob("*.checkpoint")
    lines = path.read_bytes().split(b"\n", 2)
    assert lines[0] == old_lines[0]
    new_about, old_about = json.loads(lines[1]), json.loads(old_lines[1])
    assert new_about.keys() == old_about.keys()
    assert {kind for _, kind, _ in new_about["arrays"]} <= {"float32", "float64", "int64"}


def test_a_capture_has_the_format_of_the_version_before(
        before: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *CAPTURE]) == 0
    old, new = (json.loads(Path(name, "capture.json").read_text()) for name in ("capture", "now"))
    assert new["format"] == old["format"] and new.keys() >= old.keys()
    for key in ("buffers", "commands"):
        assert new[key][0].keys() >= old[key][0].keys()
    for key in ("reads", "writes"):
        assert new["commands"][0][key][0].keys() >= old["commands"][0][key][0].keys()


def test_headers_hold_the_attributes_of_the_version_before(before: Path) -> None:
    """The exposure is in stops here, which that version did not know: it keeps the author's."""
    old = headers_of(Path("run/shot.0001.exr"))[""]
    assert main(["run", *RUN, "--overwrite"]) == 0
    new = headers_of(Path("run/shot.0001.exr"))[""]
    lost = set(old) - set(new)
    assert lost == {"postfx:exposureUsed"}
    assert new["postfx:exposure"] == old["postfx:exposure"]
