"""`postfx.denoise`: one picture in one call."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import postfx
from postfx import DenoiseUpscale, Device, Frame, Pipeline, PostfxError, Role, stills

RNG = np.random.default_rng(0)
COLOUR, ALBEDO = RNG.random((24, 32, 3), np.float32), RNG.random((24, 32, 3), np.float32)
NORMAL = np.dstack([np.zeros((24, 32, 2), np.float32), np.ones((24, 32, 1), np.float32)])


@pytest.mark.parametrize("scale", [1, 2])
def test_it_is_a_pipeline_of_one_frame(scale):
    found = postfx.denoise(COLOUR, albedo=ALBEDO, normal=NORMAL, scale=scale, model="s",
                           device="cpu")
    frame = Frame({Role.COLOUR: COLOUR, Role.DIFFUSE_ALBEDO: ALBEDO, Role.NORMAL: NORMAL})
    whole = Pipeline([DenoiseUpscale(scale=scale, model="s")], Device("cpu"))(frame)
    np.testing.assert_array_equal(found, whole[Role.COLOUR])
    assert found.shape == (24 * scale, 32 * scale, 3) and found.dtype == np.float32
    again = postfx.denoise(COLOUR, albedo=ALBEDO, normal=NORMAL, scale=scale, model="s",
                           device="cpu")
    np.testing.assert_array_equal(again, found)  # the call before is no history


def test_alpha_stays_with_the_colour():
    with_alpha = np.dstack([COLOUR, np.ones((24, 32, 1), np.float32)])
    found = postfx.denoise(with_alpha, model="s", device="cpu")
    np.testing.assert_array_equal(found[..., :3], postfx.denoise(COLOUR, model="s", device="cpu"))
    np.testing.assert_array_equal(found[..., 3], 1)


def test_both_spellings_are_taken_and_one_is_needed():
    by_name = postfx.denoise(colour=COLOUR, albedo=ALBEDO, model="s", device="cpu")
    np.testing.assert_array_equal(by_name,
                                  postfx.denoise(COLOUR, albedo=ALBEDO, model="s", device="cpu"))
    frame = {"color": COLOUR, "albedo": ALBEDO}
    assert list(Frame(frame).planes) == [Role.COLOUR, Role.DIFFUSE_ALBEDO]
    for given in ((), (COLOUR,)):
        with pytest.raises(PostfxError, match="denoise takes one picture: give color"):
            postfx.denoise(*given, **({"colour": COLOUR} if given else {}))


def test_the_former_name_of_an_option_works_and_warns():
    with pytest.warns(DeprecationWarning, match="pass 'tonemap': option 'tag' is now 'look'"):
        old = postfx.ToneMap(tag="agx")
    assert repr(old) == repr(postfx.ToneMap("agx")) == "ToneMap(look='agx')"


def test_tensors_in_and_out():
    torch = pytest.importorskip("torch")
    found = postfx.denoise(torch.from_numpy(COLOUR), albedo=torch.from_numpy(ALBEDO), model="s",
                           device="cpu")
    assert torch.equal(torch.from_dlpack(found), torch.from_numpy(
        postfx.denoise(COLOUR, albedo=ALBEDO, model="s", device="cpu")))


def test_networks_are_loaded_once():
    stills._pipeline.cache_clear()
    for _ in range(3):
        postfx.denoise(COLOUR, model="s", device="cpu")
    assert stills._pipeline.cache_info().misses == 1


@pytest.mark.parametrize(("color", "options", "message"), [
    ([[0.0]], {}, "color is list: give a NumPy array of floats"),
    (COLOUR[..., :2], {}, r"plane 'colour' of frame 1 has shape .24, 32, 2.: it needs"),
    (COLOUR, {"albedo": ALBEDO[:12]},
     "albedo is 32x12, color 32x24: give arrays of one size"),
    (COLOUR, {"normal": NORMAL.astype(int)}, "plane 'normal' of frame 1 is int64"),
    (COLOUR, {"scale": 9}, "scale"),
    (COLOUR, {"model": "none.onnx"}, "no such file"),
    (COLOUR, {"model": "tiny"}, "no network .tiny.: give s, m, l, xl, classic "
     "or FILE.onnx; 'postfx models' lists all$"),
    (COLOUR, {"device": "tpu"}, "no device 'tpu': use auto, cpu"),
    (COLOUR, {"exposure": "bright"}, "exposure 'bright'"),
])
def test_wrong_use_is_told(color, options, message):
    with pytest.raises(PostfxError, match=message):
        postfx.denoise(color, **options)


def test_the_log_tells_what_happens(caplog):
    caplog.set_level(logging.DEBUG, "postfx")
    broken = COLOUR.copy()
    broken[3, 4] = np.nan
    pipeline = Pipeline([DenoiseUpscale(model="s")], Device("cpu"))
    pipeline(Frame({Role.COLOUR: broken}, number=7))
    told = [(record.levelname, record.getMessage())
            for record in caplog.records if record.name == "postfx"]
    assert ("INFO", "ready for frames of 32x24: denoise_upscale") in told
    assert ("WARNING",
            "frame 7: 1 pixels of AOV 'colour' were no finite numbers and were repaired") in told
    assert "frame 7: milliseconds by pass: {'denoise_upscale': " in "".join(text
                                                                            for _, text in told)


def test_a_still_hears_nothing_of_motion(caplog):
    """It cannot have any; what it could have is named."""
    caplog.set_level(logging.INFO, "postfx")
    postfx.denoise(COLOUR[:20], model="s", device="cpu")
    told = " ".join(record.getMessage() for record in caplog.records)
    assert "results are blurrier" in told and "motion" not in told and "flicker" not in told


def test_a_program_without_logging_sees_nothing(capfd):
    logging.getLogger("postfx").warning("nobody asked")
    assert capfd.readouterr() == ("", "")
