"""Small compute kernels: a compiled row function for the CPU and a portable ONNX definition of the same name."""
