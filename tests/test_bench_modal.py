"""The bench's own arithmetic: what counts as found, missed, made up and covered; and that its tables run."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from sim.bench import modal_on_board
from sim.bench.modal_records import DAMPING
from sim.bench.modal_scores import MEDIAN, Found, Score
from wingbeat.cli import app


def test_scores_of_known_modes():
    score = Score([0.72, 3.0])
    bound = np.array([[0.001, 0.0001], [0.01, 0.001]])
    score.add([Found(0.721, DAMPING + 0.0002, 0.001, 0.00005), Found(5.0, 0.01)], bound, 0.1)
    first, second, whole = score.rows("t", "m", "c")
    assert first["frequency_over_bound"] == pytest.approx(1.0 / MEDIAN)
    assert first["damping_error_median_percent"] == pytest.approx(4.0)
    assert (first["frequency_cover_percent"], first["damping_cover_percent"]) == (100.0, 0.0)
    assert second["missed"] == 1 and second["frequency_error_median_percent"] is None
    assert (whole["missed"], whole["spurious_a_record"], whole["cpu_ms"]) == (1, 1.0, 100.0)


@pytest.mark.parametrize("table", ["decay", "loop", "on_board"])
def test_tables_run_and_give_flat_rows(table, monkeypatch):
    monkeypatch.setattr(modal_on_board, "_SECONDS", 1)
    arguments = ["bench", "modal", "--rows", table, "--runs", "1", "--seed", "7", "--json", "-"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["rows"]
    assert rows and {row["table"] for row in rows} == {table}
    assert all(isinstance(value, (str, int, float, type(None))) for row in rows for value in row.values())


def test_unknown_tables_are_refused():
    result = CliRunner().invoke(app, ["bench", "modal", "--rows", "nothing"])
    assert result.exit_code != 0 and "is no table" in str(result.exception)
