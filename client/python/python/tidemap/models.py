"""The temporal models of tidemap in process, as estimators of scikit-learn.

``X`` is one column of times: ``datetime64``, or float seconds since 1970 UTC. Classifiers (``FreMEn``, ``Histogram``,
…) learn a state that is 0 or 1 and give ``predict_proba``; regressors (``FreMEnRegressor``, …) learn any number.
``time_zone`` gives the rhythms their local day and week.

Invariant: a model gives the numbers that the same model gives in the daemon for the same readings. scikit-learn is not
needed; where it is installed, the classes are its estimators and work in GridSearchCV and in pipelines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tidemap import times as _times
from tidemap._native import NativeModel
from tidemap.errors import TidemapError

if TYPE_CHECKING:

    class _Estimator:
        def get_params(self, deep: bool = True) -> dict[str, Any]: ...
        def set_params(self, **params: Any) -> Any: ...

    class _ClassifierMixin: ...

    class _RegressorMixin: ...

    class _NotFittedError(ValueError, AttributeError): ...

else:
    try:
        from sklearn.base import BaseEstimator as _Estimator
        from sklearn.base import ClassifierMixin as _ClassifierMixin
        from sklearn.base import RegressorMixin as _RegressorMixin
        from sklearn.exceptions import NotFittedError as _NotFittedError
    except ImportError:
        import inspect

        class _Estimator:
            def get_params(self, deep=True):
                names = inspect.signature(type(self).__init__).parameters
                return {name: getattr(self, name) for name in names if name != "self"}

            def set_params(self, **params):
                known = self.get_params()
                for name, value in params.items():
                    if name not in known:
                        raise ValueError(f"{type(self).__name__} has no parameter {name!r}; it has {', '.join(known)}")
                    setattr(self, name, value)
                return self

        class _ClassifierMixin:
            def score(self, X, y):
                return float(np.mean(self.predict(X) == np.asarray(y)))

        class _RegressorMixin:
            def score(self, X, y):
                y = np.asarray(y, dtype=float)
                spread = np.sum((y - y.mean()) ** 2)
                return float(1 - np.sum((self.predict(X) - y) ** 2) / spread) if spread > 0 else 0.0

        class _NotFittedError(ValueError, AttributeError):
            pass


Floats = npt.NDArray[np.float64]


def _column(X: Any) -> npt.NDArray[np.int64]:
    """Times as nanoseconds, from one column."""
    if hasattr(X, "columns") and hasattr(X, "shape") and len(X.shape) == 2:
        if X.shape[1] != 1:
            raise ValueError(f"X has {X.shape[1]} columns: a model of time needs one, the times")
        X = X.iloc[:, 0] if hasattr(X, "iloc") else X.to_series(0)
    if getattr(X, "ndim", 1) == 2:
        if X.shape[1] != 1:
            raise ValueError(f"X has {X.shape[1]} columns: a model of time needs one, the times")
        X = X[:, 0]
    array = X if hasattr(X, "dt") or hasattr(X, "tz") else np.asarray(X)
    kind = getattr(getattr(array, "dtype", None), "kind", "O")
    if kind == "f":
        seconds = np.asarray(array, dtype=np.float64).ravel()
        if not np.isfinite(seconds).all():
            raise ValueError("times must be finite: X has NaN or infinity")
        whole = np.floor(seconds)
        nanos: npt.NDArray[np.int64] = whole.astype(np.int64) * 1_000_000_000
        nanos += np.rint((seconds - whole) * 1e9).astype(np.int64)
        return nanos
    if kind in "iu":
        whole_seconds: npt.NDArray[np.int64] = np.asarray(array).ravel().astype(np.int64)
        return np.multiply(whole_seconds, 1_000_000_000, dtype=np.int64)
    return _times.all_nanos(array)


class _Model(_Estimator):
    """What all estimators share."""

    _kind = ""
    _state_kind = "probability"

    def _parameters(self) -> dict[str, Any]:
        """Parameters of the model itself."""
        return {name: value for name, value in self.get_params(deep=False).items() if name != "time_zone"}

    def _fitted(self, X: Any, y: Floats) -> None:
        nanos = _column(X)
        if len(nanos) != len(y):
            raise ValueError(f"{len(nanos)} times and {len(y)} values: X and y must be as many")
        if len(nanos) == 0:
            raise ValueError("no readings: X is empty")
        order = np.argsort(nanos, kind="stable")
        given = [(name, _text(value)) for name, value in self._parameters().items() if value is not None]
        try:
            self.model_ = NativeModel.fit(
                self._kind_of(), given, np.ascontiguousarray(nanos[order]), np.ascontiguousarray(y[order]),
                self._state_kind, getattr(self, "time_zone", "UTC"),
            )
        except TidemapError as error:
            raise ValueError(str(error)) from error
        self.n_features_in_ = 1

    def _kind_of(self) -> str:
        return self._kind

    def _values(self, X: Any) -> Floats:
        if not hasattr(self, "model_"):
            raise _NotFittedError(f"this {type(self).__name__} is not fitted: call fit() first")
        return self.model_.predict(_column(X))


def _text(value: Any) -> str:
    if isinstance(value, (float, np.floating)) and float(value).is_integer():
        return str(int(value))
    return str(value)


class _Classifier(_ClassifierMixin, _Model):
    """A state that is 0 or 1."""

    def fit(self, X: Any, y: Any) -> Any:
        """Learns readings: times, and whether the state was 1. Returns itself."""
        labels = np.asarray(y)
        self.classes_ = np.unique(labels)
        if len(self.classes_) > 2:
            raise ValueError(f"y has {len(self.classes_)} classes: a state has two; use a regressor for numbers")
        if set(self.classes_.tolist()) <= {0, 1}:
            self.classes_ = np.array([0, 1], dtype=labels.dtype)
        self._fitted(X, np.asarray(labels == self.classes_[-1], dtype=np.float64).ravel())
        return self

    def predict_proba(self, X: Any) -> Floats:
        """Probability of each class at each time, shape (times, 2)."""
        ones = self._values(X)
        return np.column_stack([1.0 - ones, ones])[:, -len(self.classes_) :]

    def predict(self, X: Any) -> npt.NDArray[Any]:
        """The more probable class at each time."""
        likely = np.argmax(self.predict_proba(X), axis=1)
        found: npt.NDArray[Any] = self.classes_[likely]
        return found

    def entropy(self, X: Any) -> Floats:
        """Entropy of each prediction in bits."""
        p = np.clip(self._values(X), 1e-12, 1 - 1e-12)
        return np.asarray(-p * np.log2(p) - (1 - p) * np.log2(1 - p), dtype=np.float64)


class _Regressor(_RegressorMixin, _Model):
    """A state that is any number."""

    _state_kind = "continuous"

    def fit(self, X: Any, y: Any) -> Any:
        """Learns readings: times and values. Returns itself."""
        self._fitted(X, np.asarray(y, dtype=np.float64).ravel())
        return self

    def predict(self, X: Any) -> Floats:
        """The expected value at each time."""
        return self._values(X)


class Mean(_Classifier):
    """The mean of all readings."""

    _kind = "mean"


class Latest(_Classifier):
    """The newest reading."""

    _kind = "latest"


class Persistence(_Classifier):
    """A two-state Markov chain from the newest reading back to the mean."""

    _kind = "persistence"


class _OfRhythms(_Model):
    """Parameters of the spectral model."""

    _kind = "spectral"

    def __init__(
        self, order: int = 2, period_base: str = "7d", period_count: int = 168, time_zone: str = "UTC"
    ) -> None:
        self.order = order
        self.period_base = period_base
        self.period_count = period_count
        self.time_zone = time_zone


class _OfBins(_Model):
    """Parameters of a histogram."""

    _kind = "histogram"

    def __init__(self, bins: int = 24, cycle: str = "day", time_zone: str = "UTC") -> None:
        self.bins = bins
        self.cycle = cycle
        self.time_zone = time_zone


class _OfWeek(_Model):
    """Parameters of the calibrated profile."""

    _kind = "calibrated"

    def __init__(self, time_zone: str = "UTC") -> None:
        self.time_zone = time_zone


class _OfClusters(_Model):
    """Parameters of warped hypertime."""

    def __init__(
        self,
        clusters: int = 3,
        method: str = "em",
        seed: int = 0,
        period_base: str = "7d",
        period_count: int = 168,
        time_zone: str = "UTC",
    ) -> None:
        self.clusters = clusters
        self.method = method
        self.seed = seed
        self.period_base = period_base
        self.period_count = period_count
        self.time_zone = time_zone

    def _kind_of(self) -> str:
        return f"hypertime-{self.method}"

    def _parameters(self) -> dict[str, Any]:
        return {name: value for name, value in super()._parameters().items() if name != "method"}


class FreMEn(_OfRhythms, _Classifier):
    """Frequency Map Enhancement (T-RO 2017): the mean and the strongest rhythms.

    ``order``: number of rhythms, 0 to 15. ``period_base``, ``period_count``: candidates base/1 … base/count.
    """


class FreMEnRegressor(_OfRhythms, _Regressor):
    """As :class:`FreMEn`, for any number."""


class Histogram(_OfBins, _Classifier):
    """The mean of each interval of the ``day``, the ``week``, or the ``weekend`` (the day, with weekends apart)."""


class HistogramRegressor(_OfBins, _Regressor):
    """As :class:`Histogram`, for any number."""


class Calibrated(_OfWeek, _Classifier):
    """A profile of day and week, only as detailed as the readings justify."""


class CalibratedRegressor(_OfWeek, _Regressor):
    """As :class:`Calibrated`, for any number."""


class Ensemble(_Classifier):
    """All that predicts the looks of a state, weighted by how well each has predicted before."""

    _kind = "ensemble"

    def __init__(self, time_zone: str = "UTC") -> None:
        self.time_zone = time_zone


class Hypertime(_OfClusters, _Classifier):
    """Warped hypertime (RA-L 2019): clusters in time wrapped onto rhythms. ``method``: ``em`` or ``km``."""


class HypertimeRegressor(_OfClusters, _Regressor):
    """As :class:`Hypertime`, for any number."""


class PerGaM(_Classifier):
    """Periodic Gaussian mixture over the day, or over another ``period`` such as ``7d``."""

    _kind = "pergam"

    def __init__(self, gaussians: int = 3, period: str = "1d", seed: int = 0, time_zone: str = "UTC") -> None:
        self.gaussians = gaussians
        self.period = period
        self.seed = seed
        self.time_zone = time_zone


class Poisson(_Regressor):
    """The rate of counts (Jovan et al., IROS 2016), as the expected count of a reading."""

    _kind = "poisson"
    _state_kind = "count"

    def __init__(self, period_base: str = "7d", period_count: int = 168, time_zone: str = "UTC") -> None:
        self.period_base = period_base
        self.period_count = period_count
        self.time_zone = time_zone
