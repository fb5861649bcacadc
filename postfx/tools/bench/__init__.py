"""Run time against error: methods measured side by side on a sequence with references."""

from importlib.util import find_spec

from postfx.errors import BenchError
from postfx.version import pip_install


def require(module: str, package: str, use: str) -> None:
    """Raise BenchError when a library of the extra 'bench' is not installed."""
    if find_spec(module) is None:
        raise BenchError(f"{package} is not installed, and it {use}: {pip_install('bench')}")
