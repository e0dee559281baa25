"""Times: one meaning of each form, and no time without a zone taken for UTC in silence."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest

import tidemap
from tidemap import times

AT_13 = 1_767_618_000_000_000_000


def nanos(given: object, zone: str | None = None, of_map: str = "UTC") -> list[int]:
    return times.resolve(times.read(given), zone, lambda: of_map).tolist()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("2026-01-05T13:00:00Z", AT_13),
        ("2026-01-05T14:00:00+01:00", AT_13),
        ("2026-01-05 14:00:00+0100", AT_13),
        ("2026-01-05T13:00:00.000000001Z", AT_13 + 1),
        (dt.datetime(2026, 1, 5, 13, tzinfo=dt.timezone.utc), AT_13),
        (dt.datetime(2026, 1, 5, 14, tzinfo=dt.timezone(dt.timedelta(hours=1))), AT_13),
        (np.datetime64("2026-01-05T13:00:00.000000001", "ns"), AT_13 + 1),
        (dt.datetime(2026, 1, 5, 13), AT_13),
        (dt.date(2026, 1, 5), AT_13 - 13 * 3600 * 10**9),
        (AT_13 + 1, AT_13 + 1),
        (np.int64(AT_13), AT_13),
        (1767618000.5, AT_13 + 500_000_000),
    ],
)
def test_times_are_exact(given, expected):
    assert nanos(given) == [expected]
    assert nanos([given, given]) == [expected, expected]
    assert times.timestamp(AT_13 + 1) == "2026-01-05T13:00:00.000000001Z"
    assert times.from_timestamp("2026-01-05T13:00:00.000000001Z") == AT_13 + 1


@pytest.mark.parametrize(
    "wrong",
    ["noon", "2026-01-05T13:00:60Z", "2026-01-05T13:00:00+25:00", "2026-02-30", np.datetime64("NaT"), True, None,
     float("nan"), 1.7e12, [1.0, float("inf")], np.array(["1666-01-01"], dtype="datetime64[s]"), np.array([True])],
)
def test_what_is_no_time_is_refused(wrong):
    with pytest.raises((ValueError, TypeError)):
        nanos(wrong)


@pytest.mark.parametrize(
    ("given", "unit"), [(1767618000, "[s]"), ([1767618000000, 0], "[ms]"), (1767618000000000, "[us]")]
)
def test_integers_that_may_be_another_unit_are_refused_with_the_way_out(given, unit):
    with pytest.raises(tidemap.InvalidArgument, match="nanoseconds") as refused:
        nanos(given)
    assert unit in str(refused.value)
    assert nanos(np.asarray(given).astype(f"datetime64{unit}"))[0] == AT_13


def test_times_without_a_zone_need_a_word():
    with pytest.raises(tidemap.InvalidArgument, match="Europe/Prague.*zone=\"local\""):
        nanos("2026-01-05T14:00:00", of_map="Europe/Prague")
    assert nanos("2026-01-05T14:00:00", "local", "Europe/Prague") == [AT_13]
    assert nanos("2026-07-05T14:00:00", "local", "Europe/Prague") == nanos("2026-07-05T12:00:00Z")
    assert nanos("2026-01-05T13:00:00", "UTC", "Europe/Prague") == [AT_13]
    # Times with a zone need no ``zone``, also between times without one.
    mixed = ["2026-01-05T14:00:00", "2026-01-05T12:00:00Z"]
    assert nanos(mixed, "local", "Europe/Prague") == [AT_13, *nanos(mixed[1])]
    with pytest.raises(tidemap.InvalidArgument, match="Mars"):
        nanos("2026-01-05T14:00:00", "Europe/Mars")


def clock(*texts: str) -> np.ndarray:
    return np.array(texts, dtype="datetime64[ns]").astype(np.int64)


def utc(local: np.ndarray, *states: int) -> list[str]:
    numbers = np.array(states, dtype=np.uint32) if states else None
    found = times.from_clock(local, "Europe/Prague", numbers)
    return [str(np.datetime64(int(one), "ns"))[11:16] for one in found]


def test_the_hour_that_exists_twice_follows_the_order_of_rows():
    # 25 October 2026: at 3:00 the clocks go back to 2:00, which is 0:00 and 1:00 UTC.
    day = "2026-10-25T"
    every_20_minutes = [f"{day}01:40", *[f"{day}02:{m:02}" for m in (0, 20, 40)] * 2, f"{day}03:00"]
    assert utc(clock(*every_20_minutes)) == [
        "23:40", "00:00", "00:20", "00:40", "01:00", "01:20", "01:40", "02:00"
    ]
    hourly = [f"{day}{hour:02}:00" for hour in (1, 2, 2, 3)]
    assert utc(clock(*hourly)) == ["23:00", "00:00", "01:00", "02:00"]
    # Two states by turns: the same clock twice is not yet the second hour.
    pairs = [f"{day}02:00"] * 2 + [f"{day}02:30"] * 2 + [f"{day}02:00"] * 2
    assert utc(clock(*pairs), 0, 1, 0, 1, 0, 1) == ["00:00", "00:00", "00:30", "00:30", "01:00", "01:00"]
    # A state after the other, as an export sorts them: each follows its own order.
    blocks = [f"{day}01:00", f"{day}02:10", f"{day}02:50", f"{day}02:10", f"{day}04:00"] * 2
    assert utc(clock(*blocks), *[0] * 5, *[1] * 5) == ["23:00", "00:10", "00:50", "01:10", "03:00"] * 2
    # Rows that are a little out of order do not begin the second hour.
    jitter = [f"{day}02:00:01", f"{day}02:00:00", f"{day}02:30", f"{day}02:59", f"{day}02:01"]
    assert utc(clock(*jitter), 0, 1, 0, 1, 0) == ["00:00", "00:00", "00:30", "00:59", "01:01"]


def test_the_hour_that_does_not_exist_is_refused():
    with pytest.raises(tidemap.InvalidArgument, match="row 1: 2026-03-29T02:30:00 does not exist in Europe/Prague"):
        utc(clock("2026-03-29T01:30", "2026-03-29T02:30"))
    assert utc(clock("2026-03-29T01:59", "2026-03-29T03:00")) == ["00:59", "01:00"]


def test_the_clock_of_a_zone_is_there_and_back():
    every_hour = clock("2026-01-01T00:30")[0] + np.arange(366 * 24) * 3600 * 10**9
    for zone in ("Europe/Prague", "America/New_York", "Australia/Lord_Howe", "Asia/Kathmandu", "UTC"):
        shown = times.to_clock(every_hour, zone).astype(np.int64)
        assert (times.from_clock(shown, zone) == every_hour).all(), zone


def test_frames_and_series_keep_their_zone():
    pandas = pytest.importorskip("pandas")
    index = pandas.DatetimeIndex(["2026-01-05T14:00:00", "2026-07-05T14:00:00"], tz="Europe/Prague")
    expected = [AT_13, *nanos("2026-07-05T12:00:00Z")]
    assert nanos(index, of_map="Asia/Tokyo") == expected
    assert nanos(pandas.Series(index), of_map="Asia/Tokyo") == expected
    assert nanos(list(index), of_map="Asia/Tokyo") == expected
    assert nanos(pandas.Series(index.astype(str)), of_map="Asia/Tokyo") == expected
    assert nanos(pandas.Timestamp("2026-01-05T13:00:00.000000001Z")) == [AT_13 + 1]
    with pytest.raises(tidemap.InvalidArgument, match="no zone"):
        nanos(index.tz_localize(None), of_map="Asia/Tokyo")
    with pytest.raises(tidemap.InvalidArgument, match="NaT"):
        nanos(pandas.Series([index[0], pandas.NaT]))
    polars = pytest.importorskip("polars")
    series = polars.Series(list(index.tz_convert("UTC")))
    assert nanos(series.dt.convert_time_zone("Europe/Prague"), of_map="Asia/Tokyo") == expected
    with pytest.raises(tidemap.InvalidArgument, match="no zone"):
        nanos(series.dt.replace_time_zone(None), of_map="Asia/Tokyo")
