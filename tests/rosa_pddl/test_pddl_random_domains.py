"""Random domains: what is planned in this process and by Fast Downward is what brute force finds."""

from random import Random

import pytest
from brute_force import fewest_steps

from rosa_pddl import Planner, Problem, UnsupportedPddlError, initial_state, parse_domain

THINGS = ("a", "b", "c")
MOST_STATES = 3000


def formula(rng, variables, depth=0):
    things = [f"?{name}" for name in variables] + [*THINGS]
    kind = rng.random()
    if depth > 2 or kind < 0.45:
        return "(s)" if rng.random() < 0.33 else f"({rng.choice('pq')} {rng.choice(things)})"
    if kind < 0.6:
        return f"(not {formula(rng, variables, depth + 1)})"
    if kind < 0.84:
        parts = [formula(rng, variables, depth + 1) for _ in range(2)]
        return f"({rng.choice(['and', 'or', 'imply'])} {' '.join(parts)})"
    if kind < 0.9:
        return f"(= {rng.choice(things)} {rng.choice(things)})"
    name = f"v{depth}"
    return f"({rng.choice(['forall', 'exists'])} (?{name} - t) {formula(rng, [*variables, name], depth + 1)})"


def literal(rng, variables):
    things = [f"?{name}" for name in variables] + ["a", "b"]
    atom = "(s)" if rng.random() < 0.2 else f"({rng.choice('pq')} {rng.choice(things)})"
    return atom if rng.random() < 0.6 else f"(not {atom})"


def effect(rng, variables, when):
    """Return an effect, wrapped by `when`, which says the time in a durative action."""
    kind = rng.random()
    if kind < 0.6:
        return when(literal(rng, variables))
    if kind < 0.8:
        return f"(when {when(formula(rng, variables, 1))} {when(literal(rng, variables))})"
    inner = [*variables, "w"]
    return f"(forall (?w - t) (when {when(formula(rng, inner, 2))} {when(literal(rng, inner))}))"


def action(rng, number):
    variables = [f"x{place}" for place in range(rng.randint(0, 2))]
    head = f"a{number} :parameters ({' '.join(f'?{name} - t' for name in variables)})"
    if rng.random() < 0.3:
        effects = " ".join(effect(rng, variables, str) for _ in range(rng.randint(1, 3)))
        return f"(:action {head} :precondition {formula(rng, variables)} :effect (and {effects}))"
    needs = " ".join(f"({time} {formula(rng, variables)})" for time in ("at start", "over all", "at end"))
    times = rng.choices(["at start", "at end"], k=rng.randint(1, 4))
    effects = " ".join(effect(rng, variables, lambda part, time=time: f"({time} {part})") for time in times)
    return f"(:durative-action {head} :duration (= ?duration 2) :condition (and {needs}) :effect (and {effects}))"


def random_domain(rng):
    actions = " ".join(action(rng, number) for number in range(rng.randint(1, 4)))
    facts = " ".join(f"({name} {thing})" for name in "pq" for thing in THINGS if rng.random() < 0.4)
    return parse_domain(
        f"""(define (domain z) (:types t) (:constants {" ".join(THINGS)} - t)
          (:predicates (p ?x - t) (q ?x - t) (s)) {actions})""",
        f"(define (problem z) (:domain z) (:init {facts} {rng.choice(['', '(s)'])}) (:goal {formula(rng, [])}))",
    )


@pytest.mark.parametrize("moves", [50_000, 0])
def test_fewest_steps_are_those_of_brute_force(moves):
    planner, found = Planner(moves=moves, cached=0), []
    for seed in range(60 if moves else 25):
        rng = Random(seed)
        try:
            domain = random_domain(rng)
        except UnsupportedPddlError:  # effects that contradict one another
            continue
        fewest = fewest_steps(domain, initial_state(domain), MOST_STATES)
        if fewest == -1:
            continue
        result = planner.plan(Problem(domain, initial_state(domain)))
        assert not result.outcome.is_trouble, (seed, result.message)
        found.append((seed, len(result.steps) if result.outcome.is_solved else None, fewest))
    assert len(found) > 20
    assert [one for one in found if one[1] != one[2]] == []
    assert {fewest is None for *_, fewest in found} == {True, False}


def test_step_that_does_nothing_for_some_objects_is_left_out_for_fast_downward():
    domain = parse_domain(
        """(define (domain d) (:types place) (:predicates (at ?p - place))
          (:action go :parameters (?from ?to - place) :precondition (at ?from)
            :effect (and (not (at ?from)) (at ?to))))""",
        "(define (problem p) (:domain d) (:objects x y - place) (:init (at x)) (:goal (at y)))",
    )
    result = Planner(moves=0).plan(Problem(domain, initial_state(domain)))
    assert ([str(step) for step in result.steps], result.message) == (["go(x, y)"], "")


@pytest.mark.parametrize(
    ("conditions", "effects", "cost"),
    [
        ("(over all (p ?y))", "(at start (p ?x)) (at end (s))", 1.0),
        ("", "(at start (q ?x)) (when (at end (q ?y)) (at end (s)))", 1.0),
        ("(at start (q a))", "(at start (not (q a))) (when (at end (q a)) (at end (s)))", None),
        ("(at start (q a)) (over all (q ?x))", "(at start (not (q a))) (at end (s))", None),
        ("", "(at start (p ?x)) (at end (not (p ?y))) (when (at end (p a)) (at end (s)))", 1.0),
        ("(at end (>= (f ?y) 2))", "(at start (increase (f ?x) 2)) (at end (s))", 1.0),
        ("(over all (< (f a) 1))", "(when (at start (q a)) (at start (assign (f ?x) 2))) (at end (s))", None),
    ],
)
def test_conditions_of_a_step_are_those_after_its_start(conditions, effects, cost):
    domain = parse_domain(
        f"""(define (domain d) (:types t) (:predicates (p ?x - t) (q ?x - t) (s)) (:functions (f ?x - t) (g))
          (:durative-action one :parameters (?x ?y - t) :duration (= ?duration 1)
            :condition (and {conditions}) :effect (and {effects})))""",
        "(define (problem p) (:domain d) (:objects a - t) (:init (q a) (= (f a) 0) (= (g) 0)) (:goal (s)))",
    )
    start = initial_state(domain) - ({"(q a)"} if "when (at end (q ?y))" in effects else set())
    result = Planner().plan(Problem(domain, start))
    assert (result.cost, result.outcome.is_trouble) == (cost, False)


def test_what_the_end_of_a_step_changes_numbers_by_is_what_it_is_after_its_start():
    domain = parse_domain(
        """(define (domain d) (:types t) (:functions (f ?x - t) (g))
          (:durative-action one :parameters (?x ?y - t) :duration (= ?duration 1)
            :effect (and (at start (increase (f ?x) 2)) (at end (increase (g) (f ?y))))))""",
        """(define (problem p) (:domain d) (:objects a b - t) (:init (= (f a) 0) (= (f b) 1) (= (g) 0))
          (:goal (>= (g) 3)))""",
    )
    result = Planner().plan(Problem(domain, initial_state(domain)))
    assert [str(step) for step in result.steps] == ["one(b, b)"]
