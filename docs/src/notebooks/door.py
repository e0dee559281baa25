# %% [markdown]
# # A door
# A robot passes a door now and then, and sees whether it is open. When will it be open tomorrow, and how sure is that?

# %%
import numpy as np
import pandas as pd
import tidemap

daemon = tidemap.serve()  # a daemon that ends with this notebook; tidemap.connect("HOST:PORT") for another one
client = daemon.connect()
client.create_map("office", time_zone="Europe/London")

# %% [markdown]
# Five weeks, a look every 20 to 70 minutes. The door is open from nine to five on working days; one look in thirty is
# wrong.

# %%
rng = np.random.default_rng(1)
minutes = np.cumsum(rng.integers(20, 70, 1_120))
seen = pd.Timestamp("2026-01-05", tz="Europe/London") + pd.to_timedelta(minutes, unit="min")
is_open = (seen.hour >= 9) & (seen.hour < 17) & (seen.day_of_week < 5)
looks = pd.Series(is_open ^ (rng.random(len(seen)) < 1 / 30), index=seen, name="door").astype(int)
client.observe("office", looks)

# %% [markdown]
# An update learns what was observed; a daemon that runs does it every night. What was learned is a mean and rhythms:

# %%
client.update("office")
model = client.describe("office", "door")
pd.DataFrame(model["components"]).assign(period_hours=lambda rhythms: rhythms["period_secs"] / 3600).head(3)

# %% [markdown]
# The week to come, with intervals of 90 %. The axis shows the clock of the map's zone.

# %%
week = pd.date_range("2026-02-16", periods=7 * 48, freq="30min", tz="Europe/London")
forecast = client.predict("office", "door", week, interval=0.9)
forecast.plot()

# %%
table = forecast.to_pandas()
monday_noon, sunday_noon = table.loc["2026-02-16 12:00"], table.loc["2026-02-22 12:00"]
print("Monday at noon", monday_noon["door"].round(3).to_dict())
print("Sunday at noon", sunday_noon["door"].round(3).to_dict())

# %% [markdown]
# Is that better than simpler models? `evaluate` compares them with looks that are not learned.

# %%
later = pd.Series(((week.hour >= 9) & (week.hour < 17) & (week.day_of_week < 5)).astype(int), index=week, name="door")
scores = client.evaluate("office", later, models=["mean", "latest", "histogram:24", "auto"])
scores

# %% [markdown]
# In the night to Tuesday somebody leaves the door open. That is unusual, and is reported as one episode. With one
# observation in thirty wrong, the model is sure of a shut door to 0.96, not to the usual 0.99.

# %%
night = pd.date_range("2026-02-16 22:00", periods=6, freq="30min", tz="Europe/London")
client.observe("office", states="door", times=night, values=[1] * 6, label="night")
episodes = client.anomalies("office", from_time="2026-02-16", confidence=0.9, zone="local")
episodes

# %%
daemon.stop()
