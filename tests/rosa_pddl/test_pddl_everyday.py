"""Faults of everyday use: derived atoms in a tick, goals that are left out, promises that hold."""

import pytest
from pddl_world import World
from py_trees.behaviours import TickCounter
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_pddl import (
    PlanExecutor,
    Planner,
    PlannerSettingError,
    Problem,
    ReplanningPolicy,
    SensingError,
    UnsupportedPddlError,
    initial_state,
    load_domain,
    parse_domain,
)
from rosa_pddl.belief import ExpectedEffects

NODES = 24
GRID = """(define (domain grid) (:requirements :adl :typing :derived-predicates)
  (:types node switch)
  (:predicates (via ?a ?b - node ?s - switch) (closed ?s - switch) (source ?a - node)
               (fed ?a - node))
  (:derived (fed ?x - node) (or (source ?x) (exists (?y - node ?s - switch)
    (and (fed ?y) (via ?y ?x ?s) (closed ?s)))))
  (:action close :parameters (?s - switch) :precondition (not (closed ?s)) :effect (closed ?s)))"""
TAGS = """(define (domain tags) (:types tag) (:predicates (seen ?t - tag))
  (:action look :parameters (?t - tag) :precondition () :effect (seen ?t)))"""
THREE = """(define (problem p) (:domain tags) (:objects t1 t2 t3 - tag) (:init)
  (:goal (and (seen t1) (seen t2) (seen t3))))"""


def grid():
    nodes = " ".join(f"n{number}" for number in range(NODES))
    switches = " ".join(f"s{number}" for number in range(NODES - 1))
    ways = [f"(via n{n} n{n + 1} s{n})" for n in range(NODES - 1)]
    ways += [f"(closed s{n})" for n in range(NODES - 1) if n % 8 != 3]
    return parse_domain(
        GRID,
        f"""(define (problem p) (:domain grid) (:objects {nodes} - node {switches} - switch)
          (:init (source n0) {" ".join(ways)}) (:goal (fed n{NODES - 1})))""",
    )


class Look(TickCounter):
    """Looks for two ticks; whether it succeeds is said."""

    def __init__(self, step, fails):
        failed = step.arguments[0] in fails
        status = Status.FAILURE if failed else Status.SUCCESS
        super().__init__(str(step), duration=2, completion_status=status)


def executed(fails=(), sense=dict, change=None, policy=None):
    now = [0.0]
    executor = PlanExecutor(
        "tags",
        kb=KnowledgeBase(Model("m"), clock=lambda: now[0]),
        domain=parse_domain(TAGS, THREE),
        behaviours={"look": lambda step: Look(step, fails)},
        sense=sense,
        clock=lambda: now[0],
        policy=policy,
    )
    for number in range(600):
        if number == 1 and change is not None:
            change(executor)
        executor.catch_up()
        executor.tick_once()
        now[0] += 0.1
        if executor.status is not Status.RUNNING:
            break
    return executor


@pytest.mark.parametrize("how", [{"fails": {"t1"}}, {"sense": lambda: {"(seen t1)": False}}])
def test_executor_does_the_others_when_one_goal_is_hopeless(how):
    executor = executed(**how)
    assert executor.status is Status.FAILURE
    assert executor.holds("(and (seen t2) (seen t3))")
    assert "out of reach: (seen t1)" in executor.feedback_message


def test_executor_drops_the_goal_of_an_object_that_is_gone():
    executor = executed(change=lambda executor: executor.remove_object("t3"))
    assert executor.status is Status.SUCCESS
    assert [goal.text for goal in executor.goals] == ["(seen t1)", "(seen t2)"]
    assert executor.feedback_message == "the goal holds; gone with their objects: (seen t3)"


def test_the_outcome_names_the_goals_that_are_gone_also_without_a_plan():
    executor = executed(
        change=lambda executor: executor.remove_object("t3"), fails={"t1"}, policy=None
    )
    assert executor.status is Status.FAILURE
    assert "gone with their objects: (seen t3)" in executor.feedback_message


def test_executor_stops_a_step_that_takes_far_too_long():
    domain = parse_domain(
        TAGS.replace(":action look", ":durative-action look").replace(
            ":precondition () :effect (seen ?t)",
            ":duration (= ?duration 0.1) :condition () :effect (at end (seen ?t))",
        ),
        THREE,
    )
    world = World(domain, policy=ReplanningPolicy(overrun=1.5, retries=0))
    world.ticks = {"look": 50}
    assert world.run() is Status.FAILURE
    assert "takes longer than 0.15 s" in world.executor.plans[1].reason


def test_executor_without_a_function_that_senses_says_what_is_expected():
    with pytest.raises(SensingError, match="expected a function"):
        executed(sense={})
    with pytest.raises(PlannerSettingError, match="overrun"):
        ReplanningPolicy(overrun=0.5)


def test_executor_refuses_what_can_only_be_planned():
    text = TAGS.replace(
        "(:action", "(:event e :parameters () :precondition () :effect ()) (:action"
    )
    with pytest.raises(UnsupportedPddlError, match="not executed: events"):
        World(parse_domain(text, THREE))


# ---------------------------------------------------------------- promises

CURE = """(define (domain cure) (:types action)
  (:predicates (action_feasible ?a - action) (spray_action ?a - action) (refill_action ?a - action)
               (sprayed))
  (:action spray :parameters (?a - action)
    :precondition (and (spray_action ?a) (action_feasible ?a)) :effect (sprayed))
  (:action refill :parameters (?a ?b - action)
    :precondition (and (refill_action ?a) (action_feasible ?a) (spray_action ?b))
    :effect (action_feasible ?b)))"""
FIELD = """(define (problem p) (:domain cure) (:objects spray refill - action)
  (:init (spray_action spray) (refill_action refill)) (:goal (sprayed)))"""


def field(*, restores):
    model = Model("field")
    tank = model.quality_attribute("tank", low=0.0, high=1.0)
    boom = model.component("boom")
    spraying = model.function("spraying")
    spraying.design("by boom", [boom], priority=1)
    model.action("spray", requires=[spraying]).constrain(tank >= 0.1)
    model.action("refill", restores=[tank] if restores else [])
    return KnowledgeBase(model, clock=lambda: 0.0)


def planned(kb):
    domain = parse_domain(CURE, FIELD)
    state = initial_state(domain)
    state |= {atom for atom, action in domain.feasibility.items() if kb.is_feasible(action)}
    effects = ExpectedEffects(domain, kb)
    result = Planner().plan(Problem(effects.domain, state))
    return result, effects.assumptions(result.steps, state)


def test_promise_holds_for_what_the_action_restores():
    kb = field(restores=True)
    kb.measure("tank", 0.0)
    result, assumed = planned(kb)
    assert [step.schema for step in result.steps] == ["refill", "spray"]
    assert assumed == ()


def test_promise_does_not_hold_for_a_cause_that_the_action_does_not_restore():
    kb = field(restores=True)
    kb.component_failed("boom")
    assert planned(kb)[0].outcome.is_unsolvable


def test_promise_of_which_the_model_says_nothing_is_an_assumption():
    kb = field(restores=False)
    kb.component_failed("boom")
    result, assumed = planned(kb)
    assert result.outcome.is_solved
    assert assumed[0].startswith("assumes that refill cures: spray is unfeasible because")
    assert "boom has failed" in assumed[0]


# ---------------------------------------------------------------- reading


def test_reader_takes_problems_of_unified_planning():
    up = pytest.importorskip("unified_planning.shortcuts")
    done = up.Fluent("done")
    act = up.InstantaneousAction("act")
    act.add_effect(done, True)
    problem = up.Problem("p")
    problem.add_fluent(done, default_initial_value=False)
    problem.add_action(act)
    problem.add_goal(done)
    domain = load_domain(problem)
    result = Planner().plan(Problem(domain, initial_state(domain)))
    assert [step.schema for step in result.steps] == ["act"]


def test_reader_takes_a_domain_without_a_problem(tmp_path):
    (tmp_path / "domain.pddl").write_text(TAGS)
    world = World(load_domain(tmp_path / "domain.pddl"))
    world.executor.add_object("t9", "tag")
    world.executor.goals.add("(seen t9)")
    assert world.run() is Status.SUCCESS


@pytest.mark.parametrize(
    ("metric", "expected"),
    [
        ("(traveled rover)", ["drive"]),
        ("(+ (total-time) 5)", ["fly"]),
        ("(+ (* 9 (traveled rover)) (total-time) 1)", ["drive"]),
    ],
)
def test_metric_may_have_arguments_times_and_constants(metric, expected):
    domain = parse_domain(
        """(define (domain d) (:requirements :durative-actions :numeric-fluents) (:types robot)
          (:predicates (there)) (:functions (traveled ?r - robot))
          (:durative-action drive :parameters (?r - robot) :duration (= ?duration 9) :condition ()
            :effect (and (at end (there)) (at end (increase (traveled ?r) 1))))
          (:durative-action fly :parameters (?r - robot) :duration (= ?duration 2) :condition ()
            :effect (and (at end (there)) (at end (increase (traveled ?r) 4)))))""",
        f"""(define (problem p) (:domain d) (:objects rover - robot) (:init (= (traveled rover) 0))
          (:goal (there)) (:metric minimize {metric}))""",
    )
    result = Planner().plan(Problem(domain, initial_state(domain)))
    assert [step.schema for step in result.steps] == expected
