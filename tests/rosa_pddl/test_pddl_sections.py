"""Files as they come: sections in any order, durations of any form, misspelt words.

What is wrong has a place.
"""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pddl_world import FakeKb

from rosa_pddl import PddlError, Planner, Problem, UnsupportedPddlError, initial_state, parse_domain
from rosa_pddl.reader import parse

CORPUS = Path(__file__).with_name("corpus")
DOMAIN = """(define (domain plain)
  (:types thing other)
  (:predicates (ok ?t - thing) (odd ?o - other) (done ?t - thing))
  (:functions (total-cost) (far ?t - thing))
  (:durative-action go
    :parameters (?t - thing)
    :duration (= ?duration 5)
    :condition (at start (ok ?t))
    :effect (and (at end (done ?t))))
  (:action jump
    :parameters (?t - thing)
    :precondition (ok ?t)
    :effect (and (done ?t) (increase (total-cost) 2))))
"""
PROBLEM = """(define (problem p)
  (:domain plain)
  (:objects a - thing)
  (:init (ok a))
  (:goal (done a)))
"""


def read(old="", new=""):
    assert old in DOMAIN + PROBLEM
    return parse_domain(DOMAIN.replace(old, new, 1), PROBLEM.replace(old, new, 1))


def plan(domain):
    state = initial_state(domain) | {domain.feasible_atom(action) for action in domain.rosa_actions}
    return Planner().plan(Problem(domain, state))


def texts(name):
    return [(CORPUS / name / f"{kind}.pddl").read_text() for kind in ("domain", "problem")]


def shuffled(text, rng):
    """The same sections in another order; all but the first two words of the file."""
    root = parse(text, "file")
    sections = [as_text(section) for section in root[2:]]
    rng.shuffle(sections)
    return "\n".join([f"(define {as_text(root[1])}", *sections, ")"])


def as_text(tree):
    return f"({' '.join(map(as_text, tree))})" if isinstance(tree, tuple) else str(tree)


@settings(max_examples=8)
@given(
    name=st.sampled_from(sorted(path.name for path in CORPUS.iterdir())),
    rng=st.randoms(use_true_random=False),
)
def test_the_order_of_sections_makes_no_difference(name, rng):
    whole = parse_domain(*texts(name))
    mixed = parse_domain(*(shuffled(text, rng) for text in texts(name)))
    assert sorted(mixed.schemas) == sorted(whole.schemas)
    assert {name: schema.action for name, schema in mixed.schema_of.items()} == {
        name: schema.action for name, schema in whole.schema_of.items()
    }
    assert initial_state(mixed) == initial_state(whole)
    assert mixed.goals == whole.goals


@settings(max_examples=8)
@given(rng=st.randoms(use_true_random=False))
def test_what_unified_planning_refuses_is_placed_wherever_its_section_stands(rng):
    text = shuffled(DOMAIN.replace("(at start (ok ?t))", "(at start\n (odd ?t))"), rng)
    with pytest.raises(PddlError) as caught:
        parse_domain(text, PROBLEM)
    assert caught.value.line == text[: text.index("(odd ?t)")].count("\n") + 1
    assert "argument 1 of 'odd' must be other" in str(caught.value)


@pytest.mark.parametrize(
    "duration",
    [
        "(= ?duration 5)",
        "(>= ?duration 3)",
        "(<= ?duration 3)",
        "(and (>= ?duration 1) (<= ?duration 10))",
        "(and (= ?duration 5))",
        "(at start (>= ?duration 5))",
        "()",
    ],
)
def test_a_duration_may_be_of_any_form(duration):
    domain = read("(= ?duration 5)", duration)
    result = plan(domain)
    assert [step.schema for step in result.steps] in (["go"], ["jump"])


@pytest.mark.parametrize("word", [":durativ-actions"])
def test_a_misspelt_requirement_does_no_harm(word):
    domain = read("(:types", f"(:requirements :STRIPS {word} :adl)\n  (:types")
    assert domain.check(FakeKb(())) == ()


REFUSED = {
    "name with an accent": (("(:objects a", "(:objects é a"), 3, "invalid characters in 'é'"),
    "parameter twice": (
        (":parameters (?t - thing)", ":parameters (?t ?t - thing)"),
        6,
        "in durative action 'go': parameter ?t declared twice",
    ),
    "untimed condition": (
        ("(at start (ok ?t))", "(ok ?t)"),
        8,
        "in durative action 'go': conditions of durative actions must be under at start, at end or over all",
    ),
    "untimed effect": (
        ("(at end (done ?t))", "(done ?t)"),
        9,
        "in durative action 'go': effects of durative actions must be under at start or at end (or be continuous)",
    ),
    "effect over all": (
        ("(at end (done ?t))", "(over all (done ?t))"),
        9,
        "in durative action 'go': effects of durative actions must be under at start or at end (or be continuous)",
    ),
    "timed in an instant": (
        (":precondition (ok ?t)", ":precondition (at start (ok ?t))"),
        12,
        "in action 'jump': at start / at end / over all only belong at the top of durative conditions",
    ),
    "number as an effect": (
        ("(done ?t) (increase", "(far ?t) (increase"),
        13,
        "in action 'jump': unknown predicate 'far'",
    ),
    "number as a condition": (
        ("(at start (ok ?t))", "(at start (not (far ?t)))"),
        8,
        "found '(far ?t)', which is a number, expected a predicate; compare it, as in (> (x) 0)",
    ),
    "number as a goal": (
        ("(:goal (done a))", "(:goal (far a))"),
        5,
        "found '(far a)', which is a number, expected a predicate; compare it, as in (> (x) 0)",
    ),
    "number as a fact": (
        ("(:init (ok a))", "(:init (far a))"),
        4,
        "found '(far a)', which is a number, expected a predicate; compare it, as in (> (x) 0)",
    ),
    "number denied": (
        ("(:init (ok a))", "(:init (ok a) (not (far a)))"),
        4,
        "found '(far a)', which is a number, expected a predicate; compare it, as in (> (x) 0)",
    ),
    "predicate that changes": (
        ("(increase (total-cost) 2)", "(assign (done ?t) 2)"),
        13,
        "in action 'jump': unknown function 'done'",
    ),
    "predicate as a factor": (
        ("(increase (total-cost) 2)", "(scale-up (ok ?t) 2)"),
        13,
        "in action 'jump': unknown function 'ok'",
    ),
    "predicate as an amount": (
        ("(total-cost) 2)", "(total-cost) (ok ?t))"),
        13,
        "in action 'jump': unknown function 'ok'",
    ),
    "predicate compared": (
        ("(:goal (done a))", "(:goal (> (done a) 1))"),
        5,
        "in the goal: unknown function 'done'",
    ),
    "predicate with a value": (
        ("(:init (ok a))", "(:init (= (ok a) 1))"),
        4,
        "found '(ok a)', which is a predicate, expected a number",
    ),
    "difference of three": (
        ("(total-cost) 2)", "(total-cost) (- 3 1 1))"),
        13,
        "'-' needs one or two operands",
    ),
    "value that is none": (
        ("(:init (ok a))", "(:init (ok a) (= (far a) (far a)))"),
        4,
        "initial value of 'far' must be a number",
    ),
    "value too large": (
        ("(:init (ok a))", "(:init (ok a) (= (far a) 1e309))"),
        4,
        "number out of range: 1e309",
    ),
    "times within or": (
        ("(at start (ok ?t))", "(or (at start (ok ?t)) (at end (ok ?t)))"),
        8,
        "found '(or (at start (ok ?t)) (at end (ok ?t)))', expected '(at start ...)', '(over all ...)' or '(at end ...)'",
    ),
}
UNSUPPORTED = {
    "condition at another time": (
        ("(at end (done ?t))", "(when (at start (ok ?t)) (at end (done ?t)))"),
        9,
        "an effect at one time that depends on another",
    ),
}


@pytest.mark.parametrize("case", [*REFUSED, *UNSUPPORTED])
def test_what_cannot_be_read_is_refused_with_its_place_and_what_to_write(case):
    (old, new), line, words = (REFUSED | UNSUPPORTED)[case]
    with pytest.raises(PddlError) as caught:
        read(old, new)
    assert words in str(caught.value)
    assert caught.value.line == line
    assert isinstance(caught.value, UnsupportedPddlError) == (case in UNSUPPORTED)
