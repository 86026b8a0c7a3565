"""Reaction times as SUAVE measures them: from the news of an uncertainty to the change that answers it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Final, NamedTuple

from missions.engine.mission import Message

if TYPE_CHECKING:
    from suave_env import Change

__all__ = ["News", "Reaction", "UNCERTAINTIES", "find_reactions", "mean_reactions", "news_in"]

UNCERTAINTIES: Final = ("U1", "U2", "U3")
"""Thruster, visibility, battery, as the ROSA paper calls them."""
LOW_LEVEL: Final = 0.25


@dataclass(frozen=True, slots=True)
class Reaction:
    """An answer to an uncertainty.

    Attributes:
        uncertainty: "U1", a thruster has failed: until the recovery is active; "U2", the search is set to another
            altitude than the visibility calls for: until it is set to that; "U3", the battery is below a quarter: until
            the recharge is active.
        start_s: stamp of the first message that tells it [s].
        end_s: when the answer was in force [s].
    """

    uncertainty: str
    start_s: float
    end_s: float

    @property
    def delay_s(self) -> float:
        """How long it took [s], in simulated time."""
        return self.end_s - self.start_s


class News(NamedTuple):
    """A value that was published.

    Attributes:
        time: the stamp [s].
        key: what it is of.
        value: as it was published.
    """

    time: float
    key: str
    value: str


def news_in(message: Message) -> Iterable[News]:
    """Yield what a message says of visibility, battery and thrusters."""
    for status in message["status"]:
        for key, value in status["values"].items():
            if key in ("water_visibility", "battery_level") or key.startswith("c_thruster_"):
                yield News(message["time"], key, value)


def find_reactions(
    news: Iterable[News], changes: Iterable["Change"], altitude_m: float, expected: Callable[[float], float]
) -> tuple[Reaction, ...]:
    """Return every reaction, in order of its end, by the rules of SUAVE's mission metrics (v1.3.0).

    A mismatch that is never answered is no reaction, and a mismatch of the altitude that the low battery interrupts is
    forgotten.

    Args:
        news: what was published, in order of time.
        changes: what was switched and set, in order of time.
        altitude_m: altitude to which the search is set at the start [m].
        expected: gives the altitude [m] that a visibility [m] calls for.
    """
    judge = _Judge(altitude_m, expected)
    events: list[News | Change] = sorted([*news, *changes], key=lambda event: event.time)
    for event in events:
        if isinstance(event, News):
            judge.hear(event)
        else:
            judge.see(event)
    return tuple(judge.reactions)


def mean_reactions(reactions: Iterable[Reaction]) -> dict[str, float | None]:
    """Return the mean delay for each uncertainty [s], None if there was none; the names are as in a report."""
    delays: dict[str, list[float]] = {uncertainty: [] for uncertainty in UNCERTAINTIES}
    for one in reactions:
        delays[one.uncertainty].append(one.delay_s)
    return {
        f"reaction_{uncertainty.lower()}_s": fmean(found) if found else None for uncertainty, found in delays.items()
    }


class _Judge:
    """Follows a run, event by event."""

    def __init__(self, altitude_m: float, expected: Callable[[float], float]) -> None:
        self.reactions: list[Reaction] = []
        self._since: dict[str, float] = {}
        self._altitude_m = altitude_m
        self._expected = expected
        self._called_for: float | None = None
        self._is_low = False

    def hear(self, news: News) -> None:
        if news.key == "water_visibility":
            self._called_for = self._expected(float(news.value))
            if self._called_for != self._altitude_m and not self._is_low:
                self._since.setdefault("U2", news.time)
        elif news.key == "battery_level":
            was_low, self._is_low = self._is_low, float(news.value) < LOW_LEVEL
            if self._is_low and not was_low:
                self._since.setdefault("U3", news.time)
                self._since.pop("U2", None)
        elif news.value == "FALSE":
            self._since.setdefault("U1", news.time)

    def see(self, change: "Change") -> None:
        if change.component == "recover_thrusters" and change.active:
            self._answer("U1", change.time)
        elif change.component == "recharge" and change.active:
            self._answer("U3", change.time)
        elif change.component == "spiral_search" and change.parameters["spiral_altitude"] != self._altitude_m:
            self._altitude_m = change.parameters["spiral_altitude"]
            if self._altitude_m == self._called_for:
                self._answer("U2", change.time)

    def _answer(self, uncertainty: str, time: float) -> None:
        since = self._since.pop(uncertainty, None)
        if since is not None:
            self.reactions.append(Reaction(uncertainty, since, time))
