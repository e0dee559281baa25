"""Points generated requests at the sample office, so that they reach more than "no such map".

Half of the requests keep the generated name. Calls that would delete the office keep theirs always.
"""

import hashlib
import json

import schemathesis

DESTRUCTIVE = ("DeleteMap", "Erase")
STATES = ["kitchen", "meeting-room", "storage-door"]


@schemathesis.hook
def map_body(context, body):
    if not isinstance(body, dict):
        return body
    if any(context.operation.path.endswith(name) for name in DESTRUCTIVE):
        return body
    # Ordered by content, so that the same seed gives the same requests.
    digest = hashlib.sha256(json.dumps(body, sort_keys=True, default=str).encode()).digest()
    if digest[0] % 2 == 0:
        return body
    changed = dict(body)
    if isinstance(body.get("map"), str):
        changed["map"] = "office"
    if isinstance(body.get("name"), str) and context.operation.path.endswith("GetMap"):
        changed["name"] = "office"
    if isinstance(body.get("states"), list):
        changed["states"] = STATES[: 1 + digest[1] % 3]
    for field in ("state", "from", "to", "start"):
        if isinstance(body.get(field), str):
            changed[field] = "kitchen"
    return changed
