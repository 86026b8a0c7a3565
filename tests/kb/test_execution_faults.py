"""No fault and no interrupt makes the manager lie, stall or end a plan twice."""

from collections import Counter
from itertools import count
from random import Random

import pytest
from interrupting import Interrupted, interrupted_at
from managed_stand_ins import Operation, Scripted, base, rover, turn
from models import Clock

from kb import ConfigurationManager, KnowledgeBase, Model, OptimalPlanner, StagedExecutor, Status

DURATIONS = {"slow": 2.0, "late": 6.0, "never": 1e9, "fail": 1.0}
FAULTS = ("at once", *DURATIONS, "lie", "raise", "interrupt before", "interrupt after")
TIMEOUT = 4.0
ATTEMPTS = 3


class Ending(Operation):
    """Has its effect at its end, whether anybody still asks or not."""

    def __init__(self, system, ends, effect, error):
        super().__init__(system.clock, ends, effect, error)
        self.system = system

    def done(self):
        self.system.confuse("done")
        return super().done()

    def exception(self):
        self.system.confuse("exception")
        return self.error


class Faulty(Scripted):
    """Obeys with a chance, else is slow, late, silent, lying or broken; `running` truly runs."""

    def __init__(self, clock, chance, faults, interrupts):
        super().__init__(clock)
        self.chance = chance
        self.faults = faults
        self.interrupts = interrupts
        self.under_way = []

    def confuse(self, what):
        if self.chance.random() < self.interrupts:
            raise Interrupted(what)
        if self.chance.random() < self.faults / 20:
            raise OSError(f"{what} cannot be told")

    def pass_time(self, seconds):
        self.clock.now += seconds
        for operation in self.under_way:
            if operation.ends <= self.clock.now:
                Operation.done(operation)

    def _do(self, verb, component, effect, parameters=None):
        fault = self.chance.choice(FAULTS) if self.chance.random() < self.faults else "at once"
        if verb == "configure" and fault in ("lie", "late"):  # nobody can be asked about parameters
            fault = "never"
        if fault == "raise" or (fault.startswith("interrupt") and not self.interrupts):
            raise OSError(f"{verb} {component} is broken")
        if fault in ("at once", "interrupt after"):
            effect()
        if fault.startswith("interrupt"):
            raise Interrupted(fault)
        if fault in ("at once", "lie"):
            return None
        error = OSError("it failed") if fault == "fail" else None
        operation = Ending(self, self.clock.now + DURATIONS[fault], effect, error)
        self.under_way.append(operation)
        return operation

    def is_active(self, component):
        self.confuse("is_active")
        return component in self.running


def robot():
    """Return a model of functions that share components, each of which may be given up."""
    model = Model("robot")
    light = model.environmental_attribute("light")
    charge = model.quality_attribute("charge")
    for name in ("eye", "ear", "nose", "arm"):
        flags = {"stops_to_configure": name == "ear", "always_improve": name == "eye"}
        part = model.component(name, kind="lifecycle", **flags)
        fast = part.configuration(f"{name} fast", {"rate": 9.0}, constraints=[light >= 0.5])
        fast.estimate(charge, 4.0)
        part.configuration(f"{name} slow", {"rate": 1.0}, priority=2)
    see = model.function("see", always_improve=True)
    see.design("by eye", ["eye"], priority=1, constraints=[charge >= 0.3])
    see.design("by ear", ["ear", "nose"], priority=2)
    reach = model.function("reach")
    reach.design("by arm", ["arm", "eye"], priority=1)
    reach.design("by nose", ["nose"], priority=2)
    model.action("look", requires=[see])
    model.action("take", requires=[see, reach], constraints=[charge >= 0.1])
    return model


class Life:
    """A robot's life: things happen at random, and each turn what must be true is looked at.

    A component that is recorded to run runs at that moment, and one that is recorded not to run
    does not; a plan ends once; a command that fails is given no more often than allowed, and none
    stays open longer than its time-out.
    """

    def __init__(self, seed, *, faults=0.3, interrupts=0.0):
        self.chance = Random(seed)
        self.clock = Clock(100.0)
        self.kb = KnowledgeBase(robot(), clock=self.clock)
        self.system = Faulty(self.clock, self.chance, faults, interrupts)
        self.manager = ConfigurationManager(
            self.kb,
            self.system,
            planner=OptimalPlanner() if seed == 5 else None,
            executor=StagedExecutor(self.system, attempts=ATTEMPTS, timeout=TIMEOUT, hold=20.0),
        )
        self.lies = []
        self.ends = Counter()
        self.interrupted = 0
        self.seen = 0
        self.kb.subscribe(self._check)

    def _check(self, event):
        if event.verb == "component_active":
            name, is_active, *_ = event.arguments
            if is_active is not (name in self.system.running):
                self.lies.append((event.time, name, is_active))

    def turn(self, at=None):
        """Let something happen, take a turn, perhaps interrupted, and look at what must be true."""
        for what in self.chance.sample(("light", "charge", "recover", "look", "take", "crash"), 2):
            self._happen(what)
        self.update(at)
        self.look()
        self.system.pass_time(self.chance.choice((0.5, 1.0, 3.0)))

    def update(self, at=None):
        try:
            if at is None:
                self.manager.update()
            else:
                self.interrupted += interrupted_at(at, self.manager.update, harsher=True)
        except Interrupted:
            self.interrupted += 1

    def _happen(self, what):
        kb = self.kb
        running = self.system.running
        if what in ("light", "charge"):
            kb.measure(what, self.chance.choice((0.05, 0.2, 0.4, 0.9)))
        elif what == "recover":
            self.recover()
        elif what == "crash":
            if running and self.chance.random() < 0.2:
                running.discard(self.chance.choice(sorted(running)))
        elif kb.required_actions and self.chance.random() < 0.4:
            kb.cancel_action(what)
        else:
            kb.request_action(what)

    def recover(self):
        for name in self.kb.components:
            self.kb.component_recovered(name)

    def look(self):
        for event in self.kb.log.since(self.seen):
            if event.verb == "finish_plan":
                self.ends[event.arguments[0]] += 1
        self.seen = self.kb.log.last
        assert not self.lies, self.lies
        assert all(ends == 1 for ends in self.ends.values()), self.ends
        assert len(self.kb.history.open_plans) <= 1
        for plan in self.kb.plans[-3:]:
            assert (plan.end is not None) == (self.ends[plan.number] == 1), plan
        for attempt in self.kb.history.attempts[-20:]:
            assert attempt.end is not None or attempt.plan.end is None, attempt
            if not self.interrupted:
                assert (attempt.end or self.clock.now) - attempt.start <= TIMEOUT + 3.0, attempt
                assert attempt.number <= ATTEMPTS, attempt

    def rest(self):
        """Have the system obey again, and see that all comes right."""
        kb = self.kb
        system = self.system
        system.faults = system.interrupts = 0.0
        system.under_way.clear()  # nobody can know of a start that comes true after its stop
        kb.measure("light", 0.9)
        kb.measure("charge", 0.9)
        for number in range(60):
            if number == 30:  # no configuration is held back any more
                self.recover()
                kb.request_action("take")
            self.update()
            self.look()
            system.pass_time(1.0)
        assert kb.pending_plan is None
        assert all(plan.end is not None for plan in kb.plans)
        assert all(attempt.end is not None for attempt in kb.history.attempts)
        active = [view for view in kb.components.values() if view.is_active]
        assert {view.name for view in active} == system.running
        assert kb.actions["take"].status is Status.SOLVED, kb.explain("take")
        for view in active:
            if view.is_required:  # one that could not be stopped may run on, and is known to
                chosen = kb.configurations[view.selected_configuration]
                assert view.parameters_in_force == chosen.parameters
                assert system.parameters[view.name] == dict(chosen.parameters)


@pytest.mark.parametrize("interrupts", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(10))
def test_no_managed_system_makes_the_manager_lie(seed, interrupts):
    life = Life(seed, interrupts=interrupts)
    for _ in range(40 if seed == 5 else 150):
        life.turn()
    life.rest()
    assert len(life.kb.plans) > 3
    results = {plan.result for plan in life.kb.plans}
    assert results <= {"completed", "failed", *(["abandoned"] if interrupts else [])}
    abandoned = [attempt for attempt in life.kb.history.attempts if attempt.result == "abandoned"]
    assert bool(life.interrupted > 1 and abandoned) is bool(interrupts)


@pytest.mark.parametrize("seed", range(6))
def test_update_interrupted_anywhere_goes_on_correctly(seed):
    life = Life(seed)
    for number in range(60):
        life.turn(at=1 + (97 * number * number + 13 * seed) % 4000)
    life.rest()
    assert life.interrupted > 1


def test_interrupted_plan_begins_with_its_first_stage():
    for step in count(1, 499):
        life = Life(0, faults=0.0)
        life.kb.request_action("take")
        life.update(step)
        if not life.interrupted:
            break
        life.update()
        life.look()
        assert [plan.result for plan in life.kb.plans] == ["completed"], step
    assert step > 1000


class Impatient(Scripted):
    """Its user presses Ctrl-C in the first call to start the camera."""

    is_interrupted = False

    def activate(self, component):
        if component == "camera" and not self.is_interrupted:
            self.is_interrupted = True
            raise KeyboardInterrupt
        return super().activate(component)


def test_two_open_plans_after_an_interrupt_end_as_they_were():
    kb, clock = base(rover())
    managed = Impatient(clock)
    manager = ConfigurationManager(kb, managed)
    kb.request_action("explore")
    with pytest.raises(KeyboardInterrupt):
        manager.update()
    kb.select({"see": "by lidar"})
    turn(manager, clock, 3)
    assert [plan.result for plan in kb.plans] == ["abandoned", "completed"]
    started = [attempt for attempt in kb.history.attempts if attempt.operation == "activate"]
    assert [(attempt.plan.number, attempt.component, attempt.result) for attempt in started] == [
        (1, "camera", "abandoned"),
        (2, "lidar", "completed"),
    ]
    assert managed.running == {"lidar"}
    assert kb.actions["explore"].status is Status.SOLVED


def test_latest_plan_stops_what_an_older_open_plan_gave_up():
    model = Model("two")
    model.function("see").design("by a", [model.component("a", kind="lifecycle")], priority=1)
    model.functions["see"].design("by b", [model.component("b", kind="lifecycle")], priority=2)
    model.function("go").design("by d", [model.component("d", kind="lifecycle")], priority=1)
    model.action("explore", requires=["see", "go"])
    kb, clock = base(model)
    managed = Impatient(clock)
    managed.is_interrupted = True
    manager = ConfigurationManager(kb, managed)
    kb.component_failed("d")
    kb.assert_required(kb.functions["see"], True)
    turn(manager, clock, 3)
    assert managed.running == {"a"}
    kb.component_recovered("d")
    kb.assert_required(kb.functions["go"], True)
    kb.select({"see": "by b"})
    kb.select({"go": "by d"})
    turn(manager, clock, 3)
    assert managed.running == {"b", "d"}
    assert [plan.result for plan in kb.plans] == ["completed", "abandoned", "completed"]
