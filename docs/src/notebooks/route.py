# %% [markdown]
# # A route
# Edges of a topological map are not always open. The robot reports how it got along, and asks for the way at a time.

# %%
import numpy as np
import pandas as pd
import tidemap

daemon = tidemap.serve()
client = daemon.connect()
client.create_map("building", time_zone="Europe/London")

# %% [markdown]
# Nodes and edges are two tables. The direct way from the lab to the office leads through a door.

# %%
nodes = pd.DataFrame({
    "name": ["Lab", "Office", "Corridor", "Stairs"], "x_m": [0.0, 12, 0, 12], "y_m": [0.0, 0, 8, 8]
})
edges = pd.DataFrame(
    [("Lab", "Office", 12.0), ("Lab", "Corridor", 8.0), ("Corridor", "Stairs", 12.0), ("Stairs", "Office", 8.0)],
    columns=["from", "to", "length_m"],
).assign(both_ways=True)
client.load_topology("building", edges, nodes)
client.topology("building").edges

# %% [markdown]
# Four weeks of runs, eight a day on each edge. The door is shut from six in the evening to seven in the morning.

# %%
rng = np.random.default_rng(4)
starts = pd.date_range("2026-02-02", periods=4 * 7 * 8, freq="3h", tz="Europe/London")
runs = []
for _, edge in edges.iterrows():
    took = pd.to_timedelta(edge["length_m"] / 0.5 + rng.normal(0, 1, len(starts)).clip(-3, 3), unit="s")
    shut = (edge["from"] == "Lab") & (edge["to"] == "Office") & ((starts.hour < 7) | (starts.hour >= 18))
    runs.append(pd.DataFrame({
        "from": edge["from"], "to": edge["to"], "start": starts, "end": starts + took, "success": ~shut,
        "reason": np.where(shut, "door closed", None),
    }))
client.traverse("building", pd.concat(runs).sort_values("start", kind="stable"))
client.update("building")

# %% [markdown]
# The same question at two times.

# %%
noon = client.route("building", "Lab", "Office", "2026-03-03T12:00", zone="local")
noon

# %%
night = client.route("building", "Lab", "Office", "2026-03-03T22:00", zone="local")
night

# %% [markdown]
# And over the whole day: how long the best way takes, and how probable it is to get through.

# %%
hours = pd.date_range("2026-03-03", periods=24, freq="h", tz="Europe/London")
day = pd.DataFrame([
    {"edges": len(best), **{name: best.attrs["routes"][0][name] for name in ("success", "expected_secs")}}
    for best in (client.route("building", "Lab", "Office", hour) for hour in hours)
], index=hours)
print(day.round(3))

# %%
day["expected_secs"].plot(drawstyle="steps-post", ylabel="seconds", title="Lab to Office")

# %%
daemon.stop()
