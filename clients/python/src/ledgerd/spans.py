"""Spans of time in the units of the API."""

from __future__ import annotations

import math


def scaled(name: str, seconds: object, units_per_second: int) -> int:
    """Seconds as a whole number of smaller units. A text such as "10m" is rejected: Python would multiply it by repeating it."""
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not math.isfinite(seconds) or seconds < 0:
        raise ValueError(f"{name} is not usable: found {seconds!r}, wanted a number of seconds, such as 600 for ten minutes")
    return int(seconds * units_per_second)
