# %% [markdown]
# # Sensors of a home
# A smart home writes a row whenever a sensor changes, with its own columns and words, and the clock on the wall.

# %%
import numpy as np
import pandas as pd
import tidemap

daemon = tidemap.serve()
client = daemon.connect()
client.create_map("home", time_zone="Europe/Berlin")

# %%
rng = np.random.default_rng(2)
habits = {  # on from, off at, whether also at weekends
    "light.kitchen": (6.5, 8.0, True), "light.living": (18.0, 23.0, True), "door.study": (9.0, 17.0, False),
    "motion.hall": (7.0, 7.5, True), "heating.bath": (5.5, 7.0, True),
}
rows = []
for day in pd.date_range("2026-09-21", periods=42):
    for name, (on, off, weekends) in habits.items():
        if weekends or day.day_of_week < 5:
            for hour, word in ((on, "on"), (off, "off")):
                at = day + pd.Timedelta(hours=hour) + pd.Timedelta(minutes=round(rng.normal(0, 6)))
                rows.append((at.strftime("%Y-%m-%d %H:%M:%S"), name, word))
rows.append(("2026-10-12 12:00:00", "door.study", "unavailable"))
log = pd.DataFrame(sorted(rows), columns=["last_changed", "entity_id", "state"])
log.head()

# %% [markdown]
# A row is a change: the value holds until the next one. `reports="changes"` says so, and then the log needs no more
# work: its columns are named, its words are known, and `times="local"` reads the clock on the wall.

# %%
columns = {"time": "last_changed", "state": "entity_id", "value": "state"}
sent = client.observe("home", log, columns=columns, times="local", reports="changes")
sent

# %% [markdown]
# All rows are stored, and only they; the table of states shows how each one is reported. While the study's sensor was
# `unavailable` nothing is learned of it.

# %%
client.update("home")
client.states("home")

# %% [markdown]
# All sensors of tomorrow, a Tuesday. Without names `predict` takes all states.

# %%
tomorrow = pd.date_range("2026-11-03", periods=144, freq="10min")
forecast = client.predict("home", times=tomorrow, zone="local")
forecast.plot()

# %%
noon = forecast.to_pandas().loc["2026-11-03 12:00"]
evening = forecast.to_pandas().loc["2026-11-03 20:00"]
print(pd.DataFrame({"noon": noon, "evening": evening}).round(2))

# %% [markdown]
# How well is each sensor known? The entropy in bits, over the day: the most doubtful hours are those of the changes.

# %%
doubt = pd.DataFrame(forecast.entropy.T, index=tomorrow, columns=forecast.states)
doubt.resample("1h").mean().idxmax().dt.strftime("%H:%M")

# %%
daemon.stop()
