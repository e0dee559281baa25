"""The temporal models of tidemap in process, as estimators of scikit-learn.

``X`` is the times, as one column or without columns, in any form of :mod:`tidemap.times`. Classifiers such as
``FreMEn`` learn a state of two values and give ``predict_proba``; regressors such as ``FreMEnRegressor`` learn any
number. ``time_zone`` gives the rhythms their local day and week; ``zone`` is the zone of times that have none:
``"local"`` for ``time_zone``, or the name of another zone. Without ``zone`` such times are refused, unless
``time_zone`` is UTC.

Invariant: a model gives the numbers that the same model gives in the daemon for the same readings, also after it was
pickled or copied. scikit-learn is not needed; where it is installed, the classes are its estimators.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from tidemap import times as _times
from tidemap._native import NativeModel
from tidemap.errors import TidemapError

if TYPE_CHECKING:

    class _Estimator:
        def get_params(self, deep: bool = True) -> dict[str, Any]: ...
        def set_params(self, **params: Any) -> Any: ...
        def __sklearn_tags__(self) -> Any: ...

    class _ClassifierMixin: ...

    class _RegressorMixin: ...

    class _NotFittedError(ValueError, AttributeError): ...

    class _DataConversionWarning(UserWarning): ...

else:
    try:
        from sklearn.base import BaseEstimator as _Estimator
        from sklearn.base import ClassifierMixin as _ClassifierMixin
        from sklearn.base import RegressorMixin as _RegressorMixin
        from sklearn.exceptions import DataConversionWarning as _DataConversionWarning
        from sklearn.exceptions import NotFittedError as _NotFittedError
    except ImportError:
        import inspect

        class _Estimator:
            def get_params(self, deep=True):
                # Models without parameters have the __init__ of object.
                named = inspect.Parameter.POSITIONAL_OR_KEYWORD
                parameters = inspect.signature(type(self).__init__).parameters.values()
                names = [known.name for known in parameters if known.kind == named and known.name != "self"]
                return {name: getattr(self, name) for name in names}

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

        class _DataConversionWarning(UserWarning):
            pass


Floats = npt.NDArray[np.float64]
C = TypeVar("C", bound="_Classifier")
R = TypeVar("R", bound="_Regressor")


class Rhythm(NamedTuple):
    """A term amplitude · cos(2π t / period + phase); t is local civil time in seconds since 1970-01-01T00:00."""

    period_secs: float
    amplitude: float
    """In the unit of the values."""
    phase_rad: float


def _times_of(X: Any) -> tuple[Any, list[str] | None]:
    """The one column of X, and its name as a list if it has one."""
    if hasattr(X, "toarray"):
        raise TypeError("X is sparse: a model of time needs the times, dense (X.toarray())")
    names = None
    if hasattr(X, "columns") and hasattr(X, "shape") and len(X.shape) == 2:
        if X.shape[1] != 1:
            raise ValueError(f"X has {X.shape[1]} columns: a model of time needs one, the times")
        names = [name for name in X.columns if isinstance(name, str)] or None
        X = X.iloc[:, 0] if hasattr(X, "iloc") else X.to_series(0)
    if getattr(X, "ndim", None) is None and not hasattr(X, "dt"):
        X = X if hasattr(X, "__array__") else list(X) if hasattr(X, "__iter__") else X
        X = np.asarray(X) if not isinstance(X, list) or any(isinstance(row, (list, tuple)) for row in X) else X
    dimensions = getattr(X, "ndim", 1)
    if dimensions == 0:
        raise ValueError("X is one number: a model of time needs an array of times; Reshape your data")
    if dimensions > 2:
        raise ValueError(f"X has {dimensions} axes: a model of time needs one column, the times")
    if dimensions == 2:
        if X.shape[1] != 1:
            raise ValueError(f"X has {X.shape[1]} columns: a model of time needs one, the times")
        X = X[:, 0]
    if getattr(getattr(X, "dtype", None), "kind", "") == "c":
        raise ValueError("Complex data not supported: X needs times")
    return X, names


def _numbers_of(y: Any, what: str) -> npt.NDArray[Any]:
    """The values, without columns."""
    if y is None:
        raise ValueError(f"{what} requires y to be passed, but the target y is None")
    values = np.asarray(y)
    if values.dtype.kind == "c":
        raise ValueError("Complex data not supported: y needs numbers or labels")
    if values.ndim == 2 and values.shape[1] == 1:
        warnings.warn(
            "A column-vector y was passed when a 1d array was expected: use y.ravel()", _DataConversionWarning,
            stacklevel=4,
        )
        values = values.ravel()
    if values.ndim != 1:
        raise ValueError(f"y has the shape {values.shape}: it needs one value for each time")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError(f"y has NaN or infinity in row {int(np.argmax(~np.isfinite(values)))}")
    return values


class _Model(_Estimator):
    """The base of all estimators."""

    _kind = ""
    _state_kind = "probability"

    def __repr__(self, N_CHAR_MAX: int = 700) -> str:  # noqa: N803 scikit-learn passes it by this name
        parameters = ", ".join(f"{name}={value!r}" for name, value in self.get_params(deep=False).items())
        return f"{type(self).__name__}({parameters})"

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        # The tags are those of IsotonicRegression, which also takes one column. check_estimator then has no data to
        # try.
        tags.input_tags.one_d_array = True
        tags.input_tags.two_d_array = False
        tags.target_tags.required = True
        return tags

    def _more_tags(self) -> dict[str, Any]:
        # The form for scikit-learn before 1.6.
        return {"X_types": ["1darray"], "binary_only": True, "requires_y": True}

    def _parameters(self) -> dict[str, Any]:
        """Parameters of the model itself."""
        own = self.get_params(deep=False).items()
        return {name: value for name, value in own if name not in ("time_zone", "zone")}

    def _nanos(self, X: Any) -> tuple[npt.NDArray[np.int64], list[str] | None]:
        """The times, and the name of their column as a list if it has one."""
        column, names = _times_of(X)
        own_zone = getattr(self, "time_zone", "UTC")
        zone: str | None = getattr(self, "zone", None)
        return _times.resolve(_times.read(column), zone, lambda: own_zone), names

    def _fitted(self, X: Any, y: Floats) -> None:
        nanos, names = self._nanos(X)
        if len(nanos) != len(y):
            raise ValueError(f"{len(nanos)} times and {len(y)} values: X and y must be as many")
        if len(nanos) == 0:
            raise ValueError("no readings: X is empty, with 0 sample(s) (shape=(0,)) while a minimum of 1 is required")
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
        if names is not None:
            self.feature_names_in_ = np.array(names, dtype=object)
        elif hasattr(self, "feature_names_in_"):
            del self.feature_names_in_
        rhythms = self.model_.rhythms()
        if rhythms is not None:
            self.mean_ = rhythms[0]
            self.rhythms_ = [Rhythm(*rhythm) for rhythm in rhythms[1]]

    def _kind_of(self) -> str:
        return self._kind

    def _values(self, X: Any) -> Floats:
        if not hasattr(self, "model_"):
            raise _NotFittedError(f"this {type(self).__name__} is not fitted: call fit() first")
        return self.model_.predict(self._nanos(X)[0])


def trained_anew(
    kind: str,
    parameters: list[tuple[str, str]],
    times: npt.NDArray[np.int64],
    values: Floats,
    state_kind: str,
    zone: str,
) -> NativeModel:
    """A model as pickle makes it."""
    return NativeModel.fit(kind, parameters, times, values, state_kind, zone)


def _text(value: Any) -> str:
    if isinstance(value, (float, np.floating)) and float(value).is_integer():
        return str(int(value))
    return str(value)


class _Classifier(_ClassifierMixin, _Model):
    """A state of two values."""

    classes_: npt.NDArray[Any]
    """Both values, in order."""

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.classifier_tags.multi_class = False
        # The data that scikit-learn tries has no rhythms.
        tags.classifier_tags.poor_score = True
        return tags

    def fit(self: C, X: Any, y: Any) -> C:
        """Learns readings: times, and which of the two values the state had. Returns itself."""
        labels = _numbers_of(y, type(self).__name__)
        classes = np.unique(labels)
        if len(classes) > 2:
            if labels.dtype.kind == "f" and (labels != np.floor(labels)).any():
                raise ValueError("Unknown label type: y has fractions, and a state has two values; use a regressor")
            raise ValueError(
                f"Only binary classification is supported: y has {len(classes)} classes, and a state has two values; "
                "use a regressor for numbers"
            )
        if set(classes.tolist()) <= {0, 1}:
            classes = np.array([0, 1], dtype=labels.dtype)
        self._fitted(X, np.asarray(labels == classes[-1], dtype=np.float64))
        self.classes_ = classes
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

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags

    def fit(self: R, X: Any, y: Any) -> R:
        """Learns readings: times and values. Returns itself."""
        values = _numbers_of(y, type(self).__name__)
        self._fitted(X, np.ascontiguousarray(values, dtype=np.float64))
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
        self,
        order: int = 2,
        period_base: str = "7d",
        period_count: int = 168,
        time_zone: str = "UTC",
        zone: str | None = None,
    ) -> None:
        self.order = order
        self.period_base = period_base
        self.period_count = period_count
        self.time_zone = time_zone
        self.zone = zone


class _OfBins(_Model):
    """Parameters of a histogram."""

    _kind = "histogram"

    def __init__(
        self, bins: int = 24, cycle: str = "day", time_zone: str = "UTC", zone: str | None = None
    ) -> None:
        self.bins = bins
        self.cycle = cycle
        self.time_zone = time_zone
        self.zone = zone


class _OfWeek(_Model):
    """Parameters of the calibrated profile."""

    _kind = "calibrated"

    def __init__(self, time_zone: str = "UTC", zone: str | None = None) -> None:
        self.time_zone = time_zone
        self.zone = zone


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
        zone: str | None = None,
    ) -> None:
        self.clusters = clusters
        self.method = method
        self.seed = seed
        self.period_base = period_base
        self.period_count = period_count
        self.time_zone = time_zone
        self.zone = zone

    def _kind_of(self) -> str:
        return f"hypertime-{self.method}"

    def _parameters(self) -> dict[str, Any]:
        return {name: value for name, value in super()._parameters().items() if name != "method"}


class FreMEn(_OfRhythms, _Classifier):
    """Frequency Map Enhancement (T-RO 2017): the mean and the strongest rhythms.

    ``order``: number of rhythms, 0 to 15. ``period_base``, ``period_count``: candidates base/1 … base/count. Once
    fitted, ``mean_`` and ``rhythms_`` hold the learned model, the strongest rhythm first.
    """


class FreMEnRegressor(_OfRhythms, _Regressor):
    """The model of :class:`FreMEn`, for any number."""


class Histogram(_OfBins, _Classifier):
    """The mean of each interval of the ``day``, the ``week``, or the ``weekend`` (the day, with weekends apart)."""


class HistogramRegressor(_OfBins, _Regressor):
    """The model of :class:`Histogram`, for any number."""


class Calibrated(_OfWeek, _Classifier):
    """A profile of day and week, only as detailed as the readings justify."""


class CalibratedRegressor(_OfWeek, _Regressor):
    """The model of :class:`Calibrated`, for any number."""


class Ensemble(_Classifier):
    """All models that predict the half-hour bins of a state, weighted by how well each has predicted before."""

    _kind = "ensemble"

    def __init__(self, time_zone: str = "UTC", zone: str | None = None) -> None:
        self.time_zone = time_zone
        self.zone = zone


class Hypertime(_OfClusters, _Classifier):
    """Warped hypertime (RA-L 2019): clusters in time wrapped onto rhythms. ``method``: ``em`` or ``km``."""


class HypertimeRegressor(_OfClusters, _Regressor):
    """The model of :class:`Hypertime`, for any number."""


class PerGaM(_Classifier):
    """Periodic Gaussian mixture over the day, or over another ``period`` such as ``7d``."""

    _kind = "pergam"

    def __init__(
        self,
        gaussians: int = 3,
        period: str = "1d",
        seed: int = 0,
        time_zone: str = "UTC",
        zone: str | None = None,
    ) -> None:
        self.gaussians = gaussians
        self.period = period
        self.seed = seed
        self.time_zone = time_zone
        self.zone = zone


class Poisson(_Regressor):
    """The rate of counts (Jovan et al., IROS 2016), as the expected count of a reading."""

    _kind = "poisson"
    _state_kind = "count"

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.positive_only = True
        return tags

    def __init__(
        self, period_base: str = "7d", period_count: int = 168, time_zone: str = "UTC", zone: str | None = None
    ) -> None:
        self.period_base = period_base
        self.period_count = period_count
        self.time_zone = time_zone
        self.zone = zone
