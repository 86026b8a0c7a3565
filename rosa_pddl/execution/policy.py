"""When to plan anew: pure decisions, and the policy that they follow."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from rosa_pddl.domain import State
from rosa_pddl.exceptions import PlannerSettingError

__all__ = ["Decision", "ReplanningPolicy", "Situation", "decide", "news_of", "wait_s"]

Situation = tuple[State, Mapping[str, float]]
"""What is believed: the true atoms, and numbers by their text."""


@dataclass(frozen=True)
class ReplanningPolicy:
    """How eager a plan executor is to plan anew.

    A plan that does not reach the goal any more is always replaced; what a running step needs is always watched, and
    the step stopped at once when it is missing.

    Args:
        eager: whether to look for a better plan whenever the world changed by itself though the current plan still
            works. The better plan replaces the current one if it costs less.
        at_most_every_s: no planning begins sooner than this after the one before [s].
        while_planning: what becomes of steps that run while a plan is needed: `continue` lets those go on whose own
            conditions hold, and they run on if the new plan starts with them; `hold` stops them all.

    Raises:
        PlannerSettingError: a setting that makes no sense.
    """

    eager: bool = False
    at_most_every_s: float = 0.2
    while_planning: Literal["continue", "hold"] = "continue"

    def __post_init__(self) -> None:
        if not 0.0 <= self.at_most_every_s < float("inf"):
            raise PlannerSettingError(f"at_most_every_s is {self.at_most_every_s:g} s, expected 0 or more")
        if self.while_planning not in ("continue", "hold"):
            message = f"while_planning is {self.while_planning!r}, expected 'continue' or 'hold'"
            raise PlannerSettingError(message)


@dataclass(frozen=True)
class Decision:
    """That a plan is to be made.

    Args:
        reason: why, in words.
        is_needed: whether the current plan is of no use any more; else it goes on unless a better one is found.
    """

    reason: str
    is_needed: bool


def decide(policy: ReplanningPolicy, *, flaw: str | None, goals_changed: bool, news: str | None) -> Decision | None:
    """Decide whether to plan anew while there is a plan; None to go on with it.

    Args:
        policy: how eager.
        flaw: why the rest of the current plan does not reach the goals, None if it does.
        goals_changed: whether others are wanted than when it was last looked for.
        news: what changed in the world other than by the plan, in words; None if nothing did.
    """
    if flaw is not None:
        return Decision(f"the goals changed: {flaw}" if goals_changed else flaw, is_needed=True)
    if goals_changed:
        return Decision("the goals changed", is_needed=False)
    if policy.eager and news is not None:
        return Decision(f"something better may be possible: {news}", is_needed=False)
    return None


def news_of(expected: Situation | None, now: Situation) -> str | None:
    """Return what changed by itself since it was last looked, in words; None if nothing did."""
    if expected is None or expected == now:
        return None
    (before, told), (state, numbers) = expected, now
    changed = sorted(state - before) + [f"(not {atom})" for atom in sorted(before - state)]
    changed += [f"{text} is {value:g}" for text, value in sorted(numbers.items()) if told.get(text) != value]
    return ", ".join(changed[:3]) + (", ..." if len(changed) > 3 else "")


def wait_s(policy: ReplanningPolicy, now_s: float, last_s: float | None) -> float:
    """Return how long the next planning has to wait [s]; 0 if it may begin now.

    Args:
        policy: sets the rate.
        now_s: the executor's clock [s].
        last_s: when the last planning began [s]; None if there was none.
    """
    return 0.0 if last_s is None else max(0.0, last_s + policy.at_most_every_s - now_s)
