"""Plans with the times at which what is feasible is forecast to be so no more: judged by trying everything."""

from heapq import heappop, heappush
from itertools import count, permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosa_pddl import (
    Outcome,
    Planner,
    Problem,
    SensingError,
    TimedStep,
    UnknownNameError,
    flaw,
    initial_state,
    parse_domain,
    schedule_flaw,
)
from rosa_pddl.validate import ended, goal_holds, missing_at_start, started

DOMAIN = """(define (domain islands) (:requirements :durative-actions :numeric-fluents)
  (:types action site)
  (:predicates (action_feasible ?a - action) (sail_action ?a - action) (walk_action ?a - action)
    (rest_action ?a - action) (at ?s - site) (seen ?s - site))
  (:functions (toll ?x ?y - site) (minutes ?x ?y - site) (total-cost))
  (:durative-action sail :parameters (?a - action ?x ?y - site) :duration (= ?duration (minutes ?x ?y))
    :condition (and (at start (sail_action ?a)) (over all (action_feasible ?a)) (at start (at ?x))
                    (at start (not (= ?x ?y))))
    :effect (and (at start (not (at ?x))) (at end (at ?y)) (at end (seen ?y))
                 (at end (increase (total-cost) (toll ?x ?y)))))
  (:durative-action walk :parameters (?a - action ?x ?y - site) :duration (= ?duration 3)
    :condition (and (at start (walk_action ?a)) (at start (action_feasible ?a)) (at start (at ?x))
                    (at start (not (= ?x ?y))))
    :effect (and (at start (not (at ?x))) (at end (at ?y)) (at end (seen ?y)) (at end (increase (total-cost) 4))))
  (:durative-action rest :parameters (?a ?b - action) :duration (= ?duration 2)
    :condition (and (at start (rest_action ?a)) (over all (action_feasible ?a)) (at start (sail_action ?b)))
    :effect (and (at end (when (seen quay) (action_feasible ?b))) (at end (increase (total-cost) 1))))
)"""
PROBLEM = """(define (problem one) (:domain islands)
  (:objects sail walk rest - action quay reef bank - site)
  (:init (sail_action sail) (walk_action walk) (rest_action rest) (at bank) (= (total-cost) 0)
    (= (minutes quay reef) 1) (= (minutes reef quay) 1) (= (minutes quay bank) 1) (= (minutes bank quay) 1)
    (= (minutes bank reef) 1) (= (minutes reef bank) 1) (= (toll quay reef) 1) (= (toll reef quay) 1)
    (= (toll quay bank) 1) (= (toll bank quay) 1) (= (toll bank reef) 1) (= (toll reef bank) 1))
  (:goal (and (seen quay) (seen reef)))
  (:metric minimize (total-cost)))
"""
SITES = ("quay", "reef", "bank")
ISLANDS = parse_domain(DOMAIN, PROBLEM)
GROUND = [ISLANDS.step("rest", ("rest", "sail"))] + [
    ISLANDS.step(name, (name, *pair))
    for name in ("sail", "walk")
    for pair in permutations(SITES, 2)
]
SAIL, WALK, REST = map(ISLANDS.feasible_atom, ("sail", "walk", "rest"))
TENTHS = st.integers(0, 90).map(lambda tenths: tenths / 10)
EXACT = Planner("label-setting", cached=0)


def problem(until, *, costs=None, feasible=(SAIL, WALK, REST), shares=None):
    return Problem(
        ISLANDS, initial_state(ISLANDS).union(feasible), None, costs or {}, {}, until, shares or {}
    )


@st.composite
def problems(draw):
    feasible = [atom for atom in (SAIL, WALK, REST) if draw(st.integers(0, 4))]
    until = {atom: draw(TENTHS) for atom in feasible if draw(st.booleans())}
    pairs = list(permutations(SITES, 2))
    costs = {
        f"({name} {one} {two})": draw(TENTHS) for name in ("toll", "minutes") for one, two in pairs
    }
    shares = (
        {draw(st.sampled_from(GROUND)): draw(st.sampled_from([0.0, 0.25, 0.5]))}
        if draw(st.booleans())
        else {}
    )
    return problem(until, costs=costs, feasible=feasible, shares=shares)


def by_exhaustion(asked):
    """Return the least cost of a plan that keeps all times, in tenths, from all that can be done; None if none does."""

    def tenths(name, step, else_):
        return (
            round(10 * asked.costs[f"({name} {' '.join(step.arguments[1:])})"])
            if step.schema == "sail"
            else else_
        )

    order = count()
    waiting, seen = [(0, next(order), asked.state, 0, frozenset())], set()
    while waiting:
        cost, _, state, now, made = heappop(waiting)
        if goal_holds(ISLANDS, state):
            return cost / 10
        if (state, now, made) in seen:
            continue
        seen.add((state, now, made))
        for step in GROUND:
            takes = tenths("minutes", step, {"walk": 30, "rest": 20}.get(step.schema))
            takes *= asked.shares.get(step, 1) if len(seen) == 1 else 1
            atom = ISLANDS.feasible_atom(step.action)
            is_late = atom not in made and now + takes > 10 * asked.until.get(atom, 1000)
            if is_late or missing_at_start(ISLANDS, step, state) is not None:
                continue
            more = {SAIL} if step.schema == "rest" and "(seen quay)" in state else set()
            after = ended(ISLANDS, step, started(ISLANDS, step, state))
            price = tenths("toll", step, {"walk": 40, "rest": 10}.get(step.schema))
            # once all times are over, how much later it is makes no difference
            heappush(waiting, (cost + price, next(order), after, min(now + takes, 91), made | more))
    return None


@given(problems())
def test_plans_cost_as_little_as_what_trying_everything_finds_in_time(asked):
    expected, found = by_exhaustion(asked), EXACT.plan(asked)
    assert found.outcome is (
        Outcome.UNSOLVABLE_PROVEN if expected is None else Outcome.SOLVED_OPTIMALLY
    )
    assert found.cost == (None if expected is None else pytest.approx(expected))


def steps(result):
    return [step.schema for step in result.steps]


def test_without_times_the_answer_is_the_same_to_the_step():
    asked = problem({})
    assert EXACT.plan(asked) == EXACT.plan(problem({SAIL: 1000.0}))
    assert steps(EXACT.plan(asked)) == ["sail", "sail"]


@pytest.mark.parametrize("engine", ["label-setting", "fast-downward-opt", "fast-downward"])
def test_what_would_end_too_late_is_done_otherwise_or_after_it_was_made_feasible_anew(engine):
    planner = Planner(engine, cached=0)
    assert steps(planner.plan(problem({SAIL: 2.0}))) == ["sail", "sail"]
    result = planner.plan(problem({SAIL: 1.9}))
    assert (steps(result), result.cost) == (["sail", "rest", "sail"], 3.0)
    assert result.steps[0].arguments[2] == "quay"  # only there a rest helps
    assert planner.plan(problem({SAIL: 1.9, REST: 2.9})).cost == 5.0
    assert (
        planner.plan(problem({SAIL: 1.9, REST: 0.0, WALK: 2.0})).outcome
        is Outcome.UNSOLVABLE_PROVEN
    )
    # what is not feasible does not become so by a forecast
    assert planner.plan(problem({SAIL: 99.0}, feasible=(WALK,))).cost == 8.0


@pytest.mark.parametrize(("engine", "moves"), [("fast-downward-opt", 0), ("label-setting", 1)])
def test_a_search_that_knows_no_times_is_believed_only_if_its_plan_keeps_them(engine, moves):
    planner = Planner(engine, moves=moves, cached=0)
    assert planner.plan(problem({SAIL: 2.0})).outcome is Outcome.SOLVED_OPTIMALLY
    late = planner.plan(problem({SAIL: 1.5}))
    assert late.outcome is Outcome.UNSUPPORTED
    assert "would end in 2 s, too late by 0.5 s" in late.message
    assert planner.plan(problem({SAIL: 1.5}, feasible=())).outcome is Outcome.UNSOLVABLE_PROVEN


def test_the_judge_says_which_step_is_too_late():
    walk = [ISLANDS.step("walk", ("walk", *pair)) for pair in (("bank", "quay"), ("quay", "reef"))]
    state = initial_state(ISLANDS) | {WALK}
    assert flaw(ISLANDS, walk, state) is None
    assert flaw(ISLANDS, walk, state, until={WALK: 6.0}) is None
    assert (
        flaw(ISLANDS, walk, state, until={WALK: 5.0})
        == "walk(walk, quay, reef) would end in 6 s, too late by 1 s"
    )
    timed = [TimedStep(step, 3.5 * number, 3.0) for number, step in enumerate(walk)]
    assert schedule_flaw(ISLANDS, timed, state, until={WALK: 6.5}) is None
    assert "would end in 6.5 s" in schedule_flaw(ISLANDS, timed, state, until={WALK: 6.0})


CREW = """(define (domain crew) (:requirements :durative-actions :numeric-fluents :disjunctive-preconditions)
  (:types action) (:predicates (action_feasible ?a - action) (is_go ?a - action) (is_fix ?a - action) (fixed) (done))
  (:functions (pace))
  (:durative-action fix :parameters (?a - action) :duration (= ?duration 2)
    :condition (and (at start (is_fix ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (action_feasible ?a)) (at end (fixed))))
  (:durative-action slow :parameters () :duration (= ?duration 1) :condition (and (at start (not (fixed))))
    :effect (and (at end (assign (pace) 50)) (at end (fixed))))
  (:durative-action go :parameters (?a - action) :duration (= ?duration {takes})
    :condition (and (at start (is_go ?a)) (at start (fixed)) (over all {needs}))
    :effect (at end (done))))"""
CREW_PROBLEM = """(define (problem p) (:domain crew) (:objects go fix - action)
  (:init (is_go go) (is_fix fix) (= (pace) 5)) (:goal (done)))"""


def crew(until, *, needs="(action_feasible fix)", takes="5"):
    """Return the crew's domain, a state in which all is feasible, and what is planned in such a time."""
    domain = parse_domain(CREW.format(takes=takes, needs=needs), CREW_PROBLEM)
    state = initial_state(domain) | {"(action_feasible go)", "(action_feasible fix)"}
    return domain, state, EXACT.plan(Problem(domain, state, until=until))


def test_a_step_makes_feasible_anew_what_it_needs_itself():
    domain, state, found = crew(until := {"(action_feasible fix)": 4.0})
    assert steps(found) == ["fix", "go"]
    assert flaw(domain, found.steps, state, until=until) is None
    assert crew({"(action_feasible fix)": 1.9})[2].outcome is Outcome.UNSOLVABLE_PROVEN


@pytest.mark.parametrize("kind", ["exists", "forall"])
@pytest.mark.usefixtures("without_java")
def test_what_is_needed_of_several_actions_is_judged_by_what_is_feasible_in_the_end(kind):
    until = {"(action_feasible fix)": 1.0, "(action_feasible go)": 4.0}
    domain, state, found = crew(until, needs=f"({kind} (?b - action) (action_feasible ?b))")
    assert not found.outcome.is_solved
    plan = [domain.step("slow", ()), domain.step("go", ("go",))]
    assert "would end in 6 s, too late by " in flaw(domain, plan, state, until=until)
    one_lasts = flaw(domain, plan, state, until={"(action_feasible go)": 4.0})
    assert (one_lasts is None) is (kind == "exists")


@pytest.mark.usefixtures("without_java")
def test_how_long_steps_take_is_not_guessed_where_it_is_computed_or_changes():
    domain, state, found = crew({"(action_feasible fix)": 10.0}, takes="(pace)")
    assert not found.outcome.is_solved
    assert (
        "how long steps take changes, which is not planned with what is forecast" in found.message
    )
    go = [domain.step("fix", ("fix",)), domain.step("go", ("go",))]
    assert (
        flaw(domain, go[1:], state | {"(fixed)"}, until={"(action_feasible fix)": 9.0}) is not None
    )
    assert flaw(domain, go, state, until={"(action_feasible fix)": 9.0}) is None


def test_a_time_of_what_is_no_feasibility_is_refused():
    for text in ("(action_feasible row)", "(at quay)", "action_feasible sail"):
        with pytest.raises(UnknownNameError, match=r"nearest|known"):
            problem({text: 1.0})


@pytest.mark.parametrize("left_s", [float("nan"), float("inf"), "soon", None])
def test_a_time_that_is_no_number_is_refused(left_s):
    with pytest.raises(
        SensingError, match=r"\(action_feasible sail\) is forecast to hold for .* a finite number"
    ):
        problem({SAIL: left_s})


RIG = """(define (domain rig) (:requirements :durative-actions)
  (:types action) (:predicates (action_feasible ?a - action) (lift_action ?a - action) (push_action ?a - action)
    (up) (aside))
  (:durative-action lift :parameters (?a - action) :duration (= ?duration 8)
    :condition (and (at start (lift_action ?a)) (over all (action_feasible ?a))) :effect (at end (up)))
  (:durative-action push :parameters (?a - action) :duration (= ?duration 20)
    :condition (and (at start (push_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (up)) (at end (aside))))
  (:durative-action swing :parameters (?a - action) :duration (= ?duration 4)
    :condition (and (at start (lift_action ?a)) (over all (action_feasible ?a)) (at start (up)))
    :effect (at end (aside))))
"""


def test_a_temporal_engine_is_told_of_the_times():
    pytest.importorskip("up_aries")
    goal = "(define (problem p) (:domain rig) (:objects lift push - action)"
    init = "(:init (lift_action lift) (push_action push)) (:goal (aside)) (:metric minimize (total-time)))"
    rig = parse_domain(RIG, f"{goal} {init}")
    lift, push = map(rig.feasible_atom, ("lift", "push"))
    planner = Planner("aries", 300.0, overlapping=True)
    either = (
        {push: 19.987},
        ["lift", "swing"],
    )  # it counts in tenths of a second, and begins a tenth after an end
    for until, expected in (
        either,
        ({lift: 12.1, push: 0.05}, ["lift", "swing"]),
        ({lift: 11.51}, ["push"]),
    ):
        result = planner.plan(Problem(rig, initial_state(rig) | {lift, push}, until=until))
        assert steps(result) == expected
