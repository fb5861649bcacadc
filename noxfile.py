"""Tests on every Python that postfx supports.

nox                      # those that are here; others are skipped
nox -p 3.13 -- tests/io  # one Python, some tests
nox -s lowest            # the oldest dependencies that are allowed

Environments are fresh and have neither torch nor the other extras for training: tests that need
them are skipped. `make release` installs the wheel and the sdist into each Python and runs them.
"""

import nox

PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
TESTS = ["tests/cli", "tests/files", "tests/io", "tests/reliability", "tests/test_site.py"]
LOWEST = ["tests/cli", "tests/files", "tests/io", "tests/interpolate", "tests/test_repeats.py"]


@nox.session(python=PYTHONS, venv_backend="venv")
def tests(session: nox.Session) -> None:
    """Files, the command line and what the site says."""
    session.install("--quiet", "--constraint", "constraints.txt", "--editable", ".[test]")
    session.run("postfx", "--version")
    session.run("python", "-m", "pytest", "-q", *(session.posargs or TESTS))


@nox.session(python="3.11", venv_backend="venv")
def lowest(session: nox.Session) -> None:
    """The oldest versions of dependencies that are allowed; the others have the newest."""
    session.install("--quiet", "--constraint", "constraints-lowest.txt", "--editable", ".[test]")
    session.run("python", "-m", "pytest", "-q", *(session.posargs or LOWEST))
