"""Plans: which passes run, what is read for them, what is skipped and why."""

import json

import pytest

from postfx.errors import MissingPlaneError, PassContractError
from postfx.frame import FrameSpec, GuideSpec, Role
from postfx.passes import Pass, Reflection
from postfx.passes.denoise import DenoiseUpscale
from postfx.plan import Skip, make_plan
from tests import toys

SPEC = FrameSpec(6, 10, (Role.COLOUR, Role.ALPHA, Role.DEPTH, Role.NORMAL))


class Mask(Pass):
    """Writes a reactive mask out of depth."""

    name = "mask"

    def reflect(self, spec):
        output = FrameSpec(spec.width, spec.height, (*spec.roles, Role.REACTIVE), spec.encoding)
        return Reflection(reads=(Role.DEPTH,), writes=(Role.REACTIVE,), output=output)


class Encode(Pass):
    """Scene-linear to srgb."""

    name = "encode"

    def reflect(self, spec):
        return Reflection((Role.COLOUR,), (Role.COLOUR,),
                          FrameSpec(spec.width, spec.height, spec.planes, "srgb"))

    def skip(self, spec):
        return "colour is encoded already" if spec.encoding == "srgb" else None


def test_order_is_kept_and_specs_are_handed_on():
    plan = make_plan([toys.Sum(), toys.Enlarge(), Encode()], SPEC)
    assert [step.name for step in plan.steps] == ["sum", "enlarge", "encode"]
    assert [(step.input.width, step.input.encoding) for step in plan.steps] == [
        (6, "scene-linear"), (6, "scene-linear"), (12, "scene-linear")]
    assert plan.output == FrameSpec(12, 20, (Role.COLOUR,), "srgb")


def test_only_needed_planes_are_read():
    plan = make_plan([toys.Sum()], SPEC)
    assert plan.planes == (Role.COLOUR, Role.ALPHA) and plan.input.roles == plan.planes
    assert Skip("AOV 'depth'", "no pass reads it") in plan.skips
    assert make_plan([toys.Enlarge()], SPEC).planes == (Role.COLOUR, Role.ALPHA, Role.DEPTH)


def test_steps_up_to_the_last_one_that_improves_with_earlier_frames():
    class Mean(toys.Sum):
        """Of all frames so far."""

        name = "mean"

        def accumulates(self, spec):
            return spec.has(Role.COLOUR)

    def names(*passes: Pass) -> list[str]:
        return [step.name for step in make_plan(passes, SPEC).accumulating_steps()]

    assert names(toys.Sum(), Mean(), Encode()) == ["sum", "mean"]
    assert names(Mean(), toys.Sum()) == ["mean"] and names(toys.Sum(), Encode()) == []


def test_optional_planes_are_read_when_there():
    with_mask = FrameSpec(6, 10, (Role.COLOUR, Role.REACTIVE))
    assert make_plan([toys.Sum()], with_mask).planes == (Role.COLOUR, Role.REACTIVE)


def test_planes_that_an_earlier_pass_writes_are_not_read():
    spec = FrameSpec(6, 10, (Role.COLOUR, Role.DEPTH, Role.REACTIVE))
    assert make_plan([Mask(), toys.Sum()], spec).planes == (Role.COLOUR, Role.DEPTH)
    assert make_plan([toys.Sum(), Mask()], spec).planes == (Role.COLOUR, Role.DEPTH, Role.REACTIVE)


def test_skipped_passes_are_left_out_with_their_reason():
    plan = make_plan([Encode(), toys.Double(times=0), Encode()], FrameSpec(6, 10, (Role.COLOUR,)))
    assert [step.name for step in plan.steps] == ["encode"]
    assert plan.skips == (Skip("double", "times is 0"),
                          Skip("encode 2", "colour is encoded already"))


def test_the_same_pass_twice_gets_a_number():
    plan = make_plan([toys.Sum(), toys.Sum()], SPEC)
    assert [step.name for step in plan.steps] == ["sum", "sum 2"]


def test_missing_plane_names_pass_plane_and_mend():
    with pytest.raises(MissingPlaneError,
                       match="pass 'enlarge' needs AOV 'depth', but the frame does not have it: "):
        make_plan([toys.Enlarge()], FrameSpec(6, 10, (Role.COLOUR,)))


def test_plane_that_an_earlier_pass_dropped():
    with pytest.raises(MissingPlaneError,
                       match="pass 'enlarge 2' needs AOV 'depth', but an earlier pass dropped it"):
        make_plan([toys.Enlarge(), toys.Enlarge()], SPEC)


@pytest.mark.parametrize(("writes", "output", "message"), [
    ((Role.COLOUR,), FrameSpec(6, 10, (Role.COLOUR, Role.MOTION)),
     "other planes than it keeps and writes"),
    ((Role.COLOUR, Role.MOTION), FrameSpec(6, 10, (Role.COLOUR,)),
     "other planes than it keeps and writes"),
    ((Role.COLOUR,), FrameSpec(12, 20, (Role.COLOUR, Role.DEPTH)),
     "keeps plane 'depth' at the old one"),
])
def test_reflections_that_cannot_be(writes, output, message):
    class Wrong(Pass):
        name = "wrong"

        def reflect(self, spec):
            return Reflection((Role.COLOUR,), writes, output)

    with pytest.raises(PassContractError, match=message):
        make_plan([Wrong()], SPEC)


def test_no_passes_read_what_is_written_out():
    plan = make_plan([], SPEC)
    assert plan.planes == (Role.COLOUR, Role.ALPHA) and plan.output == plan.input


def test_a_plan_prints_what_runs_and_what_is_left_out():
    plan = make_plan([toys.Double(times=0), toys.Enlarge(), Encode()], SPEC)
    assert str(plan).splitlines() == [
        "frame   6x10, scene-linear: colour, alpha, depth, normal",
        "reads   colour, alpha, depth",
        "pass 1  enlarge: reads colour, depth; writes colour; 6x10 -> 12x20",
        "pass 2  encode: reads colour; writes colour; scene-linear -> srgb",
        "skips   double: times is 0",
        "skips   AOV 'normal': no pass reads it",
        "output  12x20, srgb: colour",
    ]


def test_a_plan_as_json_names_what_runs_and_what_is_left_out():
    plan = make_plan([toys.Double(times=0), toys.Enlarge()], SPEC)
    document = json.loads(plan.to_json())
    assert document == plan.as_dict()
    assert document["planes"] == ["colour", "alpha", "depth"]
    assert document["passes"] == [{
        "name": "enlarge", "reads": ["colour", "depth"], "guides": [], "writes": ["colour"],
        "output": {"width": 12, "height": 20, "encoding": "scene-linear", "planes": ["colour"],
                   "guides": None},
        "notes": [],
    }]
    assert document["skipped"][0] == {"what": "double", "why": "times is 0"}


def test_remarks_of_active_passes_are_kept():
    class Wishing(toys.Enlarge):
        def remarks(self, spec):
            return () if spec.has(Role.MOTION) else ("no motion",)

    plan = make_plan([Wishing(), toys.Double(times=0)], SPEC)
    assert plan.remarks == ("enlarge: no motion",)
    assert "note    enlarge: no motion" in str(plan).splitlines()
    assert plan.as_dict()["remarks"] == ["enlarge: no motion"]


GUIDES = GuideSpec(12, 20, (Role.NORMAL, Role.DIFFUSE_ALBEDO))
GUIDED = FrameSpec(6, 10, (Role.COLOUR,), guides=GUIDES)


def test_only_guides_that_a_pass_reads_are_read():
    plan = make_plan([toys.AddGuide()], GUIDED)
    assert (plan.guides == (Role.DIFFUSE_ALBEDO,) == plan.input.guide_roles
            == plan.steps[0].uses_guides)
    assert plan.skips == (Skip("guide 'normal'", "no pass reads it"),)
    assert plan.output == FrameSpec(12, 20, (Role.COLOUR,))


def test_guides_that_no_pass_reads_are_the_same_spec_to_the_passes():
    one, other = (make_plan([toys.Sum()], FrameSpec(6, 10, (Role.COLOUR,), guides=guides))
                  for guides in (GUIDES, GuideSpec(12, 20, (Role.DEPTH,))))
    assert one.guides == other.guides == () and Skip("guides", "no pass reads them") in one.skips
    assert one.steps[0].input == other.steps[0].input


def test_guides_end_where_the_size_changes():
    plan = make_plan([toys.AddGuide(), toys.AddGuide()], GUIDED)
    assert [step.uses_guides for step in plan.steps] == [(Role.DIFFUSE_ALBEDO,), ()]


def test_guides_that_nobody_brought_cannot_be_left():
    class Wrong(Pass):
        name = "wrong"

        def reflect(self, spec):
            return Reflection((Role.COLOUR,), (Role.COLOUR,), GUIDED)

    with pytest.raises(PassContractError, match="other planes than it keeps"):
        make_plan([Wrong()], FrameSpec(6, 10, (Role.COLOUR,)))


@pytest.mark.parametrize(("guides", "line"), [
    (GUIDES, "guides  12x20, used: diffuse_albedo"),
    (GuideSpec(12, 20, (Role.DEPTH,)), "guides  12x20, not used"),
    (None,
     "guides  none: albedo, normals and depth at output size would make edges sharper (--guides)"),
])
def test_text_says_whether_guides_are_used(guides, line):
    lines = str(make_plan([toys.AddGuide()],
                          FrameSpec(6, 10, (Role.COLOUR,), guides=guides))).splitlines()
    assert line in lines
    assert any("uses the guides" in text for text in lines) == (guides == GUIDES)
    assert not any(text.startswith("guides")
                   for text in str(make_plan([toys.Sum()], SPEC)).splitlines())


@pytest.mark.parametrize(("scale", "is_told"), ((1, False), (2, True)))
def test_text_misses_guides_only_where_a_frame_is_enlarged(scale, is_told):
    """At the render's size the AOVs have it already."""
    text = str(make_plan([DenoiseUpscale(scale)], FrameSpec(64, 32, (Role.COLOUR,))))
    assert ("would make edges sharper (--guides)" in text) == is_told


def test_json_of_guides():
    document = make_plan([toys.AddGuide()], GUIDED).as_dict()
    assert document["input"]["guides"] == {"width": 12, "height": 20,
                                           "planes": ["normal", "diffuse_albedo"]}
    assert document["guides"] == document["passes"][0]["guides"] == ["diffuse_albedo"]
