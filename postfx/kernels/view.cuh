// What every CUDA kernel begins with, those of plug-ins too.
//
// A kernel takes one View for each of its bindings, in their order. A thread makes one pixel: x
// counts the axis after `row_axis`, y that axis itself (postfx/kernels/__init__.py). Kernels whose
// row binding has one axis run as one block.

struct View {
    float* __restrict__ at;
    int size[4];
};

#define PIXEL(width, height) \
    const int x = blockIdx.x * blockDim.x + threadIdx.x;                                           \
    const int y = blockIdx.y * blockDim.y + threadIdx.y;                                           \
    if (x >= (width) || y >= (height)) return

