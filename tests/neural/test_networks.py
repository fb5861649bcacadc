"""Small networks: their results, gradients and steps are those of torch, in every form and on any
threads."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from postfx.compiled import library
from postfx.errors import BindingError, DeviceError, ModelError
from postfx.kernels.neural import ADAM, FORWARD, GRADIENTS, GRID, GRID_PULL, GRID_STEP, UNITS
from postfx.neural import DECAYS, EPSILON, Grid, Learner, Network
from postfx.runtime import ArgumentTable, Device, Library
from postfx.runtime.device import cuda_fault
from postfx.runtime.encoders import EncoderBarrier
from tests.kernels import host_cuda, neural_cases
from tests.kernels.neural_cases import HYPER, NETWORKS

pytestmark = pytest.mark.usefixtures("every_level")
IDS = ["-".join(map(str, network.sizes)) for network in NETWORKS]
every_network = pytest.mark.parametrize("network", NETWORKS, ids=IDS)


class Twin:
    """The network in torch, and its points and targets; no ReLU's argument is so near 0 that
    rounding decides."""

    def __init__(self, network: Network, count: int = 700) -> None:
        random = np.random.default_rng(1)
        parameters = network.initial(2)
        self.network = network
        self.start = parameters + random.normal(0, 0.02, parameters.shape).astype(np.float32)
        self.layers = []
        for weights, biases in network.layers(self.start.copy()):
            layer = torch.nn.Linear(weights.shape[1], weights.shape[0])
            layer.weight.data, layer.bias.data = torch.from_numpy(weights), torch.from_numpy(biases)
            self.layers.append(layer)
        self.points = random.uniform(-1, 1, (count, network.inputs)).astype(np.float32)
        with torch.no_grad():
            self.run(torch.from_numpy(self.points))
        if network.activation == "relu":
            self.points = self.points[self.nearest.numpy() > 1e-5]
        assert len(self.points) > 0.9 * count
        self.targets = random.normal(size=(len(self.points), network.outputs)).astype(np.float32)

    def run(self, points: torch.Tensor) -> torch.Tensor:
        network, row = self.network, points
        encoded = network.inputs if network.encoded is None else network.encoded
        if network.bands:
            angles = points[:, None, :encoded] * (2.0 ** torch.arange(network.bands)
                                                  * np.pi)[:, None]
            waves = torch.stack([angles.sin(), angles.cos()], -1)
            row = torch.cat([points, waves.reshape(len(points), -1)], 1)
        activation = {"relu": torch.relu, "gelu": torch.nn.functional.gelu,
                      "sine": torch.sin}[network.activation]
        self.nearest = torch.full((len(points),), np.inf)
        for layer in self.layers[:-1]:
            row = layer(row)
            self.nearest = torch.minimum(self.nearest, row.abs().amin(1))
            row = activation(row)
        return self.layers[-1](row)

    def gradients(self, targets: np.ndarray) -> tuple[np.ndarray, float]:
        """Of the mean squared error, and that error."""
        loss = ((self.run(torch.from_numpy(self.points)) - torch.from_numpy(targets)) ** 2).mean()
        parts = [part for layer in self.layers for part in layer.parameters()]
        return (np.concatenate([g.numpy().ravel() for g in torch.autograd.grad(loss, parts)]),
                loss.item())


def in_frame(device: Device, learner: Learner, points: np.ndarray, targets: np.ndarray,
             steps: int = 1) -> np.ndarray:
    """Values after `steps` steps, all in one command buffer."""
    places, wanted = device.wrap("points", points), device.wrap("targets", targets)
    values = device.heap.tensor("values", targets.shape)
    commands = device.command_buffer("frame")
    with commands.compute_encoder("network") as encoder:
        for _ in range(steps):
            learner.learn(encoder, places, wanted)
        learner.run(encoder, places, values)
    commands.commit()
    commands.wait()
    return values.download()


def gradients_of(learner):
    """Of the mean squared error of the points that were learnt."""
    sums = learner._last.download().sum(0)
    return sums[:-2] / sums[-1]


@every_network
def test_values_and_gradients_are_those_of_torch(network):
    twin = Twin(network)
    device = Device("cpu", threads=2)
    learner = Learner(device, network, 0.0, twin.start)
    values = in_frame(device, learner, twin.points, twin.targets)
    wanted, error = twin.gradients(twin.targets)
    found = gradients_of(learner)
    np.testing.assert_allclose(values, twin.run(torch.from_numpy(twin.points)).detach(), atol=1e-5,
                               rtol=1e-5)
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    assert learner.error() == pytest.approx(error, rel=1e-5) and abs(wanted).max() > 0.01


def test_steps_are_those_of_adam_in_torch():
    """The same gradients to both, as tiny ones decide the sign of a step."""
    random = np.random.default_rng(0)
    start = random.normal(size=50).astype(np.float32)
    partials = random.normal(size=(3, 52)).astype(np.float32)
    partials[:, -1] = 0.25, 0, 0.25  # half of the points are learnt
    parameters = torch.nn.Parameter(torch.from_numpy(start.copy()))
    adam = torch.optim.Adam([parameters], 0.01, DECAYS, EPSILON)
    found, moments = start.copy(), np.zeros((50, 3), np.float32)
    for step in range(5):
        scaled = partials * np.append(np.full(51, 1 + step), 1).astype(np.float32)
        parameters.grad = torch.from_numpy(2 * scaled[:, :-2].sum(0))
        adam.step()
        ADAM.rows(0, 20, scaled, HYPER, found, moments)
        ADAM.rows(20, 50, scaled, HYPER, found, moments)
        np.testing.assert_allclose(found, parameters.detach(), atol=1e-6)
    assert (moments[:, 2] == 5).all()


def test_threads_do_not_change_a_bit():
    network, twin = NETWORKS[2], Twin(NETWORKS[2], 2500)
    results = []
    for threads in (1, 2):
        device = Device("cpu", threads=threads)
        learner = Learner(device, network, 1e-3, twin.start)
        results.append((in_frame(device, learner, twin.points, twin.targets, 3),
                        learner.parameters.download()))
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("every", [3, 100])
def test_points_without_a_target_count_nowhere(every):
    """Not in the sums, nor in what these are divided by: with 99 % empty points, too."""
    network, twin = NETWORKS[1], Twin(NETWORKS[1], 300)
    holes = np.arange(len(twin.points)) % every == 0
    holes = holes if every == 3 else ~holes
    device, targets = Device("cpu", threads=2), twin.targets.copy()
    targets[holes, 1] = np.nan
    learner = Learner(device, network, 0.0, twin.start)
    in_frame(device, learner, twin.points, targets)
    with torch.no_grad():
        filled = np.where(holes[:, None], twin.run(torch.from_numpy(twin.points)).numpy(), targets)
    wanted, error = twin.gradients(filled)
    learnt = 1 - holes.mean()
    np.testing.assert_allclose(gradients_of(learner), wanted / learnt, atol=1e-6 / learnt)
    assert learner.error() == pytest.approx(error / learnt, rel=1e-5)


@pytest.mark.parametrize("dims", [0, 2])
def test_empty_points_change_no_step(dims):
    """The points that are learnt alone, and among others that are not: the same error and the same
    step."""
    random = np.random.default_rng(4)
    points = random.uniform(0, 1, (40, 2)).astype(np.float32)
    targets = random.normal(size=(40, 1)).astype(np.float32)
    among, empty = np.repeat(points, 100, 0), np.full((4000, 1), np.nan, np.float32)
    empty[::100] = targets
    grid = Grid(2, levels=3, entries=256, sides=(4, 16)) if dims else None
    network, errors, made = Network(grid.width if grid else 2, (8,), 1, "gelu"), [], []
    for seen, wanted in ((points, targets), (among, empty)):
        learner = Learner(Device("cpu", threads=1), network, 1e-2, grid=grid)
        made.append(in_frame(learner.device, learner, seen, wanted, 3)[::len(seen) // 40])
        errors.append(learner.error())
    assert errors[1] == pytest.approx(errors[0], rel=1e-5)
    np.testing.assert_allclose(made[1], made[0], atol=1e-5)


def test_an_error_of_no_points_is_no_number():
    learner = Learner(Device("cpu", threads=1), Network(2, (4,), 1))
    in_frame(learner.device, learner, np.zeros((8, 2), np.float32),
             np.full((8, 1), np.nan, np.float32))
    assert np.isnan(learner.error()) and np.isfinite(learner.parameters.download()).all()


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
@every_network
def test_a_gpu_computes_what_torch_does(network):
    """Values and gradients within 1e-5, and the same bits again."""
    twin, device = Twin(network, 3000), Device("cuda")
    twin.targets[::7, 0] = np.nan
    with torch.no_grad():
        made = twin.run(torch.from_numpy(twin.points)).numpy()
    known = np.isfinite(twin.targets).all(1)
    wanted, error = (part / known.mean()
                     for part in twin.gradients(np.where(known[:, None], twin.targets, made)))
    learner, found = Learner(device, network, 0.0, twin.start), []
    for _ in range(2):
        values = in_frame(device, learner, twin.points, twin.targets)
        found.append((values, learner._last.download()))
    print(f"{network.sizes}: values {np.abs(values - made).max():.1e}, gradients "
          f"{np.abs(gradients_of(learner) - wanted).max():.1e} of {np.abs(wanted).max():.1e}")
    np.testing.assert_allclose(values, made, atol=1e-5, rtol=1e-5)
    np.testing.assert_allclose(gradients_of(learner), wanted, atol=1e-5)
    assert learner.error() == pytest.approx(error, rel=1e-5)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
def test_a_gpu_learns_as_the_cpu_does():
    """A network of 128 by 4, whose weights do not fit into shared memory, and one whose do."""
    for network in (Network(3, (128,) * 4, 3, "gelu"), NETWORKS[2]):
        errors = []
        for name in ("cpu", "cuda"):
            device = Device(name)
            learner, random = Learner(device, network, 1e-3), np.random.default_rng(0)
            points = random.uniform(-1, 1, (4000, network.inputs)).astype(np.float32)
            in_frame(device, learner, points, np.sin(3 * points[:, :3]), 40)
            errors.append(learner.error())
        print(f"{network.sizes}: error {errors[0]:.6f} on the CPU, {errors[1]:.6f} on the GPU")
        assert errors[1] == pytest.approx(errors[0], rel=0.01)


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
@pytest.mark.parametrize("shared", [None, pytest.param(80 << 10, marks=pytest.mark.soak)],
                         ids=["much", "little"])
@every_network
def test_cuda_kernels_compute_what_the_compiled_rows_do(network, shared):
    """Also with less shared memory than the parameters of wide layers need."""
    twin = Twin(network, 150)
    inputs = {"network": network.facts(), "parameters": twin.start, "points": twin.points,
              "targets": twin.targets}
    inputs["targets"][5, 0] = np.inf
    sizes = {"values": twin.targets.shape, "pulls": twin.points.shape,
             "partials": (2, network.count + 2)}
    for kernel, rows in ((FORWARD, len(twin.points)), (GRADIENTS, 2)):
        given = {binding: inputs[binding] for binding in kernel.reads}
        wanted, found = ({name: np.full(sizes[name], np.nan, np.float32) for name in kernel.writes}
                         for _ in range(2))
        kernel.rows(0, rows, *given.values(), *wanted.values())
        blocks = replace(kernel.blocks, shared=shared or kernel.blocks.shared,
                         most=2 if shared else 264)
        host_cuda.run(replace(kernel, blocks=blocks), given | found)
        for name, array in wanted.items():
            np.testing.assert_allclose(found[name], array, atol=1e-5, rtol=1e-5)
    wanted = wanted["partials"]
    states = [(twin.start.copy(), np.full((network.count, 3), [0.5, 0.5, 3], np.float32))
              for _ in range(2)]
    ADAM.rows(0, network.count, wanted, HYPER, *states[0])
    host_cuda.run(ADAM, {"partials": wanted, "hyper": HYPER, "parameters": states[1][0],
                         "moments": states[1][1]})
    for one, other in zip(*states, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


@every_network
@pytest.mark.parametrize("kernel", neural_cases.KERNELS, ids=lambda kernel: kernel.name)
def test_every_level_gives_the_same_bits(kernel, network):
    """Without fused products, nearly the same."""
    given = neural_cases.arguments(kernel, network, 300, dims=2 + network.outputs % 2)
    found = {level: neural_cases.run(kernel, given, level) for level in library.levels()}
    lowest, wanted = found.pop("baseline"), next(iter(found.values()))
    for name, array in wanted.items():
        for level, arrays in found.items():
            np.testing.assert_array_equal(arrays[name], array, f"{name} {level}")
        unit = UNITS if array.dtype == np.int64 else 1
        np.testing.assert_allclose(lowest[name] / unit, array / unit, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("kernel", "binding", "most"), [
    (FORWARD, "points", 3), (GRADIENTS, "points", 392), (GRADIENTS, "targets", 392),
    (ADAM, "partials", 3),
    (ADAM, "parameters", 1), (GRID, "points", 3), (GRID, "table", 300), (GRID_PULL, "pulls", 8),
    (GRID_STEP, "table", 1), (GRID_STEP, "moments", 3)],
    ids=lambda value: getattr(value, "name", value))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_and_infinity_go_into_what_is_made_of_them_and_into_nothing_else(kernel, binding, most,
                                                                             value):
    """In every form: a group's gradients, a point's values, a parameter's step; sums of whole
    numbers leave NaN out."""
    given = neural_cases.arguments(kernel, NETWORKS[1], 300)
    broken = {name: array.copy() for name, array in given.items()}
    broken[binding].reshape(-1)[20] = value
    clean, found = {}, {}
    for made, arrays in ((clean, given), (found, broken)):
        for level in library.levels():
            made[level] = neural_cases.run(kernel, arrays, level)
        if host_cuda.COMPILER:
            arrays = {name: array.copy() for name, array in arrays.items()}
            host_cuda.run(kernel, arrays)
            made["cuda"] = {name: arrays[name] for name in kernel.writes}
    levels = [level for level in library.levels() if level != "baseline"] or ["baseline"]
    wanted, before = found[levels[0]], clean[levels[0]]
    changed = {name: wanted[name] != before[name] for name in kernel.writes}
    assert sum(int(one.sum()) for one in changed.values()) <= most
    for form, arrays in found.items():
        for name, array in arrays.items():
            finite = np.isfinite(wanted[name])
            np.testing.assert_array_equal(np.isfinite(array), finite, f"{name} {form}")
            unit = UNITS if array.dtype == np.int64 else 1
            bits = 0 if form in levels else 1e-5
            np.testing.assert_allclose(array[finite] / unit, wanted[name][finite] / unit, bits,
                                       bits, err_msg=form)


@every_network
def test_the_onnx_form_reads_the_tensor_that_learning_writes(network, tmp_path):
    """In one command buffer; the form that holds the parameters gives the same."""
    device, twin = Device("cpu", threads=2), Twin(network, 100)
    learner = Learner(device, network, 1e-2, twin.start)
    network.save_onnx(tmp_path / "open.onnx")
    state = device.pipeline_state(Library(tmp_path), "open", {"points": len(twin.points)})
    points, targets = device.wrap("points", twin.points), device.wrap("targets", twin.targets)
    direct, portable = (device.heap.tensor(name, twin.targets.shape)
                        for name in ("direct", "portable"))
    commands = device.command_buffer("frame")
    with commands.compute_encoder("learn") as encoder:
        learner.learn(encoder, points, targets)
        learner.run(encoder, points, direct)
    with commands.machine_learning_encoder("portable") as encoder:
        encoder.barrier(after="compute", before="machine-learning")
        encoder.dispatch_network(state, ArgumentTable(state, {
            "points": points, "parameters": learner.parameters, "values": portable}))
    commands.commit()
    commands.wait()
    np.testing.assert_allclose(portable.array, direct.array, atol=1e-5, rtol=1e-5)
    assert (np.abs(direct.array - twin.run(torch.from_numpy(twin.points)).detach().numpy())
            .max() > 1e-3)
    network.save_onnx(tmp_path / "closed.onnx", learner.parameters.download())
    closed = device.pipeline_state(Library(tmp_path), "closed", {"points": len(twin.points)})
    assert [binding.name for binding in closed.bindings] == ["points", "values"]


class GridTwin:
    """A network behind a grid, in torch."""

    def __init__(self, dims: int) -> None:
        random = np.random.default_rng(0)
        # the first levels fit, others share
        self.grid = Grid(dims, levels=5, numbers=2, entries=256, sides=(4, 40))
        self.network = Network(self.grid.width + 1, (16,), 2, "gelu")
        self.start = self.network.initial(1)
        self.table = torch.nn.Parameter(torch.from_numpy(random.normal(0, 1, (5, 512))
                                                         .astype(np.float32)))
        self.points = random.uniform(-0.1, 1.1, (600, dims + 1)).astype(np.float32)
        self.targets = random.normal(size=(600, 2)).astype(np.float32)

    def values(self) -> torch.Tensor:
        points, parts = torch.from_numpy(self.points), []
        place = points[:, :self.grid.dims].clamp(0, 1)
        for level, side in enumerate((4, 7, 13, 22, 40)):
            cell = (place * side).floor().clamp(max=side - 1).long()
            rest, value = place * side - cell, 0
            for corner in itertools.product((0, 1), repeat=self.grid.dims):
                at = cell + torch.tensor(corner)
                share = torch.where(torch.tensor(corner) == 1, rest, 1 - rest).prod(1)
                if (side + 1) ** self.grid.dims <= 256:
                    entry = (at * (side + 1) ** torch.arange(self.grid.dims)).sum(1)
                else:
                    entry = torch.zeros(len(at), dtype=torch.long)
                    for axis, prime in enumerate((1, 2654435761, 805459861)[:self.grid.dims]):
                        entry ^= at[:, axis] * prime
                value = value + share[:, None] * self.table[level].reshape(256, 2)[entry & 255]
            parts.append(value)
        row = torch.cat([*parts, points[:, self.grid.dims:]], 1)
        (first, bias), (last, other) = ([torch.from_numpy(part) for part in layer]
                                        for layer in self.network.layers(self.start.copy()))
        return torch.nn.functional.gelu(row @ first.T + bias) @ last.T + other


def check_grid(dims: int, device: Device) -> None:
    """Values, derivatives by the table and a step of Adam are those of torch; again, they are the
    same bits."""
    twin, found = GridTwin(dims), []
    values = twin.values()
    ((values - torch.from_numpy(twin.targets)) ** 2).mean().backward()
    wanted = twin.table.grad.numpy().copy()
    before = twin.table.detach().numpy().copy()
    torch.optim.Adam([twin.table], 1e-2, DECAYS, EPSILON).step()
    for _ in range(2):
        learner = Learner(device, twin.network, 1e-2, twin.start, grid=twin.grid)
        learner.table.upload(before)
        points, targets = device.wrap("points", twin.points), device.wrap("targets", twin.targets)
        made = device.heap.tensor("values", twin.targets.shape)
        commands = device.command_buffer("frame")
        with commands.compute_encoder("network") as encoder:
            learner.run(encoder, points, made)
            learner.learn(encoder, points, targets)
        commands.commit()
        commands.wait()
        found.append((made.download(), learner._grid._sums.download() / UNITS,
                      learner.table.download()))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(found[0][0], values.detach(), atol=1e-5)
    np.testing.assert_allclose(found[0][1], wanted, atol=1e-7)
    clear = abs(wanted) > 1e-6  # the sign of a step from less is that of rounding
    np.testing.assert_allclose(found[0][2][clear], twin.table.detach().numpy()[clear], atol=1e-5)
    np.testing.assert_array_equal(found[0][2][wanted == 0], before[wanted == 0])
    assert clear.sum() > 500


@pytest.mark.parametrize("dims", [2, 3])
def test_a_hash_grid_learns_as_in_torch(dims):
    check_grid(dims, Device("cpu", threads=2))


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
@pytest.mark.parametrize("dims", [2, 3])
def test_a_hash_grid_on_a_gpu(dims):
    check_grid(dims, Device("cuda"))


@pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")
@pytest.mark.parametrize("dims", [2, 3])
def test_the_cuda_kernels_of_a_grid_compute_what_the_compiled_rows_do(dims):
    twin, random = GridTwin(dims), np.random.default_rng(2)
    table, pulls = twin.table.detach().numpy(), random.normal(size=(600, 11)).astype(np.float32)
    inputs = {"grid": twin.grid.facts(), "table": table, "points": twin.points, "pulls": pulls}
    for kernel, name, made in ((GRID, "rows", np.empty((600, 11), np.float32)),
                               (GRID_PULL, "sums", np.empty((5, 512), np.int64))):
        given, found = {binding: inputs[binding] for binding in kernel.reads}, np.zeros_like(made)
        kernel.rows(0, len(made), *given.values(), made)
        host_cuda.run(kernel, given | {name: found})
        np.testing.assert_allclose(found / UNITS, made / UNITS, atol=1e-6)
    partials = np.full((2, 7), 0.25, np.float32)
    states = [(table.copy(), np.full((5, 512, 3), [0.5, 0.5, 3], np.float32)) for _ in range(2)]
    GRID_STEP.rows(0, 5, made, partials, HYPER, *states[0])
    host_cuda.run(GRID_STEP, {"sums": made, "partials": partials, "hyper": HYPER,
                              "table": states[1][0], "moments": states[1][1]})
    for one, other in zip(*states, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_a_picture_is_learnt_by_a_grid():
    """Better than by Fourier features in as many steps."""
    random, errors = np.random.default_rng(0), []
    places = random.uniform(0, 1, (4096, 2)).astype(np.float32)
    wanted = np.sign(np.sin(40 * places[:, :1]) * np.sin(31 * places[:, 1:])).astype(np.float32)
    grid = Grid(2, levels=8, entries=1 << 12, sides=(8, 128))
    for learner in (Learner(Device("cpu", threads=2), Network(grid.width, (32,), 1), 1e-2,
                            grid=grid),
                    Learner(Device("cpu", threads=2), Network(2, (32,), 1, bands=5), 1e-2)):
        in_frame(learner.device, learner, places, wanted, 60)
        errors.append(learner.error())
    assert errors[0] < 0.2 * errors[1]


def test_fitting_learns_and_is_repeatable():
    random = np.random.default_rng(3)
    points = random.uniform(-1, 1, (2000, 2)).astype(np.float32)
    targets = np.sin(3 * points[:, :1] * points[:, 1:])
    targets[::7] = np.nan
    found = []
    for threads in (1, 2):
        learner = Learner(Device("cpu", threads=threads), Network(2, (16, 16), 1, "gelu"), seed=1)
        learner.fit(points, targets, 400, 2e-2, batch=256)
        found.append(learner.parameters.download())
        assert learner.error() < 0.01 < 0.1 < np.nanvar(targets)
    np.testing.assert_array_equal(*found)


def test_what_does_not_fit_is_told():
    for wrong, said in (((4,), "2 or 3"), ((2, 20), "at most 16"),
                        ((2, 8, 2, 1000), "a power of two"), ((2, 8, 2, 0), "a power of two"),
                        ((2, 8, 2, 1024, (64, 16)), "64 to 16 cells")):
        with pytest.raises(ModelError, match=said):
            Grid(*wrong)
    with pytest.raises(ModelError, match="needs at least 16 inputs"):
        Learner(Device("cpu", threads=1), NETWORKS[0], grid=Grid(3))
    with pytest.raises(BindingError, match="no grid"):
        _ = Learner(Device("cpu", threads=1), NETWORKS[0]).table
    for wrong, said in (((3, (200,), 3), "1 to 128"), ((3, (4,) * 5, 3), "at most 4"),
                        ((3, (), 3, "tanh"), "'tanh'"),
                        ((3, (4,), 3, "relu", 2, 4), "there are 3 inputs")):
        with pytest.raises(ModelError, match=said):
            Network(*wrong)
    device = Device("cpu", threads=1)
    learner = Learner(device, NETWORKS[0])
    with pytest.raises(BindingError, match="not learned yet"):
        learner.error()
    with pytest.raises(BindingError, match=r"\(5, 2\)"):
        in_frame(device, learner, np.zeros((5, 2), np.float32), np.zeros((5, 3), np.float32))
    with pytest.raises(BindingError, match="this network has"):
        learner.restart(np.zeros(3, np.float32))
    with pytest.raises(DeviceError, match="without explicit_barriers"):
        Learner(Device("cpu", threads=1, explicit_barriers=True), NETWORKS[0])


def test_what_a_network_learns_by_is_ordered_by_what_it_reads_and_writes():
    device, grid = Device("cpu", threads=1), Grid(2)
    learner = Learner(device, Network(grid.width, (16,), 1), grid=grid)
    points, targets = (device.wrap(name, np.zeros((64, count), np.float32))
                       for name, count in (("points", 2), ("targets", 1)))
    values = device.heap.tensor("values", (64, 1))
    commands = device.command_buffer("two steps, then a look")
    with commands.compute_encoder("learn") as encoder:
        learner.learn(encoder, points, targets)
        learner.learn(encoder, points, targets)
        learner.run(encoder, points, values)
    commands.commit()
    commands.wait()
    order = ["|" if isinstance(record, EncoderBarrier) else record.command
             for record in commands.records]
    step = "grid | gradients | adam grid_pull | grid_step"
    words = " ".join(order).replace("kernel 'neural_", "").replace("'", "")
    assert words == f"{step} | {step} | grid | forward"


def test_the_example_of_the_document_learns(capsys):
    text = (Path(__file__)
            .parents[2] / "docs" / "howto" / "networks.md").read_text(encoding="utf-8")
    exec(re.search(r"```python\n(.*?)```", text, re.DOTALL)[1], {})
    assert float(capsys.readouterr().out) < 1e-3
