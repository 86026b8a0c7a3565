"""What keeps a plan, or a part of one, from being carried out: a veto, budgets, and the quarantine of what failed."""

import logging
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from decimal import Decimal

from kb.elements import EstimationKind, finite_number, is_number
from kb.exceptions import InvalidValue, UnknownName
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import words_of
from kb.network import Node
from kb.records import ReconfigurationPlan
from kb.state import State
from kb.status import Status

_log = logging.getLogger(__name__)

Veto = Callable[[ReconfigurationPlan], bool | str | None]
"""Is shown a plan, with its reason; answers None or True to let it pass, False or the reason to forbid it."""


class VetoGate:
    """Asks about every plan before it is executed, and takes back what a forbidden one had selected."""

    def __init__(self, kb: KnowledgeBase, veto: Veto) -> None:
        if not callable(veto):
            raise InvalidValue(f"a veto is a function that is called with each plan; {veto!r} cannot be called")
        self._kb = kb
        self._veto = veto
        self._passed: list[ReconfigurationPlan] = []

    def check(self) -> bool:
        """Ask about the plans that were not asked about yet, and tell whether one was forbidden: it is abandoned."""
        kb, is_vetoed = self._kb, False
        self._passed = [plan for plan in self._passed if plan.end is None]
        while (plan := kb.pending_plan) is not None and plan not in self._passed:
            objection = self._objection(plan)
            kb.record_answer(plan, is_vetoed=bool(objection), reason=objection)
            if not objection:
                self._passed.append(plan)
                break
            _log.info("vetoed: %s, because %s", plan, objection)
            self._take_back(plan, f"vetoed: {objection}")
            kb.finish_plan(plan, "abandoned")
            is_vetoed = True
        return is_vetoed

    def _objection(self, plan: ReconfigurationPlan) -> str:
        try:
            answer: object = self._veto(plan)
        except Exception as error:
            return words_of(error)
        if answer is None or answer is True:
            return ""
        if answer is False or answer == "":
            return "no reason was given"
        if isinstance(answer, str):
            return answer
        return f"the veto function answered {answer!r}; it is to answer None or True to let a plan pass, else a reason"

    def _take_back(self, plan: ReconfigurationPlan, reason: str) -> None:
        """Undo what the plan's event has selected, and nothing else: what is not executed is not in force."""
        made = (event.effects for event in self._kb.log.since(plan.cause or 0) if event.plan is plan)
        for kind, name, is_selected in next(made, ()):
            with suppress(UnknownName):  # it has left the model
                self._kb.assert_selected((kind, name), not is_selected, reason if is_selected else "")


class Budgets:
    """What all that is chosen and runs may be estimated to use while a plan is carried out, by name of attribute."""

    def __init__(self, most: Mapping[str, float] | None) -> None:
        if not isinstance(most, Mapping | None):
            raise InvalidValue(f"budgets are given as the most by name of attribute, not as {most!r}")
        self.most = {name: finite_number(limit) for name, limit in (most or {}).items()}

    def allow(self, kb: KnowledgeBase, started: Collection[str], failed: Collection[str]) -> bool:
        """Tell whether all that is selected keeps within the budgets once it is carried out.

        That is when the components `started` run too, and those that `failed` are as they were.
        """
        loads = self._loads(kb, started, failed)
        return all(load <= Decimal(repr(limit)) for load, limit in zip(loads, self.most.values(), strict=True))

    def are_eased(self, kb: KnowledgeBase, component: str, failed: Collection[str]) -> bool:
        """Tell whether a component that runs uses no more with its new parameters than with those that it has."""
        after, before = self._loads(kb, (), failed), self._loads(kb, (), {*failed, component})
        return all(new <= old for new, old in zip(after, before, strict=True))

    def _loads(self, kb: KnowledgeBase, started: Collection[str], failed: Collection[str]) -> list[Decimal]:
        loads = dict.fromkeys(self.most, Decimal())
        with kb.reading() as state:
            for estimation in state.network.model.estimations:
                causer = state.network.find(estimation.causer)
                if estimation.attribute in loads and _counts(kb, state, causer, started, failed):
                    value = Decimal(repr(estimation.value))
                    loads[estimation.attribute] += -value if estimation.kind is EstimationKind.NEGATIVE else value
        return list(loads.values())


def _counts(kb: KnowledgeBase, state: State, causer: Node, started: Collection[str], failed: Collection[str]) -> bool:
    """Tell whether what an estimation is of is in force: a design is selected, a component runs, and with what."""
    if causer.kind == "function design":
        return state.selected[causer.index]
    component = causer if causer.kind == "component" else causer.wholes[0]
    if component.name not in started and not state.active[component.index]:
        return False
    if causer is component:
        return True
    if component.name in failed or not any(state.selected[one.index] for one in component.parts):
        return dict(kb.components[component.name].parameters_in_force) == dict(causer.element.parameters)
    return state.selected[causer.index]


class Quarantine:
    """The configurations that count as unfeasible, by an asserted status that lapses by itself after a hold [s].

    Attributes:
        held: the component of each that is in quarantine now, by name; up to date after `review`.
    """

    def __init__(self, hold: float) -> None:
        if not is_number(hold) or not hold >= 0:
            raise InvalidValue(f"a configuration is held back for 0 s or longer, math.inf for ever, not {hold!r}")
        self._hold = hold
        self.held: dict[str, str] = {}
        self._failed: set[str] = set()

    def put(self, kb: KnowledgeBase, configuration: str, reason: str) -> None:
        """Have a configuration count as unfeasible from now on, and no longer as selected: it is not in force."""
        view = kb.configurations[configuration]
        kb.assert_selected(view, False)
        with suppress(InvalidValue):  # the hold is over already
            kb.assert_status(view, Status.UNFEASIBLE, reason, kb.now + self._hold)
        self.held[configuration] = view.component

    def adopt(self, kb: KnowledgeBase) -> None:
        """Take up what was in quarantine before the knowledge base was opened again."""
        last = {one.configuration: one for one in kb.history.attempts if one.configuration is not None}
        self.held |= {name: one.component for name, one in last.items() if one.result == "failed"}
        self.review(kb)

    def review(self, kb: KnowledgeBase) -> None:
        """Release those whose component has recovered from a failure, and forget those released otherwise."""
        with kb.reading() as state:
            components, known, asserted = state.network.components, state.network.configurations, state.asserted
            stand = {name for name in self.held if name in known and asserted[known[name].index] is Status.UNFEASIBLE}
            self.held = {name: one for name, one in self.held.items() if name in stand}
            failed = {one for one in self.held.values() if state.status[components[one].index] is Status.FAILURE}
        for name in [name for name, one in self.held.items() if one in self._failed - failed]:
            kb.retract_status(kb.configurations[name])
            del self.held[name]
        self._failed = failed
