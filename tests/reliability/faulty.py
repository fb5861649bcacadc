"""`postfx` with faults: python faulty.py FAULTS ARGUMENTS...

FAULTS is a JSON list of objects: `at`, the dotted name of a function that is called by its module's name; `do`, one of
kill (SIGKILL to this process), sleep, fail (ReadError) and full (OSError: no space left); `when`, before (default) or
after the call; `of`, what the arguments must name; `calls`, numbers of such calls from 1 on that it happens at, or all
of them without; `seconds` of sleep.
"""

import errno
import importlib
import itertools
import json
import os
import signal
import sys
import time

from postfx.cli.main import main
from postfx.errors import ReadError


def act(fault):
    if fault["do"] == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif fault["do"] == "sleep":
        time.sleep(fault["seconds"])
    elif fault["do"] == "fail":
        raise ReadError("a read that failed for once")
    elif fault["do"] == "full":
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def install(fault):
    module_name, _, name = fault["at"].rpartition(".")
    try:
        owner = importlib.import_module(module_name)
    except ModuleNotFoundError:
        parent, _, kind = module_name.rpartition(".")
        owner = getattr(importlib.import_module(parent), kind)
    original, count = getattr(owner, name), itertools.count(1)

    def faulty(*arguments, **options):
        meant = fault.get("of", "") in " ".join(map(str, arguments))
        happens = meant and ("calls" not in fault or next(count) in fault["calls"])
        if happens and fault.get("when", "before") == "before":
            act(fault)
        result = original(*arguments, **options)
        if happens and fault.get("when") == "after":
            act(fault)
        return result

    setattr(owner, name, faulty)


if __name__ == "__main__":
    for one in json.loads(sys.argv[1]):
        install(one)
    sys.exit(main(sys.argv[2:]))
