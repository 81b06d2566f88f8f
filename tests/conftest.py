"""What several tests share: recorded data beside the project, and one simulated run that all may read."""

import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from hypothesis import settings

from wingbeat.cli import main

# No test asserts a time: machines are shared.
settings.register_profile("shared", deadline=None)
settings.load_profile("shared")

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of recorded data that nobody made for these tests."""
    if not SHARED.is_dir():
        pytest.skip("the recorded data (../shared/data) is not on this machine")
    return SHARED


def wingbeat(*arguments: object, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    command = [sys.executable, "-m", "wingbeat.cli", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    if check:
        assert done.returncode == 0, done.stderr
    return done


def wingbeat_here(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The same command in this process, where nothing depends on its own: start-up takes seconds."""
    out, err, given = StringIO(), StringIO(), sys.argv
    sys.argv = ["wingbeat", *map(str, arguments)]
    try:
        with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as end:
            main()
    finally:
        sys.argv = given
    code = end.value.code or 0
    if isinstance(code, str):  # Python prints it, and returns 1
        err.write(code + "\n")
        code = 1
    return subprocess.CompletedProcess(list(arguments), code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight seconds of the scenario `small`, flown in lockstep."""
    folder = tmp_path_factory.mktemp("runs") / "small"
    wingbeat("sil", "small", "--duration", "8", "--out", folder)
    return folder
