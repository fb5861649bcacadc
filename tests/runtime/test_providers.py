"""Networks on other execution providers of ONNX Runtime, through the one that every machine has."""

import numpy as np
import pytest

from postfx import DenoiseUpscale, Pipeline
from postfx.cli.main import main
from postfx.frame import Role
from postfx.runtime import ArgumentTable, Device, DeviceError, ModelError
from postfx.runtime import session as session_module
from postfx.runtime.session import Provider, parse_provider
from tests import toys


def test_how_a_provider_is_written():
    asked = parse_provider("OpenVINO,device_type=CPU,load_config={'a': 1, 'b': 2},library=ep.so")
    assert asked == Provider("OpenVINO",
                             (("device_type", "CPU"), ("load_config", "{'a': 1, 'b': 2}")), "ep.so")
    assert str(asked) == "OpenVINO,device_type=CPU,load_config={'a': 1, 'b': 2},library=ep.so"


@pytest.mark.parametrize("text", ["", ",a=1", "OpenVINO,device_type", "OpenVINO,=CPU"])
def test_what_is_no_provider(text):
    with pytest.raises(DeviceError, match="cannot be read: write NAME,option=value"):
        Device("cpu", provider=text)


PLUG_IN = Provider("CPUExecutionProvider", library="x")


@pytest.mark.parametrize("provider, how", [("cpu", "by name"), (PLUG_IN, "plug-in")])
def test_the_same_bits_by_a_provider_of_that_name(provider, how, monkeypatch):
    monkeypatch.setattr(session_module, "_register", lambda library: None)
    called = []
    if how == "plug-in":
        make = session_module._plug_in_session
        monkeypatch.setattr(session_module, "_plug_in_session",
                            lambda *args: called.append(args[2].name) or make(*args))
    frame = toys.make_frame(1, (32, 24))
    plain, other = (Pipeline([DenoiseUpscale(model="s.fp32")], device)(frame)
                    for device in (Device("cpu", threads=1),
                                   Device("auto", threads=1, provider=provider)))
    assert np.array_equal(plain[Role.COLOUR], other[Role.COLOUR])
    assert set(called) == ({"CPUExecutionProvider"} if how == "plug-in" else set())


@pytest.mark.parametrize("provider, reason", [
    ("Nowhere", "no provider 'Nowhere' in onnxruntime .*, which has .*CPUExecutionProvider: "
     "install one that has"),
    ("CPU,library=nowhere.so",
     "'nowhere.so' of a provider is neither a file nor a package that has one"),
    ("CPU,library=json", "'json' of a provider is neither a file nor a package that has one"),
    (f"CPU,library={__file__}", "of a provider cannot be loaded: "),
])
def test_providers_that_are_not_there(provider, reason):
    with pytest.raises(DeviceError, match=reason):
        Device("cpu", provider=provider)


def test_a_plug_in_without_a_device_here(monkeypatch):
    monkeypatch.setattr(session_module, "_register", lambda library: None)
    with pytest.raises(DeviceError,
                       match="'NPU' has no device on this machine, although 'ep.so' is loaded"):
        Device("cpu", provider="NPU,library=ep.so")


def test_inputs_are_bound_before_every_run(library, monkeypatch):
    """A provider with memory of its own gets a copy when an input is bound, and none when the
    network runs."""
    device = Device("cpu", threads=1, provider="CPU")
    make, copied = session_module.ort.InferenceSession.io_binding, []

    def far(session):
        binding = make(session)
        bind = binding.bind_input
        binding.bind_input = (lambda *place: copied.append(float(tensors["x"].array.max()))
                              or bind(*place))
        return binding

    monkeypatch.setattr(session_module.ort.InferenceSession, "io_binding", far)
    state = device.pipeline_state(library, "double", {"height": 4, "width": 5})
    tensors = {name: device.heap.tensor(name, (1, 4, 5)) for name in ("x", "y")}
    tensors["x"].fill(1)
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder("network") as encoder:
        encoder.dispatch_network(state, ArgumentTable(state, tensors))
    for value in (1, 2, 3):
        commands.commit()
        commands.wait()
        assert copied[-1] == value and tensors["y"].array.max() == 2 * value
        tensors["x"].fill(value + 1)


def test_options_that_a_provider_refuses(library, monkeypatch):
    def refuse(*args, providers=(), enable_fallback=True, **kept):
        assert providers == [("CPUExecutionProvider", {"typo": "1"})] and not enable_fallback
        raise RuntimeError("Invalid option: typo\nmore")

    device = Device("cpu", provider="CPU,typo=1")
    monkeypatch.setattr(session_module.ort, "InferenceSession", refuse)
    with pytest.raises(ModelError, match="'double' cannot be made ready: Invalid option: typo$"):
        device.pipeline_state(library, "double", {"height": 4, "width": 5})


def test_the_command_line_names_what_is_missing(tmp_path, capsys):
    wish = ["run", "samples/room/noisy.####.exr", "-o", str(tmp_path / "out.####.exr"),
            "--provider", "TensorRT,a=1"]
    assert main(wish) != 0
    assert "no provider 'TensorRT' in onnxruntime" in capsys.readouterr().err
