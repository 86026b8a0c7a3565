"""What was news, and what it made of the actions."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from kb import Event, KnowledgeBase, Status

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

__all__ = ["Headlines", "News"]

REMEMBERED: Final = 256
"""How much news is remembered until the plan that it led to is there."""


@dataclass(frozen=True, slots=True)
class News:
    """Something that was told.

    Attributes:
        time: when it was so [s].
        text: what, in words.
        reason: why it calls for another action, in words; empty if it does not by itself.
    """

    time: float
    text: str
    reason: str = ""


class Headlines:
    """What was news, from one tick of the task layer to the next, and what it did to the actions.

    Attributes:
        lost: why an action is unfeasible, by name.
        regained: what made an action feasible again, by name.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self.lost: dict[str, News] = {}
        self.regained: dict[str, News] = {}
        self._kb = kb
        self._since_tick: list[tuple[News, bool]] = []
        self._turns: deque[tuple[float, News]] = deque(maxlen=REMEMBERED)
        self._before_tick: list[News] = []
        self._own: list[tuple[str, News | None]] = []

    def hear(self, event: Event, stamp: float | None) -> None:
        """Take in what was measured; without a stamp it is the task layer's own word, and counts from its next tick."""
        for change in event.changes:
            if change.kind != "action" or Status.UNFEASIBLE not in (change.old, change.new):
                continue
            time = event.time if stamp is None else stamp
            is_lost = change.new is Status.UNFEASIBLE
            why = self._kb.why(self._kb.actions[change.name]) if is_lost else f"{change.name} is feasible again"
            news = News(time, event.text, why)
            if stamp is None:
                self._own.append((change.name, news if is_lost else None))
            elif is_lost:
                self.lost[change.name] = news
            else:
                self.lost.pop(change.name, None)
                self.regained[change.name] = news
        if stamp is not None:
            self.note(News(stamp, event.text), is_turn=bool(event.changes))

    def note(self, news: News, *, is_turn: bool) -> None:
        """Take in news; a turn has made a difference, other news is of no more than a number."""
        self._since_tick.append((news, is_turn))

    def ticking(self, time: float) -> None:
        """Close what a tick can have been led to by."""
        for name, lost in self._own:
            if lost is None:
                self.lost.pop(name, None)
            else:
                self.lost[name] = lost
        self._own.clear()
        heard, self._since_tick = self._since_tick, []
        turns = [news for news, is_turn in heard if is_turn]
        self._before_tick = turns or [news for news, _ in heard]
        self._turns.extend((time, news) for news in turns)

    def of_tick(self) -> News | None:
        """Return what was news before this tick: what made a difference, or else what was measured; None for none."""
        return _together(self._before_tick)

    def of_plan(self, plan: "PlanRecord") -> News:
        """Return what was news when a plan was asked for, or else why it was."""
        until = max((tick for tick, _ in self._turns if tick <= plan.at_s), default=None)
        led = _together([news for tick, news in self._turns if tick == until])
        return News(plan.at_s, plan.reason, plan.reason) if led is None else News(led.time, led.text, plan.reason)


def _together(news: Sequence[News]) -> News | None:
    return News(news[0].time, " and ".join(dict.fromkeys(one.text for one in news))) if news else None
