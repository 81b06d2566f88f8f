"""`wingbeat identify` on files: methods by name, measured inputs, reference shapes, gaps."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from sim.bench.modal_loop import closed_loop
from sim.bench.modal_records import grid, published, shapes
from wingbeat.cli import app


def identified(*arguments):
    result = CliRunner().invoke(app, ["identify", *map(str, arguments), "--json", "-"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture
def decay(tmp_path):
    record = published("D2", 3)
    y = record.noisy.copy()
    y[200:215] = np.nan
    y[::17, 3] = np.nan
    np.savez(tmp_path / "decay.npz", time_s=record.time_s, y=y)
    return tmp_path / "decay.npz"


@pytest.mark.parametrize("method", ["refined", "paper", "rdt_era_dc", "ssi_data"])
def test_every_method_finds_the_first_mode_of_a_decay_with_gaps(decay, method):
    modes = identified(decay, "--method", method)["modes"]
    assert any(mode["frequency_hz"] == pytest.approx(0.72, rel=5e-3) for mode in modes)


def test_shapes_are_told_against_references(decay, tmp_path):
    form = shapes(*grid(5, 4))
    np.savez(tmp_path / "fe.npz", shape=np.array([form[name][2] for name in ("B2", "B1", "T1")]))
    modes = [mode for mode in identified(decay, "--shapes", tmp_path / "fe.npz")["modes"] if mode["valid"]]
    assert [mode["reference_shape"] for mode in modes] == [1, 2, 0]
    assert all(mode["shape_assurance"] > 0.998 for mode in modes)


def test_a_file_with_measured_torque_gives_the_plants_pole(tmp_path):
    record = closed_loop(7)
    np.savez(tmp_path / "loop.npz", time_s=record.time_s, y=record.y, u=record.u)
    (mode,) = [mode for mode in identified(tmp_path / "loop.npz")["modes"] if mode["valid"]]
    assert mode["frequency_hz"] == pytest.approx(abs(record.open_pole) / (2.0 * np.pi), rel=2e-3)
