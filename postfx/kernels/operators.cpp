// Operators that ONNX Runtime calls while it runs a network on a CPU: convolutions of 3x3 pixels by
// tiles, and means of windows. Its interface is a table of C functions that only grows. What is
// used of it is declared here, with the places in the table that onnxruntime_c_api.h gives.
//
//     Convolve3x3(weights (K, C, 3, 3) ..., biases (K) ..., pictures (1, C, h, w) ...)
//         -> (1, K, h, w)
//     Convolve3x3Relu: the same, and results below 0 become 0
//
// The channels of all weights, one behind the other, are those of all pictures. So several
// convolutions whose results are added are one, and pictures need not be joined before. Biases are
// added. Each picture but the last one may have half the size: each of its pixels becomes four.
//
//     WindowMean(picture (1, C, h, w), axis = 2 or 3, size) -> (1, C, h, w)
//
// The size is an odd number of pixels.
#include "window_means.h"
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
constexpr Size AXES = 4;
constexpr Size MOST_PICTURES = 4;           // of a convolution
constexpr Size INPUTS = 6 + MOST_PICTURES;  // with three weights and biases
enum Place {
    CREATE_FAILURE = 0, CREATE_DOMAIN = 26, ADD_TO_DOMAIN = 27, ADD_DOMAIN = 28, DATA = 51,
    CREATE_SHAPE = 57, SET_TYPE = 58, SET_SIZES = 59, AXIS_COUNT = 61, SIZES = 62, SHAPE = 65,
    INTEGER_ATTRIBUTE = 86, INPUT_COUNT = 88, INPUT = 90, OUTPUT = 91, RELEASE_SHAPE = 99,
    CONSTANT_INPUT = 249, INPUT_SHAPE_COUNT = 267, INPUT_SHAPE = 268, OUTPUT_SHAPE = 270,
    PARALLEL = 274,
};

static Functions the_functions;
template <class R = Failure*, class... A> FN R ask(Place place, A... arguments) {
    return ((R (*)(A...))the_functions[place])(arguments...);
}
FN Failure* no_memory() {
    return ask(CREATE_FAILURE, FAILED, "no memory for an operator");
}
#define TRY(asked) \
    if (Failure* failed = asked) return failed

// Sizes of a shape, of at most `AXES` axes; those of others are 0.
static Failure* take_sizes(const TensorShape* shape, Long* sizes, Size* count) {
    TRY(ask(AXIS_COUNT, shape, count));
    return *count > AXES ? ask(CREATE_FAILURE, FAILED, "a tensor of too many axes")
                         : ask(SIZES, shape, sizes, *count);
}
static Failure* sizes_of(const Tensor* tensor, Long* sizes, Size* count) {
    TensorShape* shape = nullptr;
    TRY(ask(SHAPE, tensor, &shape));
    Failure* failed = take_sizes(shape, sizes, count);
    ask<void>(RELEASE_SHAPE, shape);
    return failed;
}
static Failure* numbers_of(const Tensor* tensor, float** at) {
    return ask(DATA, (Tensor*)tensor, (void**)at);
}

// Answers which sizes a result has, unless they are not fixed.
static Failure* tell_sizes(const ShapeQuestion* asked, const Long* sizes) {
    TensorShape* shape = nullptr;
    if (sizes[2] <= 0 || sizes[3] <= 0) return nullptr;
    TRY(ask(CREATE_SHAPE, &shape));
    Failure* failed = ask(SET_TYPE, shape, FLOAT);
    if (!failed) failed = ask(SET_SIZES, shape, sizes, AXES);
    if (!failed) failed = ask(OUTPUT_SHAPE, asked, Size(0), (const TensorShape*)shape);
    ask<void>(RELEASE_SHAPE, shape);
    return failed;
}

// A node of a network that is ready to run, and behind it its bias and its weights.
struct Convolution {
    Layer layer;
    Size constants;  // the inputs before the pictures
    bool is_rectified;

    float* bias() { return (float*)(this + 1); }
    float* weights() { return bias() + layer.results; }
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
    Failure* (*create_checked)(const Operator*, Functions, const NodeInfo*, void**);
    Failure* (*compute_checked)(void*, NodeCall*);
    Failure* (*infer_shape)(const Operator*, ShapeQuestion*);
    void* of_versions_and_aliases[6];
    const char* own_name;
    bool is_rectified;
};

static Failure* infer_sums(const Operator*, ShapeQuestion* call) {
    TensorShape *picture = nullptr, *weights = nullptr;
    Long sizes[AXES] = {}, weight_sizes[AXES] = {};
    Size inputs = 0, count = 0;
    const ShapeQuestion* asked = call;
    TRY(ask(INPUT_SHAPE_COUNT, asked, &inputs));
    TRY(ask(INPUT_SHAPE, asked, inputs - 1, &picture));
    TRY(take_sizes(picture, sizes, &count));
    TRY(ask(INPUT_SHAPE, asked, Size(0), &weights));
    TRY(take_sizes(weights, weight_sizes, &count));
    sizes[1] = weight_sizes[0];
    return tell_sizes(asked, sizes);
}

// An input of a node that never changes: weights (results, channels, 3, 3), or a bias (results).
struct Constant {
    float* numbers;
    Long sizes[AXES];
    Size axes;

    bool is_weights() const { return axes == AXES; }
};
static Failure* find_constants(const NodeInfo* node, Constant* found, Size* count) {
    for (*count = 0; *count < INPUTS; ++*count) {
        const Tensor* tensor = nullptr;
        int is_constant = 0;
        Constant& one = found[*count];
        TRY(ask(CONSTANT_INPUT, node, *count, &is_constant, &tensor));
        if (!is_constant) return nullptr;
        TRY(sizes_of(tensor, one.sizes, &one.axes));
        TRY(numbers_of(tensor, &one.numbers));
    }
    return nullptr;
}

static Failure* create_convolution(const Operator* of, Functions, const NodeInfo* node,
                                   void** made) {
    Constant constants[INPUTS];
    Size count = 0;
    TRY(find_constants(node, constants, &count));
    Layer layer{};
    for (const Constant* one = constants; one < constants + count; one++) {
        if (one > constants && one->sizes[0] != layer.results)
            return ask(CREATE_FAILURE, FAILED, "convolutions of other numbers of channels");
        layer.results = one->sizes[0];
        if (one->is_weights()) layer.channels += one->sizes[1];
    }
    if (!layer.channels) return ask(CREATE_FAILURE, FAILED, "weights that are computed");
    const Size size = sizeof(Convolution) + sizeof(float) * (layer.results + layer.weights());
    auto* own = (Convolution*)(*made = malloc(size));
    if (!own) return no_memory();
    __builtin_memset(own, 0, size);
    *own = {layer, count, of->is_rectified};
    Long first = 0;
    for (const Constant* one = constants; one < constants + count; one++)
        if (one->is_weights()) {
            prepare_weights(layer, one->numbers, first, one->sizes[1], own->weights());
            first += one->sizes[1];
        } else {
            for (Long k = 0; k < layer.results; k++) own->bias()[k] += one->numbers[k];
        }
    return nullptr;
}

struct Work {
    Convolution* convolution;
    Layer layer;
    Source pictures[MOST_PICTURES];
    float* out;
    Long parts;
    bool has_failed;
};
static void make_part(Work* work, Size part) {
    Convolution& own = *work->convolution;
    Strips strips(work->layer, work->pictures, own.weights(), own.bias(), work->out,
                  own.is_rectified);
    const Long count = work->layer.strips();
    if (!strips.room) work->has_failed = true;
    else
        for (Long i = count * part / work->parts; i < Long(count * (part + 1) / work->parts); i++)
            strips.make(i);
}

// The pictures that a node reads; the last one has the size of the results.
static Failure* find_pictures(const NodeCall* call, Size first, Work* work) {
    Size count = 0, axes = 0;
    Long channels = 0, sizes[AXES];
    TRY(ask(INPUT_COUNT, call, &count));
    for (Size i = count; i-- > first;) {
        const Tensor* tensor = nullptr;
        float* numbers = nullptr;
        TRY(ask(INPUT, call, i, &tensor));
        TRY(sizes_of(tensor, sizes, &axes));
        TRY(numbers_of(tensor, &numbers));
        if (sizes[0] != 1) return ask(CREATE_FAILURE, FAILED, "a convolution of several images");
        if (i == count - 1) {
            work->layer.height = sizes[2];
            work->layer.width = sizes[3];
        }
        const Long height = work->layer.height, width = work->layer.width;
        const bool is_half = 2 * sizes[2] == height && 2 * sizes[3] == width;
        if (!is_half && (sizes[2] != height || sizes[3] != width))
            return ask(CREATE_FAILURE, FAILED, "a convolution of pictures of other sizes");
        work->pictures[i - first] = {numbers, sizes[1], is_half};
        channels += sizes[1];
    }
    return channels == work->layer.channels
        ? nullptr : ask(CREATE_FAILURE, FAILED, "a convolution with weights for other channels");
}

static Failure* convolve(void* node, NodeCall* call) {
    auto* convolution = (Convolution*)node;
    Tensor* out = nullptr;
    Work work{convolution, convolution->layer, {}, nullptr, 0, false};
    TRY(find_pictures(call, convolution->constants, &work));
    const Long sizes[AXES] = {1, work.layer.results, work.layer.height, work.layer.width};
    TRY(ask(OUTPUT, call, Size(0), (const Long*)sizes, AXES, &out));
    TRY(numbers_of(out, &work.out));
    work.parts = smaller<Long>(work.layer.strips(), MOST_PARTS);
    TRY(ask(PARALLEL, (const NodeCall*)call, (void (*)(void*, Size))make_part, Size(work.parts),
            Size(0), (void*)&work));
    return work.has_failed ? no_memory() : nullptr;
}

// A node that takes means of windows.
struct Mean {
    Long axis, size;
};

static Failure* infer_mean(const Operator*, ShapeQuestion* call) {
    TensorShape* picture = nullptr;
    Long sizes[AXES] = {};
    Size count = 0;
    const ShapeQuestion* asked = call;
    TRY(ask(INPUT_SHAPE, asked, Size(0), &picture));
    TRY(take_sizes(picture, sizes, &count));
    return tell_sizes(asked, sizes);
}

static Failure* create_mean(const Operator*, Functions, const NodeInfo* node, void** made) {
    auto* own = (Mean*)(*made = malloc(sizeof(Mean)));
    if (!own) return no_memory();
    TRY(ask(INTEGER_ATTRIBUTE, node, "axis", &own->axis));
    return ask(INTEGER_ATTRIBUTE, node, "size", &own->size);
}

struct MeanWork {
    WindowMeans means;
    Long parts;
    bool has_failed;
};
static void make_mean_part(MeanWork* work, Size part) {
    const WindowMeans& means = work->means;
    const Room<float> sums(means.room());
    if (!sums) work->has_failed = true;
    else
        for (Long row = means.rows() * part / work->parts;
             row < Long(means.rows() * (part + 1) / work->parts); row++)
            means.make(row, sums.at);
}

static Failure* take_means(void* node, NodeCall* call) {
    const Mean& own = *(const Mean*)node;
    const Tensor* picture = nullptr;
    Tensor* out = nullptr;
    Long sizes[AXES] = {};
    Size axes = 0;
    float *from = nullptr, *to = nullptr;
    TRY(ask(INPUT, (const NodeCall*)call, Size(0), &picture));
    TRY(sizes_of(picture, sizes, &axes));
    TRY(numbers_of(picture, &from));
    TRY(ask(OUTPUT, call, Size(0), (const Long*)sizes, AXES, &out));
    TRY(numbers_of(out, &to));
    MeanWork work{{sizes[0] * sizes[1], sizes[2], sizes[3], own.size / 2, own.axis == 2, from, to},
                  MOST_PARTS, false};
    TRY(ask(PARALLEL, (const NodeCall*)call, (void (*)(void*, Size))make_mean_part,
            Size(work.parts), Size(0), (void*)&work));
    return work.has_failed ? no_memory() : nullptr;
}

constexpr Operator convolution_of(const char* name, bool is_rectified) {
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
        .input_kind = [](const Operator*, Size at) { return at < 2 ? REQUIRED : OPTIONAL; },
        .output_kind = [](const Operator*, Size) { return REQUIRED; },
        .memory = [](const Operator*, Size) { return 0; },
        .of_many = {},
        .create_checked = create_convolution,
        .compute_checked = convolve,
        .infer_shape = infer_sums,
        .of_versions_and_aliases = {},
        .own_name = name,
        .is_rectified = is_rectified,
    };
}
constexpr Operator mean_of(const char* name) {
    Operator made = convolution_of(name, false);
    made.count_inputs = [](const Operator*) { return Size(1); };
    made.create_checked = create_mean;
    made.compute_checked = take_means;
    made.infer_shape = infer_mean;
    return made;
}

struct Interface {
    Functions (*functions)(unsigned version);
    const char* (*version)();
};

// What ONNX Runtime calls where a session names this library.
EXPORTED Word RegisterCustomOps(Word options, const Interface* interface) {
    static constexpr Operator OPERATORS[] = {convolution_of("Convolve3x3", false),
                                             convolution_of("Convolve3x3Relu", true),
                                             mean_of("WindowMean")};
    the_functions = interface->functions(VERSION);
    void* domain = nullptr;
    Failure* failed = ask(CREATE_DOMAIN, "postfx", &domain);
    for (const Operator& one : OPERATORS)
        if (!failed) failed = ask(ADD_TO_DOMAIN, domain, &one);
    if (!failed) failed = ask(ADD_DOMAIN, (void*)options, domain);
    return (Word)failed;
}
