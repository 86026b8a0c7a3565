"""Small missions for verification: correct ones, and the same with one bug seeded in each."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Running, Success
from py_trees.common import OneShotPolicy, ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import Decorator, Inverter, OneShot, RunningIsFailure, SuccessIsFailure

from kb import Model
from kb.planning import PriorityPlanner
from missions.proof import Leaf, always, eventually, never
from rosa_bt import (
    ForAction,
    HasStatus,
    IsActionFeasible,
    Measurement,
    RosaAction,
    do_until_unfeasible,
    feasible_then_act,
    first_feasible,
    switch_safely,
)
from rosa_bt.decorators import UntilSuccess


def rover_model(
    *,
    energy: str = ">=",
    needed: float = 0.25,
    night: float | None = 2.0,
    radar: tuple[str, ...] = ("radar",),
    designs: bool = True,
    improves: bool = True,
    dark: float | None = None,
    used: bool = True,
) -> Callable[[], Model]:
    def make():
        model = Model("rover")
        level = model.quality_attribute("energy", low=0.0, high=1.0)
        light = model.environmental_attribute("light", low=0.0)
        camera = model.component("camera", kind="lifecycle", always_improve=improves)
        day = [light >= 0.5] if dark is None else [light >= 0.5, light <= dark]
        camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=day)
        camera.configuration("night", {"exposure": 0.2}, priority=night)
        others = [model.component(name, kind="lifecycle") for name in ("radar", "wheels", "arm")]
        by_name = {"camera": camera, **dict(zip(("radar", "wheels", "arm"), others, strict=True))}
        see, move = model.function("see", always_improve=improves), model.function("move")
        if designs:
            see.design("by_camera", [camera], priority=1)
            see.design("by_radar", [by_name[name] for name in radar], priority=2)
        move.design("by_wheels", [by_name["wheels"]], priority=1)
        condition = {">=": level >= needed, "<=": level <= needed}[energy]
        model.action("explore", requires=[see, move], constraints=[condition])
        model.action("charge", requires=[move])
        if not used:
            model.action("dance")
        return model

    return make


class Act(RosaAction):
    def update(self):
        return Status.RUNNING


class Work(Behaviour):
    def update(self):
        return Status.RUNNING


class Keeps(Act):
    """Forgets to release its request."""

    def stop(self, new_status):
        self.status = new_status
        self.iterator = self.tick()
        self._has_begun = False


class Cancels(Decorator):
    """Takes back the request of what it decorates, while that runs."""

    def update(self):
        self.decorated.kb.cancel_action(self.decorated.action)
        return self.decorated.status


class Requests(Decorator):
    """Requests an action by itself and never gives it back."""

    def __init__(self, name, kb, action, child):
        super().__init__(name, child)
        self.kb, self.action_name = kb, action

    def update(self):
        self.kb.request_action(self.action_name)
        return self.decorated.status


class Leaves(Selector):
    """Goes to another child without stopping the one that runs."""

    def tick(self):
        for child in self.children:
            if child.status is not Status.RUNNING:
                yield from child.tick()
            if child.status is Status.RUNNING and child is self.children[-1]:
                break
        self.status = self.children[-1].status
        yield self


class Latch(Decorator):
    """Fails for ever once its child has failed."""

    def __init__(self, name, child):
        super().__init__(name, child)
        self.is_over = False

    def tick(self):
        if self.is_over:
            self.status = Status.FAILURE
            yield self
        else:
            yield from super().tick()

    def update(self):
        self.is_over = self.decorated.status is Status.FAILURE
        return self.decorated.status


class Idle:
    """Chooses nothing."""

    def plan(self, kb):
        return None


class Restless:
    """Chooses another configuration each time."""

    def plan(self, kb):
        if kb.components["camera"].is_required or kb.adaptable_functions():
            other = "night" if kb.configurations["day"].is_selected else "day"
            designs = {"see": "by_camera", "move": "by_wheels"}
            is_possible = kb.configurations[other].status != "unfeasible" and kb.is_feasible(
                "explore"
            )
            if is_possible and kb.designs["by_camera"].status != "unfeasible":
                return kb.select(designs, {"camera": other})
        return PriorityPlanner().plan(kb)


class Stubborn:
    """Chooses the camera whatever there is."""

    def plan(self, kb):
        return kb.select({"see": "by_camera"}, {}) if kb.adaptable_functions() else None


class Half:
    """Chooses designs and no configurations."""

    def plan(self, kb):
        return (
            kb.select({"see": "by_camera"}, {"camera": "night"})
            if "see" in kb.adaptable_functions()
            else None
        )


@dataclass
class Case:
    name: str
    build: Callable[..., Behaviour]
    model: Callable[[], Model] = field(default_factory=rover_model)
    broken: str = ""
    given: dict[str, Any] = field(default_factory=dict)
    wanted: tuple = ()


def explore(kb, **given):
    return Act("explore", kb, "explore", **given)


def charge(kb, **given):
    return Act("charge", kb, "charge", **given)


def until(child):
    return UntilSuccess("until explored", child)


def either(kb, first=None, second=None, *, memory=False):
    """Explore if feasible, charge otherwise."""
    second = SuccessIsFailure("then go on", second or feasible_then_act(charge(kb)))
    return until(
        Selector(
            "mission", memory=memory, children=[first or feasible_then_act(explore(kb)), second]
        )
    )


def guarded(kb, condition, task, *, memory=False):
    return Sequence("guarded", memory=memory, children=[condition, task])


def asks(kb, action="explore"):
    return IsActionFeasible("feasible?", kb, action)


def rough(kb, **given):
    return explore(kb, even_if_unfeasible=True, **given)


FULL = {
    "start": {"energy": 0.625, "light": 1.5},
    "exclusive": [("explore", "charge")],
    "failing": ("camera", "radar", "wheels"),
}
CHARGES = Leaf(effects={"S": {"energy": 0.625}})
WORKS = {"leaves": {"explore": Leaf("RS")}}

ONLY_IF_NEEDED = never(
    "it does not charge while it could explore",
    lambda rig: rig.is_required("charge") and rig.kb.is_feasible("explore"),
)
DAY = always(
    "by day the camera is set for the day",
    lambda rig: (
        (rig.measured("light") or 0) < 0.5
        or not rig.kb.components["camera"].is_active
        or rig.kb.configurations["day"].is_selected
    ),
)
ENOUGH = always(
    "it explores with enough energy only",
    lambda rig: not rig.is_required("explore") or (rig.measured("energy") or 1) >= 0.25,
)
STILL = eventually(
    "it can explore again",
    lambda rig: rig.is_required("explore") or rig.root.status is Status.SUCCESS,
)

CHARGED = never(
    "charged it can explore",
    lambda rig: (
        rig.measured("energy") in (0.625, 0.1) and not (rig.kb.is_feasible("explore") or rig.read().failed)
    ),
)
OVER = never(
    "it is over only when it could explore",
    lambda rig: rig.root.status is Status.SUCCESS and rig.measured("energy") == 0.125,
)
UNFEASIBLE, RELEASED, TOGETHER = "unfeasible for longer", "released once", "exclude each other"
GOAL, STUCK, WAVERS = "goal is reached if", "not stuck", "waver"
NODES, ADAPTS, MANAGER = "every node", "every adaptation", "the manager keeps"


def _give_way(kb, task=None, other=None, **given):
    return until(do_until_unfeasible(task or explore(kb), other or charge(kb), **given))


MUTANTS = [
    # guards
    Case("no guard", lambda kb: either(kb, rough(kb)), broken=UNFEASIBLE),
    Case(
        "guard with memory",
        lambda kb: either(kb, guarded(kb, asks(kb), rough(kb), memory=True)),
        broken=UNFEASIBLE,
    ),
    Case(
        "guard asks another",
        lambda kb: either(kb, guarded(kb, asks(kb, "charge"), rough(kb))),
        broken=UNFEASIBLE,
    ),
    Case(
        "threshold too low",
        lambda kb: either(
            kb, guarded(kb, Measurement("enough?", kb, "energy", ">=", 0.1), rough(kb))
        ),
        broken=UNFEASIBLE,
    ),
    Case(
        "operator the wrong way",
        lambda kb: either(
            kb, guarded(kb, Measurement("enough?", kb, "energy", "<", 0.25), explore(kb))
        ),
        broken=GOAL,
    ),
    Case(
        "unknown is enough",
        lambda kb: either(
            kb,
            guarded(
                kb,
                Measurement("enough?", kb, "energy", ">=", 0.25, unknown=Status.SUCCESS),
                rough(kb),
            ),
        ),
        broken=UNFEASIBLE,
    ),
    Case(
        "charging goes on with failed wheels",
        lambda kb: either(kb, second=charge(kb, even_if_unfeasible=True)),
        broken=UNFEASIBLE,
    ),
    Case(
        "no guard while it gives way",
        lambda kb: _give_way(kb, Inverter("not", Inverter("not", rough(kb)))),
        broken=UNFEASIBLE,
    ),
    Case(
        "guard behind the action",
        lambda kb: either(kb, guarded(kb, rough(kb), asks(kb))),
        broken=UNFEASIBLE,
    ),
    Case(
        "guard beside the action",
        lambda kb: either(
            kb,
            Parallel("both", ParallelPolicy.SuccessOnAll(synchronise=True), [asks(kb), rough(kb)]),
        ),
        broken=UNFEASIBLE,
    ),
    Case(
        "guard asks for a status",
        lambda kb: either(
            kb, guarded(kb, HasStatus("f?", kb, kb.actions["explore"], "feasible"), explore(kb))
        ),
        broken=WAVERS,
    ),
    Case(
        "guard asks for solved",
        lambda kb: either(
            kb, guarded(kb, HasStatus("s?", kb, kb.actions["explore"], "solved"), explore(kb))
        ),
        broken=GOAL,
    ),
    # order and memory
    Case(
        "memory in the choice",
        lambda kb: either(kb, memory=True),
        wanted=(ONLY_IF_NEEDED,),
        broken="does not charge",
        given=WORKS,
    ),
    Case(
        "priority swapped",
        lambda kb: until(
            Selector("m", memory=False, children=[SuccessIsFailure("on", charge(kb)), explore(kb)])
        ),
        wanted=(ONLY_IF_NEEDED,),
        broken="does not charge",
        given=WORKS,
    ),
    Case("task and other swapped", lambda kb: _give_way(kb, charge(kb), explore(kb)), broken=NODES),
    Case(
        "finishes charging",
        lambda kb: _give_way(kb, memory=True),
        wanted=(ONLY_IF_NEEDED,),
        broken="does not charge",
        given=WORKS,
    ),
    Case(
        "gives up for ever",
        lambda kb: either(kb, Latch("latch", feasible_then_act(explore(kb)))),
        broken=STUCK,
    ),
    Case(
        "charges once only",
        lambda kb: _give_way(kb, OneShot("once", explore(kb), OneShotPolicy.ON_COMPLETION)),
        broken=STUCK,
    ),
    Case(
        "latch cannot come back",
        lambda kb: either(kb, Latch("latch", explore(kb))),
        wanted=(STILL,),
        broken="can explore again",
    ),
    Case(
        "running leaf first",
        lambda kb: until(Selector("m", memory=False, children=[Running("wait"), explore(kb)])),
        broken=NODES,
    ),
    Case(
        "behind a failure",
        lambda kb: until(Sequence("m", memory=False, children=[Failure("no"), explore(kb)])),
        broken=NODES,
    ),
    Case(
        "behind a success",
        lambda kb: until(Selector("m", memory=False, children=[Success("yes"), explore(kb)])),
        broken=NODES,
    ),
    Case(
        "success turned round",
        lambda kb: until(Inverter("not", feasible_then_act(explore(kb)))),
        broken="over only when",
        wanted=(OVER,),
    ),
    Case(
        "success hidden",
        lambda kb: until(SuccessIsFailure("no", feasible_then_act(explore(kb)))),
        broken=GOAL,
    ),
    Case(
        "never long enough",
        lambda kb: either(kb, RunningIsFailure("now", feasible_then_act(explore(kb)))),
        wanted=(ONLY_IF_NEEDED,),
        broken="does not charge",
        given=WORKS,
    ),
    Case(
        "waits before it requests",
        lambda kb: until(
            Sequence(
                "m",
                memory=False,
                children=[HasStatus("ready?", kb, "explore", "solved"), explore(kb)],
            )
        ),
        broken=GOAL,
    ),
    # requests
    Case(
        "request kept",
        lambda kb: either(kb, feasible_then_act(Keeps("explore", kb, "explore"))),
        broken=RELEASED,
    ),
    Case(
        "request of the other kept",
        lambda kb: either(kb, second=Keeps("charge", kb, "charge")),
        broken=RELEASED,
    ),
    Case("request taken back", lambda kb: either(kb, Cancels("c", explore(kb))), broken=RELEASED),
    Case(
        "request beside the tree",
        lambda kb: either(kb, Requests("r", kb, "charge", explore(kb))),
        broken=RELEASED,
    ),
    Case(
        "child left running",
        lambda kb: until(Leaves("m", memory=False, children=[explore(kb), charge(kb)])),
        broken=TOGETHER,
    ),
    Case(
        "both at once",
        lambda kb: until(
            Parallel("m", ParallelPolicy.SuccessOnAll(synchronise=False), [explore(kb), charge(kb)])
        ),
        broken=TOGETHER,
    ),
    Case(
        "one of two is enough",
        lambda kb: until(
            Parallel(
                "m", ParallelPolicy.SuccessOnOne(), [charge(kb), feasible_then_act(explore(kb))]
            )
        ),
        broken=TOGETHER,
    ),
    # models
    Case("no design", lambda kb: either(kb), rover_model(designs=False), GOAL),
    Case(
        "constraint the wrong way",
        lambda kb: either(kb),
        rover_model(energy="<="),
        "enough energy",
        wanted=(ENOUGH,),
    ),
    Case(
        "threshold too high",
        lambda kb: either(kb),
        rover_model(needed=0.99),
        "charged it can explore",
        {"leaves": {"charge": CHARGES}},
        (CHARGED,),
    ),
    Case("threshold out of range", lambda kb: either(kb), rover_model(needed=1.5), GOAL),
    Case("configuration contradicts itself", lambda kb: either(kb), rover_model(dark=0.3), ADAPTS),
    Case("configuration never preferred", lambda kb: either(kb), rover_model(night=0.5), ADAPTS),
    Case(
        "design needs what failed",
        lambda kb: either(kb),
        rover_model(radar=("camera", "radar")),
        ADAPTS,
    ),
    Case(
        "not always improved",
        lambda kb: either(kb),
        rover_model(improves=False),
        "set for the day",
        wanted=(DAY,),
    ),
    # choosing, and leaves
    Case("chooses nothing", lambda kb: either(kb), broken=MANAGER, given={"planner": Idle}),
    Case(
        "chooses anew each time", lambda kb: either(kb), broken=MANAGER, given={"planner": Restless}
    ),
    Case(
        "chooses what has failed",
        lambda kb: either(kb),
        broken=MANAGER,
        given={"planner": Stubborn},
    ),
    Case("chooses one thing only", lambda kb: either(kb), broken=MANAGER, given={"planner": Half}),
    Case(
        "never done", lambda kb: either(kb), broken=GOAL, given={"leaves": {"explore": Leaf("RF")}}
    ),
    Case(
        "charging is in vain",
        lambda kb: either(kb),
        broken="charged it can explore",
        given={"leaves": {"charge": Leaf("RS", {"S": {"energy": 0.1}})}},
        wanted=(CHARGED,),
    ),
]


def fetching_model():
    model = Model("fetcher")
    for action, part in (("drive", "wheels"), ("look", "camera")):
        component = model.component(part, kind="lifecycle")
        model.action(
            action,
            requires=[model.function(f"can {action}").design(f"by {part}", [component]).function],
        )
    return model


def _fetch(kb):
    """Drive there, and then look: when the wheels have failed since, that is still possible."""
    children = [Act("drive", kb, "drive"), Act("look", kb, "look")]
    return until(Sequence("fetch", memory=True, children=children))


CORRECT = [
    Case("either", lambda kb: either(kb)),
    Case("gives way", _give_way),
    Case("gives way with memory", lambda kb: _give_way(kb, memory=True)),
    Case(
        "for action",
        lambda kb: _give_way(kb, ForAction("explore", kb, "explore", Work("drive")), charge(kb)),
    ),
    Case(
        "two for actions",
        lambda kb: either(
            kb,
            ForAction("e", kb, "explore", Work("drive")),
            ForAction("c", kb, "charge", Work("stand")),
        ),
    ),
    Case(
        "first feasible",
        lambda kb: until(first_feasible("m", [explore(kb), SuccessIsFailure("on", charge(kb))])),
    ),
    Case(
        "first feasible with memory",
        lambda kb: until(
            first_feasible("m", [explore(kb), SuccessIsFailure("on", charge(kb))], memory=True)
        ),
    ),
    Case(
        "guarded twice",
        lambda kb: either(kb, guarded(kb, asks(kb), feasible_then_act(explore(kb)))),
    ),
    Case("guarded though rough", lambda kb: either(kb, guarded(kb, asks(kb), rough(kb)))),
    Case(
        "asks what is measured",
        lambda kb: either(kb, guarded(kb, Measurement("m", kb, "energy", ">=", 0.5), explore(kb))),
    ),
    Case(
        "waits for the robot",
        lambda kb: _give_way(kb, explore(kb, wait=True), charge(kb, wait=True)),
    ),
    Case("two failures", lambda kb: either(kb), given={"failures": 2}),
    Case("two changes", lambda kb: _give_way(kb), given={"at_once": 2}),
    Case(
        "unguarded but given up by itself",
        lambda kb: until(
            Selector("m", memory=False, children=[explore(kb), SuccessIsFailure("on", charge(kb))])
        ),
    ),
    Case(
        "inverted twice",
        lambda kb: either(kb, Inverter("a", Inverter("b", feasible_then_act(explore(kb))))),
    ),
    Case(
        "in steps",
        lambda kb: until(Sequence("m", memory=True, children=[_step(kb, "one"), _step(kb, "two")])),
    ),
    Case(
        "beside a watch",
        lambda kb: either(
            kb, Parallel("p", ParallelPolicy.SuccessOnOne(), [explore(kb), Running("watch")])
        ),
    ),
    Case(
        "steps that need what has failed since",
        _fetch,
        fetching_model,
        given={"start": {}, "failing": None, "exclusive": ()},
    ),
    Case("more light", lambda kb: either(kb), rover_model(dark=2.0)),
    Case(
        "only charges if it has to",
        lambda kb: either(kb),
        wanted=(ONLY_IF_NEEDED, ENOUGH, STILL, DAY),
        given=WORKS,
    ),
    Case(
        "folds its arm", lambda kb: switch_safely(either(kb), {("explore", "charge"): Work("fold")})
    ),
]


def _step(kb, name):
    return do_until_unfeasible(
        ForAction(name, kb, "explore", Work(f"drive {name}")),
        Act(f"charge for {name}", kb, "charge"),
    )
