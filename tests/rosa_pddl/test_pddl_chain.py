"""What is tried when planning fails, in what order, for how long, and what is told of it."""

import sys
import threading
from concurrent.futures import Future
from pathlib import Path

import pytest
from pddl_world import MISSIONS, load_text

from rosa_pddl import (
    Attempt,
    Outcome,
    Planner,
    PlannerSettingError,
    PlanningBudgetError,
    PlanningResult,
    Problem,
    UnknownNameError,
    awaited,
    feasible_atoms,
    flaw,
    initial_state,
    load_domain,
    schedule_flaw,
)
from rosa_pddl.engines import fast_downward_program

NAUGHTY = """
import os, subprocess, sys, time
import unified_planning as up
from unified_planning.engines import Engine
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.engines.results import PlanGenerationResult, PlanGenerationResultStatus as Status
from unified_planning.engines.plan_validator import SequentialPlanValidator
from unified_planning.plans import SequentialPlan


class Naughty(Engine, OneshotPlannerMixin):
    def __init__(self, **options):
        Engine.__init__(self)
        OneshotPlannerMixin.__init__(self)

    name = "naughty"

    @staticmethod
    def supported_kind():
        return SequentialPlanValidator.supported_kind()

    @staticmethod
    def supports(kind):
        return True

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        print("here I am")
        self.act()
        return PlanGenerationResult(self.status, self.plan(problem), "naughty")

    status = Status.SOLVED_SATISFICING

    def plan(self, problem):
        return SequentialPlan([], problem.environment)

    def act(self):
        pass


class Hangs(Naughty):
    def act(self):
        child = subprocess.Popen(["sleep", "1000"])
        with open(os.environ["CHILD"], "w") as file:
            file.write(str(child.pid))
        while True:
            time.sleep(1)


class Lies(Naughty):
    pass


class Boasts(Naughty):
    def plan(self, problem):
        return None


class Raises(Naughty):
    def act(self):
        raise ZeroDivisionError("oh dear")


class Dies(Naughty):
    def act(self):
        os.kill(os.getpid(), 9)


class Quits(Naughty):
    def act(self):
        sys.exit("enough")


class Swells(Naughty):
    def act(self):
        self.fat = [bytes(1 << 28) for _ in range(12_000)]


class GivesUp(Naughty):
    status = Status.UNSOLVABLE_INCOMPLETELY

    def plan(self, problem):
        return None
"""


@pytest.fixture
def naughty(tmp_path, monkeypatch):
    """The extended mission with engines that misbehave."""
    (tmp_path / "naughty.py").write_text(NAUGHTY)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("CHILD", str(tmp_path / "child"))
    monkeypatch.delitem(sys.modules, "naughty", raising=False)
    domain = load_domain(
        MISSIONS / "suave_extended" / "domain.pddl", MISSIONS / "suave_extended" / "problem.pddl"
    )
    factory = domain.up_problem.environment.factory
    for name in ("Hangs", "Lies", "Boasts", "Raises", "Dies", "Quits", "Swells", "GivesUp"):
        factory.add_engine(name.lower(), "naughty", name)
    return domain


class All:
    """A knowledge base to which everything is feasible."""

    def __init__(self, domain):
        self.actions = dict.fromkeys(domain.rosa_actions)

    def is_feasible(self, action):
        return True


def feasible(domain):
    return Problem(domain, initial_state(domain) | feasible_atoms(domain, All(domain)))


def told(result):
    return [(attempt.way, attempt.outcome) for attempt in result.attempts]


@pytest.mark.parametrize(
    ("engine", "outcome", "words"),
    [
        (
            "lies",
            Outcome.ENGINE_CRASHED,
            "does not work: the rest of the plan does not reach the goal",
        ),
        ("boasts", Outcome.ENGINE_CRASHED, "returned a plan that does not work"),
        ("raises", Outcome.ENGINE_CRASHED, "ZeroDivisionError: oh dear"),
        ("dies", Outcome.ENGINE_CRASHED, "here I am"),
        ("quits", Outcome.ENGINE_CRASHED, "enough"),
        ("swells", Outcome.OUT_OF_MEMORY, "out of memory"),
        ("givesup", Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN, "as far as known"),
    ],
)
def test_whatever_an_engine_does_has_a_name(naughty, engine, outcome, words):
    result = Planner(engine, timeout_s=300.0, memory_mb=2048).plan(feasible(naughty))
    assert (result.outcome, result.steps) == (outcome, ())
    assert words in result.message


def test_an_engine_that_hangs_is_killed_with_its_children(naughty, tmp_path):
    note = tmp_path / "child"
    note.touch()
    # on a busy machine the engine may not have come to start its child in a short time
    for timeout_s in (2.0, 6.0, 20.0, 64.0):
        result = Planner("hangs", timeout_s=timeout_s).plan(feasible(naughty))
        assert result.outcome is Outcome.OUT_OF_TIME
        assert f"{timeout_s:g} s" in result.message
        if note.read_text():
            break
    child = int(note.read_text())
    for _ in range(12_000):
        try:
            if "State:\tZ" in Path(f"/proc/{child}/status").read_text():
                break
        except FileNotFoundError:
            break
        threading.Event().wait(0.01)
    else:
        raise AssertionError("the child lives on")


@pytest.fixture
def broken_search(monkeypatch, tmp_path):
    file = tmp_path / "search"
    file.write_text("#!/bin/sh\necho oh dear; exit 1\n")
    file.chmod(0o755)
    monkeypatch.setattr("rosa_pddl.engines.fast_downward_program", lambda: file)


def test_another_engine_plans_when_fast_downward_fails(extended, broken_search):
    # aries now and then recharges on the way, as it does not look for the shortest plan: here it cannot
    state = feasible(extended).state - {extended.feasible_atom("recharge")}
    result = Planner(moves=0, timeout_s=300.0, fallback=("aries",)).plan(Problem(extended, state))
    crashed = Outcome.ENGINE_CRASHED
    assert told(result) == [("warm", crashed), ("cold", crashed), ("aries", Outcome.SOLVED)]
    assert result.engine == "aries"
    assert [step.schema for step in result.steps] == ["search_pipeline", "inspect_pipeline"]
    assert all("oh dear" in attempt.message for attempt in result.attempts[:2])


def test_a_fallback_that_is_not_installed_is_passed_over_and_told(naughty, broken_search):
    result = Planner(moves=0, fallback=("tamer", "givesup"), timeout_s=300.0).plan(
        feasible(naughty)
    )
    assert told(result)[2:] == [
        ("tamer", Outcome.ENGINE_MISSING),
        ("givesup", Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN),
    ]
    assert result.outcome is Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN


def test_no_other_engine_is_asked_once_there_is_an_answer(naughty):
    planner = Planner(fallback=("raises",))
    assert told(planner.plan(feasible(naughty))) == [("warm", Outcome.SOLVED_OPTIMALLY)]
    assert told(planner.plan(Problem(naughty, initial_state(naughty)))) == [
        ("warm", Outcome.UNSOLVABLE_PROVEN)
    ]


def test_a_budget_leaves_time_for_what_comes_after(extended, monkeypatch, tmp_path):
    slow = tmp_path / "slow"
    slow.write_text("#!/bin/sh\nexec sleep 1000\n")
    slow.chmod(0o755)
    monkeypatch.setattr("rosa_pddl.engines.fast_downward_program", lambda: slow)
    planner = Planner(
        moves=0, timeout_s=300.0, fallback=("aries",), budgets_s={"warm": 0.3, "cold": 0.3}
    )
    result = planner.plan(feasible(extended))
    late = Outcome.OUT_OF_TIME
    assert told(result) == [("warm", late), ("cold", late), ("aries", Outcome.SOLVED)]
    assert result.hangs_on_the_clock


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"budgets_s": {"wram": 1.0}}, "nearest: warm"),
        ({"timeout_s": float("nan")}, "expected more than 0"),
        ({"overlapping": True}, "rosa-taca\\[temporal\\]"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, words):
    with pytest.raises(PlannerSettingError, match=words):
        Planner(**settings)


# ------------------------------------------------------------------ the safe step


def test_the_safe_step_is_there_when_a_plan_is_not(extended, broken_search):
    planner = Planner(
        moves=0, safe_step="(recharge recharge search_pipeline inspect_pipeline bluerov)"
    )
    result = planner.plan(feasible(extended))
    assert result.outcome is Outcome.ENGINE_CRASHED
    assert result.safe_step.schema == "recharge"


def test_there_is_no_safe_step_if_it_cannot_start_or_is_not_needed(extended):
    planner = Planner(safe_step="(recharge recharge search_pipeline inspect_pipeline bluerov)")
    unsolvable = planner.plan(Problem(extended, initial_state(extended)))
    assert (unsolvable.outcome, unsolvable.safe_step) == (Outcome.UNSOLVABLE_PROVEN, None)
    assert planner.plan(feasible(extended)).safe_step is None


@pytest.mark.parametrize("step", ["(recarge)", "(recharge)", "(recharge recharge a b bluerov)", ""])
def test_a_safe_step_that_is_none_of_the_domain_is_refused(extended, step):
    with pytest.raises(UnknownNameError, match=r"recharge|'a'"):
        Planner(safe_step=step).plan(feasible(extended))


# ------------------------------------------------------------------ lock-step


def test_in_lock_step_an_answer_is_waited_for(extended):
    result = awaited(Planner().start(feasible(extended)), 300.0)
    assert result.outcome is Outcome.SOLVED_OPTIMALLY


def test_in_lock_step_a_late_answer_ends_the_run(extended):
    future = Future()
    with pytest.raises(PlanningBudgetError, match=r"no plan after 0\.01 s"):
        awaited(future, 0.01)
    assert future.cancelled()


def test_in_lock_step_an_answer_that_hangs_on_the_clock_ends_the_run():
    future = Future()
    attempts = (
        Attempt("warm", Outcome.OUT_OF_TIME, "no answer after 1 s"),
        Attempt("cold", Outcome.SOLVED),
    )
    future.set_result(PlanningResult(Outcome.SOLVED, attempts=attempts))
    with pytest.raises(PlanningBudgetError, match=r"warm: out of time .no answer after 1 s"):
        awaited(future, 1.0)


# ------------------------------------------------------------------ the cache


def test_the_same_question_is_answered_at_once(extended, monkeypatch):
    planner = Planner(moves=0)
    first = planner.plan(feasible(extended))
    monkeypatch.setattr("rosa_pddl.engines.fast_downward_program", lambda: "/nowhere")
    again = planner.plan(feasible(extended))
    assert told(again) == [("cache", Outcome.SOLVED_OPTIMALLY)]
    assert (again.steps, again.cost) == (first.steps, first.cost)
    assert (
        planner.plan(Problem(extended, initial_state(extended))).outcome is Outcome.ENGINE_MISSING
    )


def test_trouble_is_not_remembered(extended, tmp_path, monkeypatch):
    planner, there = Planner(moves=0), fast_downward_program()
    with monkeypatch.context() as patched:
        patched.setattr("rosa_pddl.engines.fast_downward_program", lambda: "/nowhere")
        assert planner.plan(feasible(extended)).outcome is Outcome.ENGINE_MISSING
    assert fast_downward_program() == there
    assert planner.plan(feasible(extended)).outcome is Outcome.SOLVED_OPTIMALLY


@pytest.mark.parametrize(
    ("cached", "most_atoms", "held"),
    [(2, 1_000_000, [1, 2, 1, 2]), (0, 1_000_000, [0] * 4), (9, 15, [1, 2, 1, 2])],
)
def test_the_cache_holds_so_many_answers_and_fewer_of_large_states(
    extended, monkeypatch, cached, most_atoms, held
):
    monkeypatch.setattr("rosa_pddl.planner._MOST_ATOMS", most_atoms)
    planner, state = Planner(cached=cached), feasible(extended).state  # of 6 facts
    search = extended.step("search_pipeline", ["search_pipeline", "pipeline", "bluerov"])
    known = []
    for number in range(4):
        planner.plan(Problem(extended, state, weights={search: number + 2}))
        known.append(len(planner.cache))
    assert known == held


# ------------------------------------------------------------------ overlapping steps


ERRANDS = """(define (domain errands) (:requirements :durative-actions)
  (:types thing) (:predicates (done ?t - thing) (free ?t - thing) (lit) (used))
  (:durative-action burn :parameters () :duration (= ?duration 6)
    :condition (at start (not (used))) :effect (and (at start (lit)) (at start (used)) (at end (not (lit)))))
  (:durative-action do :parameters (?t - thing) :duration (= ?duration 4)
    :condition (and (over all (lit)) (at start (free ?t)))
    :effect (and (at start (not (free ?t))) (at end (free ?t)) (at end (done ?t)))))"""
ERRANDS_PROBLEM = """(define (problem p) (:domain errands) (:objects a b - thing)
  (:init (free a) (free b)) (:goal (and (done a) (done b))))"""


def test_a_temporal_engine_lets_steps_overlap(tmp_path):
    """One match burns too briefly for one errand after the other."""
    domain = load_text(tmp_path, ERRANDS, ERRANDS_PROBLEM)
    problem = Problem(domain, initial_state(domain))
    result = Planner("aries", overlapping=True, timeout_s=300.0).plan(problem)
    assert result.outcome.is_solved, result.message
    assert schedule_flaw(domain, result.schedule, problem.state) is None
    starts = {str(timed.step): timed for timed in result.schedule}
    assert set(starts) == {"burn()", "do(a)", "do(b)"}
    assert starts["do(a)"].start_s < starts["do(b)"].end_s
    assert starts["do(b)"].start_s < starts["do(a)"].end_s
    assert result.steps[0].schema == "burn"
    assert Planner().plan(problem).outcome is Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN


def test_judges_are_public(extended):
    result = Planner().plan(feasible(extended))
    assert flaw(extended, result.steps, feasible(extended).state) is None
