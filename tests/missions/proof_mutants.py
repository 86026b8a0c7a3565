"""Small missions for verification: correct ones, and the same with one bug seeded in each."""

from dataclasses import dataclass, field

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Running, Success
from py_trees.common import OneShotPolicy, ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import Decorator, Inverter, OneShot, RunningIsFailure, SuccessIsFailure

from kb import Model
from kb.planning import PriorityPlanner
from missions.proof import Leaf, always, eventually, never
from missions.proof.setup import failed
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
    upwards=True,
    needed=0.25,
    night=2.0,
    radar=("radar",),
    designs=True,
    improves=True,
    dark=9.0,
):
    def make():
        model = Model("rover")
        level = model.quality_attribute("energy", low=0.0, high=1.0)
        light = model.environmental_attribute("light", low=0.0)
        parts = {name: model.component(name, kind="lifecycle") for name in ("radar", "wheels")}
        camera = model.component("camera", kind="lifecycle", always_improve=improves)
        parts["camera"] = camera
        day = [light >= 0.5, *([light <= dark] if dark < 9.0 else [])]
        camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=day)
        camera.configuration("night", {"exposure": 0.2}, priority=night)
        see = model.function("see", always_improve=improves)
        move = model.function("move")
        if designs:
            see.design("by_camera", [camera], priority=1)
            see.design("by_radar", [parts[name] for name in radar], priority=2)
        move.design("by_wheels", [parts["wheels"]], priority=1)
        enough = level >= needed if upwards else level <= needed
        model.action("explore", requires=[see, move], constraints=[enough])
        model.action("charge", requires=[move])
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
    """Requests to charge by itself and never gives it back."""

    def update(self):
        self.decorated.kb.request_action("charge")
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

    is_over = False

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
            is_possible = kb.configurations[other].status != "unfeasible"
            is_possible &= kb.is_feasible("explore")
            if is_possible and kb.designs["by_camera"].status != "unfeasible":
                return kb.select({"see": "by_camera", "move": "by_wheels"}, {"camera": other})
        return PriorityPlanner().plan(kb)


class Stubborn:
    """Chooses the camera whatever there is."""

    def plan(self, kb):
        return kb.select({"see": "by_camera"}, {}) if kb.adaptable_functions() else None


class Half:
    """Chooses for one of the functions only."""

    def plan(self, kb):
        if "see" in kb.adaptable_functions():
            return kb.select({"see": "by_camera"}, {"camera": "night"})
        return None


BOTH = never(
    "explore and charge exclude each other",
    lambda rig: "explore" in rig.required and "charge" in rig.required,
)


@dataclass
class Case:
    """A mission, and which property is broken; `options` are those of `verify`."""

    name: str
    build: object
    broken: str = ""
    model: object = field(default_factory=rover_model)
    wanted: tuple = ()
    options: dict = field(default_factory=dict)

    def tree(self, kb):
        """Build the tree for a rover with enough energy and light."""
        for name, value in (("energy", 0.625), ("light", 1.5)):
            if name in kb.attributes:
                kb.measure(name, value)
        return self.build(kb)

    @property
    def arguments(self):
        return {"wanted": (BOTH, *self.wanted), **self.options}


def explore(kb, **options):
    return Act("explore", kb, "explore", **options)


def charge(kb, **options):
    return Act("charge", kb, "charge", **options)


def stubborn(action):
    action.even_if_unfeasible = True
    return action


def rough(kb):
    return stubborn(explore(kb))


def acts(kb):
    return feasible_then_act(explore(kb))


def until(child):
    return UntilSuccess("until explored", child)


def select(*children, memory=False):
    return until(Selector("mission", memory, [*children]))


def in_turn(*children, memory=False):
    return until(Sequence("mission", memory, [*children]))


def onward(child):
    return SuccessIsFailure("then go on", child)


def either(kb, first=None, second=None, *, memory=False):
    """Explore if feasible, charge otherwise."""
    second = onward(second or feasible_then_act(charge(kb)))
    return select(first or acts(kb), second, memory=memory)


def give_way(kb, task=None, other=None, **options):
    return until(do_until_unfeasible(task or explore(kb), other or charge(kb), **options))


def guarded(kb, condition, task, *, memory=False):
    return Sequence("guarded", memory=memory, children=[condition, task])


def asks(kb, action="explore"):
    return IsActionFeasible("feasible?", kb, action)


def has(kb, status):
    return HasStatus("status?", kb, kb.actions["explore"], status)


def enough(kb, limit=0.25, operator=">=", unknown=Status.FAILURE):
    return Measurement("enough?", kb, "energy", operator, limit, unknown=unknown)


def behind(guard, task=rough, **options):
    """Return what builds the tree in which this guard is before the exploration."""
    return lambda kb: either(kb, guarded(kb, guard(kb), task(kb), **options))


def wrapped(decorate, task=acts):
    """Return what builds the tree in which the exploration is decorated."""
    return lambda kb: either(kb, decorate(task(kb)))


def beside(policy, *tasks):
    return until(Parallel("both", policy, [*tasks]))


ALL = ParallelPolicy.SuccessOnAll
FIRST = ParallelPolicy.SuccessOnOne
CHARGES = {"leaves": {"charge": Leaf(effects={"S": {"energy": 0.625}})}}
WORKS = {"leaves": {"explore": Leaf("RS")}}

ONLY_IF_NEEDED = never(
    "it does not charge while it could explore",
    lambda rig: "charge" in rig.required and rig.kb.is_feasible("explore"),
)
DAY = always(
    "by day the camera is set for the day",
    lambda rig: (
        (rig.kb.attributes["light"].value or 0) < 0.5
        or not rig.kb.components["camera"].is_active
        or rig.kb.configurations["day"].is_selected
    ),
)
ENOUGH = always(
    "it explores with enough energy only",
    lambda rig: "explore" not in rig.required or (rig.kb.attributes["energy"].value or 1) >= 0.25,
)
STILL = eventually(
    "it can explore again",
    lambda rig: "explore" in rig.required or rig.root.status is Status.SUCCESS,
)
CHARGED = never(
    "charged it can explore",
    lambda rig: (
        rig.kb.attributes["energy"].value in (0.625, 0.1)
        and not rig.kb.is_feasible("explore")
        and not failed(rig.read())
    ),
)
OVER = never(
    "it is over only when it could explore",
    lambda rig: rig.root.status is Status.SUCCESS and rig.kb.attributes["energy"].value == 0.125,
)
UNFEASIBLE, RELEASED, TOGETHER = "unfeasible for longer", "released once", "exclude each other"
GOAL, STUCK, WAVERS = "goal is reached if", "not stuck", "waver"
NODES, ADAPTS, MANAGER = "every node", "every adaptation", "the manager keeps"
IDLE = "does not charge"


def rover(**options):
    return {"model": rover_model(**options)}


def chosen_by(planner):
    return {"options": {"planner": planner}}


NEEDED = {"wanted": (ONLY_IF_NEEDED,), "options": WORKS}

MUTANTS = [
    # guards
    Case("no guard", lambda kb: either(kb, rough(kb)), UNFEASIBLE),
    Case("guard with memory", behind(asks, memory=True), UNFEASIBLE),
    Case("guard asks another", behind(lambda kb: asks(kb, "charge")), UNFEASIBLE),
    Case("threshold too low", behind(lambda kb: enough(kb, 0.1)), UNFEASIBLE),
    Case("operator the wrong way", behind(lambda kb: enough(kb, operator="<"), explore), GOAL),
    Case("unknown is enough", behind(lambda kb: enough(kb, unknown=Status.SUCCESS)), UNFEASIBLE),
    Case(
        "charging goes on with failed wheels",
        lambda kb: either(kb, second=stubborn(charge(kb))),
        UNFEASIBLE,
    ),
    Case(
        "no guard while it gives way",
        lambda kb: give_way(kb, Inverter("not", Inverter("not", rough(kb)))),
        UNFEASIBLE,
    ),
    Case(
        "guard behind the action",
        lambda kb: either(kb, guarded(kb, rough(kb), asks(kb))),
        UNFEASIBLE,
    ),
    Case(
        "guard beside the action",
        lambda kb: either(kb, Parallel("both", ALL(synchronise=True), [asks(kb), rough(kb)])),
        UNFEASIBLE,
    ),
    Case("guard asks for a status", behind(lambda kb: has(kb, "feasible"), explore), WAVERS),
    Case("guard asks for solved", behind(lambda kb: has(kb, "solved"), explore), GOAL),
    # order and memory
    Case("memory in the choice", lambda kb: either(kb, memory=True), IDLE, **NEEDED),
    Case("priority swapped", lambda kb: select(onward(charge(kb)), explore(kb)), IDLE, **NEEDED),
    Case("task and other swapped", lambda kb: give_way(kb, charge(kb), explore(kb)), NODES),
    Case("finishes charging", lambda kb: give_way(kb, memory=True), IDLE, **NEEDED),
    Case("gives up for ever", wrapped(lambda task: Latch("latch", task)), STUCK),
    Case(
        "charges once only",
        lambda kb: give_way(kb, OneShot("once", explore(kb), OneShotPolicy.ON_COMPLETION)),
        STUCK,
    ),
    Case(
        "latch cannot come back",
        wrapped(lambda task: Latch("latch", task), explore),
        "can explore again",
        wanted=(STILL,),
    ),
    Case("running leaf first", lambda kb: select(Running("wait"), explore(kb)), NODES),
    Case("behind a failure", lambda kb: in_turn(Failure("no"), explore(kb)), NODES),
    Case("behind a success", lambda kb: select(Success("yes"), explore(kb)), NODES),
    Case(
        "success turned round",
        lambda kb: until(Inverter("not", acts(kb))),
        "over only when",
        wanted=(OVER,),
    ),
    Case("success hidden", lambda kb: until(SuccessIsFailure("no", acts(kb))), GOAL),
    Case("never long enough", wrapped(lambda task: RunningIsFailure("now", task)), IDLE, **NEEDED),
    Case("waits before it requests", lambda kb: in_turn(has(kb, "solved"), explore(kb)), GOAL),
    # requests
    Case(
        "request kept",
        lambda kb: either(kb, feasible_then_act(Keeps("explore", kb, "explore"))),
        RELEASED,
    ),
    Case("request taken back", wrapped(lambda task: Cancels("c", task), explore), RELEASED),
    Case("request beside the tree", wrapped(lambda task: Requests("r", task), explore), RELEASED),
    Case(
        "child left running",
        lambda kb: until(Leaves("m", False, [explore(kb), charge(kb)])),
        TOGETHER,
    ),
    Case(
        "both at once", lambda kb: beside(ALL(synchronise=False), explore(kb), charge(kb)), TOGETHER
    ),
    # models
    Case("no design", either, GOAL, **rover(designs=False)),
    Case(
        "constraint the wrong way", either, "enough energy", rover_model(upwards=False), (ENOUGH,)
    ),
    Case("threshold too high", either, "charged", rover_model(needed=0.99), (CHARGED,), CHARGES),
    Case("threshold out of range", either, GOAL, **rover(needed=1.5)),
    Case("configuration contradicts itself", either, ADAPTS, **rover(dark=0.3)),
    Case("configuration never preferred", either, ADAPTS, **rover(night=0.5)),
    Case("design needs what failed", either, ADAPTS, **rover(radar=("camera", "radar"))),
    Case("not always improved", either, "for the day", rover_model(improves=False), (DAY,)),
    # choosing, and leaves
    Case("chooses nothing", either, MANAGER, **chosen_by(Idle)),
    Case("chooses anew each time", either, MANAGER, **chosen_by(Restless)),
    Case("chooses what has failed", either, MANAGER, **chosen_by(Stubborn)),
    Case("chooses one thing only", either, MANAGER, **chosen_by(Half)),
    Case("never done", either, GOAL, options={"leaves": {"explore": Leaf("RF")}}),
    Case(
        "charging is in vain",
        either,
        "charged it can explore",
        wanted=(CHARGED,),
        options={"leaves": {"charge": Leaf("RS", {"S": {"energy": 0.1}})}},
    ),
]


def fetching_model():
    model = Model("fetcher")
    for action, part in (("drive", "wheels"), ("look", "camera")):
        component = model.component(part, kind="lifecycle")
        able = model.function(f"can {action}").design(f"by {part}", [component]).function
        model.action(action, requires=[able])
    return model


def step(kb, name):
    drive = ForAction(name, kb, "explore", Work(f"drive {name}"))
    return do_until_unfeasible(drive, Act(f"charge for {name}", kb, "charge"))


def for_action(kb, name="explore"):
    return ForAction(name, kb, name, Work(f"work on {name}"))


def twice(task):
    return Inverter("a", Inverter("b", task))


CORRECT = [
    Case("either", either),
    Case("gives way", give_way),
    Case("gives way with memory", lambda kb: give_way(kb, memory=True)),
    Case("for action", lambda kb: give_way(kb, for_action(kb))),
    Case("two for actions", lambda kb: either(kb, for_action(kb), for_action(kb, "charge"))),
    Case(
        "first feasible", lambda kb: until(first_feasible("m", [explore(kb), onward(charge(kb))]))
    ),
    Case(
        "first feasible with memory",
        lambda kb: until(first_feasible("m", [explore(kb), onward(charge(kb))], memory=True)),
    ),
    Case("guarded twice", behind(asks, acts)),
    Case("guarded though rough", behind(asks)),
    Case("asks for more than is needed", behind(lambda kb: enough(kb, 0.5), acts)),
    Case(
        "waits for the robot",
        lambda kb: give_way(kb, explore(kb, wait=True), charge(kb, wait=True)),
    ),
    Case("two failures", either, options={"failures": 2}),
    Case("no failures", either, options={"failures": 0}),
    Case("unguarded but given up by itself", lambda kb: select(explore(kb), onward(charge(kb)))),
    Case("inverted twice", wrapped(twice)),
    Case("inverted twice without a guard", wrapped(twice, explore)),
    Case("in steps", lambda kb: in_turn(step(kb, "one"), step(kb, "two"), memory=True)),
    Case(
        "beside a watch",
        wrapped(lambda task: Parallel("p", FIRST(), [task, Running("watch")]), explore),
    ),
    Case(
        "with a part that is stopped in its tick",
        lambda kb: in_turn(Parallel("p", FIRST(), [Success("s"), Running("r")]), either(kb)),
    ),
    Case(
        "steps that need what has failed since",
        lambda kb: in_turn(Act("drive", kb, "drive"), Act("look", kb, "look"), memory=True),
        model=fetching_model,
    ),
    Case("more light", either, **rover(dark=2.0)),
    Case(
        "only charges if it has to",
        either,
        wanted=(ONLY_IF_NEEDED, ENOUGH, STILL, DAY),
        options=WORKS,
    ),
    Case(
        "folds its arm", lambda kb: switch_safely(either(kb), {("explore", "charge"): Work("fold")})
    ),
]
