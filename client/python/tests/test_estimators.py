"""The models as estimators: what scikit-learn and joblib expect of one."""

from __future__ import annotations

import copy
import inspect
import pickle
from typing import Any

import numpy as np
import pytest

from tidemap import models
from test_models import CLASSIFIERS, MONDAY, office

ESTIMATORS = [
    *CLASSIFIERS, models.Mean(), models.Latest(), models.Persistence(), models.FreMEnRegressor(order=8),
    models.HistogramRegressor(), models.CalibratedRegressor(), models.HypertimeRegressor(), models.Poisson(),
]


def answers(model: Any, when: np.ndarray) -> np.ndarray:
    return model.predict_proba(when)[:, 1] if hasattr(model, "predict_proba") else model.predict(when)


@pytest.mark.parametrize("model", ESTIMATORS, ids=lambda model: type(model).__name__)
def test_a_copy_gives_the_same_numbers(model, tmp_path):
    when, value = office(14)
    expected = answers(model.fit(when, value), when)
    copies = {"pickle": pickle.loads(pickle.dumps(model)), "deepcopy": copy.deepcopy(model)}
    joblib = pytest.importorskip("joblib")
    joblib.dump(model, tmp_path / "model.joblib")
    copies["joblib"] = joblib.load(tmp_path / "model.joblib")
    for way, twin in copies.items():
        assert (answers(twin, when) == expected).all(), way
        assert twin.get_params() == model.get_params() and repr(twin) == repr(model)
    clone = pytest.importorskip("sklearn.base").clone
    assert clone(model).get_params() == model.get_params()
    assert not hasattr(clone(model), "model_")


def test_parameters_stand_in_the_repr():
    assert repr(models.FreMEn(order=3)) == (
        "FreMEn(order=3, period_base='7d', period_count=168, time_zone='UTC', zone=None)"
    )
    assert repr(models.Mean()) == "Mean()"


def test_what_was_learned_is_there():
    when, value = office(28)
    model = models.FreMEn(order=2).fit(when, value)
    assert model.n_features_in_ == 1 and model.classes_.tolist() == [0, 1]
    assert model.mean_ == pytest.approx(value.mean())
    assert [round(rhythm.period_secs / 3600) for rhythm in model.rhythms_] == [24, 7 * 24]
    day = model.rhythms_[0]
    assert day.amplitude > 0.3 and np.cos(2 * np.pi * 13 / 24 + day.phase_rad) > 0.9, "highest at 13 h"
    pandas = pytest.importorskip("pandas")
    named = models.FreMEn().fit(pandas.DataFrame({"when": when}), value)
    assert named.feature_names_in_.tolist() == ["when"]
    assert not hasattr(named.fit(when, value), "feature_names_in_")


def test_columns_and_rows_are_the_same():
    when, value = office(7)
    flat = models.Histogram().fit(when, value)
    column = models.Histogram().fit(when.reshape(-1, 1), value)
    assert (flat.predict_proba(when) == column.predict_proba(when.reshape(-1, 1))).all()
    words = np.where(value == 1, "open", "shut")
    assert set(models.Histogram().fit(when, words).predict(when)) == {"open", "shut"}


def test_one_meaning_of_integers():
    when, value = office(7)
    nanos = when.astype(np.int64)
    expected = models.FreMEn().fit(when, value).predict_proba(when)
    assert (models.FreMEn().fit(nanos.reshape(-1, 1), value).predict_proba(when) == expected).all()
    with pytest.raises(ValueError, match="ambiguous"):
        models.FreMEn().fit(nanos // 10**9, value)


def test_times_without_a_zone_need_a_word_in_a_zone():
    when, value = office(14)
    with pytest.raises(ValueError, match="Europe/Prague"):
        models.Histogram(time_zone="Europe/Prague").fit(when, value)
    local = models.Histogram(time_zone="Europe/Prague", zone="local").fit(when, value)
    assert local.predict_proba([MONDAY + np.timedelta64(12, "h")])[0, 1] > 0.7
    before, after = local.predict_proba(["2026-01-19T06:30:00Z", "2026-01-19T07:30:00Z"])[:, 1]
    assert after > 0.7 > before


# check_estimator has no data with one column to try. So all but the width of X is checked on the first column of its
# data.
WIDTH = {"check_n_features_in", "check_n_features_in_after_fitting", "check_classifiers_train"}
# The small integers of check_estimator may be seconds or nanoseconds, and are refused.
INTEGERS = {"check_estimators_dtypes", "check_classifier_data_not_an_array"}


@pytest.mark.filterwarnings("ignore:Can't test estimator")
@pytest.mark.parametrize("model", sorted({type(model) for model in ESTIMATORS}, key=lambda model: model.__name__))
def test_scikit_learn_takes_it_for_an_estimator(model):
    checks = pytest.importorskip("sklearn.utils.estimator_checks")
    validation = pytest.importorskip("sklearn.utils.validation")
    if "on_fail" not in inspect.signature(checks.check_estimator).parameters:
        pytest.skip("scikit-learn before 1.6")
    checks.check_estimator(model())

    class FirstColumn(model):
        def _nanos(self, X):
            X = validation.check_array(X, dtype=None)
            return super()._nanos(X[:, 0])

        def __sklearn_tags__(self):
            tags = super().__sklearn_tags__()
            tags.input_tags.one_d_array, tags.input_tags.two_d_array = False, True
            return tags

    FirstColumn.__init__ = model.__init__
    # Pickle finds classes by name.
    FirstColumn.__qualname__ = FirstColumn.__name__ = f"First{model.__name__}"
    globals()[FirstColumn.__name__] = FirstColumn
    results = checks.check_estimator(FirstColumn(), on_fail=None, on_skip=None)
    failed = {result["check_name"] for result in results if result["status"] == "failed"}
    passed = {result["check_name"] for result in results if result["status"] == "passed"}
    assert failed <= WIDTH | INTEGERS
    assert {"check_estimators_pickle", "check_fit_idempotent", "check_estimators_nan_inf"} <= passed


def test_fit_has_the_type_of_its_estimator():
    import typing

    from tidemap import models

    for kind in (models.FreMEn, models.FreMEnRegressor):
        hints = typing.get_type_hints(kind.fit)
        assert hints["self"] == hints["return"] and hints["return"] is not typing.Any, kind
