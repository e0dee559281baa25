"""The types of the actions of fremenserver and frenap: the installed ones, else types made at run time by genpy.

Invariant: types that are made here have the fields, in name, type and order, of the published definitions, so that
their checksums are equal to those of clients built with catkin. ROS refuses a client whose sum differs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tidemap_ros import optional

_RULE = "\n" + "=" * 80 + "\n"


@dataclass(frozen=True)
class Definition:
    """An action: its package, its name, and the fields of its three messages."""

    package: str
    name: str
    goal: str
    result: str
    feedback: str = "string status"

    @property
    def type_name(self) -> str:
        """The name of the type, as ROS has it."""
        return f"{self.package}/{self.name}Action"

    def text(self, standard: dict[str, str]) -> str:
        """The definition with all that it needs, as genpy reads it; ``standard`` has the texts of other packages."""
        name = self.name
        parts = [f"{name}ActionGoal action_goal\n{name}ActionResult action_result\n"
                 f"{name}ActionFeedback action_feedback"]
        own = {
            f"{name}Goal": self.goal, f"{name}Result": self.result, f"{name}Feedback": self.feedback,
            f"{name}ActionGoal": f"Header header\nactionlib_msgs/GoalID goal_id\n{name}Goal goal",
            f"{name}ActionResult": f"Header header\nactionlib_msgs/GoalStatus status\n{name}Result result",
            f"{name}ActionFeedback": f"Header header\nactionlib_msgs/GoalStatus status\n{name}Feedback feedback",
        }
        parts += [f"MSG: {self.package}/{kind}\n{fields}" for kind, fields in own.items()]
        parts += [f"MSG: {kind}\n{fields}" for kind, fields in standard.items()]
        return _RULE.join(parts)


_GOAL = """string operation
string id
string[] ids
uint32[] times
int32 order
int32[] orders
bool[] states
float32[] values"""
_RESULT = """int32 success
string message
float32[] probabilities
float32[] entropies
float32[] errors"""

FREMEN = Definition(
    "fremenserver", "Fremen", f"{_GOAL}\nfloat32 confidence",
    f"{_RESULT}\nuint32[] anomalyTimes\nuint32[] anomalyValues",
)
"""The newest definition, with the operation ``detect``."""
FREMEN_BEFORE_DETECT = Definition("fremenserver", "Fremen", _GOAL, _RESULT)
"""The definition that was published before."""
PREDICTION = Definition(
    "frenap", "TopologicalPrediction",
    """string action
string mapName
int64 startTime
int64 endTime
int64 predictionTime
int32 resultOrder
int32 durationOrder""",
    """bool success
string message
string[] edgeName
float32[] probability
float32[] duration""",
)


def generated(definition: Definition) -> dict[str, Any]:
    """The classes of a definition by the names of their types, made by genpy; needs ROS 1."""
    from actionlib_msgs.msg import GoalID, GoalStatus
    from genpy.dynamic import generate_dynamic
    from std_msgs.msg import Header

    standard = {
        # The texts of the definitions end with the types that they use, which are here already.
        kind._type: kind._full_text.split("=" * 80)[0].rstrip() for kind in (Header, GoalID, GoalStatus)
    }
    return dict(generate_dynamic(definition.type_name, definition.text(standard)))


def action(definition: Definition, log: Callable[[str], object]) -> Any:
    """The class of the action: from its package if that is installed, else a class that is made here."""
    without = f"the types of {definition.type_name} are made at run time"
    installed = optional.found(f"{definition.package}.msg", f"{definition.name}Action", without, log)
    return generated(definition)[definition.type_name] if installed is None else installed
