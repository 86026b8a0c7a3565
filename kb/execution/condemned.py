"""Configurations that could not be put in force: they count as unfeasible until they are forgiven."""

import math
from collections import deque
from contextlib import suppress
from dataclasses import dataclass

from kb.exceptions import InvalidValue
from kb.history import KEPT_RECORDS
from kb.knowledge_base import KnowledgeBase
from kb.status import Status

__all__ = ["Condemnation", "Condemned"]


@dataclass(frozen=True, slots=True, eq=False)
class Condemnation:
    """A configuration that counts as unfeasible because its parameters could not be set; only its executor can end it.

    Attributes:
        configuration: its name.
        component: name of what it is a configuration of.
        reason: why, in words.
        start: since when [s].
        until: when it is forgiven at the latest [s].
        end: when it was forgiven [s], None before that.
    """

    configuration: str
    component: str
    reason: str
    start: float
    until: float
    end: float | None = None

    def __str__(self) -> str:
        return f"{self.configuration} is not used for {self.component} because {self.reason}"

    def _finish(self, end: float) -> None:
        object.__setattr__(self, "end", end)


class Condemned:
    """The configurations that count as unfeasible, by an asserted status with a reason that lapses by itself.

    Args:
        hold: how long [s].
    """

    def __init__(self, hold: float) -> None:
        if not isinstance(hold, int | float) or isinstance(hold, bool) or not hold >= 0:
            raise InvalidValue(f"a configuration is held back for 0 s or longer, math.inf for ever, not {hold!r}")
        self._hold = hold
        self._records: deque[Condemnation] = deque(maxlen=KEPT_RECORDS)
        self._open: list[Condemnation] = []
        self._failed: set[str] = set()

    @property
    def records(self) -> tuple[Condemnation, ...]:
        """The newest 10,000, in order, also those that have been forgiven."""
        return tuple(self._records)

    def condemn(self, kb: KnowledgeBase, configuration: str, reason: str, now: float) -> None:
        """Have a configuration count as unfeasible from now on, and no longer as selected: it is not in force."""
        view, until = kb.configurations[configuration], now + self._hold
        kb.assert_selected(view, False)
        with suppress(InvalidValue):  # the hold is over already
            kb.assert_status(view, Status.UNFEASIBLE, reason, until)
        self._enter(Condemnation(configuration, view.component, reason, now, until))

    def adopt(self, kb: KnowledgeBase) -> None:
        """Take up what was condemned before the knowledge base was opened again."""
        failed = {one.configuration: one for one in kb.attempts if one.configuration is not None}
        for name, attempt in failed.items():
            if attempt.result == "failed" and attempt.end is not None and _stands(kb, name):
                said = kb._state.reason("asserted", kb.configurations.node(name))
                until = math.inf if said.until is None else said.until
                self._enter(Condemnation(name, attempt.component, said.text, attempt.end, until))

    def review(self, kb: KnowledgeBase, now: float) -> None:
        """Forgive those whose component has recovered from a failure, and note which were forgiven otherwise."""
        if not self._open:
            return
        components = {one.component for one in self._open if one.component in kb.components}
        failed = {name for name in components if kb.components[name].status is Status.FAILURE}
        recovered, self._failed = self._failed - failed, failed
        for one in self._open:
            if not _stands(kb, one.configuration):
                one._finish(min(now, one.until))
            elif one.component in recovered:
                kb.retract_status(kb.configurations[one.configuration])
                one._finish(now)
        self._open = [one for one in self._open if one.end is None]

    def _enter(self, one: Condemnation) -> None:
        self._open.append(one)
        self._records.append(one)


def _stands(kb: KnowledgeBase, configuration: str) -> bool:
    """Tell whether a configuration is still asserted unfeasible."""
    if configuration not in kb.configurations:
        return False
    state = kb._state
    return state.asserted[kb.configurations.node(configuration).index] is Status.UNFEASIBLE
