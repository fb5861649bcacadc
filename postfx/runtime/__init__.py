"""An ML command encoder over ONNX Runtime, named after Metal 4. See docs/runtime.md."""

from postfx.errors import (
    BindingError,
    CaptureError,
    CommandError,
    CommandTimeout,
    DeviceError,
    EncodingError,
    HazardError,
    ModelError,
)
from postfx.runtime.capture import Capture
from postfx.runtime.commands import CommandBuffer
from postfx.runtime.device import Device, default_device
from postfx.runtime.encoders import ComputeEncoder, MachineLearningEncoder
from postfx.runtime.heap import Heap
from postfx.runtime.models import Library
from postfx.runtime.session import has_networks
from postfx.runtime.states import (
    ArgumentTable,
    Binding,
    CompiledComputeState,
    Intermediates,
    PipelineState,
    PortableComputeState,
)
from postfx.runtime.tensor import Tensor, TensorState

__all__ = [
    "ArgumentTable",
    "Binding",
    "BindingError",
    "Capture",
    "CaptureError",
    "CommandBuffer",
    "CommandError",
    "CommandTimeout",
    "CompiledComputeState",
    "ComputeEncoder",
    "Device",
    "DeviceError",
    "EncodingError",
    "HazardError",
    "Heap",
    "Intermediates",
    "Library",
    "MachineLearningEncoder",
    "ModelError",
    "PipelineState",
    "PortableComputeState",
    "Tensor",
    "TensorState",
    "default_device",
    "has_networks",
]
