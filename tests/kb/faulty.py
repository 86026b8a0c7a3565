"""A managed system that does anything it should not, a manager on it, and what must be true."""

import sys
from collections import Counter
from dataclasses import dataclass, field
from random import Random

from interrupting import out_of_reach
from models import Clock

from kb import ConfigurationManager, KnowledgeBase, Model, OptimalPlanner, StagedExecutor, Status

FAULTS = (
    "at once",
    "slow",
    "late",
    "never",
    "lie",
    "raise",
    "fail",
    "interrupt before",
    "interrupt after",
    "mumble",
)
TIMEOUT, ATTEMPTS = 4.0, 3


class Interrupted(BaseException):
    """What a signal raises, anywhere."""


@dataclass
class Operation:
    """Ends at a time of the clock, well or badly.

    What it does it does then, whether anybody still waits or not.
    """

    system: "Faulty"
    ends: float
    effect: object = None
    error: Exception | None = None

    def done(self):
        self.system.confuse("done")
        return self.system.clock.now >= self.ends

    def exception(self):
        self.system.confuse("exception")
        return self.error


@dataclass
class Faulty:
    """Obeys with a chance, else is slow, late, silent, lying or broken.

    `running` is what truly runs.
    """

    clock: Clock
    chance: Random
    faults: float = 0.5
    interrupts: float = 0.0
    running: set = field(default_factory=set)
    parameters: dict = field(default_factory=dict)
    under_way: list = field(default_factory=list)
    commands: Counter = field(default_factory=Counter)

    def confuse(self, what):
        if self.chance.random() < self.interrupts:
            raise Interrupted(what)
        if self.chance.random() < self.faults / 20:
            raise OSError(f"{what} cannot be told")

    def pass_time(self, seconds):
        self.clock.now += seconds
        for one in [one for one in self.under_way if one.ends <= self.clock.now]:
            self.under_way.remove(one)
            one.effect()

    def _command(self, verb, component, effect):
        self.commands[verb] += 1
        fault = self.chance.choice(FAULTS) if self.chance.random() < self.faults else "at once"
        if verb == "configure" and fault in ("lie", "late"):  # nobody can be asked about parameters
            fault = "never"
        if fault.startswith("interrupt"):
            if self.interrupts == 0.0:
                fault = "raise"
            else:
                if fault.endswith("after"):
                    effect()
                raise Interrupted(fault)
        if fault == "raise":
            raise OSError(f"{verb} {component} is broken")
        if fault == "lie":
            return None
        if fault == "at once":
            effect()
            return None
        lasts = {"slow": 2.0, "late": 6.0, "never": 1e9, "fail": 1.0, "mumble": 1.0}[fault]
        error = OSError("it failed") if fault == "fail" else None
        operation = Operation(self, self.clock.now + lasts, effect, error)
        if fault in ("slow", "late", "mumble"):
            self.under_way.append(operation)
        return operation

    def activate(self, component):
        return self._command("activate", component, lambda: self.running.add(component))

    def deactivate(self, component):
        return self._command("deactivate", component, lambda: self.running.discard(component))

    def set_parameters(self, component, parameters):
        given = dict(parameters)
        return self._command(
            "configure", component, lambda: self.parameters.__setitem__(component, given)
        )

    def is_active(self, component):
        self.confuse("is_active")
        return component in self.running


def robot():
    """Three functions that share components.

    Light and charge decide, and each component may be given up.
    """
    model = Model("robot")
    light = model.environmental_attribute("light")
    charge = model.quality_attribute("charge")
    for name in ("eye", "ear", "nose", "arm"):
        part = model.component(
            name, kind="lifecycle", stops_to_configure=name == "ear", always_improve=name == "eye"
        )
        part.configuration(f"{name} fast", {"rate": 9.0}, priority=1, constraints=[light >= 0.5])
        part.configuration(f"{name} slow", {"rate": 1.0}, priority=2)
        for configuration, watts in ((f"{name} fast", 4.0), (f"{name} slow", 1.0)):
            model.configurations[configuration].estimate(charge, watts)
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

    A component that is told to run runs at that moment, and one that is told not to run does not; a
    plan ends once; a command that fails is given no more often than allowed, and none stays open
    longer than its time-out.
    """

    def __init__(self, seed, *, faults=0.5, interrupts=0.0, optimal=False):
        self.chance, self.clock = Random(seed), Clock(100.0)
        self.kb = KnowledgeBase(robot(), clock=self.clock)
        self.system = Faulty(self.clock, self.chance, faults, interrupts)
        planner = OptimalPlanner() if optimal else None
        executor = StagedExecutor(self.system, attempts=ATTEMPTS, timeout=TIMEOUT, hold=20.0)
        self.manager = ConfigurationManager(
            self.kb, self.system, planner=planner, executor=executor
        )
        self.lies, self.ends, self.interrupted, self._seen = [], Counter(), 0, 0
        self.kb.subscribe(self._heard)

    def _heard(self, event):
        if event.verb == "component_active":
            name, is_active, *_ = event.arguments
            if is_active is not (name in self.system.running):
                self.lies.append((event.time, name, is_active))

    def turn(self, at=None):
        """Let something happen, take a turn, perhaps interrupted, and look at what must be true."""
        self._happen()
        self.update(at)
        self.look()
        self.system.pass_time(self.chance.choice((0.5, 1.0, 3.0)))

    def update(self, at=None):
        try:
            return self.manager.update() if at is None else interrupted_at(at, self.manager.update)
        except Interrupted:
            self.interrupted += 1
            return None

    def _happen(self):
        kb = self.kb
        chance = self.chance
        for what in chance.sample(("light", "charge", "recover", "look", "take", "crash"), 2):
            if what in ("light", "charge"):
                kb.measure(what, chance.choice((0.05, 0.2, 0.4, 0.9)))
            elif what == "recover":
                for name in kb.components:
                    kb.component_recovered(name)
            elif what == "crash":
                if self.system.running and chance.random() < 0.2:
                    self.system.running.discard(chance.choice(sorted(self.system.running)))
            elif kb.required_actions and chance.random() < 0.4:
                kb.cancel_action(what)
            else:
                kb.request_action(what)

    def look(self):
        for event in self.kb.log.since(self._seen):
            if event.verb == "finish_plan":
                self.ends[event.arguments[0]] += 1
            self._seen = event.number
        assert not self.lies, self.lies
        assert all(count == 1 for count in self.ends.values()), self.ends
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
        for number in range(80):
            if number == 40:  # what came true late has, and no configuration is held back any more
                for name in kb.components:
                    kb.component_recovered(name)
                kb.request_action("take")
            self.update()
            self.look()
            system.pass_time(1.0)
        assert kb.pending_plan is None
        assert all(plan.end is not None for plan in kb.plans)
        assert all(attempt.end is not None for attempt in kb.history.attempts)
        assert {
            component.name for component in kb.components.values() if component.is_active
        } == system.running
        assert kb.actions["take"].status is Status.SOLVED, kb.explain("take")
        for component in kb.components.values():
            if (
                component.is_active and component.is_required
            ):  # one that could not be stopped may run on, and is known to
                chosen = kb.configurations[component.selected_configuration]
                assert (
                    dict(component.parameters_in_force)
                    == dict(chosen.parameters)
                    == system.parameters[component.name]
                )


def interrupted_at(step, call, count=None):
    """Interrupt a call at one of the instructions that it runs in the product.

    `count` gets how many it came to.

    Those on a way out of a `with` or a function are left out: Python looks for no signal there.
    """
    passed = 0

    def trace(frame, event, _):
        nonlocal passed
        file = frame.f_code.co_filename
        if "/kb/" not in file or "/tests/" in file:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and frame.f_lasti not in out_of_reach(frame.f_code):
            passed += 1
            if passed == step:
                sys.settrace(None)
                raise Interrupted
        return trace

    sys.settrace(trace)
    try:
        return call()
    finally:
        sys.settrace(None)
        if count is not None:
            count.append(passed)


def lived(seed, turns, **options):
    """Live a life, let it come to rest, and return it."""
    life = Life(seed, **options)
    for _ in range(turns):
        life.turn()
    life.rest()
    return life


def interrupted_turns(seed, steps):
    """Live a life of turns each of which is interrupted at one of its instructions.

    Return how many were.
    """
    life = Life(seed, faults=0.3)
    for step in steps:
        life.turn(at=step)
    life.rest()
    return life
