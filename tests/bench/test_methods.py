"""Which methods there are, and choosing among them."""

import pytest

from postfx.errors import BenchError
from postfx.tools.bench.job import with_planes
from postfx.tools.bench.methods import OTHERS, catalogue, select

MODELS = ("denoise_upscale.l", "denoise_upscale.m", "denoise_upscale.m.guides",
          "denoise_upscale.m.int8", "denoise_upscale.m.fp16", "denoise_upscale.s", "tonemap.aces2")


def names(found):
    return [method.name for method in found.methods]


def test_networks_come_by_size_with_and_without_history():
    found = catalogue(MODELS, "cpu", guides=False, motion=True)
    ours = [name for name in names(found) if name[0] in "sml"]
    kinds = ("", "-alone", "-run-up", "-both-ways")
    assert ours == [tag + kind for tag in ("s", "m", "m-int8", "l") for kind in kinds]
    assert names(found)[len(ours) :] == [method.name for method in OTHERS]


def test_networks_for_1x_are_what_the_others_run_there():
    more = (*MODELS, "denoise_upscale.m.1x", "denoise_upscale.m.int8.1x",
            "denoise_upscale.m.fp16.1x")
    assert catalogue(more, "cpu", guides=True, motion=True) == catalogue(MODELS, "cpu", guides=True,
                                                                         motion=True)


def test_what_is_left_out_says_why():
    omissions = dict(catalogue(MODELS, "cpu", guides=False, motion=False).omissions)
    assert omissions["m fp16"] == "fp16 is for cuda, not for cpu"
    assert omissions["l int8"] == "there is no model denoise_upscale.l.int8"
    assert omissions["m fp32 guides"] == "the frames have no AOVs at output size"
    assert omissions["accumulation"] == "the frames have no motion vectors"


def test_a_network_that_reads_guides():
    found = catalogue(MODELS, "cuda", guides=True, motion=False)
    guided = next(method for method in found.methods if method.guides)
    assert (guided.name, guided.model, guided.title) == ("m-guides", "m", "m fp32 guides")
    omissions = dict(catalogue(MODELS, "cuda", guides=True, motion=False).omissions)
    assert (omissions["s guides"] == "there is no model denoise_upscale.s.guides" and "m "
            "guides" not in omissions)
    assert "m-fp16" in names(found) and "m-int8" not in names(found)
    assert not any(method.alone or method.accumulated for method in found.methods)


def test_ablations_leave_each_plane_out_and_all():
    found = catalogue(MODELS, "cpu", guides=True, motion=True, lost=["depth", "specular_albedo"])
    ours = [method
            for method in found.methods if method.model == "m" and method.precision == "fp32"]
    assert [method.name for method in ours] == ["m", "m-alone", "m-run-up", "m-both-ways",
                                                "m-without-depth", "m-without-specular_albedo",
                                                "m-without-all", "m-guides", "m-guides-alone",
                                                "m-guides-run-up", "m-guides-both-ways"]
    assert ours[5].without == ("specular_albedo",) and ours[5].title == "m fp32, no specular albedo"
    assert ours[6].without == ("depth", "specular_albedo") and ours[0].without == ()
    assert "m-int8-without-depth" not in names(found)
    assert names(catalogue(MODELS, "cpu", False, False, ["depth"]))[2:4] == ["m", "m-without-depth"]


def test_selection_by_name_family_and_tag():
    found = catalogue(MODELS, "cpu", guides=False, motion=True)
    assert names(select(found, "bicubic,oidn-high", None)) == ["oidn-high", "bicubic"]
    assert names(select(found, "ours", "s")) == ["s", "s-alone", "s-run-up", "s-both-ways"]
    assert names(select(found, "ours,plain", "l")) == ["l", "l-alone", "l-run-up", "l-both-ways",
                                                         "accumulation", "bicubic"]
    assert select(found, None, None) == found


@pytest.mark.parametrize(
    ("methods", "models", "message"),
    [("oidn-best", None,
      "--methods oidn-best: there is no 'oidn-best' here: did you mean oidn-fast. use accumul"),
     (None, "xl", "--models xl: there is no 'xl' here: did you mean l. use l, m, s"),
     ("m", "s", "leaves nothing to measure")],
)
def test_names_that_fit_nothing(methods, models, message):
    with pytest.raises(BenchError, match=message):
        select(catalogue(MODELS, "cpu", guides=False, motion=True), methods, models)


def test_what_is_accumulated_takes_planes_like_the_best_of_single_frames():
    accumulated = next(method for method in OTHERS if method.name == "oidn-high-accumulated")

    def row(planes, psnr, quality="high", accumulated=False):
        return {"planes": planes, "quality": quality, "accumulated": accumulated,
                "scores": {"psnr_late": psnr}}
    rows = [row("clean", 30), row("raw", 31), row("none", 29), row("clean", 40, ""),
            row("best", 50, accumulated=True)]
    assert with_planes(accumulated, rows).planes == "raw"
    assert with_planes(accumulated, []).planes == "prefiltered"
    assert with_planes(OTHERS[0], rows) is OTHERS[0]


def test_open_image_denoise_runs_in_five_ways():
    ways = [(method.planes, method.accumulated) for method in OTHERS if method.quality == "high"]
    assert ways == [("clean", False), ("prefiltered", False), ("raw", False), ("none", False),
                    ("best", True)]
