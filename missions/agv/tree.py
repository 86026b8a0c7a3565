"""The mission as a behaviour tree: what is planned is done, and planned anew when what is believed changes.

until arrived
└── follow route             one child for each corridor; the one that is planned next is ticked
    ├── cross c1 if feasible
    └── ...
"""

from collections.abc import Iterator, Mapping

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite

from kb import KnowledgeBase
from missions.agv.actions import Cross
from missions.agv.building import Building
from missions.agv.joint import Answer
from missions.agv.route import Route
from missions.engine.mission import Percepts
from rosa_bt import feasible_then_act
from rosa_bt.decorators import UntilSuccess
from rosa_pddl import Outcome, PlanRecord, Step


class FollowRoute(Composite):
    """Ticks the child for the corridor that is planned next; another one that runs is stopped first.

    SUCCESS at the goal, FAILURE while there is no plan, with the reason as feedback, and when a corridor is crossed.
    `plans` are the joint plans so far, but for those that are the rest of the one before.
    """

    def __init__(self, route: Route) -> None:
        self._route = route
        self._crossings = {name: Cross(route, name, lambda: route.leg) for name in route.building.corridors}
        self._by_corridor = {name: feasible_then_act(one) for name, one in self._crossings.items()}
        self.plans: tuple[PlanRecord, ...] = ()
        self._planned: Answer | None = None
        super().__init__("follow route", list(self._by_corridor.values()))

    def tick(self) -> Iterator[Behaviour]:
        """Do what is planned next."""
        leg = None if self._route.is_there else self._route.leg
        self._note(self._route.answer)
        planned = None if leg is None else self._by_corridor[leg.corridor]
        for name, child in self._by_corridor.items():
            if child is not planned and child.status is Status.RUNNING:
                if self._crossings[name].is_crossed:
                    yield from child.tick()
                else:
                    self._give_up(name)
        self.current_child = planned
        if planned is None:
            self.feedback_message = "" if self._route.is_there else self._route.answer.reason
            self._end(Status.SUCCESS if self._route.is_there else Status.FAILURE)
        else:
            self.feedback_message = self._route.answer.reason
            yield from planned.tick()
            self._end(Status.RUNNING if planned.status is Status.RUNNING else Status.FAILURE)
        yield self

    def _note(self, answer: Answer) -> None:
        """Put a plan down as made if it is not the rest of the one before."""
        before, self._planned = self._planned, answer
        if answer is before or (before is not None and _is_rest(answer, before)):
            return
        first = f"; {answer.legs[0]}" if answer.legs else ""
        steps = [
            Step("cross", (leg.corridor, leg.origin, leg.to, leg.mode.name), self._crossings[leg.corridor].action)
            for leg in answer.legs
        ]
        outcome = Outcome.SOLVED_OPTIMALLY if answer.is_solved else Outcome.UNSOLVABLE_PROVEN
        made = PlanRecord(self._route.kb.now, answer.reason + first, outcome, tuple(steps), "joint plan")
        self.plans = (*self.plans, made)

    def _give_up(self, corridor: str) -> None:
        """Stop a crossing, and say why: as it ends it lowers what it demands, so it is asked before."""
        crossing, kb = self._crossings[corridor], self._route.kb
        feasible = kb.is_feasible(crossing.action)
        why = self._route.answer.reason if feasible else kb.why(kb.actions[crossing.action])
        kb.cancel_action(crossing.action, "abandoned", why)
        self._by_corridor[corridor].stop(Status.INVALID)

    def _end(self, status: Status) -> None:
        if status is Status.RUNNING:
            self.status = status
        else:
            self.stop(status)


def _is_rest(answer: Answer, before: Answer) -> bool:
    ways, others = ([(leg.corridor, leg.to, leg.mode.name) for leg in one.legs] for one in (answer, before))
    return answer.is_solved is before.is_solved and ways == others[len(others) - len(ways) :]


def agv_tree(building: Building, weights: Mapping[str, float], kb: KnowledgeBase, percepts: Percepts) -> Behaviour:
    """Build the tree; it runs until the goal is reached."""
    return UntilSuccess("until arrived", FollowRoute(Route(building, kb, percepts, weights)))
