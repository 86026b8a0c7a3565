"""Looking for the best configuration in the background: no update waits, and every run is the same."""

from threading import Event

import pytest
from managed_stand_ins import Scripted
from models import Clock
from test_optimal_planner import intricate
from test_optimal_planner_reasons import model

from kb import ConfigurationManager, InvalidValue, KnowledgeBase
from kb.planners.optimal import BackgroundSolver, OptimalPlanner

__all__ = ["model"]


class Bench:
    """A robot, its manager, and what was planned when."""

    def __init__(self, model, delay, **settings):
        self.clock = Clock()
        self.kb = KnowledgeBase(model, clock=self.clock)
        self.planner = OptimalPlanner(delay=delay, **settings)
        self.manager = ConfigurationManager(self.kb, Scripted(self.clock), planner=self.planner)
        self.made = []

    def update(self, times=1):
        for _ in range(times):
            self.clock.now += 0.1
            self.planner.catch_up(self.kb)
            plan = self.manager.update()
            if plan:
                self.made.append((round(self.clock.now, 6), str(plan), plan.reason))


def test_answer_is_taken_when_it_is_due_and_is_the_one_that_would_have_been_given_at_once(model):
    made = []
    for delay in (None, 0.0, 0.3):
        bench = Bench(model, delay)
        bench.update()
        bench.kb.request_action("explore", "accuracy")
        bench.update(times=10)
        made.append(bench.made)
    (at_once,), (next_time,), (later,) = made
    assert at_once[1:] == next_time[1:] == later[1:]
    assert [at_once[0], next_time[0], later[0]] == [0.2, 0.3, 0.5]


def story(model):
    bench = Bench(model, 0.25, switching_cost=0.01)
    bench.kb.request_action("explore", "accuracy")
    for turn in range(40):
        if turn == 8:
            bench.kb.component_failed("lidar")
        if turn == 9:
            bench.kb.measure("accuracy", 0.3)
        if turn == 20:
            bench.kb.cancel_action("explore")
            bench.kb.request_action("explore", {"power": -1.0})
        bench.update()
    return bench.made


def test_same_story_has_the_same_trace_however_long_the_answers_take(model):
    first = story(model)
    assert [time for time, _, _ in first] == [0.4, 1.2, 2.4]
    assert story(model) == first


def test_question_is_asked_anew_when_it_is_another_by_now(model):
    bench = Bench(model, 0.5)
    bench.kb.request_action("explore", "accuracy")
    bench.update(times=3)
    bench.kb.component_failed("lidar")
    bench.update(times=12)
    assert [(time, plan) for time, plan, _ in bench.made] == [(0.9, "activate camera; configure fine")]


def test_nothing_is_asked_when_nothing_has_to_be_chosen_any_more(model):
    bench = Bench(model, 0.5)
    bench.kb.request_action("explore", "accuracy")
    bench.update(times=3)
    bench.kb.cancel_action("explore")
    bench.update(times=12)
    assert bench.made == []
    revision = bench.kb.revision
    bench.update(times=3)
    assert bench.kb.revision == revision


def test_choice_by_priority_waits_for_no_answer(model):
    bench = Bench(model, 0.5)
    bench.kb.request_action("explore")
    bench.update()
    assert [time for time, _, _ in bench.made] == [0.1]


def test_dry_run_is_answered_at_once_and_asks_nothing(model):
    bench = Bench(model, 0.3)
    bench.kb.request_action("explore", "accuracy")
    tried = bench.manager.dry_run()
    bench.update(times=10)
    assert [(time, plan) for time, plan, _ in bench.made] == [(0.4, str(tried))]


def test_update_does_not_wait_for_an_answer_that_is_late():
    problem = OptimalPlanner()._encoded(intricate())
    free, answers = Event(), []

    def solve(problem):
        assert free.wait(30.0)
        return answers[0]

    answers.append(OptimalPlanner()._solve(problem))
    background = BackgroundSolver(solve, 0.2)
    assert [background.answer(problem, time) for time in (0.0, 0.1, 0.2, 0.3)] == [None] * 4
    free.set()
    background.catch_up(0.3)
    assert background.answer(problem, 0.3) is answers[0]


def test_answer_that_is_not_due_is_not_waited_for():
    background, free = BackgroundSolver(lambda problem: free.wait(30.0), 0.2), Event()
    problem = OptimalPlanner()._encoded(intricate())
    assert background.answer(problem, 0.0) is None
    background.catch_up(0.1)
    free.set()


@pytest.mark.parametrize("delay", [-0.1, float("nan"), float("inf")])
def test_delay_that_is_no_time_is_refused(delay):
    with pytest.raises(InvalidValue):
        OptimalPlanner(delay=delay)
