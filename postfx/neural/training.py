"""A small network that learns while frames run: its tensors, and the commands that read and write them."""

from __future__ import annotations

import numpy as np

from postfx.errors import BindingError
from postfx.kernels.neural import ADAM, FORWARD, GRADIENTS
from postfx.neural.network import Network
from postfx.runtime import ArgumentTable, ComputeEncoder, Device, Tensor

GROUP, MOST_GROUPS = 256, 64
"""Points of a group at least, and groups at most: a group is summed by one thread, or one block of a GPU."""
DECAYS, EPSILON = (0.9, 0.999), 1e-8


class Learner:
    """A network on a device, with the state of Adam (Kingma 2015).

    Attributes:
        parameters: tensor (count,), which `learn` changes and `run` reads in the order in which they are recorded.
        moments: tensor (count, 3) of Adam: mean, mean square, and number of steps.
    """

    def __init__(self, device: Device, network: Network, rate: float = 1e-2, parameters: np.ndarray | None = None,
                 seed: int = 0) -> None:
        """
        Args:
            rate: step size of Adam.
            parameters: (count,) to begin with; default `network.initial(seed)`.
        """
        self.device, self.network = device, network
        self.parameters = device.heap.tensor("neural parameters", (network.count,))
        self.moments = device.heap.tensor("neural moments", (network.count, 3))
        self._facts, self._hyper = (device.heap.tensor(name, shape) for name, shape in
                                    (("network", network.facts().shape), ("neural hyper", (4,))))
        self._facts.upload(network.facts())
        self._forward, self._gradients, self._adam = map(device.compute_state, (FORWARD, GRADIENTS, ADAM))
        self._partials: dict[int, Tensor] = {}
        self._last: Tensor | None = None
        self.set_rate(rate)
        self.restart(network.initial(seed) if parameters is None else parameters)

    def set_rate(self, rate: float) -> None:
        """Change Adam's step size. No command that learns may be in flight."""
        self._hyper.upload(np.array([rate, *DECAYS, EPSILON], np.float32))

    def restart(self, parameters: np.ndarray) -> None:
        """Begin anew with these parameters (count,). No command that uses the network may be in flight."""
        if parameters.shape != (self.network.count,):
            raise BindingError(f"parameters have the shape {parameters.shape}: this network has "
                               f"({self.network.count},)")
        self.parameters.upload(parameters.astype(np.float32))
        self.moments.fill(0)

    def run(self, encoder: ComputeEncoder, points: Tensor, values: Tensor) -> None:
        """Record the network: points (points, inputs) -> values (points, outputs)."""
        self._check(points, self.network.inputs, points.shape[0])
        self._check(values, self.network.outputs, points.shape[0])
        encoder.dispatch(self._forward, ArgumentTable(self._forward, {
            "network": self._facts, "parameters": self.parameters, "points": points, "values": values}))

    def learn(self, encoder: ComputeEncoder, points: Tensor, targets: Tensor) -> None:
        """Record one step of Adam on the mean squared error, and barriers around its update of the parameters.

        Args:
            points: (points, inputs).
            targets: (points, outputs); a point with one that is not finite is left out.
        """
        self._check(points, self.network.inputs, points.shape[0])
        self._check(targets, self.network.outputs, points.shape[0])
        groups = min(MOST_GROUPS, -(-points.shape[0] // GROUP))
        if groups not in self._partials:
            self._partials[groups] = self.device.heap.tensor("neural partials", (groups, self.network.count + 1))
        partials = self._last = self._partials[groups]
        encoder.dispatch(self._gradients, ArgumentTable(self._gradients, {
            "network": self._facts, "parameters": self.parameters, "points": points, "targets": targets,
            "partials": partials}))
        encoder.barrier()
        encoder.dispatch(self._adam, ArgumentTable(self._adam, {
            "partials": partials, "hyper": self._hyper, "parameters": self.parameters, "moments": self.moments}))
        encoder.barrier()

    def error(self) -> float:
        """Mean squared error of the points of the last step that ran, before that step."""
        if self._last is None:
            raise BindingError("the network has not learned yet: record `learn` and wait for its commands")
        return float(self._last.array[:, -1].sum(dtype=np.float64))

    def _check(self, tensor: Tensor, numbers: int, points: int) -> None:
        if tensor.shape != (points, numbers) or points < 1:
            raise BindingError(f"tensor '{tensor.name}' has the shape {tensor.shape}: this network takes "
                               f"({max(points, 1)}, {numbers}) here")
