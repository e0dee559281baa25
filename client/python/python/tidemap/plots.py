"""Drawings with matplotlib.

Invariant: the axis of time shows the clock of the map's zone and names it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap import times as _times

Floats = npt.NDArray[np.float64]

LINES_MOST = 12
"""With more states than these, a heat map is drawn: a row a state."""


def states(
    ax: Any, names: list[str], nanos: npt.NDArray[np.int64], values: Floats, bounds: tuple[Floats, Floats] | None,
    zone: str,
) -> Any:
    """Values of states over time; returns the axes."""
    import matplotlib.pyplot as plt
    from matplotlib import dates as matplotlib_dates

    dates: Any = matplotlib_dates
    clock = _times.to_clock(nanos, zone)
    heat = len(names) > LINES_MOST
    if ax is None:
        ax = plt.subplots(figsize=(9, 3 if not heat else min(1 + 0.22 * len(names), 40)), layout="constrained")[1]
    if heat:
        _heat(ax, names, clock, nanos, values)
    else:
        for row, name in enumerate(names):
            (line,) = ax.plot(clock, values[row], label=name)
            if bounds is not None:
                ax.fill_between(clock, bounds[0][row], bounds[1][row], alpha=0.2, color=line.get_color())
        ax.set_ylabel(_label(values))
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    locator = dates.AutoDateLocator()
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    ax.set_xlabel(f"time ({zone})")
    return ax


def _label(values: Floats) -> str:
    known = values[~np.isnan(values)]
    return "probability" if known.size == 0 or (known.min() >= 0 and known.max() <= 1) else "expected value"


def _heat(ax: Any, names: list[str], clock: Any, nanos: npt.NDArray[np.int64], values: Floats) -> None:
    order = np.argsort(nanos, kind="stable")
    label = _label(values)
    bounded = label == "probability"
    mesh = ax.pcolormesh(
        clock[order], np.arange(len(names)), values[:, order], cmap="viridis", shading="nearest",
        vmin=0 if bounded else None, vmax=1 if bounded else None,
    )
    ax.set_yticks(np.arange(len(names)), names, fontsize="small")
    ax.invert_yaxis()
    ax.figure.colorbar(mesh, ax=ax, label=label, pad=0.01)


def grid(ax: Any, values: npt.NDArray[np.float32], extent: tuple[float, float, float, float], title: str) -> Any:
    """The highest value of each column of cells; returns the axes."""
    import matplotlib.pyplot as plt

    ax = ax if ax is not None else plt.subplots()[1]
    highest = np.where(~np.isnan(values), values, -1).max(axis=0)
    image = ax.imshow(
        np.where(highest < 0, np.nan, highest),
        origin="lower", extent=extent, vmin=0, vmax=1, cmap="viridis", interpolation="nearest",
    )
    ax.figure.colorbar(image, ax=ax, label="probability")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    ax.set_title(title)
    return ax
