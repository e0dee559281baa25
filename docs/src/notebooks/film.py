# %% [markdown]
# # A building as a film
# A robot maps a corridor with three doors, as a grid of cells, several times a day for three weeks. Every cell learns
# its own rhythm, and the whole grid can be predicted for any time: a film of the day to come.

# %%
import numpy as np
import pandas as pd
import tidemap

daemon = tidemap.serve()
client = daemon.connect()
client.create_map("corridor", time_zone="Europe/Prague", grid_resolution_m=0.25)

# %% [markdown]
# Grids have the axes time, y, x: 1 is occupied, 0 free, -1 not seen.

# %%
hours = pd.date_range("2026-03-02", periods=21 * 12, freq="2h", tz="Europe/Prague")
seen = np.zeros((len(hours), 16, 40), dtype=np.int8)
seen[:, [0, 10], :] = 1  # the walls
seen[:, 11:, :] = -1  # what is behind them
doors = {"lab": (8, 18), "store": (10, 12), "kitchen": (6, 22)}
for place, (opens, closes) in zip((6, 18, 30), doors.values()):
    shut = (hours.hour < opens) | (hours.hour >= closes)
    seen[:, 10, place : place + 4] = shut[:, np.newaxis]
client.observe_grids("corridor", hours, seen)
client.update("corridor")

# %% [markdown]
# One picture is a `Grid`; several are an `xarray.DataArray(time, y, x)` in metres.

# %%
day = pd.date_range("2026-03-24", periods=12, freq="2h", tz="Europe/Prague")
film = client.grids("corridor", day)
film

# %%
film.plot(col="time", col_wrap=4, vmin=0, vmax=1, cmap="viridis", figsize=(14, 6))

# %% [markdown]
# As a film: `FuncAnimation` draws a frame a time; `.to_jshtml()` shows it in a notebook, `.save("day.gif")` writes it.

# %%
import matplotlib.pyplot as plt
from matplotlib.animation import FuncAnimation

figure, ax = plt.subplots(figsize=(8, 3))
picture = ax.imshow(film[0], origin="lower", vmin=0, vmax=1, extent=(0, 10, 0, 4))


def show(frame):
    picture.set_data(film[frame])
    ax.set_title(day[frame].strftime("%H:%M"))
    return (picture,)


animation = FuncAnimation(figure, show, frames=len(day))

# %% [markdown]
# And a single cell over the day: the middle of each door.

# %%
at_doors = {name: film.sel(y=2.6, x=(place + 2) * 0.25, method="nearest") for name, place in zip(doors, (6, 18, 30))}
shut = pd.DataFrame({name: cells.values for name, cells in at_doors.items()}, index=day)
print(shut.round(2))

# %%
daemon.stop()
