"""The conda-forge recipe of a release: python packaging/conda_recipe.py SDIST RECIPE.

RECIPE is for a new folder of conda-forge/staged-recipes, or for the feedstock. Dependencies stand
in pyproject.toml alone; what conda-forge calls otherwise is in NAMES. Kernels are compiled, so the
recipe is built for each system.
"""

from __future__ import annotations

import hashlib
import re
import runpy
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NAMES = {"openimageio": "py-openimageio", "isal": "python-isal"}
"""conda-forge's names of packages that the index calls otherwise."""
RECIPE = """\
schema_version: 1

context:
  version: "{version}"

package:
  name: {name}
  version: ${{{{ version }}}}

source:
  url: https://pypi.org/packages/source/{letter}/{name}/{file}-${{{{ version }}}}.tar.gz
  sha256: {digest}

build:
  number: 0
  skip:
    - match(python, "{unsupported}")
  script:
    # The compiler of the kernels: another version would give other bits.
    - python -m pip install --no-deps --target compiler {compiler}
    - if: unix
      then: PYTHONPATH=compiler python -m pip install . --no-deps --no-build-isolation -vv
      else: set PYTHONPATH=compiler&& python -m pip install . --no-deps --no-build-isolation -vv
  python:
    entry_points:
      - postfx = {entry}

requirements:
  host:
    - python
    - pip
    - {backend}
{host}
  run:
    - python
{run}

tests:
  - python:
      imports:
        - postfx
      pip_check: true
  - script:
      - postfx --version

about:
  homepage: https://pypi.org/project/{name}/
  summary: {summary}
  license: {license}
  license_file:
{license_files}

extra:
  recipe-maintainers:
    - {publisher}
"""


def recipe(sdist: bytes) -> str:
    """The recipe's text for a release whose sdist holds these bytes."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        told = tomllib.load(file)
    project = told["project"]
    backend, compiler = told["build-system"]["requires"]
    needed = "\n".join(f"    - {conda_name(one)}" for one in project["dependencies"])
    version = runpy.run_path(str(ROOT / "postfx/version.py"))
    return RECIPE.format(
        version=version["__version__"],
        publisher=version["PUBLISHER"],
        name=project["name"],
        letter=project["name"][0],
        file=project["name"].replace("-", "_"),
        digest=hashlib.sha256(sdist).hexdigest(),
        compiler=compiler,
        entry=project["scripts"]["postfx"],
        backend=conda_name(backend),
        host=needed,  # the man page is made of the command's parser, which imports them
        run=needed,
        unsupported=project["requires-python"].replace(">=", "<"),
        summary=project["description"].replace(": ", " - "),
        license=project["license"],
        license_files="\n".join(f"    - {name}" for name in project["license-files"]),
    )


def conda_name(requirement: str) -> str:
    """A requirement such as 'numpy>=2.0' as conda writes it."""
    match = re.fullmatch(r"([A-Za-z0-9._-]+)([<>=!~].*)?", requirement)
    if match is None:
        raise ValueError(f"pyproject.toml: '{requirement}' has no form for conda: see "
                         "conda_recipe.py")
    name, version = match[1].lower(), match[2] or ""
    return f"{NAMES.get(name, name)} {version}".strip()


def main(argv: list[str]) -> None:
    """Write the recipe."""
    sdist, path = map(Path, argv)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(recipe(sdist.read_bytes()), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
