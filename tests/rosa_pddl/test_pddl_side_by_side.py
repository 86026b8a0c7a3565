"""Steps of a sequential plan that run at the same time: whatever the order of what happens, it comes to the same."""

from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pddl_world import FakeKb, World
from py_trees.common import Status

from rosa_pddl import (
    Outcome,
    Planner,
    PlanningResult,
    Problem,
    ReplanningPolicy,
    initial_state,
    parse_domain,
)
from rosa_pddl.instances import is_out_of_reach
from rosa_pddl.plan_monitor import PlanExecution, shared_components
from rosa_pddl.validate import StepEvent, replay

SIDE_BY_SIDE = ReplanningPolicy(side_by_side=True)


@st.composite
def durative_worlds(draw):
    """Write a small world of durative actions over a few facts and a number, each with conditions at some times."""
    facts, times = ("(p)", "(q)", "(r)", "(s)"), ("at start", "over all", "at end")
    literal = st.sampled_from([text for fact in facts for text in (fact, f"(not {fact})")])
    actions = []
    for number in range(3):
        needs = [
            f"({draw(st.sampled_from(times))} {draw(literal)})"
            for _ in range(draw(st.integers(0, 2)))
        ]
        effects = [
            f"({draw(st.sampled_from(times[::2]))} {draw(literal)})"
            for _ in range(draw(st.integers(1, 2)))
        ]
        if draw(st.booleans()):
            effects.append(f"(at end ({draw(st.sampled_from(['increase', 'decrease']))} (x) 1))")
        if draw(st.booleans()):
            needs.append("(over all (>= (x) 0))")
        actions.append(
            f"(:durative-action a{number} :parameters () :duration (= ?duration 1)"
            f" :condition (and {' '.join(needs)}) :effect (and {' '.join(effects)}))"
        )
    domain = (
        f"(define (domain d) (:predicates (p) (q) (r) (s)) (:functions (x)) {' '.join(actions)})"
    )
    held = draw(st.sets(st.sampled_from(facts)))
    goal = draw(
        st.sampled_from(["(and (p) (q))", "(and (q) (r) (s))", "(and (p) (not (r)))", "(s)"])
    )
    problem = f"(define (problem p) (:domain d) (:init (= (x) 0) {' '.join(sorted(held))}) (:goal {goal}))"
    return domain, problem, draw(st.permutations([f"a{number}" for number in range(3)]))


def orders(plan, happened=()):
    """Yield every order in which what is left of a plan may start and end."""
    left = [event for event in plan.events if event not in happened]
    if not left:
        yield happened
    for event in left:
        is_next = plan.after[event.number] <= set(happened)
        if StepEvent(event.number, False) in happened if event.is_end else is_next:
            yield from orders(plan, (*happened, event))


@settings(max_examples=60)
@given(world=durative_worlds())
def test_every_order_that_may_come_about_comes_to_the_same(world):
    domain_text, problem_text, names = world
    domain = parse_domain(domain_text, problem_text)
    state = initial_state(domain)
    steps = []
    for name in names:  # a sequence that works, as a planner gives one
        step = domain.step(name, ())
        wrong, _ = replay(
            domain,
            [*steps, step],
            [[StepEvent(n, e)] for n in range(len(steps) + 1) for e in (False, True)],
            state,
        )
        steps += [step] if wrong is None else []
    result = PlanningResult(Outcome.SOLVED, tuple(steps))
    plan = PlanExecution.of(domain, result, (), lambda one, other: False)
    in_turn = PlanExecution.of(domain, result, ()).prediction(domain, state)
    assert in_turn.flaw is None
    for order in orders(plan):
        assert replay(domain, plan.steps, [[event] for event in order], state) == (
            None,
            in_turn.facts,
        )


PAIR = """(define (domain pair) (:types action) (:predicates (action_feasible ?a - action) (lift_action ?a - action)
    (look_action ?a - action) (up) (seen) (sent) (quiet))
  (:durative-action lift :parameters (?a - action) :duration (= ?duration 1)
    :condition (and (over all (lift_action ?a)) (over all (action_feasible ?a))) :effect (at end (up)))
  (:durative-action look :parameters (?a - action) :duration (= ?duration 1)
    :condition (and (over all (look_action ?a)) (over all (action_feasible ?a))) :effect (at end (seen)))
  (:durative-action send :parameters () :duration (= ?duration 1)
    :condition (and (at start (seen)) (over all (quiet))) :effect (at end (sent)))
  (:durative-action hammer :parameters () :duration (= ?duration 1)
    :condition () :effect (and (at start (not (quiet))) (at end (quiet)))))"""
PAIR_PROBLEM = """(define (problem p) (:domain pair) (:objects lift look - action)
  (:init (lift_action lift) (look_action look) (quiet)) (:goal (and (up) (seen) (sent))))"""


@pytest.fixture
def pair():
    return parse_domain(PAIR, PAIR_PROBLEM)


def together(world):
    """Tick to the end; return the sets of steps that ran at the same time, and the last status."""
    seen, status = set(), Status.RUNNING
    while status is Status.RUNNING:
        status = world.tick()
        seen.add(frozenset(step.schema for step in world.executor.current_steps))
    return seen, status


def test_independent_steps_run_at_the_same_time_if_the_policy_says_so(pair):
    seen, status = together(World(pair, policy=SIDE_BY_SIDE))
    assert (status, frozenset({"lift", "look"}) in seen) == (Status.SUCCESS, True)
    assert frozenset({"look", "send"}) not in seen
    seen, status = together(World(pair))
    assert (status, max(map(len, seen))) == (Status.SUCCESS, 1)


class _Composed(FakeKb):
    """Both actions need functions whose designs have components; one they share."""

    shared = "arm"

    def __init__(self, world):
        super().__init__(("lift", "look"))
        self.actions = {
            name: SimpleNamespace(functions=(f"{name}_function",)) for name in ("lift", "look")
        }
        self.functions = {
            f"{name}_function": SimpleNamespace(designs=(name,)) for name in ("lift", "look")
        }
        self.designs = {
            "lift": SimpleNamespace(components=("arm",)),
            "look": SimpleNamespace(components=("eye", self.shared)),
        }


class _Apart(_Composed):
    shared = "neck"


@pytest.mark.parametrize(("kb", "most"), [(_Composed, 1), (_Apart, 2)])
def test_steps_that_share_a_component_follow_one_another(pair, kb, most):
    seen, status = together(World(pair, kb=kb, policy=SIDE_BY_SIDE))
    assert (status, max(map(len, seen))) == (Status.SUCCESS, most)


def test_a_temporal_goal_that_nothing_brings_about_is_proven_unsolvable(pair):
    planner = Planner("aries", 300.0, overlapping=True)
    result = planner.plan(Problem(pair, initial_state(pair)))
    assert result.outcome is Outcome.UNSOLVABLE_PROVEN
    assert "ever undone" in result.message
    feasible = initial_state(pair) | {"(action_feasible lift)", "(action_feasible look)"}
    assert not is_out_of_reach(pair, feasible, pair.up_problem.goals)
    assert shared_components(FakeKb(("lift",)))(
        pair.step("lift", ["lift"]), pair.step("lift", ["lift"])
    )
