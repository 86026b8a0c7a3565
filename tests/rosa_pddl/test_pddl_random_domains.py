"""Random domains: what is planned in this process and by Fast Downward is what brute force finds."""

from random import Random

import pytest
from brute_force import fewest_steps

from rosa_pddl import Planner, Problem, UnsupportedPddlError, initial_state, parse_domain

THINGS = ("a", "b", "c")
MOST_STATES = 3000


def formula(rng, variables, depth=0, heads="pq"):
    things = [f"?{name}" for name in variables] + [*THINGS]
    kind = rng.random()
    if depth > 2 or kind < 0.45:
        return "(s)" if rng.random() < 0.33 else f"({rng.choice(heads)} {rng.choice(things)})"
    if kind < 0.6:
        return f"(not {formula(rng, variables, depth + 1, heads)})"
    if kind < 0.84:
        parts = [formula(rng, variables, depth + 1, heads) for _ in range(2)]
        return f"({rng.choice(['and', 'or', 'imply'])} {' '.join(parts)})"
    if kind < 0.9:
        return f"(= {rng.choice(things)} {rng.choice(things)})"
    name = f"v{depth}"
    return f"({rng.choice(['forall', 'exists'])} (?{name} - t) {formula(rng, [*variables, name], depth + 1, heads)})"


def literal(rng, variables):
    things = [f"?{name}" for name in variables] + ["a", "b"]
    atom = "(s)" if rng.random() < 0.2 else f"({rng.choice('pq')} {rng.choice(things)})"
    return atom if rng.random() < 0.6 else f"(not {atom})"


def effect(rng, variables, when, heads):
    """Return an effect, wrapped by `when`, which says the time in a durative action."""
    kind = rng.random()
    if kind < 0.6:
        return when(literal(rng, variables))
    if kind < 0.8:
        return f"(when {when(formula(rng, variables, 1, heads))} {when(literal(rng, variables))})"
    inner = [*variables, "w"]
    return f"(forall (?w - t) (when {when(formula(rng, inner, 2, heads))} {when(literal(rng, inner))}))"


def action(rng, number, heads):
    variables = [f"x{place}" for place in range(rng.randint(0, 2))]
    head = f"a{number} :parameters ({' '.join(f'?{name} - t' for name in variables)})"
    if rng.random() < 0.3:
        effects = " ".join(effect(rng, variables, str, heads) for _ in range(rng.randint(1, 3)))
        return f"(:action {head} :precondition {formula(rng, variables, heads=heads)} :effect (and {effects}))"
    times = ("at start", "over all", "at end")
    depth = 0
    sure = []
    if heads != "pq":  # else hardly a step could start or change what it needs
        times = rng.sample(times, k=1)
        depth = 2
        sure = ["at start", "at start"]
    needs = " ".join(f"({time} {formula(rng, variables, depth, heads)})" for time in times)
    times = sure + rng.choices(["at start", "at end"], k=rng.randint(1, 4))
    effects = " ".join(
        effect(rng, variables, lambda part, time=time: f"({time} {part})", heads) for time in times
    )
    return f"(:durative-action {head} :duration (= ?duration 2) :condition (and {needs}) :effect (and {effects}))"


def rules(rng):
    """Return the definitions of `d` and `r`, also derived from themselves, and of `e`, also from what does not hold."""
    lonely = f"({rng.choice(['and', 'or'])} {formula(rng, 'x', 1, 'pqd')} (not (r ?x {rng.choice(THINGS)})))"
    return f"""(:derived (d ?x - t) {formula(rng, "x")})
      (:derived (d ?x - t) (exists (?y - t) (and (d ?y) {formula(rng, "xy")})))
      (:derived (r ?x ?y - t) (or {formula(rng, "xy")} (exists (?z - t) (and {formula(rng, "xz")} (r ?z ?y)))))
      (:derived (e ?x - t) {lonely})"""


def random_domain(rng, is_derived=False):
    heads, derived = ("pqdee", rules(rng)) if is_derived else ("pq", "")
    actions = " ".join(action(rng, number, heads) for number in range(rng.randint(1, 4)))
    facts = " ".join(f"({name} {thing})" for name in "pq" for thing in THINGS if rng.random() < 0.4)
    facts += rng.choice(["", " (s)"])
    if is_derived:  # a formula alone often holds from the beginning
        goal = f"(and {literal(rng, [])} {literal(rng, [])} {formula(rng, [], 2, heads)})"
    else:
        goal = formula(rng, [])
    return parse_domain(
        f"""(define (domain z) (:types t) (:constants {" ".join(THINGS)} - t)
          (:predicates (p ?x - t) (q ?x - t) (s)) {derived} {actions})""",
        f"(define (problem z) (:domain z) (:init {facts}) (:goal {goal}))",
    )


@pytest.mark.parametrize("is_derived", [False, True])
def test_fewest_steps_are_those_of_brute_force(is_derived):
    planner = Planner(timeout_s=1.0)
    found = []
    first = 60 if is_derived else 0  # these have steps whose start changes what is derived
    for seed in range(first, first + (10 if is_derived else 60)):
        rng = Random(seed)
        try:
            domain = random_domain(rng, is_derived)
        except UnsupportedPddlError:  # effects that contradict one another
            continue
        fewest = fewest_steps(domain, initial_state(domain), MOST_STATES)
        if fewest == -1:
            continue
        result = planner.plan(Problem(domain, initial_state(domain)))
        if result.outcome.is_trouble:
            print(seed, result.message)
            continue
        found.append((seed, len(result.steps) if result.outcome.is_solved else None, fewest))
    assert len(found) > 4
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
    ("condition", "start_effects", "fewest"),
    [
        ("(over all (bright ?r))", "(at start (lit ?l))", 2),
        ("(over all (not (dark ?r)))", "(at start (lit ?l))", 2),
        ("(at end (not (bright ?r)))", "(forall (?l - lamp) (at start (not (lit ?l))))", 2),
        ("(over all (forall (?r - room) (bright ?r)))", "(at start (lit ?l))", None),
        ("(over all (beside ?r s))", "(when (at start (lit c)) (at start (open ?r s)))", None),
        ("(over all (beside ?r s))", "(forall (?q - room) (at start (open ?q ?r)))", 2),
        ("(at end (warm ?r))", "(at start (increase (heat ?r) 2))", 2),
    ],
)
def test_what_is_derived_after_the_start_of_a_step_is_derived_from_what_the_start_changes(
    condition, start_effects, fewest
):
    domain = parse_domain(
        f"""(define (domain d) (:types lamp room) (:constants s - room c - lamp) (:functions (heat ?r - room))
          (:predicates (lit ?l - lamp) (in ?l - lamp ?r - room) (seen ?r - room) (open ?q ?r - room))
          (:derived (bright ?r - room) (exists (?l - lamp) (and (lit ?l) (in ?l ?r))))
          (:derived (dark ?r - room) (not (bright ?r)))
          (:derived (warm ?r - room) (>= (heat ?r) 2))
          (:derived (beside ?q ?r - room) (or (open ?q ?r) (exists (?p - room) (and (open ?q ?p) (beside ?p ?r)))))
          (:durative-action look :parameters (?l - lamp ?r - room) :duration (= ?duration 1)
            :condition (and {condition}) :effect (and {start_effects} (at end (seen ?r)))))""",
        """(define (problem p) (:domain d) (:objects a b - lamp r t - room)
          (:init (in a r) (in b r) (in c s) (lit b) (= (heat r) 0) (= (heat s) 0) (= (heat t) 0))
          (:goal (and (seen r) (seen s))))""",
    )
    problem = Problem(domain, initial_state(domain))
    results = [Planner().plan(problem)]
    if "heat" not in start_effects:
        results.append(Planner(moves=0).plan(problem))  # by Fast Downward
    assert {(result.outcome.is_trouble, result.cost) for result in results} == {(False, fewest)}
    assert fewest_steps(domain, problem.state) == fewest


@pytest.mark.parametrize(
    ("conditions", "effects", "cost"),
    [
        ("(over all (p ?y))", "(at start (p ?x)) (at end (s))", 1.0),
        ("", "(at start (q ?x)) (when (at end (q ?y)) (at end (s)))", 1.0),
        ("(at start (q a))", "(at start (not (q a))) (when (at end (q a)) (at end (s)))", None),
        ("(at start (q a)) (over all (q ?x))", "(at start (not (q a))) (at end (s))", None),
        ("", "(at start (p ?x)) (at end (not (p ?y))) (when (at end (p a)) (at end (s)))", 1.0),
        ("(at end (>= (f ?y) 2))", "(at start (increase (f ?x) 2)) (at end (s))", 1.0),
        (
            "(over all (< (f a) 1))",
            "(when (at start (q a)) (at start (assign (f ?x) 2))) (at end (s))",
            None,
        ),
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


@pytest.mark.parametrize(
    ("start_effect", "step"), [("(p ?x)", "one(a)"), ("(not (p ?x))", "one(b)")]
)
def test_variable_with_the_name_of_a_parameter_is_another_thing(start_effect, step):
    domain = parse_domain(
        f"""(define (domain d) (:types t) (:predicates (p ?x - t) (q ?x - t))
          (:durative-action one :parameters (?x - t) :duration (= ?duration 1) :effect (and (at start {start_effect})
            (forall (?x - t) (when (at end (and (p ?x) (exists (?x ?x_ - t) (= ?x ?x_)))) (at end (q ?x)))))))""",
        "(define (problem p) (:domain d) (:objects a b - t) (:init (p a)) (:goal (and (q a) (not (q b)))))",
    )
    result = Planner().plan(Problem(domain, initial_state(domain)))
    assert [str(step) for step in result.steps] == [step]
