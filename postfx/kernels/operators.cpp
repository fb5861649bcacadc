// Operators that ONNX Runtime calls while it runs a network on a CPU: convolutions of 3x3 pixels by
// tiles. Its interface is a table of C functions that only grows. What is used of it is declared
// here, with the places in the table that onnxruntime_c_api.h gives.
//
//     Convolve3x3(image (1, C, h, w), weights (K, C, 3, 3), bias (K)) -> (1, K, h, w)
//     Convolve3x3Relu: the same, and results below 0 become 0
//
// The bias may be missing.
#include "winograd.h"

struct Failure;
struct Tensor;
struct TensorShape;
struct NodeInfo;
struct NodeCall;
struct ShapeQuestion;
typedef __SIZE_TYPE__ Size;
typedef void* const* Functions;

constexpr unsigned VERSION = 17;  // of the interface
constexpr int FLOAT = 1, FAILED = 1, REQUIRED = 0, OPTIONAL = 1;
constexpr Long MOST_PARTS = 32;  // of a picture, so that memory is asked for seldom
constexpr Size AXES = 4, IMAGE = 0, WEIGHTS = 1, BIAS = 2, INPUTS = 3;
enum Place {
    CREATE_FAILURE = 0, CREATE_DOMAIN = 26, ADD_TO_DOMAIN = 27, ADD_DOMAIN = 28, DATA = 51,
    CREATE_SHAPE = 57, SET_TYPE = 58, SET_SIZES = 59, SIZES = 62, SHAPE = 65, INPUT = 90,
    OUTPUT = 91, RELEASE_SHAPE = 99, CONSTANT_INPUT = 249, INPUT_SHAPE = 268, OUTPUT_SHAPE = 270,
    PARALLEL = 274,
};

static Functions the_functions;
template <class R = Failure*, class... A> FN R ask(Place place, A... arguments) {
    return ((R (*)(A...))the_functions[place])(arguments...);
}
FN Failure* no_memory() {
    return ask(CREATE_FAILURE, FAILED, "no memory for a convolution");
}
#define TRY(asked) \
    if (Failure* failed = asked) return failed

static Failure* take_sizes(TensorShape* shape, Long* sizes) {
    Failure* failed = ask(SIZES, (const TensorShape*)shape, sizes, AXES);
    ask<void>(RELEASE_SHAPE, shape);
    return failed;
}
static Failure* sizes_of(const Tensor* tensor, Long* sizes) {
    TensorShape* shape = nullptr;
    TRY(ask(SHAPE, tensor, &shape));
    return take_sizes(shape, sizes);
}
static Failure* numbers_of(const Tensor* tensor, float** at) {
    return ask(DATA, (Tensor*)tensor, (void**)at);
}

// A node of a network that is ready to run, and behind it its weights.
struct Convolution {
    Layer layer;
    bool is_rectified;

    float* weights() { return (float*)(this + 1); }
};

struct Operator {
    unsigned version;
    void* create;  // `create_checked` in its place
    const char* (*name)(const Operator*);
    const char* (*provider)(const Operator*);
    int (*input_type)(const Operator*, Size);
    Size (*count_inputs)(const Operator*);
    int (*output_type)(const Operator*, Size);
    Size (*count_outputs)(const Operator*);
    void* compute;  // `compute_checked` in its place
    void (*destroy)(void*);
    int (*input_kind)(const Operator*, Size);
    int (*output_kind)(const Operator*, Size);
    int (*memory)(const Operator*, Size);
    void* of_many[4];
    Failure* (*create_checked)(const Operator*, Functions, const NodeInfo*, Convolution**);
    Failure* (*compute_checked)(Convolution*, NodeCall*);
    Failure* (*infer_shape)(const Operator*, ShapeQuestion*);
    void* of_versions_and_aliases[6];
    const char* own_name;
    bool is_rectified;
};

static Failure* infer_shape(const Operator*, ShapeQuestion* call) {
    TensorShape *image = nullptr, *weights = nullptr, *shape = nullptr;
    Long sizes[AXES] = {}, weight_sizes[AXES] = {};
    TRY(ask(INPUT_SHAPE, (const ShapeQuestion*)call, IMAGE, &image));
    TRY(ask(SIZES, (const TensorShape*)image, sizes, AXES));
    TRY(ask(INPUT_SHAPE, (const ShapeQuestion*)call, WEIGHTS, &weights));
    TRY(ask(SIZES, (const TensorShape*)weights, weight_sizes, AXES));
    if (sizes[2] <= 0 || sizes[3] <= 0) return nullptr;  // they are not fixed
    TRY(ask(CREATE_SHAPE, &shape));
    sizes[1] = weight_sizes[0];
    Failure* failed = ask(SET_TYPE, shape, FLOAT);
    if (!failed) failed = ask(SET_SIZES, shape, (const Long*)sizes, AXES);
    if (!failed)
        failed = ask(OUTPUT_SHAPE, (const ShapeQuestion*)call, Size(0), (const TensorShape*)shape);
    ask<void>(RELEASE_SHAPE, shape);
    return failed;
}

static Failure* create(const Operator* of, Functions, const NodeInfo* node, Convolution** made) {
    const Tensor* weights = nullptr;
    int is_constant = 0;
    Long sizes[AXES];
    float* numbers;
    TRY(ask(CONSTANT_INPUT, node, WEIGHTS, &is_constant, &weights));
    if (!is_constant) return ask(CREATE_FAILURE, FAILED, "weights that are computed");
    TRY(sizes_of(weights, sizes));
    TRY(numbers_of(weights, &numbers));
    const Layer layer{sizes[1], sizes[0], 0, 0};
    *made = (Convolution*)malloc(sizeof(Convolution) + sizeof(float) * layer.weights());
    if (!*made) return no_memory();
    **made = {layer, of->is_rectified};
    prepare_weights(layer, numbers, (*made)->weights());
    return nullptr;
}

struct Work {
    Convolution* convolution;
    Layer layer;
    float *image, *bias, *out;
    Long parts;
    bool has_failed;
};
static void make_part(Work* work, Size part) {
    Strips strips(work->layer, work->image, work->convolution->weights(),
                        work->bias, work->out, work->convolution->is_rectified);
    const Long count = work->layer.strips();
    if (!strips.room) work->has_failed = true;
    else
        for (Long i = count * part / work->parts; i < Long(count * (part + 1) / work->parts); i++)
            strips.make(i);
}

static Failure* compute(Convolution* convolution, NodeCall* call) {
    const Tensor *image = nullptr, *bias = nullptr;
    Tensor* out = nullptr;
    Long sizes[AXES];
    TRY(ask(INPUT, (const NodeCall*)call, IMAGE, &image));
    TRY(ask(INPUT, (const NodeCall*)call, BIAS, &bias));
    TRY(sizes_of(image, sizes));
    if (sizes[0] != 1) return ask(CREATE_FAILURE, FAILED, "a convolution of several images");
    Work work{convolution, convolution->layer, nullptr, nullptr, nullptr, 0, false};
    work.layer.height = sizes[2];
    work.layer.width = sizes[3];
    sizes[1] = work.layer.results;
    TRY(ask(OUTPUT, call, Size(0), (const Long*)sizes, AXES, &out));
    TRY(numbers_of(image, &work.image));
    if (bias) TRY(numbers_of(bias, &work.bias));
    TRY(numbers_of(out, &work.out));
    work.parts = smaller<Long>(work.layer.strips(), MOST_PARTS);
    TRY(ask(PARALLEL, (const NodeCall*)call, (void (*)(void*, Size))make_part, Size(work.parts),
            Size(0), (void*)&work));
    return work.has_failed ? no_memory() : nullptr;
}

constexpr Operator operator_of(const char* name, bool is_rectified) {
    return {
        .version = VERSION,
        .create = nullptr,
        .name = [](const Operator* own) { return own->own_name; },
        .provider = [](const Operator*) { return "CPUExecutionProvider"; },
        .input_type = [](const Operator*, Size) { return FLOAT; },
        .count_inputs = [](const Operator*) { return INPUTS; },
        .output_type = [](const Operator*, Size) { return FLOAT; },
        .count_outputs = [](const Operator*) { return Size(1); },
        .compute = nullptr,
        .destroy = free,
        .input_kind = [](const Operator*, Size at) { return at == BIAS ? OPTIONAL : REQUIRED; },
        .output_kind = [](const Operator*, Size) { return REQUIRED; },
        .memory = [](const Operator*, Size) { return 0; },
        .of_many = {},
        .create_checked = create,
        .compute_checked = compute,
        .infer_shape = infer_shape,
        .of_versions_and_aliases = {},
        .own_name = name,
        .is_rectified = is_rectified,
    };
}

struct Interface {
    Functions (*functions)(unsigned version);
    const char* (*version)();
};

// What ONNX Runtime calls where a session names this library.
EXPORTED Word RegisterCustomOps(Word options, const Interface* interface) {
    static constexpr Operator OPERATORS[] = {operator_of("Convolve3x3", false),
                                             operator_of("Convolve3x3Relu", true)};
    the_functions = interface->functions(VERSION);
    void* domain = nullptr;
    Failure* failed = ask(CREATE_DOMAIN, "postfx", &domain);
    for (const Operator& one : OPERATORS)
        if (!failed) failed = ask(ADD_TO_DOMAIN, domain, &one);
    if (!failed) failed = ask(ADD_DOMAIN, (void*)options, domain);
    return (Word)failed;
}
