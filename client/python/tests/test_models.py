"""The models in process: their predictions, and the rules of scikit-learn for estimators."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest

from tidemap import models

MINUTE = np.timedelta64(60, "s")
MONDAY = np.datetime64("2026-01-05T00:00:00", "ns")


def office(days: int) -> tuple[np.ndarray, np.ndarray]:
    """Every ten minutes: 1 from 8 to 18 h of working days."""
    minutes = np.arange(days * 144) * 10
    hour, day = minutes // 60 % 24, minutes // 1440 % 7
    return MONDAY + minutes * MINUTE, ((hour >= 8) & (hour < 18) & (day < 5)).astype(int)


CLASSIFIERS = [
    models.FreMEn(order=8),
    models.Histogram(bins=168, cycle="week"),
    models.Calibrated(),
    models.Ensemble(),
    models.PerGaM(period="7d", gaussians=5),
    models.Hypertime(),
    models.Hypertime(method="km"),
]


@pytest.mark.parametrize("model", CLASSIFIERS, ids=repr)
def test_a_week_is_learned(model):
    when, value = office(21)
    model.fit(when[: 14 * 144], value[: 14 * 144])
    p = model.predict_proba(when[14 * 144 :])
    assert p.shape == (7 * 144, 2)
    assert np.allclose(p.sum(axis=1), 1)
    assert np.mean(model.predict(when[14 * 144 :]) == value[14 * 144 :]) > 0.85
    assert (model.entropy(when) >= 0).all()


def test_regressors_learn_numbers():
    when, value = office(21)
    for model in (models.FreMEnRegressor(order=8), models.HistogramRegressor(bins=168, cycle="week"),
                  models.CalibratedRegressor(), models.HypertimeRegressor(), models.Poisson()):
        model.fit(when, 3 * value)
        assert model.score(when, 3 * value) > 0.5, model


def test_times_may_be_seconds_dates_or_out_of_order():
    when, value = office(14)
    seconds = when.astype(np.int64) / 1e9
    expected = models.FreMEn().fit(when, value).predict_proba(when[:50])
    shuffled = np.random.default_rng(1).permutation(len(when))
    for X, at in (
        (seconds.reshape(-1, 1)[shuffled], seconds[:50].reshape(-1, 1)),
        (when[shuffled].reshape(-1, 1), when[:50]),
        ([str(time) + "Z" for time in when.astype("datetime64[s]")[shuffled]], list(when[:50])),
    ):
        assert np.allclose(models.FreMEn().fit(X, value[shuffled]).predict_proba(at), expected)


def test_the_zone_decides_what_a_day_is():
    # 9 to 10 h in Prague, over the end of summer time.
    utc = np.datetime64("2026-09-28T00:00:00", "ns") + np.arange(24 * 56) * 60 * MINUTE
    prague = [dt.datetime.fromisoformat(str(t)[:19]) + dt.timedelta(hours=2 if t < np.datetime64("2026-10-25T01") else 1)
              for t in utc]
    value = np.array([int(time.hour == 9) for time in prague])
    local = models.Histogram(time_zone="Europe/Prague", zone="UTC").fit(utc, value)
    assert np.mean(local.predict(utc) == value) == 1
    assert np.mean(models.Histogram().fit(utc, value).predict(utc) == value) < 1


def test_a_grid_search_finds_the_order():
    selection = pytest.importorskip("sklearn.model_selection")
    when, value = office(28)
    search = selection.GridSearchCV(
        models.FreMEn(), {"order": [0, 2, 8]}, cv=selection.TimeSeriesSplit(3), scoring="neg_brier_score"
    )
    search.fit(when.reshape(-1, 1), value)
    assert search.best_params_["order"] == 8
    base = pytest.importorskip("sklearn.base")
    assert base.clone(search.best_estimator_).get_params()["order"] == 8


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (models.FreMEn(order=99), "order"),
        (models.Histogram(cycle="moon"), "cycle"),
        (models.FreMEn(time_zone="Europe/Prag"), "Europe/Prag"),
    ],
)
def test_wrong_parameters_are_named(model, words):
    when, value = office(2)
    with pytest.raises(ValueError, match=words):
        model.fit(when, value)


def test_wrong_data_is_named():
    when, value = office(2)
    with pytest.raises(ValueError, match="as many"):
        models.FreMEn().fit(when, value[1:])
    with pytest.raises(ValueError, match="classes"):
        models.FreMEn().fit(when, np.arange(len(when)))
    with pytest.raises(ValueError, match="finite"):
        models.FreMEn().fit([[1.0], [float("nan")]], [0, 1])
    with pytest.raises(ValueError, match="columns"):
        models.FreMEn().fit(np.zeros((4, 2)), [0, 1, 0, 1])
    with pytest.raises(ValueError, match="fit"):
        models.FreMEn().predict(when)
