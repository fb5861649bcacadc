"""Each row of the table of faults in files is a test."""

import ast
import re
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
ROW = re.compile(r"\| `(?P<file>(?:files|fuzz)/\w+\.py)::(?P<test>\w+)(?:\[(?P<case>.+)\])?` \|$",
                 re.MULTILINE)


def test_each_row_is_a_test() -> None:
    rows = list(ROW.finditer((TESTS.parent / "docs/lab/reliability.md").read_text("utf-8")))
    assert len(rows) >= 80 and len({row[0] for row in rows}) == len(rows)
    for row in rows:
        text = (TESTS / row["file"]).read_text("utf-8")
        names = [node.name for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
        assert row["test"] in names, row[0]
        assert row["case"] is None or f'"{row["case"]}"' in text, row[0]
