"""A few faults of each group of `tests.reliability.faults`, and all of them."""

from __future__ import annotations

import pytest

from tests.reliability import faults


@pytest.mark.parametrize("name", faults.GROUPS)
def test_one_fault_of_each_group_is_survived(name: str, one_shot: faults.Shot) -> None:
    make, (kind, count) = faults.GROUPS[name].make, faults.GROUPS[name].damaged
    if make is None:
        assert count >= 28, "the process that damages files is tested in tests/fuzz/test_mutate.py"
        assert kind in faults.KINDS
        return
    attempts = list(make(one_shot))
    assert len(attempts) >= 6
    attempts[len(attempts) // 2]()


@pytest.fixture(scope="module")
def one_shot(tmp_path_factory: pytest.TempPathFactory) -> faults.Shot:
    return faults.Shot(tmp_path_factory.mktemp("faults"))


def test_what_is_not_survived_is_counted_and_told(monkeypatch: pytest.MonkeyPatch,
                                                  capsys: pytest.CaptureFixture[str]) -> None:
    def lose(_: object) -> list:
        def half_a_file() -> None:
            raise AssertionError("half a file")
        return [lambda: None, half_a_file]

    monkeypatch.setattr(faults, "Shot", lambda folder, passes: "no shot")
    monkeypatch.setitem(faults.GROUPS, "some", faults.Group("some", lose))
    assert faults.main(["some"], 1, 1) == 1
    said = capsys.readouterr().out
    assert "| some | 2 | 1 | `some` |" in said and "some 1: AssertionError half a file" in said


@pytest.mark.soak
def test_all_faults_are_survived() -> None:
    assert faults.main([], 1, 2) == 0
