"""Small models of the tests, well formed and not."""

from onnx import TensorProto, helper

from tests import toys

X, Y = toys.value("x", (1, "height")), toys.value("y", (1, "height"))


def graph_of(nodes, weights=(), inputs=(X,), outputs=(Y,)):
    return helper.make_graph(list(nodes), "g", list(inputs), list(outputs), list(weights))


def model_of(*nodes, weights=(), **kept):
    nodes = nodes or [helper.make_node("Add", ["x", "w" if weights else "x"], ["y"])]
    opsets = [helper.make_opsetid("", 20), *kept.pop("opsets", [])]
    return helper.make_model(graph_of(nodes, weights, **kept), opset_imports=opsets, ir_version=10)


def weights_of(dims, content=b"", name="w", kind=TensorProto.FLOAT):
    return TensorProto(name=name, dims=dims, data_type=kind, raw_data=content)


def outside(location, **entries):
    """Weights of four floats in another file."""
    tensor = TensorProto(name="w", dims=[4], data_type=TensorProto.FLOAT,
                         data_location=TensorProto.EXTERNAL)
    for key, value in {"location": location, **entries}.items():
        tensor.external_data.add(key=key, value=str(value))
    return tensor
