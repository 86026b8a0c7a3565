"""An event is in or out: whatever interrupts a call, the base answers as if it had been told, or had not."""

import math
import sys

import pytest
from interrupting import Interrupted, interrupted_at, is_free
from kept import answers, robot
from models import Clock

from kb import InvalidValue, KnowledgeBase, KnowledgeBaseError, Model, PriorityPlanner
from kb.network import Network
from kb.state import State, propagate
from kb.status import Status

STRIDE = 29
"""One instruction of so many is tried, to be done in time; where depends on the call."""


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
        "look",
        requires=["see"],
        constraints=[kb.model.attributes["light"] >= 0.5, kb.model.attributes["load"] <= 1.0],
    ),
    "constrain": lambda kb: kb.model.constrain(
        [kb.model.actions["rest"], kb.model.components["camera"]],
        kb.model.attributes["light"] >= 0.3,
    ),
    "change a threshold": lambda kb: kb.model.change(
        kb.model.constraints[0], value=0.1, hysteresis=0.1
    ),
    "change an attribute": lambda kb: kb.model.change(
        kb.model.attributes["energy"], max_age=1.0, agreement=(1, 1)
    ),
    "remove": lambda kb: kb.model.remove(kb.model.actions["explore"]),
    "remove a design": lambda kb: kb.model.remove(kb.model.designs["by camera"]),
}
AMENDING = (
    "declare",
    "constrain",
    "change a threshold",
    "change an attribute",
    "remove",
    "remove a design",
)
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
    return (
        found,
        kb.model.constraints and [str(one) for one in kb.model.constraints],
        list(kb.model.actions),
    )


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
            assert kb.heard == list(range(first + 1, kb.log.last + 1)), (
                f"{name}, heard after {step}"
            )
    return outs, ins


def hash_of(name):
    return sum(map(ord, name))


@pytest.mark.parametrize("name", CALLS)
def test_interrupted_anywhere_it_is_as_if_told_or_not(name):
    outs, ins = tried(name, STRIDE)
    assert outs or name == TIME
    assert outs + ins > 2


def test_what_one_event_changes_twice_is_undone_to_what_it_was_at_first():
    state = State(Network(robot()))
    state.kept = []
    for count in (1, 2):
        state.put(state.served, 0, count)
    state.undo()
    assert state.served[0] == 0


@pytest.mark.parametrize(
    "name", [name for name in CALLS if name != "remove"]
)  # `explore` is cancelled before
def test_what_handles_a_signal_sees_what_was_before_or_after_or_is_refused_and_the_call_goes_on(
    name,
):
    call, twin = CALLS[name], Base()
    before = answers(twin)
    call(twin)
    after, found, refused = known(twin), [], []
    later = live_on(twin)

    def ask(kb):
        try:
            found.append(answers(kb))
        except KnowledgeBaseError as error:
            refused.append(error)

    for step in range(1 + hash_of(name) % STRIDE, 1_000_000, STRIDE):
        kb = Base()
        if not interrupted_at(step, lambda kb=kb: call(kb), handler=lambda kb=kb: ask(kb)):
            break
        assert found[-1:] in ([], [before], [after[0][0]]), f"{name}, asked at instruction {step}"
        assert known(kb) == after, f"{name}, asked at instruction {step}"
        assert (live_on(kb), kb.heard) == (later, twin.heard), (
            f"{name}, later than asked at instruction {step}"
        )
    assert len(found + refused) > 2


@pytest.mark.parametrize("name", ["select", "request", "cancel", "attempt", "measure"])
@pytest.mark.parametrize("other", ["request", "cancel", "measure what changes nothing", TIME])
def test_what_handles_a_signal_never_comes_between_the_checks_of_an_event_and_the_event(
    name, other
):
    results = set()

    def handle():
        try:
            CALLS[other](kb)
            results.add("told")
        except KnowledgeBaseError:
            results.add("refused")

    for step in range(1 + hash_of(name) % STRIDE, 1_000_000, STRIDE):
        kb = Base()
        try:
            if not interrupted_at(step, lambda kb=kb: CALLS[name](kb), handler=handle):
                break
        except InvalidValue:
            assert (name, other) == (
                "select",
                TIME,
            )  # what is selected is unfeasible after that time
        events = list(kb.log)
        assert [one.number for one in events] == list(range(1, kb.log.last + 1)), step
        assert [one.time for one in events] == sorted(one.time for one in events), step
        assert len(kb.required_actions) == sum(one.end is None for one in kb.history.actions), step
    assert "told" in results


@pytest.mark.parametrize("name", ["measure", "select", "cancel", "declare"])
def test_what_handles_a_signal_tells_nothing_in_the_midst_of_an_event(name):
    twin, refused = Base(), []
    CALLS[name](twin)

    def tell():
        if kb._knowledge.pending is not None:
            with pytest.raises(KnowledgeBaseError) as error:
                kb.measure("load", 0.3)
            refused.append(error)

    for step in range(1, 1_000_000, STRIDE // 3):
        kb = Base()
        if not interrupted_at(step, lambda kb=kb: CALLS[name](kb), handler=tell):
            break
        assert (known(kb), kb.heard) == (known(twin), twin.heard)
    assert refused


def test_changes_come_in_the_same_order_after_an_event_that_was_undone():
    def required():
        model = Model("two")
        see = model.function("see")
        see.design("by eye", [model.component("eye")])
        for name in ("look", "watch"):
            model.action(name, requires=[see])
        kb = KnowledgeBase(model, clock=Clock(1.0))
        for name in model.actions:
            kb.request_action(name)
        kb.select({"see": "by eye"})
        return kb

    twin, outs = required(), 0
    twin.component_active("eye", True)
    while True:
        kb = required()
        last = kb.log.last
        if not interrupted_at(outs + 1, lambda kb=kb: kb.cancel_action("look")):
            break
        if len(kb.required_actions) < 2:
            break
        outs += 1
        kb.component_active("eye", True)
        assert (kb.log.last, [*kb.log][-1].changes) == (last + 1, [*twin.log][-1].changes)
    assert outs > 20


def test_elements_that_are_being_declared_are_seen_as_a_whole():
    names = set()
    for step in range(1, 1_000_000, STRIDE):
        kb = Base()
        if not interrupted_at(step, lambda kb=kb: CALLS["declare"](kb)):
            break
        if "look" in kb.actions:
            view = kb.actions["look"]
            names.add((view.name, view.functions, len(view.constraints)))
    assert names == {("look", ("see",), 2)}


def test_interrupted_at_any_instruction_each_element_that_is_declared_has_an_index_of_its_own():
    step, outs = 0, 0
    while True:
        step, model = step + 1, Model("rover")
        network = Network(model)
        model.function("see")
        model.action("look", requires=["see"])
        if not interrupted_at(step, network.renew, harsher=True):
            break
        outs += 1
        network.renew()
        assert all(network.nodes[node.index] is node for node in network.present())
    assert outs > 50


def test_base_of_a_model_whose_change_was_interrupted_knows_all_of_it():
    step, found = 0, set()
    while True:
        step, model = step + 1, robot()
        walk = [model.attributes["light"] >= 0.5, model.attributes["load"] <= 1.0]
        if not interrupted_at(
            step, lambda model=model, walk=walk: model.action("walk", constraints=walk)
        ):
            break
        kb = KnowledgeBase(model, clock=Clock(1.0))
        assert list(kb.actions) == list(model.actions)
        found |= {len(one.constraints) for one in kb.actions.values() if one.name == "walk"}
    assert found == {2}


def test_event_that_comes_and_is_undone_while_it_is_asked_without_a_lock_is_never_seen():
    kb = Base()
    known, state = kb._knowledge, kb._knowledge.state
    failed = known.network.components["camera"], known.network.components["lidar"]
    asked = KnowledgeBase.is_feasible.__code__
    count = 0

    def trace(frame, event, _):
        nonlocal count
        if frame.f_code is not asked:
            return None
        frame.f_trace_opcodes = True
        count += event == "opcode"
        if event == "opcode" and count == begin:
            known._open()
            for node in failed:
                state.put(state.failed, node.index, True)
            propagate(state, failed)
            assert state.status[known.network.actions["explore"].index] is Status.UNFEASIBLE
        elif event == "opcode" and count == end:
            known.finish()
        return trace

    kb.retract_status("lidar")
    kb.clock.now = 4.0
    kb.model.change("light", max_age=math.inf)
    assert known.measurements.alarms.due(50.0) is None
    assert known.measurements.alarms.next == math.inf  # else it is asked with the lock
    for begin in range(1, 80):
        for end in range(begin + 1, 80):
            count = 0
            sys.settrace(trace)
            answer = kb.is_feasible("explore")
            sys.settrace(None)
            known.finish()
            assert answer, (begin, end)
    assert count > 50


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

    kb._knowledge.clock = raising
    for call in [call for name, call in CALLS.items() if name != TIME]:
        with pytest.raises(error):
            call(kb)
    kb._knowledge.clock = clock
    assert known(kb) == before
    assert is_free(kb)
