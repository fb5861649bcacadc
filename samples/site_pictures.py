"""Pictures of the documentation that show tools: exposure boards, curves and views, a report, and a
captured network.

python samples/site_pictures.py FOLDER   needs Chromium, onnx and the extra 'bench' for the last two

Writes board.png, curve.png, false_colour.png, zebra.png, report.jpg and capture_network.png.
"""
import contextlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

import postfx
from postfx import Frame, Role
from postfx.canvas import Canvas, save_png
from postfx.cli.main import main
from postfx.exposure import measure
from postfx.passes import registry
from postfx.tools.exposure.debugger import debug
from postfx.tools.exposure.plot import draw_exposure

ROOT = Path(__file__).resolve().parent.parent
PAPER, INK = (250, 250, 248), (60, 60, 60)
SHOT, FRAME = 25, 6  # frames of a shot of the curve; the frame of the room that is shown
ONLY_NETWORKS = """<script>setTimeout(() => {
document.querySelectorAll("#left > section:not(#networks)").forEach((section) => section.remove());
[...document.querySelectorAll("#networks *")]
    .filter((one) => one.textContent === "down.1.0").at(-1)?.click();
}, 500)</script>"""
"""Leaves the networks on the page of a capture, and chooses a node."""


def run(*words: str | Path) -> None:
    """A command of postfx, without what it prints on standard output."""
    with contextlib.redirect_stdout(sys.stderr):
        code = main([*map(str, words)])
    if code not in (0, 1):  # postfx exposure ends with 1 where the exposure is not right
        raise SystemExit(f"postfx {words[0]} ended with {code}")


def pixels_of(path: Path) -> np.ndarray:
    """Code values 0..255 of a picture, uint8 (height, width, 3)."""
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8))[..., :3]


def draw_boards(path: Path) -> None:
    """The checkerboard of `postfx exposure` through ACES 2: one stop too dark, right, one stop too
    bright."""
    canvas = Canvas(976, 214, PAPER)
    for k, (stops, words) in enumerate(((-1, "too dark by 1 EV"), (0, "right"),
                                        (1, "too bright by 1 EV"))):
        tool = registry.create("exposure_tool", reference={1: 1.0})
        shown = postfx.Pipeline([tool, postfx.ToneMap(look="aces2")], exposure=stops)
        frame = shown(Frame({Role.COLOUR: np.zeros((180, 320, 3), np.float32)}, number=1))
        canvas.pixels[:180, 328 * k:328 * k + 320] = 255 * frame[Role.COLOUR]
        canvas.text(328 * k + 160, 197, words, INK, align="center")
    canvas.save(path)


def shots() -> Iterator[Frame]:
    """Three shots: exposed right; light that falls, followed late; exposed too dark throughout."""
    picture = np.random.default_rng(0).random((54, 96, 3), np.float32)
    right = measure(picture)
    for t in range(3 * SHOT):
        shot, at = divmod(t, SHOT)
        light = (0.1 * np.sin(at / 4), -2.2 * at / SHOT, 1.0)[shot]
        stops = right + (0.0, max(0.0, 2.2 * (at - SHOT / 2) / SHOT), -1.75)[shot]
        yield Frame({Role.COLOUR: picture * 2**light}, number=t + 1, exposure=stops, reset=at == 0)


def take_screenshot(page: Path, size: tuple[int, int], path: Path) -> None:
    """A PNG of a page, by headless Chromium."""
    chromium = (shutil.which("chromium") or shutil.which("chromium-browser")
                or shutil.which("google-chrome"))
    if chromium is None:
        raise SystemExit("screenshots need Chromium")
    command = [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
               "--disable-background-networking", f"--user-data-dir={page.parent / 'chromium'}",
               "--virtual-time-budget=20000", f"--window-size={size[0]},{size[1]}",
               f"--screenshot={path}", page.resolve().as_uri()]
    # no pipes: processes that Chromium leaves behind would hold them open
    subprocess.run(command, check=True, timeout=120, stdout=subprocess.DEVNULL,
                   stderr=subprocess.DEVNULL)


def make_all(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    noisy, reference = "samples/room/noisy.####.exr", "samples/room/reference.####.exr"
    # pages then show short paths
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(ROOT):
        work = Path(name)
        draw_boards(folder / "board.png")
        draw_exposure(debug(shots(), [postfx.ToneMap(look="aces2")], "metadata"),
                      "shot.####.exr: exposure metadata", folder / "curve.png")
        run("run", noisy, "-o", work / "clean.####.exr", "--scale", "2", "--report",
            work / "report.html", "--reference", reference, "--quiet")
        run("exposure", work / "clean.####.exr", "--frames", f"1-{FRAME}", "--views",
            work / "views")
        view = {kind: pixels_of(next((work / "views").glob(f"*{kind}*{FRAME:04d}.png")))
                for kind in ("log_c", "zebra")}
        save_png(folder / "false_colour.png", view["log_c"])
        # the windows, the lamp and the metal
        save_png(folder / "zebra.png", view["zebra"][:, -510:])
        take_screenshot(work / "report.html", (1340, 1760), work / "report.png")
        report = oiio.ImageBufAlgo.channels(oiio.ImageBuf(str(work / "report.png")), (0, 1, 2))
        report.specmod().attribute("Compression", "jpeg:85")
        report.write(str(folder / "report.jpg"))
        run("run", noisy, "-o", work / "captured.####.exr", "--scale", "2", "--frames", "1-2",
            "--model", "m.fp32", "--capture", work / "look", "--capture-network", "--quiet")
        page = work / "look/capture.html"
        page.write_text(page.read_text("utf-8").replace(f"{ROOT}/", "") + ONLY_NETWORKS, "utf-8")
        take_screenshot(page, (1500, 880), folder / "capture_network.png")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    make_all(Path(sys.argv[1]))
