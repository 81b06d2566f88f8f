"""What a figure was measured on: processor, cores, load, kernel, versions."""

import os
import platform
from importlib.metadata import version
from pathlib import Path


def this_machine() -> dict[str, str | int | float]:
    """The machine as a flat table; load: mean number of running processes in the last minute."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 0,
        "load_1min": round(os.getloadavg()[0], 2),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "opencv": version("opencv-python-headless"),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
