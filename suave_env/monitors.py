"""What is published and what is measured of a run.

Messages, changes, reactions, violations and metrics.

The messages of the monitors are plain data in the shape of ROS diagnostic_msgs.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import TypedDict

from suave_env.sea import expected_altitude
from suave_env.settings import Settings

EA_MEASUREMENT = "EA measurement"
"""Text of a measurement of the environment; kas-lab/suave v1.3.0."""
QA_STATUS = "QA status"
"""Text of a measurement of a quality of the vehicle; kas-lab/suave v1.3.0."""
COMPONENT_STATUS = "Component status"
"""Text of a failure or recovery of a component; kas-lab/suave v1.3.0."""
MISSION_STATUS = "mission status"
"""Text of a percept of the task layer; knowledge bases that follow ROSA ignore it."""

LOW_LEVEL = 0.25
"""Battery level [1] below which the extended SUAVE mission recharges; kas-lab/suave v1.3.0."""


class Status(TypedDict):
    """One status: its source (`name`), its kind (`message`), and strings by key (`values`)."""

    name: str
    message: str
    values: dict[str, str]


class Message(TypedDict):
    """One message: the time since GUIDED [s] at which it was published, and its statuses."""

    time: float
    status: list[Status]


class Outbox:
    """Collects messages until they are fetched.

    Calls `hear` with time [s], key and value of each.
    """

    def __init__(self, hear: Callable[[float, str, str], None]) -> None:
        self._hear = hear
        self._messages: list[Message] = []

    @property
    def is_waiting(self) -> bool:
        return bool(self._messages)

    def publish(self, time: float, name: str, text: str, key: str, value: float | str) -> None:
        """Publish one status of a kind such as `EA_MEASUREMENT`, now [s].

        A number as its `repr`, which is exact.
        """
        written = value if isinstance(value, str) else repr(value)
        self._messages.append(
            {"time": time, "status": [{"name": name, "message": text, "values": {key: written}}]}
        )
        self._hear(time, key, written)

    def fetch(self) -> list[Message]:
        """Return the messages since the last call, in order of time."""
        messages = self._messages
        self._messages = []
        return messages


def thruster_words(settings: Settings, fails: bool) -> tuple[str, ...]:
    """Return the words in which a failure or a recovery is published, one message each."""
    words = ("FALSE", "ERROR") if fails else ("RECOVERED", "OK")
    return words if settings.thruster_told_twice else words[:1]


@dataclass(frozen=True, slots=True)
class Change:
    """The activation, deactivation or new parameters of a component.

    The time [s], and its state from then on.
    """

    time: float
    component: str
    active: bool
    parameters: Mapping[str, float]

    def __str__(self) -> str:
        values = "".join(f", {name} = {value:g}" for name, value in self.parameters.items())
        return f"{self.component} is {'active' if self.active else 'inactive'}{values}"


@dataclass(frozen=True)
class Metrics:
    """Figures of a run up to now.

    The first two are SUAVE's (kas-lab/suave v1.3.0), the others are our own.

    Attributes:
        search_time_s: Whole seconds [s] from when the measuring node received GUIDED until the
            pipeline was found; None before. For a run that never finds it, SUAVE reports the
            duration of the mission.
        distance_inspected_m: Sum of the xy distances between consecutive points of the path that
            were reached [m]; reset to 0 whenever the follower is activated.
        total_inspected_m: The same sum, never reset [m]. Each stretch of the path counts once; ways
            to and from the path do not count.
        found_s: Time since GUIDED at which the pipeline was found [s]; None before.
        violation_s: Time for which at least one violation held [s]: see `Violations`.
        uncorrected: How many of these violations were never corrected.
        switches: How often a component was activated, deactivated or given other parameters.
        energy_j: Least energy that the thrusters have put into the water [J]: the power of an ideal
            propeller, `|T|^1.5 / sqrt(2 rho A)`, summed over time.
    """

    search_time_s: int | None
    distance_inspected_m: float
    total_inspected_m: float
    found_s: float | None
    violation_s: float
    uncorrected: int
    switches: int
    energy_j: float


class Violations:
    """Records violations of the mission's requirements, by the truth.

    There are three kinds: the search is active at another altitude than the visibility requires; a
    thruster is stuck; the battery is below a quarter and the recharge is not active. A violation is
    corrected if a change of the vehicle ends it; it is uncorrected if it ends because the sea
    changes back, or lasts to the end.
    """

    def __init__(self) -> None:
        self._open: set[str] = set()
        self._any_since = 0.0
        self._past_s = 0.0
        self._missed = 0

    def note(self, time: float, kind: str, holds: bool, corrected: bool) -> None:
        """Record whether a violation of a kind holds at a time [s].

        `corrected` counts when it has just ended.
        """
        if holds == (kind in self._open):
            return
        if holds:
            if not self._open:
                self._any_since = time
            self._open.add(kind)
            return
        self._open.remove(kind)
        self._missed += not corrected
        if not self._open:
            self._past_s += time - self._any_since

    def seconds(self, now: float) -> float:
        """Return the time for which at least one violation has held up to now [s]."""
        return self._past_s + (now - self._any_since if self._open else 0.0)

    @property
    def uncorrected(self) -> int:
        return self._missed + len(self._open)


@dataclass(frozen=True, slots=True)
class Reaction:
    """The reaction to an uncertainty.

    Attributes:
        uncertainty: "U1", a thruster has failed; ends when the recovery is active. "U2", the search
            altitude is not the one that the visibility requires; ends when it is. "U3", the battery
            is below a quarter; ends when the recharge is active. The names are those of the ROSA
            paper.
        start_s: Stamp of the first message that reports it [s].
        end_s: Time at which the reaction is in force [s].
    """

    uncertainty: str
    start_s: float
    end_s: float

    @property
    def delay_s(self) -> float:
        """Time from start to end [s], simulated."""
        return self.end_s - self.start_s


class Reactions:
    """Finds reactions by the rules of SUAVE's mission metrics (v1.3.0).

    An uncertainty without an answer gives no reaction; a low battery cancels a U2 that is still
    open.

    Args:
        altitude: Altitude to which the search is set at the start [m].
    """

    def __init__(self, altitude: float) -> None:
        self.found: list[Reaction] = []
        self._since: dict[str, float] = {}
        self._altitude = altitude
        self._called_for: float | None = None
        self._is_low = False

    def hear(self, time: float, key: str, value: str) -> None:
        """Take in a value that was published at a time [s]."""
        if key == "water_visibility":
            self._called_for = expected_altitude(float(value))
            if self._called_for != self._altitude and not self._is_low:
                self._since.setdefault("U2", time)
        elif key == "battery_level":
            was_low = self._is_low
            self._is_low = float(value) < LOW_LEVEL
            if self._is_low and not was_low:
                self._since.setdefault("U3", time)
                self._since.pop("U2", None)
        elif key.startswith("c_thruster_") and value == "FALSE":
            self._since.setdefault("U1", time)

    def see(self, change: Change) -> None:
        """Take in a change of a component."""
        answered = {"recover_thrusters": "U1", "recharge": "U3"}.get(change.component)
        if answered and change.active:
            self._answer(answered, change.time)
        elif (
            change.component == "spiral_search"
            and change.parameters["spiral_altitude"] != self._altitude
        ):
            self._altitude = change.parameters["spiral_altitude"]
            if self._altitude == self._called_for:
                self._answer("U2", change.time)

    def _answer(self, uncertainty: str, time: float) -> None:
        since = self._since.pop(uncertainty, None)
        if since is not None:
            self.found.append(Reaction(uncertainty, since, time))


def mean_reactions(reactions: Iterable[Reaction]) -> dict[str, float | None]:
    """Return the mean delay for each uncertainty [s]; None if there was no reaction."""
    delays: dict[str, list[float]] = {"u1": [], "u2": [], "u3": []}
    for reaction in reactions:
        delays[reaction.uncertainty.lower()].append(reaction.delay_s)
    return {
        f"reaction_{uncertainty}_s": fmean(found) if found else None
        for uncertainty, found in delays.items()
    }
