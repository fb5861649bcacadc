"""The table of what the code is like counts what it says."""

from pathlib import Path

from tests.code_table import (
    count_kernel_families,
    count_kernel_lines,
    count_twins,
    make_table,
    read_sources,
)

NEAR = ('NEAR = 1\nSTEP, MOST = 2, 3\nNAMES[NEAR] = 4\n\ndef f(a, b, c, d, e, f, g, *rest, h=1):\n'
        '    SMALL = 4\n    return SMALL\n')
WIDE = ('NEAR: int = 1\n\n\nclass A:\n    def f(self, a, b, c, d, e, f, g, h):\n        return '
        '"' + 88 * "x" + '"\n')


def test_the_table_counts_what_it_says(tmp_path: Path) -> None:
    (tmp_path / "near.py").write_text(NEAR)
    (tmp_path / "wide.py").write_text(WIDE)
    table = make_table(read_sources(tmp_path))
    assert {name: value.split()[0] for name, value in table.items()} == {
        "modules": "2",
        "lines": "13",
        "lines over 100 columns": "1",
        "functions with more than 8 parameters": "1",
        "constants named in several modules": "1",
        "lines with several constants": "1",
    }


def test_lines_of_kernels_are_counted_by_language(tmp_path: Path) -> None:
    for name, lines in (("postfx/kernels/a.h", 2), ("postfx/kernels/denoise/a.cpp", 3),
                        ("postfx/interpolate/a.cu", 5), ("postfx/kernels/a.py", 7),
                        ("training/kernels/a.py", 11)):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(lines * "one\n")
    assert count_kernel_lines(tmp_path) == {
        "lines of kernels": "21", "lines of kernels in C++": "5", "lines of kernels in CUDA": "5",
        "lines of kernels in PyTorch": "11"}


def test_lines_of_kernels_are_told_by_family_and_form(tmp_path: Path) -> None:
    shared = "FN float both(float a) {\n    return a;\n}\n"
    apart = "FN float apart(float a) { return a; }\n"
    for name, text in (("postfx/kernels/number.h", "FN float both(float a) { return a; }\n"),
                       ("postfx/kernels/denoise/a.h", "one\n"),
                       ("postfx/kernels/denoise/a.cpp", 3 * "one\n"),
                       ("postfx/interpolate/a.cu", shared + apart),
                       ("training/kernels/parts.py", 7 * "one\n")):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert count_kernel_families(tmp_path) == {
        "numbers and rows": {"pixels": 1}, "frames between": {"CUDA": 4},
        "denoiser": {"pixels": 1, "CPU": 3, "PyTorch": 7}}
    assert count_twins(tmp_path) == 3
