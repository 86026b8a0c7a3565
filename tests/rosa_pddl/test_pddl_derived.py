"""Derived predicates, in each state: such as what is above, or what is connected."""

from itertools import product

import pytest
from brute_force import fewest_steps
from numpy.random import default_rng
from pddl_world import World
from py_trees.common import Status

from rosa_pddl import (
    Outcome,
    PddlError,
    Planner,
    Problem,
    initial_state,
    parse_domain,
)

# `calm` is derived from itself and from what is not derived: `reaches` comes before it
WEB = """(define (domain web) (:types node) (:predicates (link ?a ?b - node) (cable ?a ?b - node) (on ?a - node)
    (reaches ?a ?b - node) (done ?a - node))
  (:derived (reaches ?a ?b - node) (and (on ?a) (or (link ?a ?b) (exists (?c - node)
    (and (link ?a ?c) (reaches ?c ?b))))))
  (:derived (lonely ?a - node) (forall (?b - node) (not (reaches ?a ?b))))
  (:derived (calm ?a - node) (lonely ?a))
  (:derived (calm ?a - node) (exists (?b - node) (and (cable ?a ?b) (calm ?b) (not (= ?a ?b)))))
  (:action plug :parameters (?a ?b - node) :precondition (and (cable ?a ?b) (calm ?b)) :effect (link ?a ?b))
  (:action cut :parameters (?a ?b - node) :precondition (and (link ?a ?b) (reaches ?a ?b))
    :effect (and (not (link ?a ?b)) (when (reaches ?b ?a) (not (on ?b)))))
  (:action wake :parameters (?a - node) :precondition (not (calm ?a)) :effect (on ?a))
  (:action use :parameters (?a ?b - node) :precondition (and (reaches ?a ?b) (on ?b)) :effect (done ?b)))"""
GOALS = (
    "(reaches n0 n2)",
    "(done n1)",
    "(not (calm n0))",
    "(lonely n1)",
    "(forall (?a - node) (calm ?a))",
    "(done n2)",
)


def web(seed):
    rng = default_rng(seed)
    nodes = [f"n{number}" for number in range(3)]
    pairs = [(a, b) for a, b in product(nodes, nodes) if a != b]
    facts = [f"(cable {a} {b})" for a, b in pairs if rng.random() < 0.6]
    facts += [f"(link {a} {b})" for a, b in pairs if rng.random() < 0.3]
    facts += [f"(on {a})" for a in nodes if rng.random() < 0.7]
    goal = " ".join(rng.choice(GOALS, size=2, replace=False))
    return parse_domain(
        WEB,
        f"""(define (problem p) (:domain web) (:objects {" ".join(nodes)} - node) (:init {" ".join(facts)})
        (:goal (and {goal})))""",
    )


def test_plans_are_as_short_as_brute_force_finds_here_and_by_fast_downward():
    found = []
    for seed in range(7):
        domain = web(seed)
        problem = Problem(domain, initial_state(domain))
        count = fewest_steps(domain, initial_state(domain))
        found.append(count)
        for planner in (Planner(timeout_s=300.0), Planner(timeout_s=300.0, moves=0)):
            result = planner.plan(problem)
            assert (result.outcome is Outcome.SOLVED_OPTIMALLY, result.cost) == (
                count is not None,
                count,
            ), seed
    assert len(set(found)) > 1


def test_what_is_derived_follows_what_changes_while_a_plan_runs():
    domain = parse_domain(
        """(define (domain net) (:types room) (:predicates (door ?a ?b - room) (open ?a ?b - room) (at ?a - room)
            (connected ?a ?b - room))
          (:derived (connected ?a ?b - room) (or (and (door ?a ?b) (open ?a ?b))
            (exists (?c - room) (and (connected ?a ?c) (connected ?c ?b)))))
          (:durative-action unlock :parameters (?a ?b - room) :duration (= ?duration 1)
            :condition (at start (door ?a ?b)) :effect (at end (open ?a ?b)))
          (:durative-action go :parameters (?a ?b - room) :duration (= ?duration 5)
            :condition (and (at start (at ?a)) (over all (connected ?a ?b)))
            :effect (and (at start (not (at ?a))) (at end (at ?b)))))""",
        """(define (problem p) (:domain net) (:objects a b c - room) (:init (at a) (door a b) (door b c) (open a b))
          (:goal (at c)))""",
    )
    world = World(domain)
    world.run(until="go")
    assert world.plans() == [["unlock", "go"]]
    assert world.executor.holds("(connected a c)")
    world.facts["(open a b)"] = False
    world.tick()
    assert world.executor.current_steps == ()
    world.facts = {}
    assert world.run() is Status.SUCCESS
    assert world.plans()[1:] == [["unlock", "go"]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "(and (cable ?a ?b) (calm ?b) (not",
            "(and (cable ?a ?b) (not (calm ?b)) (not",
            "'calm' depends negatively",
        ),
        (
            "(forall (?b - node) (not (reaches ?a ?b)))",
            "(not (lonely ?a))",
            "'lonely' depends negatively",
        ),
    ],
)
def test_a_predicate_that_is_derived_from_its_own_negation_is_refused(old, new, message):
    assert old in WEB
    with pytest.raises(PddlError, match=rf"domain\.pddl:\d+:\d+: derived predicate {message}"):
        parse_domain(
            WEB.replace(old, new), "(define (problem p) (:domain web) (:init) (:goal (and)))"
        )
