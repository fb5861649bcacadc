"""The table of faults in docs/lab/reliability.md: each row is a test, and each test of a fault is a
row."""

import ast
import re
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent
PAGE = TESTS.parent / "docs/lab/reliability.md"
ROW = re.compile(
    r"^\| .+ \| .+ \| .+ \| `(?P<file>[\w/.]+)::(?P<test>\w+)(?:\[(?P<case>.+)\])?` \|$",
    re.MULTILINE
)
LEAST = 60
COMPLETE = ("models", "looks", "resume", "locks", "interrupt", "run", "soak")
"""Files whose tests are all of faults, but for those in NO_FAULTS."""
NO_FAULTS = {
    "test_what_is_well_is_loaded", "test_every_shipped_model_is_let_through",
    "test_operators_are_onnx_own", "test_every_shipped_model_has_a_hash_and_declares_its_inputs",
    "test_our_reader_agrees_with_the_package", "test_lock_is_given_back",
    "test_claims_of_different_files", "test_manifest_tells_how_frames_were_made",
    "test_verify_in_words", "test_header_tells_how_a_frame_was_made",
    "test_log_has_an_object_for_each_event", "test_log_tells_what_was_skipped_and_why_a_run_failed",
    "test_frames_of_two_patterns_in_one_folder",
    "test_mistakes_in_options", "test_domain_that_no_node_uses_is_no_harm",
    "test_a_process_that_never_gets_there_ends_the_wait",
    "test_every_known_operator_is_one_of_onnx_runtime",
    "test_trust_overrides_what_nodes_do_and_nothing_else",
}


def names_in(path: Path) -> set[str]:
    """Names of the test functions of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in tree.body
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}


def rows() -> list[re.Match]:
    return list(ROW.finditer(PAGE.read_text(encoding="utf-8")))


def test_each_row_is_a_test():
    for row in rows():
        path = TESTS / row["file"]
        assert row["test"] in names_in(path), row[0]
        assert row["case"] is None or f'"{row["case"]}"' in path.read_text(encoding="utf-8"), row[0]


def test_each_test_of_a_fault_is_a_row():
    shown = {(row["file"], row["test"]) for row in rows()}
    for name in COMPLETE:
        file = f"reliability/test_{name}.py"
        missing = {test for test in names_in(TESTS / file) if (file, test) not in shown} - NO_FAULTS
        assert missing == set(), file


def test_no_row_is_there_twice_and_none_is_malformed():
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if "::test_" in line]
    assert len(lines) == len(set(lines)) == len(rows()) >= LEAST
