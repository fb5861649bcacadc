"""Makes the files of an earlier version that `test_version_before` reads, and has that version read
those of this one.

    git worktree add BEFORE d00620bc^
    python -m venv VENV
    VENV/bin/pip install numpy onnxruntime OpenImageIO fileseq rich numba isal torch onnxscript
    PYTHONPATH=BEFORE VENV/bin/python tests/files/make_version_before.py samples FOLDER
    PYTHONPATH=BEFORE VENV/bin/python tests/files/make_version_before.py network FOLDER

    PYTHONPATH=. python tests/files/make_version_before.py samples OTHER
    PYTHONPATH=BEFORE VENV/bin/python tests/files/make_version_before.py reads OTHER

This file imports nothing of this version: postfx is what PYTHONPATH says.

`samples` renders nothing: `FOLDER/in` gets three tiny noisy frames, `FOLDER/run` a run over them
that was killed after its second frame, with its manifest, claim and checkpoint, and
`FOLDER/capture` the capture of an encoding for displays. `network` writes a denoiser of a few
thousand weights that were never trained, with its card.

`reads` takes what `samples` of another version made: it finishes the run, checks all files by the
manifest, tone-maps them by the exposure in their headers, and compares the capture with itself. It
ends with 0 if that went well.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

FRAMES = 3
HEIGHT, WIDTH = 12, 16
FACTOR = 2.0
"""The frames' exposure, as that version has it in headers."""
HOST = "farm-07"
"""Stands for the machine that the run was killed on."""
SECONDS_SILENT = 3600
"""Age of a killed run's claim, which counts as alive for some minutes on another machine."""
RUN = ("in/shot.####.exr", "-o", "run/shot.####.exr", "--exposure", "metadata", "--model", "s",
       "--scale", "1", "--device", "cpu", "--checkpoint", "0")
AGAIN = ("-o", "again/shot.####.png", "--no-denoise", "--exposure", "metadata", "--overwrite")
"""Takes the light and the exposure of frames that were written before."""
CAPTURE = ("in/shot.0001.exr", "-o", "shown/shot.####.png", "--exposure", "metadata",
           "--no-denoise", "--no-tonemap", "--display", "srgb", "--device", "cpu", "--capture",
           "capture", "--capture-tensors", "all")
KILLED = """
import os, signal
from postfx.runs import folder
saved, save = [], folder.save_checkpoint
def kill(*arguments, **named):
    size = save(*arguments, **named)
    saved.append(size)
    if len(saved) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return size
folder.save_checkpoint = kill
from postfx.cli.main import main
main()
"""


def write_input(path: Path, number: int) -> None:
    """One frame: colour of one sample a pixel, albedo, and motion to the right."""
    random = np.random.default_rng(number)
    albedo = np.full((HEIGHT, WIDTH, 3), (0.8, 0.5, 0.3))
    colour = albedo * random.gamma(2, 0.5, (HEIGHT, WIDTH, 3))
    motion = np.dstack([np.full((HEIGHT, WIDTH), -1.0), np.zeros((HEIGHT, WIDTH))])
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 8, "half")
    spec.channelnames = ("R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "motion.X", "motion.Y")
    for name, value in (("postfx:exposure", FACTOR), ("postfx:spp", 1), ("postfx:fovX", 40.0)):
        spec.attribute(name, value)
    output = oiio.ImageOutput.create(str(path))
    pixels = np.dstack([colour, albedo, motion]).astype(np.float32)
    assert output is not None, oiio.geterror()
    assert output.open(str(path), spec) and output.write_image(pixels) and output.close()


def postfx(folder: Path, *words: str) -> int:
    """Exit code of a command of the version before."""
    return subprocess.run([sys.executable, "-m", "postfx", *words], cwd=folder,
                          check=False).returncode


def make_samples(folder: Path) -> None:
    """Write the inputs, a killed run and a capture."""
    (folder / "in").mkdir(parents=True, exist_ok=True)
    for number in range(1, FRAMES + 1):
        write_input(folder / f"in/shot.{number:04d}.exr", number)
    killed = subprocess.run([sys.executable, "-c", KILLED, "run", *RUN], cwd=folder, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.returncode
    for path in (folder / "run/postfx.manifest.json", *(folder / "run/.postfx").glob("*.claim")):
        text = path.read_text().replace(json.dumps(socket.gethostname()), json.dumps(HOST))
        path.write_text(text)
    assert postfx(folder, "run", *CAPTURE) == 0
    (folder / "capture/capture.html").unlink()


def make_network(folder: Path) -> None:
    """Write a small denoiser and its card."""
    import torch

    from training.denoise import export
    from training.denoise.model import DenoiseUpscale, TrunkConfig
    from training.export import write_card

    torch.manual_seed(1)
    config = TrunkConfig(widths=(8,), depth=1, stem=8, reach=2)
    network = DenoiseUpscale(config)
    checkpoint = {"config": config.as_dict(), "weights": network.state_dict(),
                  "notes": {"steps": 0}}
    path = folder / "denoise_upscale.tiny.onnx"
    error = export.export_trunk(export.load_trunk(checkpoint), path)
    write_card(path, export.card(checkpoint, "tiny", error, {}))


def read(folder: Path) -> int:
    """Finish a run of this version with the version before; exit code."""
    kept = {path.name: path.read_bytes() for path in sorted((folder / "run").glob("*.exr"))}
    silent = time.time() - SECONDS_SILENT
    for path in (folder / "run/.postfx").iterdir():
        os.utime(path, (silent, silent))
    codes = [postfx(folder, "run", *RUN, "--skip-existing"), postfx(folder, "verify", "run"),
             postfx(folder, "run", "run/shot.####.exr", *AGAIN),
             postfx(folder, "capture-compare", "capture", "capture")]
    same = all((folder / "run" / name).read_bytes() == content for name, content in kept.items())
    print(f"exit codes {codes}; {len(kept)} files were there, {'kept' if same else 'ALTERED'}")
    return int(any(codes) or not same or len(kept) == FRAMES)


if __name__ == "__main__":
    os.umask(0o022)
    what, place = sys.argv[1], Path(sys.argv[2])
    sys.exit({"samples": make_samples, "network": make_network, "reads": read}[what](place))
