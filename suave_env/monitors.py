"""The monitors: what of the truth becomes known, and when."""

from suave_env.battery import Battery
from suave_env.messages import COMPONENT_STATUS, EA_MEASUREMENT, QA_STATUS, Outbox
from suave_env.settings import Settings
from suave_env.water import Water

__all__ = ["BatteryMonitor", "ThrusterMonitor", "VisibilityMonitor", "thruster_words"]


class VisibilityMonitor:
    """Publishes the visibility at whole periods since its start, as kas-lab/suave v1.3.0 does at integer seconds.

    Args:
        settings: The period.
        water: What is measured.
        outbox: Where the measurement is published.

    Attributes:
        visibility: Last published visibility [m], None before the first.
    """

    name = "water_visibility_monitor"

    def __init__(self, settings: Settings, water: Water, outbox: Outbox) -> None:
        self.visibility: float | None = None
        self._period = settings.visibility_monitor_period_s
        self._water = water
        self._outbox = outbox
        self._count = 0

    def tick(self, time: float) -> None:
        """Measure and publish."""
        self.visibility = self._water.visibility(self._count * self._period)
        self._count += 1
        self._outbox.publish(time, self.name, EA_MEASUREMENT, "water_visibility", self.visibility)


class BatteryMonitor:
    """Publishes the battery level.

    Args:
        battery: What is measured.
        outbox: Where the level is published.
    """

    name = "battery_monitor"

    def __init__(self, battery: Battery, outbox: Outbox) -> None:
        self._battery = battery
        self._outbox = outbox

    def publish(self, time: float) -> None:
        """Publish the level at a time [s]."""
        self._outbox.publish(time, self.name, QA_STATUS, "battery_level", self._battery.level)


class ThrusterMonitor:
    """Publishes each failure once, and each recovery that came by itself, at its next check.

    Recoveries brought about by the recovery node are published by that node.

    Args:
        settings: The words.
        outbox: Where failures are published.
    """

    name = "thruster_monitor"

    def __init__(self, settings: Settings, outbox: Outbox) -> None:
        self._words = {fails: thruster_words(settings, fails) for fails in (True, False)}
        self._outbox = outbox
        self._news: list[tuple[int, str]] = []

    def notice(self, thruster: int, fails: bool) -> None:
        """Take note of an event of a thruster, to be published at the next check."""
        self._news += [(thruster, word) for word in self._words[fails]]

    def tick(self, time: float) -> None:
        """Publish what has happened since the last check."""
        for thruster, value in self._news:
            self._outbox.publish(time, self.name, COMPONENT_STATUS, f"c_thruster_{thruster}", value)
        self._news.clear()


def thruster_words(settings: Settings, fails: bool) -> tuple[str, ...]:
    """Return the words in which a failure or a recovery is told, one message each."""
    words = ("FALSE", "ERROR") if fails else ("RECOVERED", "OK")
    return words if settings.thruster_told_twice else words[:1]
