"""Bad input ends in one clear line, exit code 1, and no folder that looks like a run."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import wingbeat_here


@pytest.fixture
def sequence(recordings: Path, tmp_path: Path) -> Path:
    """A writable copy of the first pairs of the recorded sequence."""
    folder = tmp_path / "sequence"
    for eye in ("left", "right"):
        (folder / eye).mkdir(parents=True)
        for image in sorted((recordings / "wing_close" / eye).iterdir())[:4]:
            shutil.copyfile(image, folder / eye / image.name)
    for name in ("sequence.toml", "cameras.toml", "wing.toml"):
        shutil.copyfile(recordings / "wing_close" / name, folder / name)
    return folder


def refused(*arguments: object) -> str:
    """The one line that a command gives up with."""
    done = wingbeat_here(*arguments)
    assert done.returncode == 1, done.stdout + done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("wingbeat: error: "), done.stderr
    return lines[0]


def replay(folder: Path) -> str:
    """The line that a replay of this sequence gives up with; it leaves nothing behind that looks like a run."""
    line = refused("replay", folder / "sequence.toml", "--out", folder.parent / "run")
    assert not (folder.parent / "run").exists()
    return line


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.requirement("WB-APP-03")
def test_a_missing_image_is_named(sequence: Path) -> None:
    (sequence / "right" / "000002.png").unlink()
    assert "right" in replay(sequence)


@pytest.mark.requirement("WB-APP-03")
def test_a_broken_image_is_named(sequence: Path) -> None:
    image = sequence / "left" / "000001.png"
    image.write_bytes(image.read_bytes()[:5000])
    assert "000001.png" in replay(sequence)


def test_an_image_damaged_inside_is_named(sequence: Path) -> None:
    image = sequence / "left" / "000001.png"
    data = bytearray(image.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 400] = bytes(400)
    image.write_bytes(data)
    assert "000001.png" in replay(sequence)
    kept = {path.name for path in (sequence.parent / "run.partial").iterdir()}
    assert {"points.npz", "quality.csv"} <= kept and "summary.json" not in kept


def test_an_image_of_another_size_is_named_with_both_sizes(sequence: Path) -> None:
    cv2.imwrite(str(sequence / "left" / "000003.png"), np.zeros((100, 200), np.uint8))
    line = replay(sequence)
    assert "000003.png" in line and "200" in line and "2048" in line


def test_a_transposed_rotation_is_suspected(sequence: Path) -> None:
    text = (sequence / "cameras.toml").read_text()
    head, tail = text.split("rotation = ")
    rows = np.array(eval(tail.splitlines()[0])).T.tolist()
    (sequence / "cameras.toml").write_text(f"{head}rotation = {rows}\n" + "\n".join(tail.splitlines()[1:]) + "\n")
    line = replay(sequence)
    assert "overlap" in line and "transpose" in line and "cameras.toml" in line


def test_a_wing_out_of_view_is_said_to_be(sequence: Path) -> None:
    edit(sequence / "wing.toml", "translation_mm = [-669.789501", "translation_mm = [-9669.789501")
    line = replay(sequence)
    assert "no cell" in line and "wing.toml" in line


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("wing.toml", "cells_are", "cells_look", "cells_look"),
        ("cameras.toml", "fx = ", "focal = ", "focal"),
        ("sequence.toml", "rate_hz = 15", "rate_hz = -15", "rate_hz"),
        ("sequence.toml", "rate_hz = 15", "rate_hz 15", "TOML"),
    ],
)
@pytest.mark.requirement("WB-APP-03")
def test_a_wrong_key_or_value_is_named(sequence: Path, name: str, old: str, new: str, said: str) -> None:
    edit(sequence / name, old, new)
    line = replay(sequence)
    assert said in line and name in line


@pytest.mark.requirement("WB-APP-03")
def test_a_folder_that_is_no_run_is_not_touched(sequence: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("years of work")
    line = refused("replay", sequence / "sequence.toml", "--out", mine)
    assert "mine" in line and (mine / "thesis.txt").read_text() == "years of work"


def test_missing_files_and_unknown_scenarios_are_one_line() -> None:
    assert "nowhere.toml" in refused("replay", "nowhere.toml")
    assert "paper, small" in refused("sil", "no-such-scenario")
    assert "nowhere.npz" in refused("identify", "nowhere.npz")
    assert "nowhere.log" in refused("decode", "nowhere.log")


def test_wrong_usage_is_exit_code_2() -> None:
    assert wingbeat_here("replay").returncode == 2
    assert wingbeat_here("fluctuate").returncode == 2
