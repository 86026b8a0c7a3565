"""A gate before execution: somebody else is shown every plan and may forbid it."""

import logging
from collections.abc import Callable

from kb.exceptions import InvalidValue
from kb.history import VetoAnswer
from kb.knowledge_base import KnowledgeBase
from kb.reconfiguration import ReconfigurationPlan

__all__ = ["Gate", "Veto", "VetoAnswer"]

_log = logging.getLogger(__name__)

Veto = Callable[[ReconfigurationPlan], bool | str | None]
"""Is shown a plan, with its reason; answers None or True to let it pass, False or the reason to forbid it."""


class Gate:
    """Asks about every plan before it is executed, and takes back what a forbidden one had selected.

    Args:
        kb: whose plans are asked about.
        veto: the function that is asked.
    """

    def __init__(self, kb: KnowledgeBase, veto: Veto) -> None:
        if not callable(veto):
            raise InvalidValue(f"a veto is a function that is called with each plan; {veto!r} cannot be called")
        self._kb = kb
        self._veto = veto
        self._passed: list[ReconfigurationPlan] = []
        self._seen: tuple[int, ReconfigurationPlan | None] = (-1, None)
        self._selected: frozenset[tuple[str, str]] = frozenset()
        self.remember()

    def remember(self) -> None:
        """Take note of what is selected, so that a plan that is forbidden can be taken back to this."""
        now = (self._kb.revision, self._kb.latest_plan)
        if now != self._seen:
            self._seen, self._selected = now, self._selection()

    def check(self) -> bool:
        """Ask about the plans that were not asked about yet; a forbidden one ends as abandoned.

        Returns:
            Whether one was forbidden.
        """
        self._passed = [plan for plan in self._passed if plan.end is None]
        objection = ""
        while (plan := self._kb.pending_plan) is not None and plan not in self._passed:
            answer = self._ask(plan)
            if not answer.is_vetoed:
                self._passed.append(plan)
                break
            _log.info("vetoed: %s, because %s", plan, answer.reason)
            self._kb.finish_plan(plan, "abandoned")
            objection = answer.reason
        if objection:
            self._take_back(f"vetoed: {objection}")
        return bool(objection)

    def _ask(self, plan: ReconfigurationPlan) -> VetoAnswer:
        try:
            answer: object = self._veto(plan)
        except Exception as error:
            answer = str(error) or type(error).__name__
        reason = _objection(answer)
        return self._kb.record_answer(plan, is_vetoed=bool(reason), reason=reason)

    def _selection(self) -> frozenset[tuple[str, str]]:
        kb = self._kb
        designs = (("design", one.name) for one in kb.designs.values() if one.is_selected)
        configurations = (("configuration", one.name) for one in kb.configurations.values() if one.is_selected)
        return frozenset((*designs, *configurations))

    def _take_back(self, reason: str) -> None:
        """Select again what was selected before, and nothing else: what is not executed is not in force."""
        designs, configurations = self._kb.designs, self._kb.configurations
        for what, name in sorted(self._selection() ^ self._selected):
            views = designs if what == "design" else configurations
            if name in views:
                is_selected = (what, name) in self._selected
                self._kb.assert_selected(views[name], is_selected, "" if is_selected else reason)


def _objection(answer: object) -> str:
    """Return why a plan is forbidden, in words; nothing if it may pass."""
    if answer is None or answer is True:
        return ""
    if answer is False:
        return "no reason was given"
    if isinstance(answer, str):
        return answer or "no reason was given"
    return f"the veto function answered {answer!r}; it is to answer None or True to let a plan pass, else a reason"
