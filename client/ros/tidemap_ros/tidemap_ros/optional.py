"""Types of packages that a robot may not have.

Invariant: a package that is not installed disables the parts that need it, and gives a line in the log; nothing else.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any


def found(module: str, name: str, without: str, log: Callable[[str], object]) -> Any:
    """``name`` of ``module``, such as ``FeedbackMessage`` of a nested one by dots; ``None`` where it is not installed.

    ``without`` names what is missing then.
    """
    try:
        value: Any = importlib.import_module(module)
        for part in name.split("."):
            value = getattr(value, part)
    except (ImportError, AttributeError):
        log(f"{without}: {module}.{name} is not installed")
        return None
    return value
