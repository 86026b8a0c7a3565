"""Monitors on other threads may tell while a tree asks: no fact is lost, and no answer is torn."""

import contextlib
import sys
import threading
from contextlib import contextmanager, suppress
from functools import partial

import pytest
from interrupting import interrupted_at, is_free
from models import Clock

from kb import EventKind, InvalidValue, KnowledgeBase, Model, PriorityPlanner, Status, UnknownName
from kb.elements import ByName


@contextmanager
def frequent_switches():
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)


def run_together(*jobs):
    """Run each job on a thread of its own, all at once; raise what the first of them raised."""
    troubles, together = [], threading.Barrier(len(jobs))

    def run(job):
        try:
            together.wait()
            job()
        except BaseException as error:
            troubles.append(error)

    threads = [threading.Thread(target=run, args=(job,)) for job in jobs]
    with frequent_switches():
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    if troubles:
        raise troubles[0]


@pytest.fixture
def kb():
    """Two ways to see, by two attributes; an action that needs one of them, and one that needs the first."""
    model = Model("twofold")
    see = model.function("see", always_improve=True)
    for number in (1, 2):
        light = model.environmental_attribute(f"light {number}")
        eye = model.component(f"eye {number}", constraints=[light >= 0.5])
        eye.configuration(f"open {number}", constraints=[light <= 9.0])
        see.design(f"by eye {number}", [eye], priority=number)
    model.action("look", requires=[see])
    return KnowledgeBase(model, clock=Clock(1.0))


def test_an_action_that_is_always_possible_is_never_answered_to_be_impossible(kb):
    done = threading.Event()

    def monitor():
        for turn in range(400):
            good, bad = (1, 2) if turn % 2 else (2, 1)
            kb.measure(f"light {good}", 1.0)  # one eye sees before the other is blinded
            kb.measure(f"light {bad}", 0.0)
        done.set()

    def tree():
        situation, is_last = kb.situation(requested=["look"]), False
        while not is_last:
            is_last = done.is_set()
            assert kb.is_feasible("look")
            assert kb.actions["look"].status is not Status.UNFEASIBLE
            assert kb.selectable_actions() == ("look",)
            assert situation.is_feasible("look")
            assert kb.situation({"light 1": 1.0}).best_configuration("look").designs == {
                "see": "by eye 1"
            }
            assert kb.best_configuration("look").designs["see"] in ("by eye 1", "by eye 2")

    run_together(monitor, tree)


def test_facts_told_by_many_threads_are_all_kept_and_the_answers_are_those_of_the_last(kb):
    events = []
    kb.subscribe(events.append)

    def monitor(number):
        for turn in range(300):
            kb.measure(f"light {number}", turn / 300)
            kb.component_failed(f"eye {number}")
            kb.component_recovered(f"eye {number}")

    def manager():
        planner = PriorityPlanner()
        for _ in range(200):
            plan = None
            with contextlib.suppress(
                InvalidValue
            ):  # what was chosen became unfeasible before it was selected
                plan = planner.plan(kb)
            if plan:
                kb.finish_plan(plan, "completed")

    def mission():
        for _ in range(200):
            if kb.request_action("look"):
                kb.cancel_action("look", "completed")

    run_together(lambda: monitor(1), lambda: monitor(2), manager, mission)
    for number in (1, 2):
        history = kb.attributes[f"light {number}"].history
        assert [value for _, value in history] == [turn / 300 for turn in range(300)]
        assert kb.components[f"eye {number}"].status is not Status.FAILURE
    monitored = [event for event in events if event.kind is EventKind.MONITORING_DATA]
    assert sum("selected" not in event.text for event in monitored) == 2 * 3 * 300
    assert sum(event.kind is EventKind.ACTION_UPDATE for event in events) == 2 * len(
        kb.history.actions
    )
    assert kb.is_feasible("look")


def test_the_log_can_be_gone_through_while_others_tell(kb):
    def look():
        while kb.log.last < 2000:
            numbers = [event.number for event in kb.log.since(1)]
            assert numbers == list(range(2, len(numbers) + 2))

    run_together(look, *(lambda: [kb.measure("light 1", float(one)) for one in range(1000)],) * 2)
    assert len(kb.log) == 2000


def test_a_model_may_grow_on_one_thread_while_others_tell_and_ask(kb):
    model = kb.model

    def author():
        for turn in range(150):
            model.action(
                f"walk {turn}", requires=["see"], constraints=[model.attributes["light 1"] <= 2.0]
            )
            extra = model.functions["see"].design(f"extra {turn}", ["eye 1"], priority=3)
            if turn % 2:
                model.remove(extra)

    def monitor():
        for turn in range(300):
            kb.measure("light 1", float(turn % 2))

    def tree():
        for _ in range(150):
            assert "look" in kb.selectable_actions()
            assert all(
                kb.is_feasible(name) for name in kb.situation({"light 1": 1.0}).selectable_actions()
            )

    kb.measure("light 2", 1.0)
    run_together(author, monitor, tree)
    assert len(kb.actions) == 151
    assert len(kb.functions["see"].designs) == 2 + 75
    assert len(kb.selectable_actions()) == 151


def test_an_action_that_is_never_possible_is_never_answered_to_be_possible_while_it_comes_and_goes():
    model = Model("growing")
    model.function("never")  # without a design
    kb = KnowledgeBase(model, clock=Clock(1.0))
    done = threading.Event()

    def author():
        for _ in range(400):
            model.action("try", requires=["never"])
            assert len(list(kb.actions.values())) == 1
            model.remove(model.actions["try"])
        done.set()

    def tree():
        while not done.is_set():
            with suppress(UnknownName):  # it is not there at the moment
                assert not kb.is_feasible("try")
            assert kb.selectable_actions() == ()
            assert all(view.status is Status.UNFEASIBLE for view in kb.actions.values())
            assert sorted(kb.actions) in ([], ["try"])

    run_together(author, tree, tree)


def test_a_name_is_said_to_be_unknown_though_the_model_grows_meanwhile():
    class Growing(str):
        def __str__(self):
            table["another"] = 2  # as another thread may
            return "first"

    table = ByName("action", {Growing("first"): 1})
    with pytest.raises(UnknownName, match="known: 'first'"):
        table["nothing like it"]


def test_what_became_due_while_the_clock_was_read_is_told_before_the_fact():
    model, clock = Model("old"), Clock(1.0)
    light = model.environmental_attribute("light", max_age=100.0)
    model.component("eye")
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("light", 0.2)

    def read_slowly():
        kb._clock, clock.now = clock, 9.0
        kb.component_failed("eye")
        model.change(light, max_age=3.0)
        return 2.0

    kb._clock = read_slowly
    kb.component_recovered("eye")
    assert [one.verb for one in kb.log] == [
        "measure",
        "component_failed",
        "amend",
        "stale",
        "component_recovered",
    ]


def test_an_attribute_that_is_removed_while_the_clock_is_read_is_not_measured(kb):
    wind, clock = kb.model.quality_attribute("wind"), kb._clock

    def read_slowly():
        kb._clock = clock
        kb.model.remove(wind)
        return clock()

    kb._clock = read_slowly
    with pytest.raises(UnknownName, match="wind"):
        kb.measure("wind", 1.0)
    assert [one.verb for one in kb.log] == ["amend", "amend"], (
        "a measurement of nothing could not be told again"
    )


def test_what_another_thread_tells_while_the_model_changes_is_so_by_the_model_before_or_after():
    def made():
        model = Model("rover")
        model.action("look", constraints=[model.environmental_attribute("light") >= 0.5])
        return KnowledgeBase(model, clock=Clock(1.0))

    step, orders = 0, set()
    while True:
        step, kb = step + 7, made()
        change = partial(kb.model.change, kb.model.constraints[0], value=0.1)
        teller = threading.Thread(target=kb.measure, args=("light", 0.2))

        def tell(teller=teller):
            teller.start()
            teller.join(0.01)  # it may have to wait until the model has changed

        if not interrupted_at(step, change, handler=tell):
            break
        teller.join()
        twin = made()
        for event in kb.log:
            twin.replay(event)
        assert [*twin.log] == [*kb.log]
        orders.add(tuple(one.verb for one in kb.log))
    assert orders == {("measure", "amend"), ("amend", "measure")}


def test_a_clock_is_read_without_the_lock_when_a_situation_is_made():
    model, free, here = Model("old"), [], threading.current_thread()
    model.environmental_attribute("light", max_age=3.0)
    kb = KnowledgeBase(model, clock=Clock(1.0))
    kb.measure("light", 0.2)

    def read():
        if threading.current_thread() is here:
            free.append(is_free(kb, 1.0))
        return 1.0

    kb._clock = read
    kb.situation(light=0.3).situation(at=2.0)
    assert free
    assert all(free)


def test_what_another_thread_tells_while_the_clock_is_read_does_not_make_it_go_back(kb):
    clock, teller = kb._clock, threading.Thread(target=kb.measure, args=("light 1", 1.0))

    def read_slowly():
        shown = clock()
        if threading.current_thread() is not teller:
            clock.now = 6.0
            teller.start()
            teller.join()
        return shown

    kb._clock = read_slowly
    kb.measure("light 2", 1.0)
    assert [event.time for event in kb.log] == [6.0, 6.0]


def test_a_measurement_grows_old_for_all_threads_at_once():
    model, clock = Model("old"), Clock(0.0)
    gas = model.environmental_attribute("gas", max_age=1.0, when_stale="violated")
    model.action("enter", constraints=[gas <= 0.1])
    kb = KnowledgeBase(model, clock=clock)
    heard = []
    kb.subscribe(heard.append)
    rounds = 50

    def ask():
        for _ in range(rounds * 10):
            assert kb.actions["enter"].constraints[0].status is not Status.NOT_EVALUATED

    def age():
        for _ in range(rounds):
            kb.measure("gas", 0.0)
            clock.now += 2.0
            assert not kb.is_feasible("enter")

    kb.measure("gas", 0.0)
    run_together(age, ask, ask)
    stale = [event for event in heard if "stale" in event.text]
    assert len(stale) == rounds
