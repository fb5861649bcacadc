"""The page of a run on the sample: it needs nothing beside it, and what can be moved in it changes
the picture."""

import base64
import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("flip_evaluator")
pytest.importorskip("skimage")

from postfx import read_sequence  # noqa: E402
from postfx.cli.main import main  # noqa: E402
from postfx.frame import Role  # noqa: E402
from postfx.tools.report.pictures import encode_light  # noqa: E402

ROOM = Path(__file__).resolve().parents[2] / "samples" / "room"
SVG = "http://www.w3.org/2000/svg"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Report of frames 1 to 3 of the sample with references."""
    folder = tmp_path_factory.mktemp("report")
    path = folder / "look" / "report.html"
    assert main(["run", str(ROOM / "noisy.####.exr"), "-o", str(folder / "clean.####.exr"),
                 "--frames", "1-3", "--model", "s", "--scale", "2", "--device", "cpu", "--report",
                 str(path), "--reference", str(ROOM / "reference.####.exr")]) == 0
    return path


@pytest.fixture(scope="module")
def tab(tab, page):
    """The tab that opens this page, and knows of no other one."""
    tab.leave()
    tab.open(page)
    return tab


@pytest.fixture(autouse=True)
def as_opened(request):
    """Every test begins at the last frame, unexposed, before and after in halves."""
    if "tab" in request.fixturenames:
        tab = request.getfixturevalue("tab")
        tab.value("(scrollTo(0, 0), viewer.ev.value = 0, viewer.wipe.value = 50, viewer.left.value "
                  "= 'before', viewer.right.value = 'after', viewer.show(data.frames.length - 1))")


def seen(tab):
    """The canvas as it is drawn, (height, width, 3) uint8."""
    content = tab.value("""viewer.draw().then(() => {
        const { width, height } = viewer.picture, copy = document.createElement("canvas");
        Object.assign(copy, { width, height });
        copy.getContext("2d", { willReadFrequently: true }).drawImage(viewer.picture, 0, 0);
        return copy.toDataURL("image/png").split(",")[1]; })""")
    with Image.open(BytesIO(base64.b64decode(content))) as picture:
        return np.asarray(picture.convert("RGB"))


def noise(pixels):
    return float(np.abs(np.diff(pixels.astype(float), axis=1)).mean())


def test_the_page_needs_nothing_beside_it(page):
    text = page.read_text()
    assert set(re.findall(r"https?://[^\s\"'<>]+", text)) == {SVG}
    assert not re.search(r"<(link|iframe|object|embed)\b|<script[^>]+src|@import|url\(", text)
    assert "default-src 'none'" in text and len(text) < 10e6


def test_light_is_unpacked_as_it_was_packed(tab, page):
    """The reference in the page is the file's, exposed as the run exposed it."""
    values, ev = tab.value("""unpack(data.frames.at(-1).pictures.reference)
        .then(codes => [Array.from(codes), data.frames.at(-1).exposure_ev])""")
    (reference,) = read_sequence(ROOM / "reference.####.exr", frames=[3])
    expected = encode_light(reference[Role.COLOUR] * np.float32(2**ev), 64.0)
    assert np.array_equal(np.reshape(values, (360, 640, 3)), expected)


def test_the_line_moves_with_the_mouse_and_the_keys(tab):
    middle = seen(tab)
    # noisy at the left of the line, clean at the right
    assert noise(middle[:, :310]) > 3 * noise(middle[:, 330:])
    tab.drag("#wipe", 0.5, 0.2)
    left = seen(tab)
    assert noise(left[:, 200:310]) < noise(middle[:, 200:310]) / 3
    assert (np.array_equal(left[:, 330:], middle[:, 330:])
            and np.array_equal(left[:, :100], middle[:, :100]))
    edge = tab.value("Number(viewer.picture.dataset.edge)")
    assert abs(edge - 0.2 * 640) < 8
    tab.value("viewer.wipe.focus()")
    tab.press("ArrowRight")
    seen(tab)
    assert tab.value("Number(viewer.picture.dataset.edge)") > edge


def test_the_exposure_slider_acts_on_linear_light(tab):
    unexposed = seen(tab)
    tab.drag("#ev", 0.5, 0.75)
    exposed = seen(tab)
    ev = tab.value("Number(viewer.ev.value)")
    assert (2 < ev < 4
            and tab.value("document.getElementById('ev-text').textContent") == f"+{ev:.1f} EV")
    clean, brighter = unexposed[:, 340:] / 255, exposed[:, 340:] / 255
    inner = (clean > 0.1) & (clean < 0.9)
    code = np.where(clean <= 0.04045, clean / 12.92, ((clean + 0.055) / 1.055) ** 2.4)
    light = code / (1 - np.minimum(code, 0.999)) * 2**ev
    wanted = light / (1 + light)
    wanted = np.where(wanted <= 0.0031308, 12.92 * wanted, 1.055 * wanted ** (1 / 2.4) - 0.055)
    assert np.abs(brighter - wanted)[inner].max() < 0.02
    tab.value("document.getElementById('ev-reset').click()")
    assert np.array_equal(seen(tab), unexposed)


def test_frames_and_pictures_can_be_chosen(tab):
    last = seen(tab)
    assert tab.value("[...document.querySelectorAll('#choices button')].map(one => "
                     "one.textContent)")[0] == "1, first"
    tab.value("document.querySelector('#choices button').click()")
    assert not np.array_equal(seen(tab), last) and tab.value("viewer.picture.dataset.frame") == "1"
    tab.value("(viewer.left.value = 'reference', viewer.right.value = 'FLIP')")
    chosen = seen(tab)
    assert noise(chosen[:, :310]) < noise(last[:, :310])
    assert chosen[:, 330:].mean() < 60  # errors are dark where they are small
    note = tab.value("document.getElementById('frame-note').textContent")
    flip = re.search(r"Frame 1, 640x360\. .* PSNR before 14\.\d+ dB, PSNR after 2\d\.\d+ dB, FLIP "
                     r"(0\.\d+)\.", note)[1]
    assert 0.05 < float(flip) < 0.15


def test_the_pointer_reads_the_light_of_the_files(tab):
    seen(tab)
    tab.value("(viewer.right.value = 'reference', viewer.draw())")
    tab.drag("#wipe", 0.5, 0.5)
    text = tab.value("document.getElementById('pixel').textContent")
    x, y, light = re.match(r"\((\d+), (\d+)\) .*reference ([\d. e-]+)", text).groups()
    (reference,) = read_sequence(ROOM / "reference.####.exr", frames=[3])
    np.testing.assert_allclose(list(map(float, light.split())),
                               reference[Role.COLOUR][int(y), int(x)], rtol=0.02)


def test_curves_times_planes_and_roles_are_there(tab):
    titles = tab.value("[...document.querySelectorAll('#charts h3')].map(one => one.textContent)")
    assert titles == ["Change along the motion", "Exposure, EV", "PSNR against the reference, dB",
                      "FLIP against the reference", "Milliseconds a frame"]
    changes = tab.value("data.charts[0].curves")
    assert changes["before"][0] is None and changes["before"][1] > 5 * changes["after"][1] > 0
    assert tab.value("[...document.querySelectorAll('[data-curve]')].length") == 3 + 2 + 2 + 1 + 1
    ran = tab.value("document.getElementById('ran').innerText")
    assert ("denoise_upscale" in ran and "EXR output stays scene-linear" in ran and "3 of 3 "
            "frames" in ran)
    assert "there is no overlay" not in ran and "undid" not in ran
    tab.value("(data.run.pixel_filter = 0.5, document.querySelector('#ran table').remove(), "
              "drawRun())")
    assert "undid\tpixel filter\t0.50 px before denoising" in tab.value(
        "document.getElementById('ran').innerText")
    assert tab.value("[...document.querySelectorAll('#sheet img')].every(one => one.naturalWidth "
                     "=== 320)")
    assert "albedo.R, albedo.G, albedo.B" in tab.value("document.getElementById('roles').innerText")
    assert (tab.value("document.getElementById('findings').innerText")
            .startswith("None, in 3 frames"))


def test_it_looks_alike_in_the_dark_and_on_a_narrow_window(tab, page):
    tab.open(page, dark=True)
    assert seen(tab).shape == (360, 640, 3)
    assert tab.picture(page.with_name("dark.png"))[5, 5].max() < 60
    tab.open(page, width=700)
    seen(tab)
    assert tab.picture(page.with_name("narrow.png"))[5, 5].min() > 240
    assert tab.value("document.documentElement.scrollWidth <= 700")


def test_nothing_went_wrong_and_nothing_was_asked_for(tab, page):
    """The last test of this file, on what all others did."""
    assert tab.problems == []
    assert {request
            for request in tab.requests if not request.startswith("data:")} == {page.as_uri()}
