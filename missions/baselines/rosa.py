"""Managers that tick our tree: ROSA as published, and ours with a lookahead.

ROSA works at the pace of its services: its knowledge base is a server, every fact and every
question is a service call, and its planner and executor are programs that make one call after the
other. The model here counts the calls before something is done. The time of one call is an input,
chosen once so that the published reaction times come out. Calls of different programs do not delay
each other, and a round of planning that finds nothing takes no time.
"""

from collections import deque
from collections.abc import Callable
from typing import ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import (
    ConfigurationManager,
    Event,
    EventKind,
    KnowledgeBase,
    PriorityPlanner,
    ReconfigurationPlan,
)
from missions.baselines.manager import Manager
from missions.engine.mission import Message, Percepts
from missions.engine.settings import Setting
from missions.engine.task_layer import build_task
from missions.suave.tree import InspectPipeline
from rosa_bt import Detour, Gain, Lookahead, MissionValue, TreeRunner, ValueSelector

INSERTING = 1
"""Calls until the knowledge base has what was published."""
REQUESTING = 2
"""Calls until an action is requested or cancelled: the question whether it is feasible, then the
request."""
PLANNING = 5
"""Calls of a round of planning: adaptable functions, components, selectable designs,
configurations, selection."""
FETCHING = 1
"""Calls until the executor has a plan; then it switches components."""
CONFIGURING = 2
"""Calls after that until it sets parameters: one for the configurations, one for the values."""


class OwnTree(Manager):
    """Ticks the tree of the mission, which uses a knowledge base of ours."""

    decides_tasks = True

    def setup(self) -> None:
        super().setup()
        self.base = KnowledgeBase(self.model, clock=lambda: self.now)
        self.seen = Percepts()
        self._stop = self.base.subscribe(self._hear)
        self.runner = TreeRunner(self.build(), clock=lambda: self.now, period=self.period_s)
        self.runner.tree.setup()

    def build(self) -> Behaviour:
        return build_task("bt", self.mission, self.base, self.seen).root

    @property
    def is_done(self) -> bool:
        return self.runner.status is Status.SUCCESS

    def update(self) -> None:
        self.runner.tick()

    def release(self) -> None:
        super().release()
        self._stop()
        self.runner.shutdown()

    def _hear(self, event: Event) -> None:
        """Record the tasks that the tree begins and ends, and call for a plan."""
        if event.kind is not EventKind.ACTION_UPDATE:
            return
        record = next(
            action
            for action in reversed(self.base.history.actions)
            if action.action == event.subject
        )
        if record.end is None:
            self.begin_task(record.action)
        else:
            self.end_task(str(record.result), record.reason)
        self.requested()

    def requested(self) -> None:
        """Plan for the new requests; called when an action was requested or cancelled."""


class RosaManager(OwnTree):
    """Ticks our tree; all takes effect after as many service calls as ROSA needs."""

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

    @property
    def period_s(self) -> float:  # each tick asks whether an action is feasible
        return self.constants.tree_period_s + self._service_s

    def setup(self) -> None:
        self._service_s = float(self.values["service_s"])
        super().setup()
        self._planner = PriorityPlanner()
        self._manager = ConfigurationManager(
            self.base, self.managed, planner=self._planner
        )  # only for dry runs
        self._asked = 0
        self._is_busy = False

    def receive(self, message: Message) -> None:
        self._after(INSERTING, lambda: self._insert(message))

    def requested(self) -> None:
        self._after(REQUESTING, self._ask_for_round)

    def _after(self, calls: int, what: Callable[[], None]) -> None:
        self.later(calls * self._service_s, what)

    def _insert(self, message: Message) -> None:
        self.seen.receive(message)
        before = self.base.revision
        self.base.receive(message)
        if self.base.revision != before and self._manager.dry_run() is not None:
            self._ask_for_round()

    def _ask_for_round(self) -> None:
        self._asked += 1
        if not self._is_busy:
            self._begin_round()

    def _begin_round(self) -> None:
        self._is_busy = True
        self._after(PLANNING, self._end_round)

    def _end_round(self) -> None:
        """Plan, unless more requests have come in meanwhile.

        Each of those gets a round of its own.
        """
        self._asked -= 1
        plan = None if self._asked else self._planner.plan(self.base)
        if plan is not None:
            self._after(FETCHING, lambda: self._switch(plan))
        else:
            self._rest()

    def _switch(self, plan: ReconfigurationPlan) -> None:
        for names, switch in (
            (plan.deactivate, self.managed.deactivate),
            (plan.activate, self.managed.activate),
        ):
            for name in names:
                if name not in plan.plain:
                    switch(name)
        self._after(CONFIGURING if plan.parameters else 0, lambda: self._configure(plan))

    def _configure(self, plan: ReconfigurationPlan) -> None:
        for name in plan.parameters:
            configuration = self.base.configurations[name]
            self.managed.set_parameters(configuration.component, configuration.parameters)
        for name in (*plan.deactivate, *plan.activate):
            self.base.component_active(name, name in plan.activate)
        self.base.finish_plan(plan, "completed")
        self._rest()

    def _rest(self) -> None:
        self._is_busy = False
        if self._asked:
            self._begin_round()


FOLLOWING_M_S = 0.27
"""Inspected metres per second: half a metre at each tick of the follower, more where points are
closer."""
TRANSIT_SHARE = 0.85
"""Mean speed of a drive to the station, as a share of the speed limit."""
SEEN_POINTS = 6
"""How many points show whether the pipeline leads to the station; before that, it is taken to lead
away."""
SETTLING_S = 4.0
"""Time from the end of a drive back until the follower counts again [s]."""


class LookaheadManager(OwnTree):
    """Ticks the tree of the mission below a lookahead: it recharges when that is worth most.

    It knows what is published, the model, the deadline, its distance from the station and how its
    own nodes move it; of the pipeline and the battery it knows only what is published. The search
    is that of the tree.
    """

    def setup(self) -> None:
        super().setup()
        self._manager = ConfigurationManager(self.base, self.managed)

    def build(self) -> Behaviour:
        mission = super().build()
        self._inspect = next(
            leaf for leaf in mission.iterate() if isinstance(leaf, InspectPipeline)
        )
        self._seen = deque([(0.0, self.world.way_m())], SEEN_POINTS)
        restores = {"battery_level": 1.0}
        detour = Detour("recharge", restores, self._there_s, self._back_s, 0.2)
        self._detours = (detour,) if detour.action in self.base.actions else ()
        self._lookahead = Lookahead(self.base, self._value, period=2.0)
        return ValueSelector("what next", self._lookahead, [mission])

    def receive(self, message: Message) -> None:
        self.seen.receive(message)
        self.base.receive(message)
        self._manager.update()

    def update(self) -> None:
        super().update()
        self._manager.update()

    def _value(self) -> MissionValue:
        """Return what is gained from now on: inspected metres.

        Nothing before the pipeline is found.
        """
        if not self.seen.holds("pipeline_found"):
            return MissionValue(self.settings.duration_s)
        way_m = self.world.way_m()
        if self._inspect.inspected_m > self._seen[-1][0]:
            self._seen.append((self._inspect.inspected_m, way_m))
        before_m, before = self._seen[0]
        now_m, now = self._seen[-1]
        away = 1.0
        if len(self._seen) == SEEN_POINTS:
            away = (now - before) / (now_m - before_m)
        gain = Gain("inspect_pipeline", FOLLOWING_M_S, 0.1, away * FOLLOWING_M_S)
        deadline = self.settings.duration_s
        return MissionValue(deadline, (gain,), self._detours, away=way_m, unit="m")

    def _drive_s(self, away: float) -> float:
        return away / (TRANSIT_SHARE * self.constants.speed_limit_m_s)

    def _there_s(self, away: float) -> float:
        return self._drive_s(away) + self.constants.recharge_period_s

    def _back_s(self, away: float) -> float:
        return self._drive_s(away) + SETTLING_S
