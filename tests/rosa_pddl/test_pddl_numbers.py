"""Numbers that rise and fall: planned for exactly, kept in the state, sensed, and found again by brute force."""

from fractions import Fraction

import pytest
from brute_force import fewest_steps
from hypothesis import given, settings
from hypothesis import strategies as st
from pddl_world import World
from py_trees.common import Status

from rosa_pddl import Outcome, Planner, Problem, flaw, initial_state, parse_domain
from rosa_pddl.validate import ended

PLACES = ("dock", "w1", "w2", "w3", "w4")
FAR = {
    (a, b): 5 + 3 * abs(i - j) for i, a in enumerate(PLACES) for j, b in enumerate(PLACES) if a != b
}
CHARGING = """(define (domain charging) (:requirements :typing :fluents :durative-actions)
  (:types robot waypoint)
  (:predicates (robot_at ?r - robot ?w - waypoint) (charger_at ?w - waypoint) (connected ?a ?b - waypoint)
    (patrolled ?w - waypoint))
  (:functions (level ?r - robot) (distance ?a ?b - waypoint) (speed ?r - robot) (travelled))
  (:durative-action move :parameters (?r - robot ?a ?b - waypoint)
    :duration (= ?duration (/ (distance ?a ?b) (speed ?r)))
    :condition (and (at start (connected ?a ?b)) (at start (robot_at ?r ?a))
      (at start (>= (level ?r) (* 2 (distance ?a ?b)))))
    :effect (and (at start (not (robot_at ?r ?a))) (at end (robot_at ?r ?b)) (at end (increase (travelled) 1))
      (at end (decrease (level ?r) (* 2 (distance ?a ?b))))))
  (:durative-action patrol :parameters (?r - robot ?w - waypoint) :duration (= ?duration 5)
    :condition (and (at start (robot_at ?r ?w)) (over all (robot_at ?r ?w)) (over all (>= (level ?r) 10)))
    :effect (and (at end (patrolled ?w)) (at end (decrease (level ?r) 5))))
  (:durative-action charge :parameters (?r - robot ?w - waypoint) :duration (= ?duration 5)
    :condition (and (at start (robot_at ?r ?w)) (at start (charger_at ?w)) (at start (< (level ?r) 100)))
    :effect (at end (assign (level ?r) 100))))"""
ROUND = f"""(define (problem round) (:domain charging) (:objects leia - robot {" ".join(PLACES)} - waypoint)
  (:init (robot_at leia dock) (charger_at dock) (= (level leia) 60) (= (speed leia) 1) (= (travelled) 0)
    {" ".join(f"(connected {a} {b}) (= (distance {a} {b}) {far})" for (a, b), far in FAR.items())})
  (:goal (and (patrolled w1) (patrolled w3) (patrolled w4) (>= (level leia) 50))))"""


@pytest.fixture(scope="module")
def charging():
    return parse_domain(CHARGING, ROUND)


def test_a_battery_that_is_used_and_charged_is_planned_with_exactly(charging):
    assert charging.computed == {"level"}  # how far it has travelled is asked for nowhere
    assert charging.compared == {"distance"}
    state = initial_state(charging)
    assert "(= (level leia) 60)" in state
    result = Planner().plan(Problem(charging, state))
    assert (result.outcome, result.engine) == (Outcome.SOLVED_OPTIMALLY, "search")
    assert [step.schema for step in result.steps].count("charge") == 2
    assert flaw(charging, result.steps, state) is None
    assert "level leia" in flaw(
        charging, [step for step in result.steps if step.schema != "charge"], state
    )


def test_the_plan_runs_and_numbers_that_are_sensed_count(charging):
    world = World(charging)
    assert world.run(until="patrol") is Status.RUNNING
    world.facts = {"(level leia)": 47.5}
    assert world.tick() is Status.RUNNING
    assert "(= (level leia) 47.5)" in world.executor.state
    assert not world.executor.holds("(>= (level leia) 48)")
    world.facts = {}
    assert world.run(limit=400) is Status.SUCCESS
    assert world.executor.holds("(and (patrolled w3) (>= (level leia) 50))")
    assert any("does not hold" in record.reason for record in world.executor.plans[1:])


def test_a_running_step_is_stopped_when_a_number_falls_below_what_it_needs(charging):
    world = World(charging)
    assert world.run(until="patrol") is Status.RUNNING
    world.facts = {"(level leia)": 5}
    world.tick()
    assert "patrol" not in [step.schema for step in world.executor.current_steps]


METRIC = """(define (domain m) (:predicates (a) (b)) (:functions (fuel) (noise) (far))
  (:action one :effect (and (a) (increase (fuel) (far)) (increase (noise) 1)))
  (:action two :effect (and (a) (increase (fuel) 3) (increase (noise) 9))))"""


@pytest.mark.parametrize(
    ("metric", "far", "step"),
    [
        ("(fuel)", 2, "one"),
        ("(fuel)", 4, "two"),
        ("(+ (fuel) (* 2 (noise)))", 4, "one"),
        ("(noise)", 9, "one"),
    ],
)
def test_numbers_that_only_rise_may_be_minimized(metric, far, step):
    init = f"(:init (= (fuel) 0) (= (noise) 0) (= (far) {far}))"
    domain = parse_domain(
        METRIC, f"(define (problem p) (:domain m) {init} (:goal (a)) (:metric minimize {metric}))"
    )
    result = Planner().plan(Problem(domain, initial_state(domain)))
    assert [step.schema for step in result.steps] == [step]


# ------------------------------------------------------------------ random worlds

PLANNER = Planner(timeout_s=20.0)
COMPARE = ("<", "<=", ">=", ">", "=")


@st.composite
def numeric_worlds(draw):
    """Write a small world with two bounded numbers and two facts, where brute force can look at every state."""
    number = st.sampled_from(["(x)", "(y)"])
    actions = []
    for name in range(draw(st.integers(2, 4))):
        one = draw(number)
        other = draw(number)
        by = draw(st.sampled_from(["1", "2", "0.5", "(y)"]))
        test = f"({draw(st.sampled_from(COMPARE))} {draw(number)} {draw(st.sampled_from(['1', '2', '(x)', '1.5']))})"
        needs = draw(
            st.sampled_from(
                [test, f"(not {test})", f"(or {test} (p))", "(p)", "(not (q))", f"(and (q) {test})"]
            )
        )
        kind = draw(st.sampled_from(["increase", "decrease", "assign"]))
        fact = draw(
            st.sampled_from(["(p)", "(q)", "(not (p))", "(not (q))", "(and)", f"(when {test} (q))"])
        )
        keep = "(<= (x) 4) (>= (x) -3) (<= (y) 4) (>= (y) -3)"
        change = (
            f"({kind} {one} {by if by != '(y)' or kind == 'assign' or other == '(y)' else '1'})"
        )
        actions.append(
            f"(:action a{name} :precondition (and {needs} {keep}) :effect (and {fact} {change}))"
        )
    domain = f"(define (domain d) (:predicates (p) (q)) (:functions (x) (y)) {' '.join(actions)})"
    goal = draw(
        st.sampled_from(
            ["(q)", "(>= (x) 3)", "(and (p) (= (y) 2))", "(or (q) (< (x) -1))", "(= (x) 1.5)"]
        )
    )
    values = f"(= (x) {draw(st.integers(0, 2))}) (= (y) {draw(st.integers(-1, 2))})"
    return domain, f"(define (problem p) (:domain d) (:init {values}) (:goal {goal}))"


@settings(max_examples=40)
@given(texts=numeric_worlds())
def test_what_is_planned_in_random_worlds_is_what_brute_force_finds(texts):
    domain = parse_domain(*texts)
    state = initial_state(domain)
    fewest = fewest_steps(domain, state, most=3000)
    result = PLANNER.plan(Problem(domain, state))
    if fewest == -1:
        return
    assert result.outcome.is_solved == (fewest is not None), result
    assert result.cost == fewest or result.outcome is not Outcome.SOLVED_OPTIMALLY


def test_numbers_are_exact():
    third = """(define (domain d) (:predicates (p)) (:functions (x)) (:action a :effect (increase (x) (/ 1 3)))
      (:action b :precondition (= (x) 1) :effect (p)))"""
    domain = parse_domain(third, "(define (problem p) (:domain d) (:init (= (x) 0)) (:goal (p)))")
    state = initial_state(domain)
    result = Planner().plan(Problem(domain, state))
    assert [step.schema for step in result.steps] == ["a", "a", "a", "b"]
    for count in range(1, 4):
        state = ended(domain, result.steps[0], state)
        value = Fraction(count, 3)
        assert f"(= (x) {value})" in state


@pytest.mark.parametrize("amount", ["(- (h))", "(* -1 (h))", "-2"])
def test_a_number_that_is_increased_by_less_than_nothing_falls(amount):
    domain = parse_domain(
        f"(define (domain d) (:predicates (p)) (:functions (r) (h)) (:action a :effect (increase (r) {amount})))",
        "(define (problem p) (:domain d) (:init (= (r) 0) (= (h) 2)) (:goal (<= (r) -3)))",
    )
    result = Planner().plan(Problem(domain, initial_state(domain)))
    assert [step.schema for step in result.steps] == ["a", "a"], result.message
