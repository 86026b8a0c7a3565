"""A task grounded once answers as one that is grounded anew each time, whatever the state, goal and costs."""

from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from brute_force import least_cost
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from pddl_world import load_text
from waypoints import Waypoints

from rosa_pddl import Outcome, Planner, Problem, UnknownNameError, initial_state
from rosa_pddl.planner import _Portfolio
from rosa_pddl.validate import flaw


def atoms_of(domain):
    """Every atom that the types allow."""
    for fluent in domain.up_problem.fluents:
        if fluent.type.is_bool_type():
            choices = [
                domain.objects_of(domain.outside[part.type.name]) for part in fluent.signature
            ]
            for words in product(*choices):
                yield f"({' '.join((domain.outside[fluent.name], *words))})"


def ways(result):
    return [attempt.way for attempt in result.attempts]


def answer(result):
    assert Outcome.ENGINE_CRASHED not in {attempt.outcome for attempt in result.attempts}, (
        result.attempts
    )
    assert not result.outcome.is_trouble, result.message
    return result.outcome, result.cost


def cold_planner():
    return Planner(warm=False, cached=0)


@settings(max_examples=6)
@given(data=st.data())
@pytest.mark.parametrize("which", ["rooms", "extended"])
def test_the_warm_way_answers_as_the_cold_one(request, which, data):
    domain = request.getfixturevalue(which)
    atoms = sorted(atoms_of(domain))
    assert len(atoms) > 10
    warm, cold = Planner(cached=0), cold_planner()
    for _ in range(2):
        # mostly near to what the mission begins with, as most states of a mission are
        flipped = data.draw(st.sets(st.sampled_from(atoms), max_size=6))
        problem = Problem(domain, initial_state(domain) ^ frozenset(flipped))
        result = warm.plan(problem)
        assert answer(result) == answer(cold.plan(problem))
        assert not result.outcome.is_solved or flaw(domain, result.steps, problem.state) is None


@st.composite
def domains(draw):
    """Write a small random domain: facts with up to two arguments, negative and conditional parts, costs."""
    arities = [0, 1, 1, 2]
    literal = st.tuples(
        st.integers(0, 3), st.booleans(), st.tuples(st.integers(0, 1), st.integers(0, 1))
    )

    def written(literals):
        texts = []
        for predicate, is_true, arguments in literals:
            words = " ".join(f"?x{argument}" for argument in arguments[: arities[predicate]])
            atom = f"(p{predicate} {words})"
            texts.append(atom if is_true else f"(not {atom})")
        return " ".join(texts)

    actions = []
    for number in range(draw(st.integers(1, 4))):
        needs, effects = (
            draw(st.lists(literal, max_size=2)),
            draw(st.lists(literal, min_size=1, max_size=2)),
        )
        when = (
            f"(when (p3 ?x0 ?x1) {written([draw(literal)])})"
            if draw(st.integers(0, 5)) == 0
            else ""
        )
        cost = draw(st.sampled_from(["2", "(c ?x0)"]))
        actions.append(f"""(:action a{number} :parameters (?x0 ?x1 - t) :precondition (and {written(needs)})
          :effect (and {written(effects)} {when} (increase (total-cost) {cost})))""")
    objects = ["o0", "o1"]
    domain = f"""(define (domain d) (:types t) (:predicates (p0) (p1 ?x - t) (p2 ?x - t) (p3 ?x ?y - t))
      (:functions (total-cost) - number (c ?x - t) - number) {" ".join(actions)})"""
    goal = draw(
        st.sampled_from(
            [
                "(p0)",
                "(and (p1 o0) (not (p2 o1)))",
                "(forall (?x - t) (p1 ?x))",
                "(p3 o0 o1)",
                "(or (p1 o0) (not (p3 o1 o0)))",
            ]
        )
    )
    problem = f"""(define (problem p) (:domain d) (:objects {" ".join(objects)} - t)
      (:init (= (total-cost) 0) (= (c o0) 1) (= (c o1) 3)) (:goal {goal}) (:metric minimize (total-cost)))"""
    return domain, problem


@settings(max_examples=8)
@given(texts=domains(), data=st.data())
def test_so_it_does_in_random_domains(texts, data):
    with TemporaryDirectory() as folder:
        domain = load_text(Path(folder), *texts)
    atoms = sorted(atoms_of(domain))
    warm, cold = Planner(cached=0), cold_planner()
    for _ in range(3):
        state = frozenset(data.draw(st.sets(st.sampled_from(atoms))))
        costs = {"(c o0)": float(data.draw(st.integers(0, 5)))} if data.draw(st.booleans()) else {}
        problem = Problem(domain, state, costs=costs)
        least = least_cost(domain, state, costs)
        outcome = Outcome.UNSOLVABLE_PROVEN if least is None else Outcome.SOLVED_OPTIMALLY
        assert answer(warm.plan(problem)) == answer(cold.plan(problem)) == (outcome, least)


def test_every_state_of_the_extended_mission_is_answered_warm(extended):
    planner = Planner(cached=0)
    changeable = [
        atom
        for atom in atoms_of(extended)
        if atom.startswith(("(action_feasible", "(pipeline_found"))
    ]
    assert len(changeable) == 4
    static = initial_state(extended)
    planner.prepare(Problem(extended, static))
    for chosen in product((False, True), repeat=4):
        facts = {atom for atom, is_true in zip(changeable, chosen, strict=True) if is_true}
        assert ways(planner.plan(Problem(extended, static | facts))) == ["warm"]


def test_facts_that_were_found_to_exclude_one_another_may_hold_together_all_the_same(rooms):
    planner = Planner(cached=0)
    assert ways(planner.plan(Problem(rooms, initial_state(rooms)))) == ["warm"]
    result = planner.plan(Problem(rooms, initial_state(rooms) | {"(at robby kitchen)"}))
    assert ways(result) == ["warm"]
    assert answer(result) == answer(
        cold_planner().plan(Problem(rooms, initial_state(rooms) | {"(at robby kitchen)"}))
    )


def test_what_no_action_changes_is_kept_alive_once_it_has_changed(rooms):
    planner = Planner(cached=0)
    assert ways(planner.plan(Problem(rooms, initial_state(rooms)))) == ["warm"]
    state = initial_state(rooms) - {"(look_action look)"}
    assert ways(planner.plan(Problem(rooms, state))) == ["warm"]
    assert planner.plan(Problem(rooms, state)).outcome is Outcome.UNSOLVABLE_PROVEN


def test_what_may_change_can_be_told_beforehand(rooms):
    planner = Planner(cached=0)
    problem = Problem(rooms, initial_state(rooms))
    planner.prepare(problem, ["(look_action go)", "(look_action look)"])
    assert ways(planner.plan(problem)) == ["warm"]
    with pytest.raises(UnknownNameError, match="nearest: look"):
        planner.prepare(problem, ["(look_action lok)"])


AXIOMS = """(define (domain blocks) (:types t) (:predicates (clear ?x - t) (on ?x ?y - t) (done))
  (:action finish :precondition (forall (?x - t) (or (clear ?x) (exists (?y - t) (on ?y ?x)))) :effect (done))
  (:action sweep :parameters (?x - t) :effect (clear ?x)))"""
AXIOMS_PROBLEM = (
    "(define (problem p) (:domain blocks) (:objects a b - t) (:init (on a b)) (:goal (done)))"
)


@pytest.mark.parametrize("moves", [0, 50_000])
def test_a_task_with_axioms_fits_every_state(tmp_path, moves):
    domain = load_text(tmp_path, AXIOMS, AXIOMS_PROBLEM)
    planner = Planner(moves=moves)
    for facts, cost in ((initial_state(domain), 2.0), (frozenset({"(on a b)", "(on b a)"}), 1.0)):
        result = planner.plan(Problem(domain, facts))
        assert (ways(result), result.outcome, result.cost) == (
            ["warm"],
            Outcome.SOLVED_OPTIMALLY,
            cost,
        )


def test_a_goal_that_holds_already_needs_no_search(rooms):
    for goals in (
        (rooms.expression("(at robby hall)"),),
        (rooms.expression("(go_action go)"),),
        (),
    ):
        for planner in (Planner(cached=0), cold_planner()):
            result = planner.plan(Problem(rooms, initial_state(rooms), goals=goals))
            assert (answer(result), result.steps) == ((Outcome.SOLVED_OPTIMALLY, 0.0), ())


def test_goals_change_without_grounding_anew(rooms):
    planner = Planner(cached=0)
    state = initial_state(rooms) | {"(action_feasible go)", "(action_feasible look)"}
    goals = {
        text: (rooms.expression(text),)
        for text in ("(at robby kitchen)", "(scanned kitchen)", "(lit hall)")
    }
    answers = {
        text: planner.plan(Problem(rooms, state, goals=goal)) for text, goal in goals.items()
    }
    assert [result.cost for result in answers.values()] == [1.0, 3.0, None]
    assert [ways(result) for result in answers.values()] == [["warm"]] * 3
    for text, result in answers.items():
        assert answer(result) == answer(
            cold_planner().plan(Problem(rooms, state, goals=goals[text]))
        )


@pytest.mark.parametrize("moves", [0, 50_000])
def test_a_goal_may_say_one_or_the_other(rooms, moves):
    either = rooms.up_problem.environment.expression_manager.Or(
        rooms.expression("(at robby kitchen)"), rooms.expression("(scanned hall)")
    )
    state = initial_state(rooms) | {"(action_feasible go)", "(action_feasible look)"}
    result = Planner(moves=moves).plan(Problem(rooms, state, goals=(either,)))
    assert (ways(result), result.cost) == (["warm"], 1.0)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return Waypoints(tmp_path_factory.mktemp("waypoints"), 12, default_rng(3))


def test_possibilities_and_costs_of_each_moment_are_put_in(world):
    planner = Planner(cached=0)
    state, costs = world.situation()
    planner.prepare(Problem(world.domain, state, costs=costs), world.changing)
    seen = set()
    for place in ("w0", "w3", "w5", "w0"):
        state, costs = world.situation(place)
        problem = Problem(world.domain, state, costs=costs)
        result = planner.plan(problem)
        assert ways(result) == ["warm"]
        assert answer(result) == answer(cold_planner().plan(problem))
        seen.add(result.cost)
    assert len(seen) > 1


def test_the_satisficing_search_is_warm_too(world):
    planner = Planner("fast-downward", cached=0)
    state, costs = world.situation()
    result = planner.plan(Problem(world.domain, state, costs=costs))
    assert (ways(result), result.outcome) == (["warm"], Outcome.SOLVED)
    assert result.cost >= cold_planner().plan(Problem(world.domain, state, costs=costs)).cost


@pytest.mark.parametrize(
    ("changed", "outcome", "words"),
    [
        ({}, Outcome.UNSUPPORTED, "has no value"),
        ({"(switch_cost c0)": -1.0}, Outcome.UNSUPPORTED, "costs are 0 or more"),
        ({"(switch_cost c0)": float("nan")}, Outcome.UNSUPPORTED, "expected a finite number"),
        ({"(switch_cost c0)": 1e9}, Outcome.SOLVED, "were rounded"),
    ],
)
def test_costs_that_cannot_be_planned_with_are_named(world, changed, outcome, words):
    state, costs = world.situation()
    result = Planner(cached=0, moves=0).plan(
        Problem(world.domain, state, costs={**costs, **changed} if changed else {})
    )
    assert result.outcome is outcome
    assert words in result.message


def test_costs_that_are_not_whole_are_told_exactly(world):
    state, costs = world.situation()
    whole = Planner(cached=0).plan(Problem(world.domain, state, costs=costs))
    halved = Problem(world.domain, state, costs={key: value / 8 for key, value in costs.items()})
    assert Planner(cached=0).plan(halved).cost == pytest.approx(whole.cost / 8)


def test_two_questions_at_once_are_answered_like_one_after_the_other(extended):
    states = [
        initial_state(extended) | {f"(action_feasible {action})"}
        for action in extended.rosa_actions
    ]
    planner = Planner(cached=0)
    futures = [planner.start(Problem(extended, state)) for state in states * 3]
    together = [answer(future.result(60.0)) for future in futures]
    assert (
        together
        == [answer(Planner(cached=0).plan(Problem(extended, state))) for state in states] * 3
    )


def test_what_takes_no_longer_than_a_tick_is_answered_at_once(extended):
    planner = Planner(cached=0)
    problem = Problem(
        extended,
        initial_state(extended) | {"(action_feasible recharge)", "(pipeline_found pipeline)"},
    )
    first = planner.plan(problem)
    at_once, future = planner.start(problem), planner.start(problem)
    assert at_once.done()
    assert at_once.result() == future.result() == first
    none = planner.start(Problem(extended, initial_state(extended)))
    assert none.done()
    assert none.result().outcome is Outcome.UNSOLVABLE_PROVEN


def test_what_takes_longer_is_not(extended, world):
    planner = Planner(cached=0)
    assert (
        _Portfolio(Planner("fast-downward"), Problem(extended, initial_state(extended))).at_once()
        is None
    )
    state, costs = world.situation()
    problem = Problem(world.domain, state, costs=costs)
    assert planner.plan(problem).outcome is Outcome.SOLVED_OPTIMALLY
    left_out = Planner(cached=0, moves=0)
    assert left_out.plan(problem).cost == planner.plan(problem).cost
    assert _Portfolio(left_out, problem).at_once() is None


def test_beyond_its_cap_the_search_is_left_to_fast_downward(world):
    state, costs = world.situation()
    problem = Problem(world.domain, state, costs=costs)
    here, capped = Planner(cached=0), Planner(cached=0, moves=len(world.possible) * 5 + 200)
    assert answer(here.plan(problem)) == answer(capped.plan(problem))
    assert ways(capped.plan(problem)) == ["warm"]
