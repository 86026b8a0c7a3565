"""What of a goal no action changes is looked up where the task is searched, and changes no answer."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pddl_world import World, load_text
from py_trees.common import Status

from rosa_pddl import Planner, Problem, initial_state
from rosa_pddl.syntax import conditions

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


FORMULAS = st.recursive(ATOMS, joined, max_leaves=6).map(
    "(forall (?x - sample) (exists (?y - sample) {}))".format
)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("samples"), DOMAIN, PROBLEM)


def states(atoms):
    return st.sets(st.sampled_from(atoms)).map(frozenset)


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(text=FORMULAS, lasting=states(LASTING), now=states(MOVING))
def test_plans_cost_the_same_as_those_of_the_cold_way(samples, text, lasting, now):
    goals = tuple(part.expression for part in conditions(samples, text))
    state = lasting | now
    plain = Planner(warm=False, cached=0).plan(Problem(samples, state, goals))
    quick = PLANNER.plan(Problem(samples, state, goals))
    assert (quick.outcome, quick.cost) == (plain.outcome, plain.cost)


PLANNER = Planner(cached=0)


def test_a_goal_about_what_is_wanted_is_planned_for_warm_whatever_is_wanted(samples):
    told = {}
    for wanted in ("", "a", "ab", "b"):
        state = initial_state(samples) - set(LASTING[:3]) | {f"(wanted {one})" for one in wanted}
        result = PLANNER.plan(Problem(samples, state))
        told[wanted] = [attempt.way for attempt in result.attempts], result.cost
    assert told == {
        "": (["warm"], 0.0),
        "a": (["warm"], 3.0),
        "ab": (["warm"], 6.0),
        "b": (["warm"], 3.0),
    }


def test_the_executor_follows_what_is_wanted_while_it_runs(samples):
    world = World(samples, PLANNER)
    world.run(until="analyse")
    world.facts = {"(wanted c)": True, "(light c)": True}
    assert world.run() is Status.SUCCESS
    assert sum(what == "SUCCESS" for _, name, what in world.log if name == "analyse") == 3
    assert world.executor.plans[1].reason.startswith("the rest of the plan does not reach (forall")


def test_a_goal_that_nothing_can_make_so_is_proven_to_be_none(samples):
    world = World(samples, PLANNER)
    world.executor.goals.replace("(wanted c)")
    assert world.run() is Status.FAILURE
    assert "unsolvable proven" in world.executor.feedback_message
