"""How budgets are said, in PDDL and in declarations; what cannot be said is refused."""

from dataclasses import replace

import pytest
from test_budgets import DOMAIN, PROBLEM

from rosa_pddl import (
    ActionSchema,
    Declarations,
    DeclaredProblem,
    Outcome,
    PddlError,
    Planner,
    Problem,
    UnknownNameError,
    initial_state,
    load_domain,
    parse_domain,
)

GO, GOAL = "(increase (noise) 1)", "(<= (noise) 9)"
REFUSED = {
    "no number": (GO, "(increase (noise) ?w)", "domain", 10, "found '?w', expected a number"),
    "misspelt": (GOAL, "(<= (nois) 9)", "problem", 6, "unknown predicate 'nois'"),
    "cost": (
        GOAL,
        "(<= (total-cost) 9)",
        "problem",
        6,
        "compares (total-cost), which is for the metric",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_planned_for_is_refused_with_its_place_and_what_would_do(case):
    old, new, which, line, words = REFUSED[case]
    assert old in DOMAIN + PROBLEM
    with pytest.raises(PddlError) as caught:
        parse_domain(DOMAIN.replace(old, new, 1), PROBLEM.replace(old, new, 1))
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"{which}.pddl:{line}:")


def test_a_limit_is_kept_apart_from_the_goals():
    domain = parse_domain(DOMAIN, PROBLEM)
    assert domain.goals == ("(at c)",)
    assert (domain.limited, len(domain.limits)) == (("energy", "noise"), 2)
    uses = {name: sorted(one.uses) for name, one in domain.schema_of.items()}
    assert uses == {"go": ["energy", "noise"], "clear": ["noise"]}


def test_an_action_with_a_duration_may_use_at_its_start_and_at_its_end():
    domain = parse_domain(
        """(define (domain d) (:predicates (done)) (:functions (used))
        (:durative-action work :parameters () :duration (= ?duration 5) :condition (and)
         :effect (and (at start (increase (used) 1)) (at end (done)))))""",
        "(define (problem p) (:domain d) (:init (= (used) 0)) (:goal (and (done) (<= (used) 1))))",
    )
    planner = Planner("label-setting", warm=False)
    assert planner.plan(Problem(domain, frozenset())).outcome is Outcome.SOLVED_OPTIMALLY
    assert (
        planner.plan(Problem(domain, frozenset(), costs={"(used)": 1})).outcome
        is Outcome.UNSOLVABLE_PROVEN
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("(max_nois)", "domain.pddl has no predicate 'max_nois' (in '(max_nois)'); nearest: "),
        ("(effort nowhere)", "domain.pddl has no object 'nowhere'"),
        ("(noise a)", "'(noise a)' has 1 arguments, 'noise' takes 0"),
        ("(at a)", "'(at a)' is no numeric fact of domain.pddl; known: effort, "),
    ],
)
def test_numbers_that_a_problem_is_given_have_to_be_facts_of_the_domain(text, words):
    domain = parse_domain(DOMAIN, PROBLEM)
    with pytest.raises(UnknownNameError) as caught:
        Problem(domain, initial_state(domain), costs={"(noise)": 1, text: 1})
    assert words in str(caught.value)
    assert len(Problem(domain, initial_state(domain), costs={"NOISE": 1}).costs) == 1


# ---------------------------------------------------------------- declarations

CROSS = ActionSchema(
    "cross",
    parameters=("?w - way", "?from ?to - place"),
    start=("(at ?from)", "(leads ?w ?from ?to)"),
    end_effects=("(not (at ?from))", "(at ?to)"),
    cost="(length ?w)",
    uses={"energy_used": "(takes ?w)", "risk": 0.1},
    action=None,
)
WALK = DeclaredProblem(
    goal=("(at c)",),
    objects={**dict.fromkeys("abc", "place"), **dict.fromkeys(("ab", "bc", "ac"), "way")},
    facts=("(at a)", "(leads ab a b)", "(leads bc b c)", "(leads ac a c)"),
    numbers={
        **{"(length ab)": 2, "(length bc)": 3, "(length ac)": 1, "(energy_left)": 0.3},
        **{"(takes ab)": 0.1, "(takes bc)": 0.2, "(takes ac)": 0.9},
    },
    limits={"energy_used": "(energy_left)", "risk": 0.2},
)


def test_declared_uses_and_limits_are_pddl_that_others_can_load(tmp_path):
    declared = Declarations("walk", [CROSS], WALK)
    (tmp_path / "domain.pddl").write_text(declared.domain_pddl)
    (tmp_path / "problem.pddl").write_text(declared.problem_pddl)
    domain = load_domain(tmp_path / "domain.pddl", tmp_path / "problem.pddl")
    planner = Planner("label-setting", cached=0)
    result = planner.plan(Problem(domain, initial_state(domain)))
    assert (result.outcome, result.cost) == (Outcome.SOLVED_OPTIMALLY, 5.0)
    assert (
        planner.plan(Problem(domain, initial_state(domain), costs={"(energy_left)": 0.9})).cost
        == 1.0
    )
    assert planner.plan(Problem(domain, initial_state(domain), costs={"(risk)": 0.11})).cost is None


def test_without_costs_the_fewest_steps_within_limits_are_the_best():
    declared = Declarations(
        "walk",
        [replace(CROSS, cost=None)],
        replace(WALK, numbers=dict(list(WALK.numbers.items())[3:])),
    )
    domain = declared.load()
    result = Planner("label-setting", warm=False).plan(Problem(domain, initial_state(domain)))
    assert (result.outcome, result.cost) == (Outcome.SOLVED_OPTIMALLY, 2.0)


def test_numbers_are_written_with_all_their_digits():
    told = replace(WALK, numbers={**WALK.numbers, "(energy_left)": 0.30000000000000004})
    assert (
        "(= (energy_left) 0.30000000000000004)" in Declarations("walk", [CROSS], told).problem_pddl
    )


@pytest.mark.parametrize(
    ("schema", "problem", "words"),
    [
        (
            CROSS,
            replace(WALK, limits={"energy": 3}),
            "'energy' is limited, but no action uses it up; nearest: energy_used",
        ),
        (
            replace(CROSS, uses={"risk": -1}),
            WALK,
            "uses['risk'] is -1, expected a number that is not negative",
        ),
        (
            replace(CROSS, uses={**CROSS.uses, "risk": "(takes ?x)"}),
            WALK,
            "in cross: found the variable '?x', expected a parameter",
        ),
    ],
)
def test_declarations_without_meaning_are_refused(schema, problem, words):
    with pytest.raises(PddlError) as caught:
        Declarations("walk", [schema], problem).load()
    assert words in str(caught.value)
