"""An event is in or out: whatever interrupts a call, the base answers as if it had been told, or had not."""

import pytest
from interrupting import Interrupted, interrupted_at, is_free
from kept import answers, robot
from models import Clock

from kb import KnowledgeBase, PriorityPlanner

STRIDE = 13
"""One instruction of so many is tried, to be done in time; tests/benchmarks/test_interrupts.py tries each."""


def attempt(kb):
    return kb.record_attempt(kb.plans[0], "camera", "activate", parameters={"speed": 1.0})


CALLS = {
    "measure": lambda kb: kb.measure("light", 0.3),
    "measure what changes nothing": lambda kb: kb.measure("load", 0.3),
    "measure debounced": lambda kb: kb.measure("energy", 0.05),
    "fail": lambda kb: kb.component_failed("camera", "rain"),
    "recover": lambda kb: kb.component_recovered("lidar"),
    "be active": lambda kb: kb.component_active("lidar", True),
    "request": lambda kb: kb.request_action("rest", {"energy": 2.0}),
    "cancel": lambda kb: kb.cancel_action("explore", "failed", "too dark"),
    "select": lambda kb: kb.select({"see": "by camera"}, {"camera": "night"}, "told"),
    "plan": lambda kb: PriorityPlanner().plan(kb),
    "finish a plan": lambda kb: kb.finish_plan(1, "completed"),
    "attempt": attempt,
    "answer": lambda kb: kb.record_answer(1, is_vetoed=True, reason="no"),
    "start": lambda kb: kb.component_started("lidar", 7),
    "assert": lambda kb: kb.assert_status("lidar", "failure", "seen", until=9.0),
    "retract": lambda kb: kb.retract_status(kb.components["lidar"]),
    "require": lambda kb: kb.assert_required(kb.functions["see"], True),
    "time": lambda kb: pass_time(kb),
    "declare": lambda kb: kb.model.action(
        "look", requires=["see"], constraints=[kb.model.attributes["light"] >= 0.5, kb.model.attributes["load"] <= 1.0]
    ),
    "constrain": lambda kb: kb.model.constrain(
        [kb.model.actions["rest"], kb.model.components["camera"]], kb.model.attributes["light"] >= 0.3
    ),
    "change a threshold": lambda kb: kb.model.change(kb.model.constraints[0], value=0.1, hysteresis=0.1),
    "change an attribute": lambda kb: kb.model.change(kb.model.attributes["energy"], max_age=1.0, agreement=(1, 1)),
    "remove": lambda kb: kb.model.remove(kb.model.actions["explore"]),
    "remove a design": lambda kb: kb.model.remove(kb.model.designs["by camera"]),
}
AMENDING = ("declare", "constrain", "change a threshold", "change an attribute", "remove", "remove a design")
TIME = "time"


def pass_time(kb):
    kb.clock.now = 60.0
    return kb.revision


class Base(KnowledgeBase):
    """One that has been told something, and what a subscriber heard of it."""

    def __init__(self):
        self.clock = Clock(1.0)
        super().__init__(robot(), clock=self.clock)
        for value in (0.9, 0.8, 0.7):
            self.measure("energy", value)
        self.measure("light", 0.9)
        self.request_action("explore")
        PriorityPlanner().plan(self)
        self.component_active("camera", True)
        self.assert_status("lidar", "failure")
        self.measure("light", 0.2)
        self.clock.now = 3.0
        self.heard = []
        self.subscribe(lambda event: self.heard.append(event.number))


def known(kb):
    found = answers(kb), [one[:6] for one in kb.log], kb.revision
    return found, kb.model.constraints and [str(one) for one in kb.model.constraints], list(kb.model.actions)


def live_on(kb):
    """Tell much more; what was interrupted may show only then."""
    kb.clock.now += 1.0
    for value in (0.05, 0.9, 0.4):
        kb.measure("light", value)
        kb.measure("energy", value)
    kb.request_action("rest")
    PriorityPlanner().plan(kb)
    kb.component_recovered("lidar")
    kb.clock.now += 4.0
    kb.component_started("lidar", 9)
    kb.cancel_action("rest", "completed")
    kb.model.change("night", priority=0)
    kb.clock.now += 60.0
    return known(kb)


def tried(name, stride, *, harsher=False):
    """Interrupt a call at one of so many instructions, compare with twins, and return how often it was out and in."""
    call = CALLS[name]
    before, told = known(Base()), Base()
    call(told)
    after = known(told)
    later = {True: live_on(told), False: live_on(Base())}
    outs = ins = 0
    for step in range(1 + hash_of(name) % stride, 1_000_000, stride):
        kb = Base()
        first = kb.log.last
        if not interrupted_at(step, lambda kb=kb: call(kb), harsher=harsher):
            break
        assert is_free(kb), f"{name}, at instruction {step}: a lock stays taken"
        if name == TIME:
            assert (pass_time(kb), known(kb))[1] == after
        found = known(kb)
        assert found in (before, after), f"{name}, at instruction {step}"
        is_in = found == after
        ins, outs = ins + is_in, outs + (not is_in)
        assert live_on(kb) == later[is_in], f"{name}, later than an interrupt at instruction {step}"
        if not harsher:
            assert kb.heard == list(range(first + 1, kb.log.last + 1)), f"{name}, heard after {step}"
    return outs, ins


def hash_of(name):
    return sum(map(ord, name))


@pytest.mark.parametrize("name", CALLS)
def test_interrupted_anywhere_it_is_as_if_told_or_not(name):
    outs, ins = tried(name, STRIDE)
    assert outs or name == TIME
    assert outs + ins > 3


def test_interrupt_comes_at_every_instruction():
    kb, steps = Base(), []
    while interrupted_at(len(steps) + 1, lambda: kb.revision):
        steps.append(1)
        assert is_free(kb)
    assert len(steps) > 5


@pytest.mark.parametrize("error", [Interrupted, ValueError])
def test_clock_that_raises_reaches_who_tells_and_nothing_has_changed(error):
    kb = Base()
    before, clock = known(kb), kb.clock

    def raising():
        raise error

    kb._time.clock = raising
    for call in [call for name, call in CALLS.items() if name != TIME]:
        with pytest.raises(error):
            call(kb)
    kb._time.clock = clock
    assert known(kb) == before
    assert is_free(kb)
