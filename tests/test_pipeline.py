"""The flow of frames through passes."""

import pickle
import threading

import numpy as np
import pytest

from postfx.errors import EncodingError, FrameError, MissingPlaneError, PassContractError
from postfx.exposure import ExposureMeter
from postfx.frame import Frame, FrameSpec, Role
from postfx.passes import Pass, Reflection
from postfx.passes.composite import Overlay
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.display import Display
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import BindingError, CommandError, Device, HazardError, Library
from tests import toys
from tests.toys import make_frame


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Library:
    return toys.make_library(tmp_path_factory.mktemp("models"))


@pytest.fixture
def device() -> Device:
    return Device("cpu", threads=2)


class Probe(Pass):
    """Notes what it is given and leaves the frame as it is."""

    name = "probe"

    def __init__(self):
        super().__init__()
        self.compiled, self.seen = [], []

    def reflect(self, spec):
        return Reflection(reads=(Role.COLOUR,), writes=(), output=spec)

    def compile(self, device, spec):
        super().compile(device, spec)
        self.compiled.append(spec)

    def encode(self, commands, frame):
        super().encode(commands, frame)
        self.seen.append(frame)


def test_passes_run_in_order(device, library):
    double, total = toys.Double(library=library, times=2), toys.Sum()
    frames = [make_frame(number) for number in (1, 2)]
    pipeline = Pipeline([double, total], device)
    results = [pipeline(frame) for frame in frames]
    np.testing.assert_allclose(results[1][Role.COLOUR],
                               4 * frames[0][Role.COLOUR] + 4 * frames[1][Role.COLOUR])


def test_results_are_not_overwritten_by_the_next_frame(device):
    pipeline = Pipeline([toys.Sum()], device)
    first = pipeline(make_frame(1))
    kept = first[Role.COLOUR].copy()
    pipeline(make_frame(2))
    assert np.array_equal(first[Role.COLOUR], kept)


def test_memory_of_results_serves_again_when_nobody_holds_them(device):
    pipeline = Pipeline([ToneMap()], device)
    first = pipeline(make_frame(1))[Role.COLOUR]
    part, place, pixels = first[1:], first.ctypes.data, first[1:].copy()
    del first
    second = pipeline(make_frame(2))[Role.COLOUR]
    np.testing.assert_array_equal(part, pixels)
    assert second.ctypes.data != place
    del part
    assert pipeline(make_frame(3))[Role.COLOUR].ctypes.data == place


def test_commands_for_small_planes_in_new_memory_are_known(device, monkeypatch):
    frames, place = [make_frame(number) for number in range(1, 8)], make_frame(1)
    known, pipeline = (Pipeline([ToneMap()], device) for _ in range(2))
    for number, frame in enumerate(frames):
        if number == 3:
            # of commands that were just recorded
            monkeypatch.setattr("postfx.runtime.commands.Footprint", None)
        place[Role.COLOUR][:] = frame[Role.COLOUR]
        given = frame[Role.COLOUR].copy()
        expected, found = known(place)[Role.COLOUR], pipeline(frame)[Role.COLOUR]
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(frame[Role.COLOUR], given)


def test_sequence_equals_frame_by_frame(device):
    frames = [make_frame(number, reset=number == 3) for number in range(1, 6)]
    pipeline = Pipeline([toys.Sum()], device)
    together = [pipeline(frame) for frame in frames]
    alone = Pipeline([toys.Sum()], device)
    apart = [alone(frame) for frame in frames]
    for one, other in zip(together, apart, strict=True):
        assert np.array_equal(one[Role.COLOUR], other[Role.COLOUR])
    expected = sum(frame[Role.COLOUR].astype(np.float64) for frame in frames[2:])
    np.testing.assert_allclose(together[-1][Role.COLOUR], expected, rtol=1e-6)


def test_metadata_reaches_the_passes_and_the_result(device):
    probe = Probe()
    frame = make_frame(12, jitter=(0.25, -0.5), reset=True, samples=4, fov_x=40.0, exposure=1.0,
                       world_to_camera=np.eye(4), metadata={"owner": "me"}, source="noisy.0012.exr")
    pipeline = Pipeline([probe], device, exposure="metadata")
    result = pipeline(frame)
    seen = probe.seen[0]
    assert (seen.number, seen.jitter, seen.reset, seen.samples, seen.fov_x) == (12, (0.25, -0.5),
                                                                                True, 4, 40.0)
    assert seen.exposure_factor == pipeline.exposure_factor == 2.0 and pipeline.exposure == 1.0
    assert seen.metadata["owner"] == "me"
    assert np.array_equal(seen.world_to_camera, np.eye(4))
    assert (result.number, result.jitter, result.reset, result.exposure) == (12, (0.25, -0.5), True,
                                                                             1.0)
    assert result.metadata == {"owner": "me"} and result.source == "noisy.0012.exr"


def test_a_pass_may_take_the_jitter_away(device):
    frame = make_frame(roles=(Role.COLOUR, Role.DEPTH), jitter=(0.25, 0.25))
    assert Pipeline([toys.Enlarge()],
                    device)(frame).jitter == (0.0, 0.0) and frame.jitter == (0.25, 0.25)


def test_exposure_is_metered_frame_by_frame(device):
    probe = Probe()
    pipeline = Pipeline([probe], device, exposure="auto")
    frames = [make_frame(number) for number in (1, 2)]
    frames[1].planes[Role.COLOUR] *= 8
    for frame in frames:
        pipeline(frame)
    meter = ExposureMeter("auto")
    assert [seen.exposure_factor for seen in probe.seen] == [meter(frame) for frame in frames]
    assert Pipeline([probe], device,
                    exposure=1.5)(make_frame()) and probe.seen[-1].exposure_factor == 2**1.5


def test_compiles_once_a_spec_and_only_for_planes_that_are_read(device):
    probe = Probe()
    pipeline = Pipeline([probe], device)
    for number in (1, 2, 3):
        pipeline(make_frame(number))
    pipeline(make_frame(4, roles=(Role.COLOUR, Role.NORMAL)))
    assert probe.compiled == [FrameSpec(24, 40, (Role.COLOUR,))]
    pipeline(make_frame(5, size=(32, 40)))
    pipeline(make_frame(6, roles=(Role.COLOUR, Role.ALPHA)))
    assert [(spec.width, len(spec.roles)) for spec in probe.compiled] == [(24, 1), (32, 1), (24, 2)]


def test_planes_that_nobody_touches_go_through_without_a_copy(device):
    frame = make_frame(roles=(Role.COLOUR, Role.ALPHA, Role.NORMAL))
    result = Pipeline([toys.Sum()], device)(frame)
    assert result[Role.ALPHA] is frame[Role.ALPHA] and result[Role.NORMAL] is frame[Role.NORMAL]
    assert result[Role.COLOUR] is not frame[Role.COLOUR]


def test_planes_of_another_size_are_dropped(device):
    result = Pipeline([toys.Enlarge()],
                      device)(make_frame(roles=(Role.COLOUR, Role.DEPTH, Role.NORMAL)))
    assert result.spec == FrameSpec(48, 80, (Role.COLOUR,))


def test_guides_reach_the_pass_that_reads_them(device):
    pipeline = Pipeline([toys.AddGuide()], device)
    for number in (1, 2):
        frame = make_frame(number, (6, 10), guides=toys.make_guides((12, 20)),
                           guide_jitter=(0.25, -0.25), guide_source="guides.exr")
        result = pipeline(frame)
        wanted = frame[Role.COLOUR].repeat(2, 0).repeat(2, 1) + frame.guides[Role.DIFFUSE_ALBEDO]
        np.testing.assert_array_equal(result[Role.COLOUR], wanted)
        assert result.guides == {} and result.guide_size is None
        assert result.guide_jitter == (0, 0) and result.guide_source is None
    bare = make_frame(1, (6, 10))
    np.testing.assert_array_equal(pipeline(bare)[Role.COLOUR],
                                  bare[Role.COLOUR].repeat(2, 0).repeat(2, 1))


def test_guides_that_nobody_reads_go_through_and_compile_nothing_anew(device):
    probe = Probe()
    pipeline = Pipeline([probe], device)
    frame = make_frame(guides=toys.make_guides((48, 80)), guide_jitter=(0.25, -0.25))
    result = pipeline(frame)
    assert all(result.guides[role] is guide for role, guide in frame.guides.items())
    pipeline(make_frame(guides=toys.make_guides((48, 80), (Role.DEPTH,))))
    assert (len(probe.compiled) == 1 and probe.seen[0].guides == {}
            and probe.seen[0].guide_jitter == (0.25, -0.25))


def test_nothing_to_do(device):
    frame = make_frame()
    pipeline = Pipeline([toys.Double(times=0)], device)
    result = pipeline(frame)
    assert result is not frame and result[Role.COLOUR] is frame[Role.COLOUR]
    assert pipeline.timings == {} and pipeline.exposure is None
    assert pipeline.explain().skips[0].why == "times is 0"


def test_timings_of_each_pass(device, library):
    pipeline = Pipeline([toys.Double(library=library), toys.Sum(), toys.Sum()], device)
    pipeline(make_frame())
    assert list(pipeline.timings) == ["double", "sum", "sum 2"]
    assert all(0 < elapsed < 10_000 for elapsed in pipeline.timings.values())


def test_explain_needs_a_spec_until_a_frame_has_run(device):
    pipeline = Pipeline([toys.Enlarge()], device)
    with pytest.raises(FrameError, match="there is no plan yet"):
        pipeline.explain()
    spec = FrameSpec(24, 40, (Role.COLOUR, Role.DEPTH))
    assert pipeline.explain(spec).output.width == 48
    pipeline(make_frame(roles=(Role.COLOUR, Role.DEPTH)))
    assert pipeline.explain().available == spec


def test_missing_plane(device):
    with pytest.raises(MissingPlaneError, match="'enlarge' needs AOV 'depth'"):
        Pipeline([toys.Enlarge()], device)(make_frame())


def test_the_same_pipeline_by_portable_kernels(device, library, tmp_path):
    portable = Device("cpu", compiled_kernels=False, kernels=toys.make_kernels(tmp_path))
    frames = [make_frame(number, roles=(Role.COLOUR, Role.DEPTH)) for number in (1, 2)]
    results = []
    for where in (device, portable):
        pipeline = Pipeline([toys.Double(library=library), toys.Sum(), toys.Enlarge()], where)
        results.append([pipeline(frame)[Role.COLOUR] for frame in frames])
    assert np.array_equal(results[0], results[1])


class Misbehaving(toys.Sum):
    """A sum with a fault that is switched on for one frame."""

    name = "misbehaving"
    fault = None

    def encode(self, commands, frame):
        colour = frame[Role.COLOUR]
        super().encode(commands, frame)
        if self.fault == "size":
            frame.set(Role.COLOUR, colour.view("part", (1, 1, 3)))
        elif self.fault == "drop":
            del frame.tensors[Role.COLOUR]
        elif self.fault == "hazard":
            self._read_nothing(commands, frame)
        elif self.fault:
            raise self.fault

    def _read_nothing(self, commands, frame):
        from postfx.runtime import ArgumentTable

        total = frame[Role.COLOUR]
        nothing = commands.device.heap.tensor("nothing", frame[Role.COLOUR].shape)
        with commands.compute_encoder("unwritten") as encoder:
            encoder.dispatch(self._state,
                             ArgumentTable(self._state,
                                           {"a": nothing, "b": nothing, "total": total}))


@pytest.mark.parametrize(("fault", "error", "message"), [
    ("size", PassContractError,
     "pass 'misbehaving' did not leave plane 'colour' as its reflection declares"),
    ("drop", PassContractError, "did not leave plane 'colour'"),
    ("hazard", HazardError, "'misbehaving/unwritten'"),
    (RuntimeError("out of ideas"), RuntimeError, "out of ideas"),
    (KeyboardInterrupt("stop"), KeyboardInterrupt, "stop"),
])
def test_a_failed_frame_drops_the_history_and_the_next_one_works(device, fault, error, message):
    instance = Misbehaving()
    pipeline = Pipeline([instance], device)
    for number in (1, 2):
        pipeline(make_frame(number))
    instance.fault = fault
    with pytest.raises(error, match=message):
        pipeline(make_frame(2))
    instance.fault = None
    assert np.array_equal(pipeline(make_frame(3))[Role.COLOUR], make_frame(3)[Role.COLOUR])


def test_a_failed_command_names_the_pass(device):
    from postfx.kernels import Kernel

    def fail(y0, y1, a, b, total):
        raise ValueError("cannot add")

    class Failing(toys.Sum):
        name = "failing"

        def compile(self, device, spec):
            super().compile(device, spec)
            kernel = Kernel("add", ("a", "b"), ("total",), fail, ("total", 0))
            self._state = device.compute_state(kernel)

    with pytest.raises(CommandError,
                       match=r"'failing/add' \(kernel 'add'\) of 'frame 1' failed: cannot add"):
        Pipeline([Failing()], device)(make_frame(1))


def test_a_pass_that_keeps_an_input_is_found_out(device):
    class Hoarder(toys.Sum):
        name = "hoarder"

        def encode(self, commands, frame):
            colour = frame[Role.COLOUR]
            super().encode(commands, frame)
            self._sums[0] = colour

    pipeline = Pipeline([Hoarder()], device)
    pipeline(make_frame(1))
    with pytest.raises(BindingError, match="'colour' was released"):
        pipeline(make_frame(2))


def test_pipelines_share_the_default_device():
    assert Pipeline([]).device is Pipeline([]).device


def test_frame_is_left_alone(device):
    frame = make_frame(3, jitter=(0.1, 0.2))
    colour = frame[Role.COLOUR].copy()
    Pipeline([toys.Sum()], device)(frame)
    assert (np.array_equal(frame[Role.COLOUR], colour) and isinstance(frame, Frame)
            and frame.number == 3)


@pytest.mark.parametrize("own", [True, False])
def test_a_pickled_pipeline_begins_anew(own, device, monkeypatch):
    # toys have no CUDA kernels
    monkeypatch.setattr("postfx.pipeline.default_device", lambda: device)
    pipeline = Pipeline([toys.Sum()], device if own else None, cuts="none")
    first = pipeline(make_frame(1))
    pipeline(make_frame(2))
    copied = pickle.loads(pickle.dumps(pipeline))
    assert copied.plan is None and copied.device.name == pipeline.device.name
    assert copied.device.threads == pipeline.device.threads
    assert (copied.device is not pipeline.device) == own
    assert copied(make_frame(1)) == first
    assert copied.exposure_factor == Pipeline([toys.Sum()], device,
                                              cuts="none")._meter(make_frame(1))


class Slow(Probe):
    """Waits within a frame until it may go on."""

    def __init__(self):
        super().__init__()
        self.began, self.may_end = threading.Event(), threading.Event()

    def encode(self, commands, frame):
        super().encode(commands, frame)
        self.began.set()
        assert self.may_end.wait(60)


def test_a_pipeline_in_two_threads_is_refused(device):
    slow = Slow()
    pipeline = Pipeline([slow], device)
    results = []
    other = threading.Thread(target=lambda: results.append(pipeline(make_frame(1))))
    other.start()
    assert slow.began.wait(60)
    with pytest.raises(EncodingError, match="make a Pipeline of its own for each thread"):
        pipeline(make_frame(2))
    with pytest.raises(EncodingError, match="make a Pipeline of its own for each thread"):
        pipeline.on_device(make_frame(2).planes)
    slow.may_end.set()
    other.join(60)
    assert len(results) == 1 and len(slow.seen) == 1
    pipeline(make_frame(2))


def test_a_pickled_pass_has_its_options():
    for one in (DenoiseUpscale(scale=1.5, model="s"), ToneMap(keep=0.5), Display(display="pq"),
                Overlay()):
        copied = pickle.loads(pickle.dumps(one))
        assert type(copied) is type(one) and copied.options == one.options
