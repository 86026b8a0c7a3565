"""Engines: Kairos in its worker, Fast Downward, and engines of unified-planning by their names."""

import os
import signal
import threading

import pytest

from rosa_pddl import Outcome, Planner, Problem, flaw, initial_state, parse_domain
from rosa_pddl.worker import up_problem_of

PUMP = """(define (domain d) (:predicates (full) (open)) (:functions (level))
  (:action pump :effect (increase (level) 1))
  (:action close :precondition (>= (level) 3) :effect (and (full) (assign (level) 0))))"""
TIMED = """(define (domain d) (:requirements :durative-actions) (:predicates (open) (in))
  (:durative-action enter :parameters () :duration (= ?duration 2)
    :condition (over all (open)) :effect (at end (in))))"""


def pump(goal="(full)"):
    problem = f"(define (problem p) (:domain d) (:init (= (level) 0)) (:goal {goal}))"
    return parse_domain(PUMP, problem)


def problem_of(domain):
    return Problem(domain, initial_state(domain))


@pytest.fixture
def kairos():
    planner = Planner("kairos", 60.0)
    yield planner
    planner.close()


def test_kairos_numbers_solves_with_the_least_cost(kairos):
    result = kairos.plan(problem_of(pump()))
    assert (result.outcome.is_solved, result.cost, result.engine) == (True, 4.0, "kairos")
    assert flaw(pump(), result.steps, initial_state(pump())) is None


def test_kairos_goal_out_of_reach_is_proven(kairos):
    assert kairos.plan(problem_of(pump("(open)"))).outcome is Outcome.UNSOLVABLE_PROVEN


def test_kairos_crash_is_an_outcome_and_starts_anew(kairos):
    problem = problem_of(pump())
    assert kairos.plan(problem).outcome.is_solved
    worker = kairos.process
    threading.Timer(0.0, os.killpg, (worker._process.pid, signal.SIGKILL)).start()
    worker._process.wait()
    assert kairos.plan(problem).outcome.is_solved


def test_kairos_killed_during_a_question_has_a_name(kairos):
    kairos.plan(problem_of(pump()))
    worker = kairos.process
    os.killpg(worker._process.pid, signal.SIGSTOP)
    future = kairos.start(problem_of(pump("(open)")))
    os.killpg(worker._process.pid, signal.SIGKILL)
    assert future.result(60.0).outcome in (Outcome.ENGINE_CRASHED, Outcome.UNSOLVABLE_PROVEN)
    assert kairos.plan(problem_of(pump())).outcome.is_solved


@pytest.mark.parametrize(("opens", "is_solved"), [("(at 5 (open))", True), ("", False)])
def test_kairos_plans_with_facts_that_change_by_themselves(kairos, opens, is_solved):
    text = f"(define (problem p) (:domain d) (:init {opens}) (:goal (in)))"
    domain = parse_domain(TIMED, text)
    result = kairos.plan(Problem(domain, initial_state(domain)))
    assert result.outcome.is_solved is is_solved


def test_planner_leaves_numbers_beyond_its_cap_to_kairos():
    planner = Planner(moves=1, timeout_s=60.0)
    result = planner.plan(problem_of(pump()))
    planner.close()
    assert result.engine == "kairos"
    assert result.outcome.is_solved


@pytest.mark.parametrize("engine", ["fast-downward-opt", "fast-downward"])
def test_fast_downward_plans_by_its_own_translator(extended, engine):
    facts = {"(action_feasible recharge)"}
    problem = Problem(extended, initial_state(extended) | facts)
    result = Planner(engine, 60.0, moves=0).plan(problem)
    assert [step.schema for step in result.steps][-2:] == ["search_pipeline", "inspect_pipeline"]
    assert result.engine == engine


@pytest.mark.parametrize("style", ["costs", "instant", "timed"])
def test_unified_planning_reads_what_is_written_for_engines(extended, style):
    text = Problem(extended, initial_state(extended)).write(style)
    assert len(up_problem_of(text.domain, text.problem).actions) == len(extended.schemas)
