"""The contract, held against every registered pass: a new pass is tested here without a line of test code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from postfx import ROLES, Frame, FrameSpec, Role
from postfx.errors import FrameError, NotCompiledError, PassOptionError
from postfx.frame import ENCODINGS, GUIDE_ROLES, GuideSpec
from postfx.passes import registry
from postfx.passes.base import Pass, ResidentFrame
from postfx.pipeline import Pipeline
from postfx.runtime import Device, Library
from tests import toys

SIZE = (37, 29)
PORTABLE_TOLERANCE = 1e-3

Maker = Callable[..., Pass]
TOYS = {"toy double": toys.Double, "toy sum": toys.Sum, "toy enlarge": toys.Enlarge, "toy guide": toys.AddGuide}


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Library:
    return toys.make_library(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def toy_kernels(tmp_path_factory) -> Library:
    return toys.make_kernels(tmp_path_factory.mktemp("kernels"))


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu")


@pytest.fixture(params=[*registry.names(), *TOYS])
def make(request, library) -> Maker:
    """Makes the pass under test, with its default options."""
    if request.param == "toy double":
        return lambda **options: toys.Double(**{"library": library, **options})
    return TOYS[request.param] if request.param in TOYS else registry.load(request.param)


def frame(spec: FrameSpec, number: int = 1, **kept) -> Frame:
    """A frame of random planes with the ranges of real ones."""
    random = np.random.default_rng(number)
    planes = {role: random.random((spec.height, spec.width, ROLES[role].channels), np.float32) for role in spec.roles}
    for role in {Role.MOTION, Role.NORMAL} & planes.keys():
        planes[role] = 2 * planes[role] - 1
    if Role.DEPTH in planes:
        planes[Role.DEPTH] = 1 + 9 * planes[Role.DEPTH]
    guides = toys.make_guides((spec.guides.width, spec.guides.height), spec.guide_roles) if spec.guides else {}
    return Frame(planes, number=number, encoding=spec.encoding, guides=guides, **kept)


def active_spec(instance: Pass, roles=tuple(Role), size=SIZE) -> FrameSpec:
    """A spec that the pass is not skipped for."""
    specs = [FrameSpec(*size, roles, encoding) for encoding in ENCODINGS]
    found = next((spec for spec in specs if instance.skip(spec) is None), None)
    assert found is not None, f"pass '{instance.name}' is skipped for every encoding with these planes: {roles}"
    return found


def run(instance: Pass, frames: list[Frame], device: Device) -> list[Frame]:
    """The frames through one pipeline, whose exposure does not depend on what came before."""
    pipeline = Pipeline([instance], device, exposure=0.5)
    return [pipeline(item) for item in frames]


def same(one: Frame, other: Frame) -> bool:
    return one.planes.keys() == other.planes.keys() and all(
        np.array_equal(one[role], other[role], equal_nan=True) for role in one.planes
    )


@pytest.mark.parametrize("name", registry.names())
def test_registered_under_its_own_name_and_documented(name):
    found = registry.load(name)
    assert found.name == name
    assert found.__doc__ and all(option in found.__doc__ for option in found.defaults)


def test_unknown_option_is_an_error_that_names_the_valid_ones(make):
    options = make().defaults
    with pytest.raises(PassOptionError, match="has no option 'colour_of_magic': its options are") as caught:
        make(colour_of_magic=8)
    assert all(option in str(caught.value) for option in options)


def test_reflect_and_skip_are_pure(make, device):
    instance = make()
    spec = active_spec(instance)
    before = dict(vars(instance))
    reflection, reason = instance.reflect(spec), instance.skip(spec)
    assert vars(instance) == before
    instance.compile(device, spec)
    assert (instance.reflect(spec), instance.skip(spec)) == (reflection, reason)
    assert (make().reflect(spec), make().skip(spec)) == (reflection, reason)


def test_reflection_names_each_plane_once(make):
    instance = make()
    reflection = instance.reflect(active_spec(instance))
    read = [*reflection.reads, *reflection.may_read]
    assert len(set(read)) == len(read) and len(set(reflection.writes)) == len(reflection.writes)
    assert all(isinstance(role, Role) for role in (*read, *reflection.writes))


def test_skip_gives_a_reason_or_none(make):
    instance = make()
    for encoding in ENCODINGS:
        for roles in (tuple(Role), (Role.COLOUR,), (Role.COLOUR, Role.ALPHA)):
            reason = instance.skip(FrameSpec(*SIZE, roles, encoding))
            assert reason is None or (isinstance(reason, str) and reason.strip() and "\n" not in reason)


def test_encode_before_compile_is_an_error(make, device):
    instance = make()
    spec = active_spec(instance)
    with pytest.raises(NotCompiledError, match=f"pass '{instance.name}' is not compiled"):
        instance.encode(device.command_buffer("early"), ResidentFrame(spec, {}))


def test_encode_for_another_spec_is_an_error(make, device):
    instance = make()
    instance.compile(device, active_spec(instance))
    with pytest.raises(NotCompiledError, match=f"pass '{instance.name}' is compiled for another spec"):
        instance.encode(device.command_buffer("other"), ResidentFrame(active_spec(instance, size=(64, 64)), {}))


def test_reset_before_compile_is_fine(make):
    make().reset()


def test_output_is_what_reflect_declares_and_the_input_stays(make, device):
    instance = make()
    given = frame(active_spec(instance))
    kept = {role: plane.copy() for role, plane in given.planes.items()}
    (result,) = run(instance, [given], device)
    output = instance.reflect(given.spec).output
    assert (result.spec.width, result.spec.height) == (output.width, output.height)
    assert result.encoding == output.encoding and set(output.roles) <= result.planes.keys()
    assert all(np.isfinite(plane).all() for plane in result.planes.values())
    assert all(np.array_equal(given[role], plane) for role, plane in kept.items())


def test_planes_that_are_not_declared_do_not_matter(make, device):
    instance = make()
    full = active_spec(instance)
    reflection = instance.reflect(full)
    declared = [role for role in full.roles if role in (*reflection.reads, *reflection.may_read)]
    given = frame(full)
    fewer = Frame({role: given[role] for role in declared}, encoding=full.encoding)
    one, other = run(make(), [given], device)[0], run(make(), [fewer], device)[0]
    assert all(np.array_equal(one[role], other[role]) for role in reflection.writes)


def test_runs_without_optional_planes(make, device):
    instance = make()
    spec = active_spec(instance, roles=instance.reflect(active_spec(instance)).reads)
    (result,) = run(instance, [frame(spec)], device)
    assert all(np.isfinite(plane).all() for plane in result.planes.values())


def test_guides_that_are_not_declared_do_not_matter(make, device):
    instance = make()
    spec = replace(active_spec(instance), guides=GuideSpec(2 * SIZE[0], 2 * SIZE[1], GUIDE_ROLES))
    reflection = instance.reflect(spec)
    given = frame(spec)
    fewer = replace(given, guides={role: given.guides[role] for role in reflection.may_read_guides})
    one, other = run(make(), [given], device)[0], run(make(), [fewer], device)[0]
    assert all(np.array_equal(one[role], other[role]) for role in reflection.writes)
    assert all(np.isfinite(one[role]).all() for role in reflection.writes)


@pytest.mark.parametrize("size", [(1, 1), (3, 50), (64, 16)])
def test_any_size(make, device, size):
    instance = make()
    (result,) = run(instance, [frame(active_spec(instance, size=size))], device)
    assert all(np.isfinite(plane).all() for plane in result.planes.values())


def test_reset_drops_the_history(make, device):
    instance = make()
    frames = [frame(active_spec(instance), number) for number in (1, 2, 3)]
    pipeline = Pipeline([instance], device)  # auto exposure has a history, too
    first = [pipeline(item) for item in frames]
    pipeline.reset()
    second = [pipeline(item) for item in frames]
    assert all(same(one, other) for one, other in zip(first, second, strict=True))


def test_a_frame_marked_as_reset_is_a_first_frame(make, device):
    instance = make()
    spec = active_spec(instance)
    cut = frame(spec, 3, reset=True)
    (alone,) = run(make(), [cut], device)
    assert same(run(instance, [frame(spec, 1), frame(spec, 2), cut], device)[-1], alone)


def test_what_it_remembers_can_be_taken_up_by_another_instance(make, device):
    instance = make()
    frames = [frame(active_spec(instance), number) for number in (1, 2, 3, 4)]
    whole = Pipeline([instance], device)
    for item in frames[:2]:
        whole(item)
    history = whole.history()
    if history is None:  # then it must be one that is told by its reset to have a history
        assert type(instance).reset is not Pass.reset and type(instance).history is Pass.history
        return
    kept = {name: np.array(array) for name, array in history.items()}
    broken = Pipeline([make()], Device("cpu"))
    broken.recall(frames[1], kept)
    assert all(same(whole(item), broken(item)) for item in frames[2:])


def test_a_history_of_something_else_is_refused(make, device):
    instance = make()
    pipeline = Pipeline([instance], device)
    pipeline(frame(active_spec(instance)))
    history = pipeline.history() or {}
    wrong = {f"{name} of another": np.array(array) for name, array in history.items() if name.startswith("pass")}
    if wrong:
        with pytest.raises(FrameError, match="the history does not fit the passes"):
            pipeline.recall(frame(active_spec(instance)), wrong)


def test_another_size_and_back(make, device):
    instance = make()
    large, small = active_spec(instance), active_spec(instance, size=(18, 20))
    first, _, last = run(instance, [frame(large), frame(small), frame(large)], device)
    assert same(first, last)


def test_two_instances_do_not_disturb_each_other(make, device):
    spec = active_spec(make())
    alone = run(make(), [frame(spec, 1), frame(spec, 2)], device)[-1]
    one, other = (Pipeline([make()], device, exposure=0.5) for _ in range(2))
    one(frame(spec, 1))
    other(frame(spec, 5))
    assert same(one(frame(spec, 2)), alone)


def test_portable_kernels_give_the_same_picture(make, toy_kernels, device):
    instance = make()
    kernels = toy_kernels if type(instance) in TOYS.values() else None
    portable = Device("cpu", compiled_kernels=False, kernels=kernels)
    frames = [frame(active_spec(instance), number) for number in (1, 2)]
    for one, other in zip(run(make(), frames, device), run(make(), frames, portable), strict=True):
        for role in one.planes:
            np.testing.assert_allclose(one[role], other[role], rtol=PORTABLE_TOLERANCE, atol=PORTABLE_TOLERANCE)


def test_device_memory_is_given_back(make):
    device = Device("cpu")
    instance = make()
    run(instance, [frame(active_spec(instance), number) for number in (1, 2)], device)
    used = device.heap.used
    run(instance, [frame(active_spec(instance), number) for number in (1, 2)], device)
    assert device.heap.used == used
