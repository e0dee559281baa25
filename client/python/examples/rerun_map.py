"""Shows a map of the next days in Rerun: its grid as a picture, and its states as curves.

    pip install rerun-sdk
    python rerun_map.py MAP [--server HOST:PORT] [--days 7] [--save FILE.rrd]

Invariant: each value stands at the time that it is predicted for, on the timeline "predicted".
"""

import argparse

import numpy as np
import rerun as rr
import tidemap

# Unknown cells are grey, like in the maps of Nav2.
UNKNOWN = 205


def picture(values: np.ndarray) -> np.ndarray:
    """A layer of cells as grey pixels: free is white, occupied black. The first row of an image is its upper one."""
    layer = values[0]
    pixels = np.where(np.isnan(layer), UNKNOWN, np.rint(255 * (1 - layer)))
    return pixels[::-1].astype(np.uint8)


def show(client: tidemap.Client, name: str, times: np.ndarray) -> None:
    """Logs the grid and the states of a map at times, as far as the map has them."""
    try:
        for time in times:
            grid = client.grid(name, time, project=True)
            rr.set_time("predicted", timestamp=time)
            rr.log("map", rr.Image(picture(grid.values)))
    except tidemap.FailedPrecondition as missing:
        print(f"without a grid: {missing}")
    try:
        predicted = client.predict(name, times=times, interval=0.9)
    except tidemap.InvalidArgument as missing:
        print(f"without states: {missing}")
        return
    index = rr.TimeColumn("predicted", timestamp=times.astype("datetime64[ns]"))
    for row, state in enumerate(predicted.states):
        for part, values in (("", predicted.values), ("/low", predicted.lower), ("/high", predicted.upper)):
            if values is not None:
                rr.send_columns(f"states/{state}{part}", [index], rr.Scalars.columns(scalars=values[row]))


def main() -> None:
    """Reads the arguments, and shows or saves the map."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", help="name of the map")
    parser.add_argument("--server", default="127.0.0.1:7435", help="address of the daemon")
    parser.add_argument("--days", type=int, default=7, help="how far into the future")
    parser.add_argument("--save", metavar="FILE.rrd", help="writes a recording instead of opening the viewer")
    arguments = parser.parse_args()
    rr.init(f"tidemap {arguments.map}", spawn=arguments.save is None)
    if arguments.save is not None:
        rr.save(arguments.save)
    begin = np.datetime64("now", "h")
    times = begin + np.arange(24 * arguments.days) * np.timedelta64(1, "h")
    show(tidemap.connect(arguments.server), arguments.map, times.astype("datetime64[ns]"))


if __name__ == "__main__":
    main()
