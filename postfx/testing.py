"""A pytest plug-in for packages that bring passes: the contract suite, devices, pictures, and the
command line.

In the `conftest.py` of such a package:

    pytest_plugins = ["postfx.testing"]

and in one of its tests, which holds the pass to the whole contract of docs/howto/passes.md:

    from postfx.testing import PassContract

    class TestVignette(PassContract):
        name = "vignette"
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from postfx.errors import FrameError, ModelError, NotCompiledError, PassOptionError
from postfx.frame import ENCODINGS, GUIDE_ROLES, ROLES, Frame, FrameSpec, GuideSpec, Role
from postfx.passes import Pass, ResidentFrame, registry
from postfx.pipeline import Pipeline
from postfx.runtime import Device

CONTRACT_SIZE_PX = (37, 29)
"""Width and height of the frames of the contract suite: odd, so that halves do not fit."""
PORTABLE_TOLERANCE = 1e-3
"""Relative and absolute difference that is allowed between the forms of a kernel."""

Maker = Callable[..., Pass]


class Outcome(NamedTuple):
    """Exit code and outputs of a command."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What it printed, read as JSON."""
        return json.loads(self.out)


@pytest.fixture(scope="module")
def device() -> Device:
    """The CPU, with kernels in their compiled form."""
    return Device("cpu")


@pytest.fixture(scope="module")
def portable() -> Device:
    """The CPU, with kernels in their portable form."""
    return Device("cpu", compiled_kernels=False)


@pytest.fixture
def postfx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
           capfd: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Runs `postfx ARGUMENTS` in the test's folder and process: a start of Python takes longer than
    most runs."""
    from postfx.cli.main import main

    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Outcome:
        capfd.readouterr()
        try:
            code = main(arguments)
        except SystemExit as ended:
            assert ended.code is None or isinstance(ended.code, int), ended.code
            code = ended.code or 0
        return Outcome(code, *capfd.readouterr())

    return run


@pytest.fixture
def write_exr(tmp_path: Path) -> Callable[..., Path]:
    """Writes channels (name -> height x width array) as a single-part file of the test's folder."""
    import OpenImageIO as oiio

    def write(name: str, channels: Mapping[str, Any], **header: Any) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        height, width = next(iter(channels.values())).shape
        spec = oiio.ImageSpec(width, height, len(channels), "float")
        spec.channelnames = tuple(channels)
        origin, display = header.pop("origin", (0, 0)), header.pop("display", None)
        spec.x, spec.y = origin
        if display:
            spec.full_x, spec.full_y, spec.full_width, spec.full_height = display
        for key, value in header.items():
            kind = {2: "float2", 16: "matrix"}.get(np.size(value))
            values = (oiio.TypeDesc(kind), tuple(map(float, value))) if kind else (value,)
            spec.attribute(key.replace("__", ":"), *values)
        output = oiio.ImageOutput.create(str(path))
        assert output and output.open(str(path), spec)
        assert output.write_image(np.stack(list(channels.values()), axis=-1).astype(np.float32))
        output.close()
        return path

    return write


def make_frame(spec: FrameSpec, number: int = 1, **facts: Any) -> Frame:
    """A frame of random planes with the ranges of real ones; the number is their seed. facts: as of
    `postfx.Frame`."""
    random = np.random.default_rng(number)
    planes = {role: random.random((spec.height, spec.width, ROLES[role].channels), np.float32)
              for role in spec.roles}
    for role in {Role.MOTION, Role.NORMAL} & planes.keys():
        planes[role] = 2 * planes[role] - 1
    if Role.DEPTH in planes:
        planes[Role.DEPTH] = 1 + 9 * planes[Role.DEPTH]
    guides: Mapping[Role, np.ndarray] = {}
    if spec.guides:
        guides = make_frame(FrameSpec(spec.guides.width, spec.guides.height, spec.guide_roles),
                            100).planes
    return Frame(planes, number=number, encoding=spec.encoding, guides=dict(guides), **facts)


def find_spec(instance: Pass, roles: tuple[Role, ...] = tuple(Role),
              size: tuple[int, int] = CONTRACT_SIZE_PX) -> FrameSpec:
    """A spec that the pass is not skipped for."""
    specs = [FrameSpec(*size, roles, encoding) for encoding in ENCODINGS]
    found = next((spec for spec in specs if instance.skip(spec) is None), None)
    assert found is not None, (f"pass '{instance.name}' is skipped for every encoding with these "
                               f"planes: {roles}")
    return found


def _run(instance: Pass, frames: list[Frame], device: Device) -> list[Frame]:
    """The frames through one pipeline, whose exposure does not depend on what came before."""
    pipeline = Pipeline([instance], device, exposure=0.5)
    return [pipeline(item) for item in frames]


def _same(one: Frame, other: Frame) -> bool:
    return one.planes.keys() == other.planes.keys() and all(
        np.array_equal(one[role], other[role], equal_nan=True) for role in one.planes
    )


class PassContract:
    """Tests that every pass must hold; a subclass whose name begins with Test, and that sets
    `name`, runs them."""

    name: ClassVar[str]
    """The pass's name in the registry."""

    @pytest.fixture
    def make(self) -> Maker:
        """Makes the pass under test, with its default options or others."""
        return registry.load(self.name)

    def test_documented_with_every_option(self, make: Maker) -> None:
        kind = type(make())
        assert kind.__doc__ and all(option in kind.__doc__ for option in kind.defaults)

    def test_unknown_option_is_an_error_that_names_the_valid_ones(self, make: Maker) -> None:
        options = make().defaults
        with pytest.raises(PassOptionError,
                           match="has no option 'colour_of_magic': its options are") as caught:
            make(colour_of_magic=8)
        assert all(option in str(caught.value) for option in options)

    def test_reflect_and_skip_are_pure(self, make: Maker, device: Device) -> None:
        instance = make()
        spec = find_spec(instance)
        before = dict(vars(instance))
        reflection, reason = instance.reflect(spec), instance.skip(spec)
        assert vars(instance) == before
        instance.compile(device, spec)
        assert (instance.reflect(spec), instance.skip(spec)) == (reflection, reason)
        assert (make().reflect(spec), make().skip(spec)) == (reflection, reason)

    def test_reflection_names_each_plane_once(self, make: Maker) -> None:
        instance = make()
        reflection = instance.reflect(find_spec(instance))
        read = [*reflection.reads, *reflection.may_read]
        assert len(set(read)) == len(read) and len(set(reflection.writes)) == len(reflection.writes)
        assert all(isinstance(role, Role) for role in (*read, *reflection.writes))

    def test_skip_gives_a_reason_or_none(self, make: Maker) -> None:
        instance = make()
        for encoding in ENCODINGS:
            for roles in (tuple(Role), (Role.COLOUR,), (Role.COLOUR, Role.ALPHA)):
                reason = instance.skip(FrameSpec(*CONTRACT_SIZE_PX, roles, encoding))
                assert (reason is None
                        or (isinstance(reason, str) and reason.strip() and "\n" not in reason))

    def test_encode_before_compile_is_an_error(self, make: Maker, device: Device) -> None:
        instance = make()
        spec = find_spec(instance)
        with pytest.raises(NotCompiledError, match=f"pass '{instance.name}' is not compiled"):
            instance.encode(device.command_buffer("early"), ResidentFrame(spec, {}))

    def test_encode_for_another_spec_is_an_error(self, make: Maker, device: Device) -> None:
        instance = make()
        instance.compile(device, find_spec(instance))
        with pytest.raises(NotCompiledError,
                           match=f"pass '{instance.name}' is compiled for another spec"):
            instance.encode(device.command_buffer("other"),
                            ResidentFrame(find_spec(instance, size=(64, 64)), {}))

    def test_reset_before_compile_is_fine(self, make: Maker) -> None:
        make().reset()

    def test_output_is_what_reflect_declares_and_the_input_stays(self, make: Maker,
                                                                 device: Device) -> None:
        instance = make()
        given = make_frame(find_spec(instance))
        kept = {role: plane.copy() for role, plane in given.planes.items()}
        (result,) = _run(instance, [given], device)
        output = instance.reflect(given.spec).output
        assert (result.spec.width, result.spec.height) == (output.width, output.height)
        assert result.encoding == output.encoding and set(output.roles) <= result.planes.keys()
        assert all(np.isfinite(plane).all() for plane in result.planes.values())
        assert all(np.array_equal(given[role], plane) for role, plane in kept.items())

    def test_planes_that_are_not_declared_do_not_matter(self, make: Maker, device: Device) -> None:
        instance = make()
        full = find_spec(instance)
        reflection = instance.reflect(full)
        declared = [role
                    for role in full.roles if role in (*reflection.reads, *reflection.may_read)]
        given = make_frame(full)
        fewer = Frame({role: given[role] for role in declared}, encoding=full.encoding)
        one, other = _run(make(), [given], device)[0], _run(make(), [fewer], device)[0]
        assert all(np.array_equal(one[role], other[role]) for role in reflection.writes)

    def test_runs_without_optional_planes(self, make: Maker, device: Device) -> None:
        instance = make()
        spec = find_spec(instance, roles=instance.reflect(find_spec(instance)).reads)
        (result,) = _run(instance, [make_frame(spec)], device)
        assert all(np.isfinite(plane).all() for plane in result.planes.values())

    def test_guides_that_are_not_declared_do_not_matter(self, make: Maker, device: Device) -> None:
        instance = make()
        spec = replace(find_spec(instance),
                       guides=GuideSpec(2 * CONTRACT_SIZE_PX[0], 2 * CONTRACT_SIZE_PX[1],
                                        GUIDE_ROLES))
        reflection = instance.reflect(spec)
        given = make_frame(spec)
        fewer = replace(given,
                        guides={role: given.guides[role] for role in reflection.may_read_guides})
        one, other = _run(make(), [given], device)[0], _run(make(), [fewer], device)[0]
        assert all(np.array_equal(one[role], other[role]) for role in reflection.writes)
        assert all(np.isfinite(one[role]).all() for role in reflection.writes)

    @pytest.mark.parametrize("size", [(1, 1), (3, 50), (64, 16)])
    def test_any_size(self, make: Maker, device: Device, size: tuple[int, int]) -> None:
        instance = make()
        (result,) = _run(instance, [make_frame(find_spec(instance, size=size))], device)
        assert all(np.isfinite(plane).all() for plane in result.planes.values())

    def test_reset_drops_the_history(self, make: Maker, device: Device) -> None:
        instance = make()
        frames = [make_frame(find_spec(instance), number) for number in (1, 2, 3)]
        pipeline = Pipeline([instance], device)  # auto exposure has a history, too
        first = [pipeline(item) for item in frames]
        pipeline.reset()
        second = [pipeline(item) for item in frames]
        assert all(_same(one, other) for one, other in zip(first, second, strict=True))

    def test_a_frame_marked_as_reset_is_a_first_frame(self, make: Maker, device: Device) -> None:
        instance = make()
        spec = find_spec(instance)
        cut = make_frame(spec, 3, reset=True)
        (alone,) = _run(make(), [cut], device)
        assert _same(_run(instance, [make_frame(spec, 1), make_frame(spec, 2), cut], device)[-1],
                     alone)

    def test_what_it_remembers_can_be_taken_up_by_another_instance(self, make: Maker,
                                                                   device: Device) -> None:
        instance = make()
        frames = [make_frame(find_spec(instance), number) for number in (1, 2, 3, 4)]
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
        assert all(_same(whole(item), broken(item)) for item in frames[2:])

    def test_a_history_of_something_else_is_refused(self, make: Maker, device: Device) -> None:
        instance = make()
        pipeline = Pipeline([instance], device)
        pipeline(make_frame(find_spec(instance)))
        history = pipeline.history() or {}
        wrong = {f"{name} of another": np.array(array)
                 for name, array in history.items() if name.startswith("pass")}
        if wrong:
            with pytest.raises(FrameError, match="the history does not fit the passes"):
                pipeline.recall(make_frame(find_spec(instance)), wrong)

    def test_another_size_and_back(self, make: Maker, device: Device) -> None:
        instance = make()
        large, small = find_spec(instance), find_spec(instance, size=(18, 20))
        first, _, last = _run(instance, [make_frame(large), make_frame(small), make_frame(large)],
                              device)
        assert _same(first, last)

    def test_two_instances_do_not_disturb_each_other(self, make: Maker, device: Device) -> None:
        spec = find_spec(make())
        alone = _run(make(), [make_frame(spec, 1), make_frame(spec, 2)], device)[-1]
        one, other = (Pipeline([make()], device, exposure=0.5) for _ in range(2))
        one(make_frame(spec, 1))
        other(make_frame(spec, 5))
        assert _same(one(make_frame(spec, 2)), alone)

    def test_portable_kernels_give_the_same_picture(self, make: Maker, device: Device,
                                                    portable: Device) -> None:
        instance = make()
        frames = [make_frame(find_spec(instance), number) for number in (1, 2)]
        try:
            others = _run(make(), frames, portable)
        except ModelError as error:
            if "has no form that runs on" not in str(error):
                raise
            pytest.skip(f"{error}; without it, the pass runs on a CPU, and on CUDA if it has a "
                        "source")
        for one, other in zip(_run(make(), frames, device), others, strict=True):
            for role in one.planes:
                np.testing.assert_allclose(one[role], other[role], rtol=PORTABLE_TOLERANCE,
                                           atol=PORTABLE_TOLERANCE)

    def test_device_memory_is_given_back(self, make: Maker) -> None:
        device = Device("cpu")
        instance = make()
        _run(instance, [make_frame(find_spec(instance), number) for number in (1, 2)], device)
        used = device.heap.used
        _run(instance, [make_frame(find_spec(instance), number) for number in (1, 2)], device)
        assert device.heap.used == used
