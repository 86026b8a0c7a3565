"""ROSA as it was published: our knowledge base and tree, at the pace of ROSA's services.

ROSA's knowledge base is a server. Whatever it is to know or is asked is the call of a service, and its planner and
executor are programs of their own, which call one after the other. What is rebuilt here is how many calls follow each
other before something is done; how long one takes is an input, chosen once so that the published reaction times come
out. Calls of different programs do not delay each other, and a round of planning that finds nothing costs nothing.
"""

from collections.abc import Callable
from typing import ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import ConfigurationManager, Event, EventKind, KnowledgeBase, PriorityPlanner, ReconfigurationPlan
from missions.baselines.manager import Manager, Robot
from missions.engine.mission import Message, Percepts
from missions.engine.settings import Setting
from missions.engine.task_layer import build_task
from rosa_bt import TreeRunner

INSERTING = 1
"""Calls until something that was published is known."""
REQUESTING = 2
"""Calls until an action is requested or cancelled: whether it is feasible, then the request."""
PLANNING = 5
"""Calls of a round of planning: adaptable functions, components, selectable designs, configurations, selection."""
FETCHING = 1
"""Calls until the executor has a plan: it then switches components."""
CONFIGURING = 2
"""Calls after that until it sets parameters: which configurations, which values."""


class OwnTree(Manager):
    """Ticks the tree of the mission, which asks and tells a knowledge base of ours."""

    decides_tasks = True

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.kb = KnowledgeBase(robot.mission.model(), clock=lambda: robot.now)
        self.percepts = Percepts()
        self._stop = self.kb.subscribe(self._hear)
        self.runner = TreeRunner(self.tree(), clock=lambda: robot.now, period=self.period_s)
        self.runner.tree.setup()

    def tree(self) -> Behaviour:
        return build_task("bt", self.robot.mission, self.kb, self.percepts).root

    @property
    def is_done(self) -> bool:
        return self.runner.status is Status.SUCCESS

    def update(self) -> None:
        self.runner.tick()

    def close(self) -> None:
        self._stop()
        self.runner.shutdown()

    def _hear(self, event: Event) -> None:
        """Take down what the tree begins and ends, and have it planned for."""
        if event.kind is not EventKind.ACTION_UPDATE:
            return
        record = next(one for one in reversed(self.kb.history.actions) if one.action == event.subject)
        if record.end is None:
            self.robot.begin(record.action)
        else:
            self.robot.end(str(record.result), record.reason)
        self.requested()

    def requested(self) -> None:
        """Plan for what was requested or cancelled."""


class RosaManager(OwnTree):
    """Ticks our tree; what is published, requested and planned takes effect after as many calls as ROSA needs."""

    options: ClassVar = (
        Setting(
            "service_s",
            0.17,
            "s",
            "time that one call of a service of ROSA takes",
            "input: chosen so that the reaction times of ROSA in the table of its paper come out",
            is_published=True,
        ),
    )

    def __init__(self, robot: Robot) -> None:
        self._service_s = robot.options["service_s"]
        self.period_s = robot.settings.tree_period_s + self._service_s  # each tick asks whether an action is feasible
        super().__init__(robot)
        self._planner = PriorityPlanner()
        self._manager = ConfigurationManager(self.kb, robot, planner=self._planner)  # to see what would be planned
        self._asked = 0
        self._is_busy = False

    def receive(self, message: Message) -> None:
        self._after(INSERTING, lambda: self._insert(message))

    def requested(self) -> None:
        self._after(REQUESTING, self._ask_for_round)

    def _after(self, calls: int, what: Callable[[], None]) -> None:
        self.robot.later(calls * self._service_s, what)

    def _insert(self, message: Message) -> None:
        self.percepts.receive(message)
        before = self.kb.revision
        self.kb.receive(message)
        if self.kb.revision != before and self._manager.dry_run() is not None:
            self._ask_for_round()

    def _ask_for_round(self) -> None:
        self._asked += 1
        if not self._is_busy:
            self._begin_round()

    def _begin_round(self) -> None:
        self._is_busy = True
        self._after(PLANNING, self._end_round)

    def _end_round(self) -> None:
        """Plan, unless something else came in meanwhile; each of that is answered by a round of its own."""
        self._asked -= 1
        plan = None if self._asked else self._planner.plan(self.kb)
        if plan is not None:
            self._after(FETCHING, lambda: self._switch(plan))
        else:
            self._rest()

    def _switch(self, plan: ReconfigurationPlan) -> None:
        for names, switch in ((plan.deactivate, self.robot.deactivate), (plan.activate, self.robot.activate)):
            for name in names:
                if name not in plan.plain:
                    switch(name)
        self._after(CONFIGURING if plan.parameters else 0, lambda: self._configure(plan))

    def _configure(self, plan: ReconfigurationPlan) -> None:
        for name in plan.parameters:
            configuration = self.kb.configurations[name]
            self.robot.set_parameters(configuration.component, configuration.parameters)
        for name in (*plan.deactivate, *plan.activate):
            self.kb.component_active(name, name in plan.activate)
        self.kb.finish_plan(plan, "completed")
        self._rest()

    def _rest(self) -> None:
        self._is_busy = False
        if self._asked:
            self._begin_round()
