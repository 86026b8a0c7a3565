"""Monitors on other threads may tell while a tree asks: no fact is lost, and no answer is torn."""

import contextlib
import sys
import threading
from contextlib import contextmanager

import pytest
from models import Clock

from kb import EventKind, InvalidValue, KnowledgeBase, Model, PriorityPlanner, Status


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
    troubles = []
    together = threading.Barrier(len(jobs))

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
    """Two ways to see, by two attributes.

    An action that needs one of them, and one that needs the first.
    """
    model = Model("twofold")
    see = model.function("see", always_improve=True)
    for number in (1, 2):
        light = model.environmental_attribute(f"light {number}")
        eye = model.component(f"eye {number}", constraints=[light >= 0.5])
        eye.configuration(f"open {number}", constraints=[light <= 9.0])
        see.design(f"by eye {number}", [eye], priority=number)
    model.action("look", requires=[see])
    return KnowledgeBase(model, clock=Clock(1.0))


def test_always_feasible_action_never_looks_unfeasible(kb):
    done = threading.Event()

    def monitor():
        for turn in range(400):
            good, bad = (1, 2) if turn % 2 else (2, 1)
            kb.measure(f"light {good}", 1.0)  # one eye sees before the other is blinded
            kb.measure(f"light {bad}", 0.0)
        done.set()

    def tree():
        situation = kb.situation(requested=["look"])
        is_last = False
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


def test_facts_of_many_threads_are_all_recorded(kb):
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


def test_model_may_grow_while_other_threads_record(kb):
    model = kb.model

    def author():
        for turn in range(150):
            model.action(
                f"walk {turn}", requires=["see"], constraints=[model.attributes["light 1"] <= 2.0]
            )
            model.functions["see"].design(f"extra {turn}", ["eye 1"], priority=3)

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
    assert len(kb.functions["see"].designs) == 2 + 150
    assert len(kb.selectable_actions()) == 151
