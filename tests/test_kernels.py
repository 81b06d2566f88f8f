"""Compiled code belongs to the sources it was made of; the command line says what it can do and how it ended."""

import ast
import json
import math
import subprocess
import sys
from dataclasses import asdict
from fcntl import LOCK_EX, flock
from importlib import import_module
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from conftest import wingbeat, wingbeat_here
from numba import config
from numba.core.errors import NumbaError
from numpy.typing import NDArray

import wingbeat.kernels as kernels
from fsw.executive.executive import Executive
from fsw.tables.flight import load_flight
from sim.compiling import PARTS, compile_part, spoil
from sim.surrogate_world import Scene, SurrogateWorld
from sim.whole_world import WholeWorld
from telemetry.modes_text import modes_table, partners
from wingbeat.console import track, write_json
from wingbeat.errors import InputError
from wingbeat.kernels import inline_kernel, kernel, tick_kernel

COMMANDS = ("sil", "replay", "identify", "decode", "export", "compile")


def test_the_folder_of_compiled_code_changes_with_any_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "painted"
    (package / "inner").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    source = package / "inner" / "edges.py"
    source.write_text("WIDTH = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(kernels, "PACKAGES", ("painted",))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    first = kernels._folder()
    assert first.is_dir() and first.is_relative_to(tmp_path / "cache") and kernels._folder() == first
    source.write_text("WIDTH = 2\n")
    second = kernels._folder()
    assert second != first
    source.rename(source.with_name("sides.py"))
    assert kernels._folder() not in (first, second)
    source.with_name("sides.py").rename(source)
    source.write_text("WIDTH = 1\n")
    assert kernels._folder() == first


def test_what_kernels_take_from_other_files_is_in_the_digest() -> None:
    makers = {"kernel", "tick_kernel", "inline_kernel"}
    taken = set()
    for room in (folder for folder in Path(__file__).parents[1].iterdir() if (folder / "__init__.py").is_file()):
        for source in room.rglob("*.py"):
            nodes = list(ast.walk(ast.parse(source.read_text(encoding="utf-8"))))
            imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
            homes = {name.asname or name.name: str(node.module) for node in imports for name in node.names}
            for function in (node for node in nodes if isinstance(node, ast.FunctionDef)):
                if makers & {getattr(maker, "id", "") for maker in function.decorator_list}:
                    names = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
                    taken |= {room.name} | {homes[name].partition(".")[0] for name in names & set(homes)}
    assert {"fsw", "hal", "sim"} <= taken
    assert taken - set(kernels.PACKAGES) <= {"numpy", "typing"}


def test_a_cache_that_cannot_be_written_moves_to_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(kernels.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    assert kernels._folder().is_relative_to(tmp_path / "temporary")


def test_a_kernel_is_kept_when_no_other_process_keeps_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "doubled.py").write_text(
        "from wingbeat.kernels import kernel\n\n@kernel\ndef double(a):\n    return 2.0 * a\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "kept"))
    double = import_module("doubled").double
    said: list[float] = []
    calling = Thread(target=lambda: said.append(double(4.0)))
    with (kernels.FOLDER / "lock").open("w") as lock:
        flock(lock, LOCK_EX)
        calling.start()
        while calling.is_alive() and not double.signatures:  # told once it is compiled, just before it is kept
            calling.join(0.02)
        calling.join(0.5)
        kept = [path for path in (tmp_path / "kept").rglob("*") if path.is_file()]
        assert calling.is_alive() and kept == []
    calling.join()
    assert said == [8.0] and list((tmp_path / "kept").rglob("*.nbi")) and list((tmp_path / "kept").rglob("*.nbc"))


def test_a_kernel_divides_by_zero_as_numpy_does() -> None:
    @kernel
    def ratio(a: float, b: float) -> float:
        return a / b

    assert ratio(1.0, 0.0) == math.inf and ratio(-1.0, 0.0) == -math.inf and math.isnan(ratio(0.0, 0.0))
    assert ratio(1.0, 4.0) == 0.25


def test_a_kernel_of_a_tick_that_allocates_does_not_compile() -> None:
    @tick_kernel
    def total(a: NDArray[np.float64]) -> float:
        return float((a + a).sum())

    @inline_kernel
    def first(a: NDArray[np.float64]) -> float:
        return float(a[0])

    @tick_kernel
    def twice(a: NDArray[np.float64]) -> float:
        return 2.0 * first(a)

    with pytest.raises(NumbaError, match="NRT"):
        total(np.ones(3))
    assert twice(np.full(3, 4.0)) == 8.0


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_has_an_example(command: str) -> None:
    text = wingbeat_here(command, "--help").stdout
    assert f"Example: wingbeat {command}" in " ".join(text.split())


def test_the_list_of_commands_names_them_all() -> None:
    text = wingbeat_here("--help").stdout
    assert all(command in text for command in COMMANDS)


def test_wrong_usage_is_told_apart_from_failure(tmp_path: Path) -> None:
    for arguments in (
        ("nonsense",),
        ("identify",),
        ("identify", "a.csv", "--kind", "sideways"),
        ("sil", "--pace", "x"),
    ):
        done = wingbeat_here(*arguments)
        assert done.returncode == 2 and "Usage" in done.stderr and not done.stdout, arguments
    done = wingbeat("identify", tmp_path / "absent.csv", check=False)
    assert done.returncode == 1 and not done.stdout
    assert done.stderr.startswith("wingbeat: error: ") and len(done.stderr.splitlines()) == 1


def test_a_defect_ends_in_one_line_that_says_so() -> None:
    code = (
        "import wingbeat.cli as cli\ndef fail(): raise ZeroDivisionError('two\\nlines')\ncli.app = fail\ncli.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1
    assert "internal error: ZeroDivisionError: two lines" in done.stderr and "report it" in done.stderr


def test_json_on_stdout_is_json_alone_and_the_same_as_in_a_file(tmp_path: Path) -> None:
    record = tmp_path / "record.csv"
    rows = [f"{math.exp(-0.02 * k) * math.cos(0.9 * k):.9f}" for k in range(240)]
    record.write_text("\n".join(["a", *rows]) + "\n")
    done = wingbeat("identify", record, "--rate", "20", "--kind", "decay", "--json", "-")
    wingbeat_here("identify", record, "--rate", "20", "--kind", "decay", "--json", tmp_path / "modes.json")
    result = json.loads(done.stdout)
    assert result == json.loads((tmp_path / "modes.json").read_text())
    s = 20.0 * complex(-0.02, 0.9)
    (mode,) = (mode for mode in result["modes"] if mode["valid"])
    assert mode["frequency_hz"] == pytest.approx(abs(s) / (2.0 * math.pi), rel=1e-5)
    assert mode["damping_ratio"] == pytest.approx(-s.real / abs(s), rel=1e-3)


def test_no_progress_is_drawn_where_nobody_looks(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(track(range(3), "work", 3)) == [0, 1, 2]
    assert capsys.readouterr().err.strip() == ""


def test_json_that_no_program_could_read_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError):
        write_json({"value": math.nan}, str(tmp_path / "out.json"))
    assert not (tmp_path / "out.json").exists()
    with pytest.raises(InputError, match="writable"):
        write_json({}, str(tmp_path / "absent" / "out.json"))


def mode(frequency_hz: float, **more: object) -> dict[str, object]:
    base: dict[str, object] = {
        "frequency_hz": frequency_hz,
        "frequency_sigma_hz": 1e-4,
        "damping_ratio": 0.006,
        "damping_ratio_sigma": 1e-4,
        "amplitude_mm": 10.0,
        "amplitude_coherence": 0.99,
        "valid": True,
        "flags": [],
    }
    return base | more


def test_the_table_shows_two_standard_deviations_and_every_doubt() -> None:
    modes = [mode(0.7146), mode(3.0, damping_ratio=None, damping_ratio_sigma=None, valid=False, flags=["harmonic"])]
    text = modes_table({"modes": modes, "flags": ["short_record"]}, [{"frequency_hz": 0.7146, "damping_ratio": 0.006}])
    head, first, second, last = text.splitlines()
    assert "0.71460 +- 0.00020" in first and "0.6000 +- 0.0196" in first and "not valid" not in first
    assert "+0.0000 % in f" in first and "truth" in head
    assert "not valid (harmonic)" in second and "- " in second and last == "record: short_record"
    assert modes_table({"modes": [], "flags": []}).startswith("no mode found")


def test_a_true_mode_stands_beside_the_nearest_found_one_only_if_it_is_near() -> None:
    found = [mode(0.70), mode(0.72), mode(4.0)]
    known = [{"frequency_hz": f, "damping_ratio": 0.01} for f in (0.7146, 3.0)]
    assert partners(found, known) == {1: known[0]}


def test_no_tick_and_no_identification_is_the_first_to_call_a_kernel(tmp_path: Path) -> None:
    script = Path(__file__).with_name("kernels_after_init.py")
    command = [sys.executable, script, "small", "2", tmp_path / "run"]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=400)
    assert said.stdout.split() == []


def test_what_is_compiled_beforehand_is_images_and_what_init_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared, drawn = [], []
    monkeypatch.setattr(Executive, "prepare", lambda _, task: prepared.append(task))
    for world in (WholeWorld, SurrogateWorld):
        monkeypatch.setattr(world, "render", lambda world, *given: drawn.append((type(world), given[3].dtype)))
    for part in PARTS:
        compile_part(part, bits=12)
    assert sorted(prepared) == sorted(2 * [row.task for row in load_flight().schedule])  # with each kind of vision
    assert drawn == 2 * [(WholeWorld, np.uint16)] + 2 * [(SurrogateWorld, np.uint8)]


def test_images_are_compiled_with_all_that_faults_do_to_them() -> None:
    scene = Scene()
    spoil(scene)
    untouched = [key for key, value in asdict(scene).items() if value == getattr(Scene(), key)]
    assert untouched == ["pattern"]
