"""What is settled of a goal is left out of what planners are asked, and changes no answer."""

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from pddl_world import World, load_text
from py_trees.common import Status

from rosa_pddl import Planner, Problem, initial_state
from rosa_pddl.formulas import conditions
from rosa_pddl.goals import GoalSimplifier
from rosa_pddl.validate import goal_holds, mentioned_atoms

# What is wanted and where it is light are for others to say.
DOMAIN = """(define (domain samples) (:requirements :typing :action-costs)
  (:types sample)
  (:predicates (wanted ?s - sample) (light ?s - sample) (seen ?s - sample) (analysed ?s - sample) (home))
  (:functions (total-cost) - number)
  (:action look :parameters (?s - sample) :precondition (light ?s)
    :effect (and (seen ?s) (not (home)) (increase (total-cost) 1)))
  (:action analyse :parameters (?s - sample) :precondition (seen ?s)
    :effect (and (analysed ?s) (not (seen ?s)) (increase (total-cost) 2)))
  (:action return :parameters () :effect (and (home) (increase (total-cost) 1))))
"""
PROBLEM = """(define (problem p) (:domain samples) (:objects a b c - sample)
  (:init (wanted a) (wanted b) (light a) (light b) (home) (= (total-cost) 0))
  (:goal (forall (?s - sample) (imply (wanted ?s) (analysed ?s)))) (:metric minimize (total-cost)))
"""
LASTING = [f"({what} {one})" for what in ("wanted", "light") for one in "abc"]
MOVING = [f"({what} {one})" for what in ("seen", "analysed") for one in "abc"] + ["(home)"]
TERMS = st.sampled_from(["a", "b", "c", "?x", "?y"])
ATOMS = st.one_of(
    st.builds("({} {})".format, st.sampled_from(["wanted", "light", "seen", "analysed"]), TERMS),
    st.just("(home)"),
    st.builds("(= {} {})".format, TERMS, TERMS),
)


def joined(parts):
    return st.one_of(
        st.builds("(and {} {})".format, parts, parts),
        st.builds("(or {} {})".format, parts, parts),
        st.builds("(not {})".format, parts),
        st.builds("(imply {} {})".format, parts, parts),
        st.builds("(forall (?x - sample) {})".format, parts),
        st.builds("(exists (?y - sample) {})".format, parts),
    )


FORMULAS = st.recursive(ATOMS, joined, max_leaves=6).map("(forall (?x - sample) (exists (?y - sample) {}))".format)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("samples"), DOMAIN, PROBLEM)


def states(atoms):
    return st.sets(st.sampled_from(atoms)).map(frozenset)


@given(
    texts=st.lists(FORMULAS, min_size=1, max_size=2), lasting=states(LASTING), now=states(MOVING), end=states(MOVING)
)
def test_what_is_left_holds_in_the_end_exactly_if_the_goal_does(samples, texts, lasting, now, end):
    goals = [part.expression for text in texts for part in conditions(samples, text)]
    rest = GoalSimplifier(samples).simplified(goals, lasting | now)
    assert goal_holds(samples, lasting | end, rest) == goal_holds(samples, lasting | end, goals)
    told = {atom for goal in rest if goal not in goals for atom in mentioned_atoms(samples, [goal], (), {})}
    assert told <= set(MOVING)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=FORMULAS, lasting=states(LASTING), now=states(MOVING))
def test_plans_cost_the_same_as_those_of_the_cold_way_for_the_goal_as_it_is(samples, text, lasting, now):
    goals = tuple(part.expression for part in conditions(samples, text))
    state = lasting | now
    rest = GoalSimplifier(samples).simplified(goals, state)
    assume(rest != goals)
    plain = Planner(warm=False, cached=0).plan(Problem(samples, state, goals))
    quick = PLANNER.plan(Problem(samples, state, rest))
    assert (quick.outcome, quick.cost) == (plain.outcome, plain.cost)


PLANNER = Planner(cached=0)


def test_a_goal_about_what_is_wanted_is_planned_for_warm_whatever_is_wanted(samples):
    simplifier, goals = GoalSimplifier(samples), tuple(samples.up_problem.goals)
    told = {}
    for wanted in ("", "a", "ab", "b"):
        state = initial_state(samples) - set(LASTING[:3]) | {f"(wanted {one})" for one in wanted}
        rest = simplifier.simplified(goals, state)
        assert sorted(map(str, rest)) == [f"analysed({one})" for one in wanted]
        result = PLANNER.plan(Problem(samples, state, rest))
        told[wanted] = [attempt.way for attempt in result.attempts], result.cost
    assert told == {"": (["warm"], 0.0), "a": (["warm"], 3.0), "ab": (["warm"], 6.0), "b": (["warm"], 3.0)}


def test_the_executor_follows_what_is_wanted_while_it_runs(samples):
    world = World(samples, PLANNER)
    world.run(until="analyse")
    world.facts = {"(wanted c)": True, "(light c)": True}
    assert world.run() is Status.SUCCESS
    assert sum(what == "SUCCESS" for _, name, what in world.log if name == "analyse") == 3
    assert world.executor.plans[1].reason.startswith("the rest of the plan does not reach (forall")


def test_a_goal_that_nothing_can_make_so_is_handed_on_as_it_is(samples):
    (goal,) = [part.expression for part in conditions(samples, "(exists (?s - sample) (not (or (wanted ?s) (home))))")]
    state = frozenset({"(wanted a)", "(wanted b)", "(wanted c)"})
    assert GoalSimplifier(samples).simplified([goal], state) == (goal,)
    world = World(samples, PLANNER)
    world.executor.goals.replace("(wanted c)")
    assert world.run() is Status.FAILURE
    assert "unsolvable proven" in world.executor.feedback_message
