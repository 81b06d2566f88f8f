"""The bench's own arithmetic: what counts as found, missed, made up and covered; and that its tables run."""

import json

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from typer.testing import CliRunner

from sim.bench import modal_beside, modal_on_board, modal_oracle
from sim.bench.modal_beside import beside
from sim.bench.modal_bounds import cramer_rao, uncertainty_law
from sim.bench.modal_oracle import oracle
from sim.bench.modal_records import AMBIENT, DAMPING, pole, published, stationary
from sim.bench.modal_scores import MEDIAN, WITHIN, Found, Score
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


def test_a_record_as_a_whole_has_the_errors_of_all_its_modes():
    score = Score([0.72, 3.0])
    bound = np.array([[0.001, 0.0001], [0.01, 0.001]])
    for offs in ((1.0, 4.0), (2.0, np.nan), (3.0, 5.0)):
        modes = zip([0.72, 3.0], bound, offs, strict=True)
        score.add([Found(f + n * a, DAMPING - n * b, a, 2.0 * b) for f, (a, b), n in modes], bound, 0.1)
    *_, whole = score.rows("t", "m", "c")
    # Five modes found of six: 1, 2, 3, 4, 5 times the bound.
    assert [whole["frequency_over_bound"], whole["damping_over_bound"]] == pytest.approx([3.0 / MEDIAN] * 2)
    assert (whole["frequency_cover_percent"], whole["damping_cover_percent"]) == pytest.approx((20.0, 60.0))
    assert whole["missed"] == 1


def _scores(errors):
    """A score of one mode with these errors of frequency and damping over the bound; NaN: missed."""
    score, bound = Score([3.0]), np.array([[0.001, 0.0001]])
    for n in errors:
        score.add([Found(3.0 + n * bound[0, 0], DAMPING + n * bound[0, 1])] if np.isfinite(n) else [], bound, 0.1)
    return score


def test_beside_peers_stands_the_nearest_on_what_both_found():
    rng = np.random.default_rng(2)
    own = rng.standard_normal(100)
    worse, nearer = 2.0 * own, np.where(np.arange(100) < 10, np.nan, 0.5 * own)
    scores = {"worse": _scores(worse), "nearer": _scores(nearer), "blind": _scores(np.full(100, np.nan))}
    rows = beside("t", "c", _scores(own), scores, _scores(own))
    assert [row["column"] for row in rows[:4]] == [
        f"{n} {q}" for n in ("frequency", "damping") for q in ("median", "p95")
    ]
    for row, share, unit in zip(rows[:2], (0.5, 0.95), (MEDIAN, WITHIN), strict=True):
        told = np.quantile(np.abs(own[10:]), share) / unit
        assert (row["method"], row["peer_missed"]) == ("nearer", 10)
        assert [row["wingbeat"], row["oracle"], row["peer"]] == pytest.approx([told, told, 0.5 * told])
        assert row["nearer_by"] == pytest.approx(-0.5 * told)
    assert beside("t", "c", _scores(own), {"blind": scores["blind"]}, _scores(own)) == []


def test_the_deviation_beside_a_peer_is_that_of_other_records(monkeypatch):
    monkeypatch.setattr(modal_beside, "_DRAWS", 50)
    rng = np.random.default_rng(3)
    nearer_by, told = [], []
    for _ in range(100):
        own = rng.standard_normal((60, 1))
        errors = np.abs([own, own + 0.3 * rng.standard_normal(own.shape)])
        nearer_by.append(np.subtract(*np.median(errors, axis=1)))
        told.append(modal_beside._deviation(errors, 0.5))
    assert np.median(told) == pytest.approx(np.std(nearer_by), rel=0.3)


@pytest.mark.parametrize("table", ["decay", "loop", "on_board"])
def test_tables_run_and_give_flat_rows(table, monkeypatch):
    monkeypatch.setattr(modal_on_board, "_SECONDS", 1)
    arguments = ["bench", "modal", "--rows", table, "--runs", "1", "--seed", "7", "--json", "-"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["rows"]
    assert rows and {row["table"] for row in rows} == {table}
    assert all(isinstance(value, (str, int, float, type(None))) for row in rows for value in row.values())


def test_a_suite_that_there_is_not_is_wrong_usage() -> None:
    result = CliRunner().invoke(app, ["bench", "nothing"])
    assert result.exit_code == 2 and "nothing is no suite; choose one of vision, modal or all" in result.output


def test_unknown_tables_are_refused():
    result = CliRunner().invoke(app, ["bench", "modal", "--rows", "nothing"])
    assert result.exit_code != 0 and "is no table" in str(result.exception)


def test_the_oracle_of_a_decay_reaches_the_bound():
    records = [published("D1", seed) for seed in range(100)]
    found = [oracle("D1", record.time_s, record.noisy)[0] for record in records]
    off = [
        (np.array([mode.frequency_hz, mode.damping_ratio]) - [0.72, DAMPING]) / cramer_rao(record)[0]
        for mode, record in zip(found, records, strict=True)
    ]
    assert np.sqrt(np.mean(np.square(off), axis=0)) == pytest.approx([1.0, 1.0], abs=0.2)


def test_the_oracle_has_the_exact_likelihood_of_a_sampled_response():
    signal = np.random.default_rng(1).standard_normal(40)
    system = modal_oracle._system(0.72, DAMPING, 2.0, 20.0)
    s = pole(0.72) / 20.0
    # White force on a damped oscillator: the correlation of the displacement falls as a free vibration does.
    correlation = 2.0 * (np.exp(s * np.arange(40)) * (1.0 + 1j * s.real / s.imag)).real
    covariance = scipy.linalg.toeplitz(correlation) + 0.3 * np.eye(40)
    direct = scipy.stats.multivariate_normal(np.zeros(40), covariance).logpdf(signal) + 20.0 * np.log(2.0 * np.pi)
    assert modal_oracle._kalman(signal, *system, 0.3) == pytest.approx(direct, rel=1e-9)


def test_the_oracle_of_a_response_is_right_within_its_deviations():
    modes, duration_s, rate_hz, points, noise_mm = AMBIENT["A1"]
    for seed in range(2):
        found = oracle("A1", *stationary(modes, duration_s, rate_hz, points, noise_mm, 500 + seed))
        for mode, hz in zip(found, modes.values(), strict=True):
            law = uncertainty_law(hz, duration_s)
            assert abs(mode.frequency_hz - hz) < 4.0 * mode.frequency_sigma_hz < 10.0 * law[0]
            assert abs(mode.damping_ratio - DAMPING) < 4.0 * mode.damping_ratio_sigma < 10.0 * law[1]
