"""Planes that stay where they lie: arrays of other libraries in, tensors for other libraries out.

There may be no GPU here. What only a GPU can do is left to the test with the mark `gpu`; the rest
runs on the host's memory, once as the CPU's, once as a device's that NumPy does not see, with
arrays that say that they are there.
"""

import ctypes
import gc
import statistics
import time

import numpy as np
import pytest

from postfx import (
    DenoiseUpscale,
    Device,
    Frame,
    MixPartner,
    Partner,
    Pipeline,
    PostfxError,
    Role,
    stills,
)
from postfx.errors import FrameError
from postfx.passes import Downloads, share_planes
from postfx.passes.display import View
from postfx.runtime import ArgumentTable, BindingError, HazardError, Tensor, memory
from postfx.runtime import device as device_module
from postfx.runtime.device import ProviderMemory, cuda_fault
from postfx.runtime.session import Placement
from postfx.runtime.tensor import element_type

gpu = pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
RNG = np.random.default_rng(0)
SIZE = (36, 48)
PLANES = {Role.COLOUR: RNG.random((*SIZE, 3), np.float32),
          Role.DEPTH: 1 + RNG.random((*SIZE, 1), np.float32),
          Role.MOTION: 1 + RNG.random((*SIZE, 2), np.float32),
          Role.NORMAL: RNG.random((*SIZE, 3), np.float32),
          Role.DIFFUSE_ALBEDO: RNG.random((*SIZE, 3), np.float32)}


class There:
    """An array in a device's memory as other libraries show it: by DLPack, by CUDA's interface, or
    by both."""

    def __init__(self, array, place=(2, 0), how=("dlpack", "cuda"), **told):
        self.array, self.streams = array, []
        if "dlpack" in how:
            self.__dlpack_device__ = lambda: place
        if "cuda" in how:
            self.__cuda_array_interface__ = {
                "shape": array.shape, "typestr": array.dtype.str,
                "data": (memory.address(array), False),
                "strides": None if array.flags.c_contiguous else array.strides, "version": 3,
                "stream": None, **told}
        if "dlpack" in how:
            self.__class__ = type("There", (There,),
                                  {"__dlpack__": There.give, "__dlpack_device__": lambda _: place})

    def give(self, *, stream=None):
        self.streams.append(stream)
        return memory.lend(memory.address(self.array), self.array.shape, self.array.dtype.name,
                           (2, 0), self.array)


@pytest.fixture
def far(monkeypatch):
    """A device whose memory counts as that of the first GPU."""

    class Far(ProviderMemory):
        followed = []

        def __init__(self, placement):
            super().__init__(placement)
            self.place = (2, 0)

        def follow(self, stream):
            self.followed.append(stream)
            return 7

    placement = Placement("CPUExecutionProvider", "cpu", 0, 2)
    monkeypatch.setattr(device_module, "choose", lambda *rest: (placement, Far(placement)))
    return Device("auto")


def frames():
    moved = {role: np.roll(plane, 1, axis=1) for role, plane in PLANES.items()}
    return [PLANES, moved, PLANES]


def expected(device):
    pipeline = Pipeline([DenoiseUpscale(model="s", scale=2)], device, exposure=0.0, cuts="none")
    return [pipeline(Frame(dict(planes), number)) for number, planes in enumerate(frames(), 1)]


def test_on_the_host_it_is_the_pipeline_without_copies():
    torch = pytest.importorskip("torch")
    pipeline = Pipeline([DenoiseUpscale(model="s", scale=2)], Device("cpu"), cuts="none")
    results = []
    for number, planes in enumerate(frames(), 1):
        given = {str(role): torch.from_numpy(plane.copy()) for role, plane in planes.items()}
        found = pipeline.on_device(given, exposure=0.0, number=number)
        results.append(torch.from_dlpack(found[Role.COLOUR]))
        assert results[-1].data_ptr() == found[Role.COLOUR].start and list(found) == [Role.COLOUR]
    for result, right in zip(results, expected(Device("cpu")), strict=True):
        assert np.array_equal(result.numpy(), right[Role.COLOUR])  # also the first, two calls later


@pytest.mark.parametrize("how", [("cuda",), ("dlpack",)])
def test_arrays_of_a_device_stay_there(far, how, monkeypatch):
    pipeline = Pipeline([DenoiseUpscale(model="s", scale=2)], far, cuts="none")
    right = expected(far)
    copied = []
    for verb in ("write", "read"):
        original = getattr(far.memory, verb)
        monkeypatch.setattr(far.memory, verb, lambda pointer, array, original=original, verb=verb: (
            copied.append((verb, array.nbytes)), original(pointer, array)))
    for number, planes in enumerate(frames(), 1):
        del copied[:], far.memory.followed[:]
        given = {role: There(plane, how=how, **({"stream": 5} if how == ("cuda",) else {}))
                 for role, plane in planes.items()}
        found = pipeline.on_device(given, exposure=0.0, number=number)
        # parameters; first, what is missing
        assert (number == 1 or sum(nbytes for _, nbytes in copied) < 1000), copied
        assert found[Role.COLOUR].__dlpack_device__() == (2, 0)
        assert np.array_equal(found[Role.COLOUR].download(), right[number - 1][Role.COLOUR])
        if how == ("cuda",):
            assert far.memory.followed == [5] * len(planes)
        else:
            assert all(array.streams == [7] for array in given.values())
    told, start = found[Role.COLOUR].__cuda_array_interface__, found[Role.COLOUR].start
    assert (told["shape"] == (72, 96, 3) and told["typestr"] == "<f4"
            and told["data"] == (start, False))


def test_an_interface_without_a_stream_leaves_the_waiting_to_dlpack(far):
    """Kernels of its producer may still write the array."""
    array = There(PLANES[Role.COLOUR])
    del array.__cuda_array_interface__["stream"]
    assert (np.array_equal(far.wrap("colour", array).download(), array.array)
            and array.streams == [7])
    only = There(PLANES[Role.COLOUR], how=("cuda",))
    del only.__cuda_array_interface__["stream"]
    assert np.array_equal(far.wrap("colour", only).download(), only.array)


def test_tensors_of_pytorch_are_looked_at(far, monkeypatch):
    """What PyTorch's current stream has to do is waited for, without its slow DLPack."""
    torch = pytest.importorskip("torch")

    class Far(torch.Tensor):
        __dlpack__ = None

        def __dlpack_device__(self):
            return 2, 0

    monkeypatch.setattr(torch.cuda, "current_stream",
                        lambda index: type("Stream", (), {"cuda_stream": 40 + index}))
    plane = torch.rand(4, 5, 3)
    planes = {role: torch.rand(4, 5, 3).as_subclass(Far) for role in (Role.COLOUR, Role.NORMAL)}
    last = {}
    for calls in (2, 1, 1):  # for the same tensors once
        del far.memory.followed[:]
        last, before = share_planes(far, "plane", planes, last), last
        assert (far.memory.followed == [40] * calls
                and all(last[role] is before[role] for role in before))
    planes[Role.COLOUR].data = torch.rand(4, 5, 3)  # elsewhere, and the other one of another type
    planes[Role.NORMAL].data = torch.rand(4, 5, 3).half()
    assert share_planes(far, "plane", {Role.COLOUR: planes[Role.COLOUR]},
                        last)[Role.COLOUR] is not last[Role.COLOUR]
    with pytest.raises(FrameError, match="float16"):
        share_planes(far, "plane", planes, last)
    for given, dtype in ((plane, "float32"), (plane[1:].half(), "float16"),
                         (plane.bfloat16()[:0], "bfloat16")):
        del far.memory.followed[:]
        tensor = far.wrap("x", given.as_subclass(Far))
        assert (tensor.shape, tensor.dtype, far.memory.followed) == (tuple(given.shape), dtype,
                                                                     [40])
        assert tensor.start == given.data_ptr()
    tensor = far.wrap("x", plane.clone().as_subclass(Far))  # which nobody else keeps alive
    gc.collect()
    assert np.array_equal(tensor.download(), plane.numpy())
    for wrong, message in ((plane.transpose(0, 1), "do not lie in order"),
                           (plane.clone().requires_grad_(), "detach"),
                           (torch.rand(3, dtype=torch.complex64), "cannot be of type complex64")):
        with pytest.raises(BindingError, match=message):
            far.wrap("x", wrong.as_subclass(Far))


def test_exposure_by_the_meter_and_planes_that_no_pass_reads():
    pipeline = Pipeline([DenoiseUpscale(model="s")], Device("cpu"))
    found = pipeline.on_device(PLANES)
    whole = Pipeline([DenoiseUpscale(model="s")], Device("cpu"))
    assert np.array_equal(found[Role.COLOUR].array, whole(Frame(dict(PLANES)))[Role.COLOUR])
    assert pipeline.exposure == whole.exposure != 0.0


def test_guides_of_torch_give_the_picture_of_a_frames_guides():
    torch = pytest.importorskip("torch")
    sharp = {Role.DIFFUSE_ALBEDO: RNG.random((72, 96, 3), np.float32),
             Role.NORMAL: RNG.random((72, 96, 3), np.float32)}
    plain = Pipeline([DenoiseUpscale(model="m", scale=2)], Device("cpu"), exposure=0.0)
    right = plain(Frame(dict(PLANES), guides=dict(sharp)))
    guides = {role: torch.from_numpy(plane) for role, plane in sharp.items()}
    found = plain.on_device(PLANES, exposure=0.0, guides=guides, reset=True)
    assert np.array_equal(found[Role.COLOUR].array, right[Role.COLOUR])
    assert plain.plan.available.guide_roles == (Role.NORMAL, Role.DIFFUSE_ALBEDO)


WRONG = [
    ({"colour": [1.0]}, {},
     "array 'colour' is list: give a NumPy array, or one of a library with DLPack"),
    ({"color": PLANES[Role.COLOUR][..., :2]}, {},
     r"plane 'colour' is \(36, 48, 2\) float32: it needs \(height, width"),
    ({"colour": PLANES[Role.COLOUR].astype("f8")}, {}, "plane 'colour' is .* float64: it needs"),
    ({"colours": PLANES[Role.COLOUR]}, {}, "plane 'colours' has no meaning here: did you mean"),
    ({"colour": There(PLANES[Role.COLOUR])}, {},
     "cannot be read from There: it is in the memory of cuda:0, the device is the host"),
    ({}, {}, "a frame needs at least one plane"),
    (PLANES | {Role.DEPTH: np.ones((2, 2, 1), "f4")}, {},
     "planes differ in size: colour 48x36, depth 2x2"),
    (PLANES, {"exposure": 65}, "exposure '65': use auto, lit, metadata or a number of stops"),
    (PLANES, {"exposure": float("nan")}, "exposure 'nan': use auto"),
    (PLANES, {"guides": {Role.MOTION: PLANES[Role.MOTION]}}, "plane 'motion' cannot be a guide"),
]


def test_a_stop_more_exposure_is_a_stop_more_light() -> None:
    """As in `Pipeline(exposure=1.0)`."""
    look = View(view="reinhard", exact=False)
    given = {Role.COLOUR: PLANES[Role.COLOUR], Role.NORMAL: PLANES[Role.NORMAL]}
    found = Pipeline([look], Device("cpu"),
                     cuts="none").on_device(given, exposure=1.0)[Role.COLOUR].download()
    wanted = Pipeline([View(view="reinhard", exact=False)], Device("cpu"), 1.0,
                      "none")(Frame(dict(given)))
    np.testing.assert_array_equal(found, wanted[Role.COLOUR])


@pytest.mark.parametrize("planes, options, message", WRONG)
def test_wrong_use_on_the_host(planes, options, message):
    with pytest.raises(PostfxError, match=message):
        Pipeline([DenoiseUpscale(model="s")], Device("cpu")).on_device(planes, **options)


@pytest.mark.parametrize("array, message", [
    (There(PLANES[Role.COLOUR], (2, 1), ("dlpack",)),
     "it is in the memory of cuda:1, the device is cuda:0"),
    (There(PLANES[Role.COLOUR], (10, 0), ("dlpack",)),
     r"DLPack's device \(10, 0\), the device is cuda:0"),
    (There(PLANES[Role.COLOUR][::2], how=("cuda",)),
     r"do not lie in order \(strides .* make it contiguous"),
    (There(PLANES[Role.COLOUR].astype(">f4"), how=("cuda",)), "byte order of other machines"),
    (There(PLANES[Role.COLOUR], how=("cuda",), data=None),
     "its __cuda_array_interface__ cannot be read"),
    (There(PLANES[Role.COLOUR].astype("c8"), how=("cuda",)),
     "cannot be of type complex64: use one of"),
])
def test_arrays_that_cannot_be_taken(far, array, message):
    with pytest.raises(BindingError, match=message):
        far.wrap("colour", array)


def test_read_only_arrays_are_not_written(far):
    array = There(np.zeros((2, 3), np.float32), how=("cuda",))
    array.__cuda_array_interface__["data"] = (array.__cuda_array_interface__["data"][0], True)
    with pytest.raises(BindingError, match="wraps a read-only array"):
        far.wrap("x", array).fill(1.0)


def test_what_is_lent_lives_as_long_as_it_is_used():
    device = Device("cpu")
    before = len(memory._lent)
    tensor = device.heap.tensor("x", (2, 3))
    with pytest.raises(HazardError, match="'x' is read by the host, but no command wrote it"):
        np.from_dlpack(tensor)
    tensor.fill(3.0)
    view = np.from_dlpack(tensor)
    assert (view.tolist() == [[3.0] * 3] * 2
            and ctypes.c_float.from_address(tensor.start).value == 3.0)
    used = device.heap.used
    del tensor
    gc.collect()
    assert device.heap.used == used and len(memory._lent) == before + 1 and view.sum() == 18
    del view
    gc.collect()
    assert device.heap.used == 0 and len(memory._lent) == before
    other = device.heap.tensor("y", (2,))
    other.fill(0.0)
    capsule = other.__dlpack__()
    assert len(memory._lent) == before + 1
    del capsule  # nobody opened it
    assert len(memory._lent) == before
    with pytest.raises(BufferError, match="use download.. for a copy"):
        other.__dlpack__(copy=True)
    assert not hasattr(other, "__cuda_array_interface__")


@pytest.mark.parametrize("dtype", ["float32", "float16", "bfloat16", "float64", "int64", "int8",
                                   "uint16", "bool"])
def test_every_type_is_shared(dtype):
    torch = pytest.importorskip("torch")
    device = Device("cpu")
    tensor = device.heap.tensor("x", (3,), dtype)
    tensor.upload(np.array([0, 1, 1]).astype(element_type(dtype)))
    shared = torch.from_dlpack(tensor)
    assert str(shared.dtype) == f"torch.{dtype}" and shared.float().tolist() == [0, 1, 1]
    if dtype == "bfloat16":
        # as NumPy has no such type
        with pytest.raises(BindingError, match="'y' cannot be read from Tensor"):
            device.wrap("y", shared)
    else:
        assert device.wrap("y", shared).array.astype("f4").tolist() == [0, 1, 1]


def test_a_plane_that_was_deleted_is_gone_though_it_was_looked_at():
    device = Device("cpu", threads=1)
    held = Downloads({role: device.wrap(str(role), plane) for role, plane in PLANES.items()})
    assert set(held) == set(PLANES) and len(held) == len(PLANES)
    for role, plane in PLANES.items():
        np.testing.assert_array_equal(held[role], plane)
    del held[Role.DEPTH]
    assert Role.DEPTH not in held and Role.DEPTH not in list(held)
    held[Role.NORMAL] = other = -PLANES[Role.NORMAL]
    assert held[Role.NORMAL] is other
    held.pop(Role.NORMAL)
    assert Role.NORMAL not in held and set(held) == set(PLANES) - {Role.DEPTH, Role.NORMAL}


class Lent:
    """A tensor of ours as an array of another library, which knows one protocol only."""

    def __init__(self, tensor, how):
        self._tensor = tensor
        if how == "cuda":
            self.__cuda_array_interface__ = tensor.__cuda_array_interface__

    @classmethod
    def by(cls, how):
        """The class for a protocol: a library looks for methods in the class."""
        methods = {"__dlpack__": lambda self, **given: self._tensor.__dlpack__(**given),
                   "__dlpack_device__": lambda self: self._tensor.__dlpack_device__()}
        return type("Lent", (cls,), methods) if how == "dlpack" else cls


@pytest.mark.gpu
@gpu
@pytest.mark.parametrize("how", ["cuda", "dlpack"])
def test_planes_on_a_gpu_give_the_picture_of_frames(how):
    """The same pictures as from frames; sharing a frame's planes and its result adds at most 0.1
    ms."""
    device = Device("cuda")
    pipeline = Pipeline([DenoiseUpscale(model="s", scale=2)], device, cuts="none")
    memory_of = Lent.by(how)
    held = {role: device.heap.tensor(str(role), plane.shape) for role, plane in PLANES.items()}
    for number, (planes, right) in enumerate(zip(frames(), expected(device), strict=True), 1):
        for role, plane in planes.items():
            held[role].upload(plane)
        lent = {role: memory_of(tensor, how) for role, tensor in held.items()}
        found = pipeline.on_device(lent, exposure=0.0, number=number)
        again = device.wrap("again", memory_of(found[Role.COLOUR], how))
        assert again.start == found[Role.COLOUR].start
        assert np.abs(again.download() - right[Role.COLOUR]).max() < 1e-2 * right[Role.COLOUR].max()
    given, times = [memory_of(tensor, how) for tensor in held.values()], []
    for _ in range(50):
        begin = time.perf_counter()
        for array in given:
            device.wrap("plane", array)
        device.wrap("result", memory_of(found[Role.COLOUR], how))
        times.append(time.perf_counter() - begin)
    print(f"sharing {len(given)} planes and a result by {how}: "
          f"{1e3 * statistics.median(times):.3f} ms")
    assert statistics.median(times) < 1e-4


@pytest.mark.gpu
@gpu
def test_tensors_of_pytorch_on_a_gpu():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("needs PyTorch for CUDA")
    device = Device("cuda")
    planes = {role: torch.from_numpy(plane).cuda() for role, plane in PLANES.items()}
    found = Pipeline([DenoiseUpscale(model="s", scale=2)],
                     device).on_device(planes, exposure=0.0)[Role.COLOUR]
    assert torch.from_dlpack(found).is_cuda
    assert np.array_equal(torch.from_dlpack(found).cpu().numpy(), found.download())
    assert torch.equal(torch.as_tensor(found, device="cuda"), torch.from_dlpack(found))
    times = []
    for _ in range(50):
        begin = time.perf_counter()
        for plane in planes.values():
            device.wrap("plane", plane)
        torch.from_dlpack(found)
        times.append(time.perf_counter() - begin)
    print(f"sharing {len(planes)} planes of PyTorch and a result: "
          f"{1e3 * statistics.median(times):.3f} ms")
    assert statistics.median(times) < 1e-4
    large = torch.randn(4096, 4096, device="cuda")
    for _ in range(3):  # our stream waits for what PyTorch's still has to do
        late = large
        for _ in range(20):
            late = late @ large / 64
        seen = device.wrap("late", late)
        held = device.heap.tensor("held", tuple(late.shape))
        device.memory.copy(held.start, seen.start, seen.nbytes)
        device.memory.synchronise()
        device.hazards.mark_written(held)
        assert np.array_equal(held.download(), late.cpu().numpy())


@pytest.mark.gpu
@gpu
def test_a_still_of_pytorch_on_a_gpu():
    """Its result is a tensor there, of the same values as on the way through the host."""
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("needs PyTorch for CUDA")
    given = {name: torch.from_numpy(PLANES[Role(name)]).cuda()
             for name in ("color", "albedo", "normal")}
    found = [stills.denoise(**given, model="s", exposure=1.0) for _ in range(3)]
    assert all(one.is_cuda and one.device == given["color"].device for one in found)
    assert all(torch.equal(one, found[0]) for one in found[1:])
    host = {name: PLANES[Role(name)] for name in given}
    right = stills.denoise(**host, model="s", exposure=1.0, device="cuda")
    np.testing.assert_allclose(found[0].cpu().numpy(), right, rtol=1e-3, atol=1e-3)


def test_work_of_other_libraries_gets_copies_of_what_lies_on_a_device(far):
    given, found = There(PLANES[Role.COLOUR]), {}

    def double(colour, output):
        found["colour"] = colour.copy()
        output[...] = 2 * colour

    state = far.host_state("double", ("colour",), ("output",), double)
    output = far.heap.tensor("doubled", PLANES[Role.COLOUR].shape)
    table = ArgumentTable(state, {"colour": far.wrap("colour", given), "output": output})
    commands = far.command_buffer("work")
    with commands.compute_encoder("double") as encoder:
        encoder.dispatch(state, table)
    commands.commit()
    commands.wait(timeout=60)
    assert np.array_equal(found["colour"], PLANES[Role.COLOUR])
    assert np.array_equal(output.download(), 2 * PLANES[Role.COLOUR])


def test_a_partner_that_runs_on_the_host_gives_the_same_on_a_device(far):
    pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")
    passes = [[Partner(), DenoiseUpscale(model="s", scale=2), MixPartner()] for _ in range(2)]
    here, there = (Pipeline(some, device, exposure=0.0, cuts="none")
                   for some, device in zip(passes, (Device("cpu", 2, compiled_kernels=False), far),
                                           strict=True))
    for number, planes in enumerate(frames(), 1):
        right = here(Frame(dict(planes), number))
        found = there.on_device({role: There(plane) for role, plane in planes.items()},
                                exposure=0.0, number=number)
        np.testing.assert_allclose(found[Role.COLOUR].download(), right[Role.COLOUR], rtol=1e-3,
                                   atol=1e-3)


def test_a_still_on_a_gpu_stays_there(far):
    """`postfx.denoise` takes its arrays where they are, and gives an array of the same library."""
    given = {name: There(PLANES[Role(name)]) for name in ("color", "albedo", "normal")}
    stills._pipeline.cache_clear()
    found = stills.denoise(given.pop("color"), **given, model="s", exposure=1.0, device="auto")
    stills._pipeline.cache_clear()
    assert isinstance(found, Tensor) and found.__dlpack_device__() == (2, 0)
    planes = {role: PLANES[role] for role in (Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.NORMAL)}
    right = Pipeline([DenoiseUpscale(model="s")], far, exposure=1.0)(Frame(planes))[Role.COLOUR]
    np.testing.assert_allclose(found.download(), right, rtol=1e-4, atol=1e-5)


def test_results_that_are_held_stay_as_they_are(far):
    """As of a list of pictures that are denoised one after the other."""
    stills._pipeline.cache_clear()
    pictures = [There((PLANES[Role.COLOUR] * factor).astype("f4")) for factor in (1, 2, 4, 8)]
    found = [stills.denoise(one, model="s", exposure=1.0, device="auto") for one in pictures]
    assert len({one.start for one in found}) == len(found)
    before = [stills.denoise(one, model="s", exposure=1.0, device="auto").download()
              for one in pictures]
    stills._pipeline.cache_clear()
    for held, right in zip(found, before, strict=True):
        np.testing.assert_array_equal(held.download(), right)


def test_a_still_on_a_gpu_has_three_channels(far):
    with_alpha = There(np.dstack([PLANES[Role.COLOUR], np.ones((36, 48, 1), "f4")]))
    with_alpha.shape = with_alpha.array.shape
    with pytest.raises(PostfxError,
                       match=r"color is \(36, 48, 4\) on a GPU.*give color\[..., :3\]"):
        stills.denoise(with_alpha, model="s", device="auto")


def test_the_gpu_of_an_array_is_the_device(monkeypatch):
    asked = []
    monkeypatch.setattr(stills, "_pipeline",
                        lambda *options: asked.append(options[4]) or pytest.skip)
    for place, wanted in (((2, 1), "cuda:1"), ((1, 0), None), ((3, 0), None)):
        with pytest.raises(AttributeError):
            stills.denoise(There(PLANES[Role.COLOUR], place=place), model="s")
        assert asked.pop() == wanted
