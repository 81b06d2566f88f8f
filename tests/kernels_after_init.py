"""Flies a scenario and prints the flight side's kernels that some tick was the first to call: python FILE NAME SECONDS.

In a process of its own, for whatever called a kernel before would hide that no INIT does.
"""

import gc
import sys
from contextlib import redirect_stdout
from typing import Any

from numba.core.dispatcher import Dispatcher

from fsw.executive.executive import Executive
from wingbeat.cli import main


def ready() -> set[str]:
    """Kernels of the flight side that are compiled, each with the types that it is compiled for."""
    found = (each for each in gc.get_objects() if isinstance(each, Dispatcher))
    ours = (each for each in found if each.py_func.__module__.startswith("fsw."))
    return {f"{each.py_func.__module__}.{each.py_func.__name__}{types}" for each in ours for types in each.overloads}


def run(scenario: str, duration_s: str, folder: str) -> None:
    """Fly, and print."""
    begun: list[set[str]] = []
    init = Executive.init

    def noted(self: Executive, *arguments: Any) -> None:
        init(self, *arguments)
        begun.append(ready())

    Executive.init = noted  # type: ignore[method-assign]
    sys.argv = ["wingbeat", "sil", scenario, "--duration", duration_s, "--out", folder]
    with redirect_stdout(sys.stderr):
        try:
            main()
        except SystemExit as end:
            assert not end.code, end.code
    assert begun
    print("\n".join(sorted(ready() - begun[-1])))


if __name__ == "__main__":
    run(*sys.argv[1:])
