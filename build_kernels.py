"""Compiles the kernels ahead, for a wheel: `python build_kernels.py`, on the kind of system that the wheel is for.

It runs the commands below on the sample to see which functions they call with which types, compiles these for each
level of the processor, as Numba would for this machine, and links them into one shared library a level, which lies with
its index in postfx/_kernels. `postfx.kernels.native` says what they are for. It needs a C compiler, and takes about
six minutes of processor time.
"""

from __future__ import annotations

import argparse
import json
import os
import pkgutil
import shlex
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from postfx import kernels
from postfx.kernels import native
from postfx.kernels.native import FOLDER, LEVELS, Kinds, digest_of_sources, target_of

ROOT = Path(__file__).resolve().parent
COMMANDS = """
run {sample} -o {out}/m.####.exr --model m
run {sample} -o {out}/s.####.exr --model s --tonemap aces2 --exposure smooth
run {sample} -o {out}/f.####.exr --model m.fp32 --scale 1.5 --strength 0.5 --bits 32
run {sample} -o {out}/m.####.png --model m --scale 1 --leave auto --tonemap
run {sample} -o {out}/b.####.jpg --both-ways --keep all
run {sample} -o {out}/c.####.exr --motion estimate
run {sample} -o {out}/n.####.exr --model classic
run {sample} -o {out}/d.####.tif --no-denoise
interpolate {sample} -o {out}/i.####.exr
inspect {sample}
"""
"""What a user may run first; the kernels of all passes are compiled in any case."""
RUNTIME = """
#include <stdint.h>
#include <stdlib.h>

/* Memory of arrays that kernels make, as numba/core/runtime/nrt.cpp lays it out. */
typedef struct { size_t count; void *dtor, *info, *data; size_t size; void *allocator; } MemInfo;

void *NRT_MemInfo_alloc_aligned(size_t size, unsigned align) {
    MemInfo *made = malloc(sizeof(MemInfo) + size + align);
    if (made) {
        uintptr_t data = (uintptr_t)(made + 1);
        *made = (MemInfo){1, 0, 0, (void *)(align ? (data + align - 1) / align * align : data), size, 0};
    }
    return made;
}

void *NRT_MemInfo_alloc(size_t size) { return NRT_MemInfo_alloc_aligned(size, 0); }
void NRT_MemInfo_call_dtor(void *made) { free(made); }
void *NRT_Allocate(size_t size) { return malloc(size); }
void NRT_Free(void *memory) { free(memory); }

/* Lists are made only for the text of an error; without memory for it there is an error, too. */
void *NRT_MemInfo_new_varsize_dtor(size_t size, void *dtor) { return 0; }
void *NRT_MemInfo_varsize_realloc(void *made, size_t size) { return 0; }

/* Strides of a contiguous array in another shape; numba/_helperlib.c has the general one. */
int numba_attempt_nocopy_reshape(intptr_t axes, const intptr_t *shape, const intptr_t *strides, intptr_t new_axes,
                                 const intptr_t *new_shape, intptr_t *new_strides, intptr_t size, int fortran) {
    intptr_t step = size;
    for (intptr_t k = axes; k-- > 0; step *= shape[k]) if (shape[k] != 1 && strides[k] != step) return 0;
    step = size;
    for (intptr_t k = new_axes; k-- > 0; step *= new_shape[k]) new_strides[k] = step;
    return !fortran;
}
"""
"""What compiled code calls of Numba's runtime."""
UNUSED = "void *{}(void) {{ return 0; }}\n"
"""Python's functions: code that would make Python's objects of an error is there, but nobody calls it."""
Wanted = dict[str, list[Kinds]]


def main() -> None:
    """Record what is called, then make a library for each level, in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--into", type=Path, default=FOLDER, help="folder of the libraries")
    parser.add_argument("--level", choices=LEVELS, help=argparse.SUPPRESS)
    parser.add_argument("--functions", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    given.into.mkdir(parents=True, exist_ok=True)
    if given.level:
        wanted = {name: [tuple(kinds) for kinds in forms] for name, forms in
                  json.loads(given.functions.read_text()).items()}
        make_library(wanted, given.into / given.level, given.level)
        return
    with tempfile.TemporaryDirectory() as folder:
        functions = Path(folder) / "functions.json"
        functions.write_text(json.dumps(record(folder)))
        jobs = [subprocess.Popen(
            [sys.executable, __file__, "--into", given.into, "--level", level, "--functions", functions],
            env={**os.environ, **target_of(level)}) for level in LEVELS]
        if any([job.wait() for job in jobs]):
            sys.exit("a library was not made")


def record(folder: str) -> Wanted:
    """Run the commands; functions that they call, by name, with the kinds of arguments."""
    from numba.core.dispatcher import Dispatcher

    from postfx.cli.main import main as postfx
    from postfx.runtime import states

    wanted: dict[str, dict[Kinds, None]] = {}

    def note(function: Any, kinds: Kinds) -> None:
        name = f"{function.__module__}.{function.__qualname__}"
        if None not in kinds and name.startswith("postfx."):
            wanted.setdefault(name, {})[kinds] = None

    compile_for_call, compile_rows = Dispatcher._compile_for_args, states.compile_rows

    def called(dispatcher: Any, *arguments: Any, **named: Any) -> Any:
        note(dispatcher.py_func, native.kinds_of(arguments))
        return compile_for_call(dispatcher, *arguments, **named)

    def prepared(rows: Any, arrays: Any) -> None:
        if hasattr(rows, "py_func"):
            note(rows, ("q", "q", *arrays))
        compile_rows(rows, arrays)

    for module in pkgutil.walk_packages(kernels.__path__, f"{kernels.__name__}."):
        for kernel in vars(import_module(module.name)).values():
            if isinstance(kernel, kernels.Kernel) and hasattr(kernel.rows, "compile"):
                shapes = [(kernel.types.get(name, "float32"), kernel.shapes.get(name)) for name in
                          (*kernel.reads, *(name for name in kernel.writes if name not in kernel.reads))]
                if all(shape is not None for _, shape in shapes):
                    note(kernel.rows, ("q", "q", *(f"{np.dtype(kind).str}:{len(shape or ())}"
                                                   for kind, shape in shapes)))
    Dispatcher._compile_for_args, states.compile_rows = called, prepared
    for line in COMMANDS.strip().splitlines():
        words = line.format(sample=ROOT / "samples/room/noisy.####.exr", out=folder)
        if status := postfx([*shlex.split(words), "--frames", "1-2"]):
            sys.exit(f"postfx {words}: status {status}")
    return {name: list(kinds) for name, kinds in wanted.items()}


def make_library(wanted: Wanted, path: Path, level: str) -> None:
    """Compile functions for a level, into a shared library and its index. Numba was told the level when it started."""
    import llvmlite.binding as llvm

    from postfx.kernels import compile_cache

    compile_cache.cache_folder = lambda: None  # which holds machine code only, for other addresses
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine(
        *target_of(level).values(), 3, reloc="pic", codemodel="default")
    functions: dict[str, tuple[str, Kinds, str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        objects: list[Path] = []
        unused: set[str] = set()
        for name, forms in sorted(wanted.items()):
            module, _, attribute = name.rpartition(".")
            for kinds in forms:
                symbol = f"postfx_{len(functions)}"
                made = compile_function(getattr(import_module(module), attribute), kinds, symbol, target)
                if made is None:
                    print(f"{name}: has no plain result")
                    continue
                code, result, python = made
                unused |= python
                functions[symbol] = (name, kinds, result)
                objects.append(Path(folder) / f"{symbol}.o")
                objects[-1].write_bytes(code)
        (Path(folder) / "runtime.c").write_text(RUNTIME + "".join(map(UNUSED.format, sorted(unused))))
        subprocess.run(["cc", "-shared", "-O2", "-fPIC", "-s", "-Wl,--no-undefined", "-o", f"{path}.so",
                        f"{folder}/runtime.c", *objects, "-lm"], check=True)
    index = {"sources": digest_of_sources(_sources()), "functions": functions}
    Path(f"{path}.json").write_text(json.dumps(index, separators=(",", ":")))
    print(f"{path}.so: {len(functions)} functions, {Path(f'{path}.so').stat().st_size / 1e6:.1f} MB")


def _sources() -> list[str]:
    """Modules with kernels, or with what these are made of."""
    package = ROOT / "postfx"
    return sorted(path.relative_to(package).as_posix() for path in package.rglob("*.py")
                  if path.is_relative_to(package / "kernels") or "postfx.kernels.numeric" in path.read_text("utf-8"))


def compile_function(function: Any, kinds: Kinds, symbol: str, target: Any) -> tuple[bytes, str, set[str]] | None:
    """An object file with a function's code and an entry that takes words, the letter of its result, and names of
    Python's that it refers to; None if the result is not one number."""
    import llvmlite.binding as llvm
    from numba.core import types
    from numba.core.registry import cpu_target

    letters = {types.none: "", types.boolean: "?", types.int64: "q", types.uint64: "Q", types.float64: "d",
               types.float32: "f"}
    signature = native.signature(kinds)
    function.compile(signature)
    compiled = function.overloads[signature]
    if compiled.signature.return_type not in letters:
        return None
    entry = write_entry(cpu_target.target_context, compiled, symbol)
    module = llvm.parse_bitcode(compiled.library._final_module.as_bitcode())
    module.link_in(llvm.parse_assembly(str(entry)))
    for one in [*module.functions, *module.global_variables]:
        if not one.is_declaration and one.name != symbol:
            one.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options(speed_level=0)))
    python = {one.name for one in [*module.functions, *module.global_variables]
              if one.is_declaration and one.name.lstrip("_").startswith("Py")}
    return target.emit_object(module), letters[compiled.signature.return_type], python


def write_entry(context: Any, compiled: Any, symbol: str) -> Any:
    """LLVM's module with `int symbol(const int64_t *words, void *result)`, which calls a compiled function."""
    from llvmlite import ir
    from numba.core import cgutils, types
    from numba.np import arrayobj

    module = ir.Module(symbol)
    module.triple, module.data_layout = compiled.library._final_module.triple, str(context.target_data)
    word, pointer = ir.IntType(64), ir.IntType(8).as_pointer()
    entry = ir.Function(module, ir.FunctionType(ir.IntType(32), [word.as_pointer(), pointer]), symbol)
    builder = ir.IRBuilder(entry.append_basic_block())
    words, place = entry.args
    read = 0

    def next_word() -> Any:
        nonlocal read
        read += 1
        return builder.load(builder.gep(words, [word(read - 1)]))

    arguments = []
    for kind in compiled.signature.args:
        if isinstance(kind, types.Array):
            address, shape = next_word(), [next_word() for _ in range(kind.ndim)]
            size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
            strides = [word(size)]
            for length in reversed(shape[1:]):
                strides.insert(0, builder.mul(strides[0], length))
            array = arrayobj.make_array(kind)(context, builder)
            arrayobj.populate_array(array, builder.inttoptr(address, array.data.type), shape, strides, word(size),
                                    meminfo=None)
            arguments.append(array._getvalue())
        elif kind == types.boolean:
            arguments.append(builder.trunc(next_word(), ir.IntType(1)))
        elif kind == types.float64:
            arguments.append(builder.bitcast(next_word(), ir.DoubleType()))
        elif kind == types.float32:
            arguments.append(builder.bitcast(builder.trunc(next_word(), ir.IntType(32)), ir.FloatType()))
        else:
            arguments.append(next_word())
    callee = context.declare_function(module, compiled.fndesc)
    result = compiled.signature.return_type
    status, value = context.call_conv.call_function(builder, callee, result, compiled.signature.args, arguments)
    with cgutils.if_likely(builder, status.is_ok):
        if result != types.none:
            kept = builder.zext(value, ir.IntType(8)) if result == types.boolean else value
            builder.store(kept, builder.bitcast(place, kept.type.as_pointer()))
    builder.ret(builder.zext(status.is_error, ir.IntType(32)))
    return module


if __name__ == "__main__":
    main()
