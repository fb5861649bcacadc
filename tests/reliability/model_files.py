"""Small models of the tests, well formed and not."""

from collections.abc import Iterable, Sequence
from typing import Any

from onnx import TensorProto, helper

from tests import toys

X, Y = toys.value("x", (1, "height")), toys.value("y", (1, "height"))


def graph_of(nodes: Iterable[Any], weights: Iterable[Any] = (), inputs: Iterable[Any] = (X,),
             outputs: Iterable[Any] = (Y,)) -> Any:
    return helper.make_graph(list(nodes), "g", list(inputs), list(outputs), list(weights))


def model_of(*nodes: Any, weights: Sequence[Any] = (), **kept: Any) -> Any:
    nodes = nodes or (helper.make_node("Add", ["x", "w" if weights else "x"], ["y"]),)
    opsets = [helper.make_opsetid("", 20), *kept.pop("opsets", [])]
    return helper.make_model(graph_of(nodes, weights, **kept), opset_imports=opsets, ir_version=10)


def weights_of(dims: Sequence[int], content: bytes = b"", name: str = "w",
               kind: int = TensorProto.FLOAT) -> Any:
    return TensorProto(name=name, dims=dims, data_type=kind, raw_data=content)


def outside(location: str, **entries: str) -> Any:
    """Weights of four floats in another file."""
    tensor = TensorProto(name="w", dims=[4], data_type=TensorProto.FLOAT,
                         data_location=TensorProto.EXTERNAL)
    for key, value in {"location": location, **entries}.items():
        tensor.external_data.add(key=key, value=str(value))
    return tensor
