"""The judges of plans say what unified-planning's validators say."""

from fractions import Fraction

import pytest
from brute_force import ground_steps
from hypothesis import given, settings
from hypothesis import strategies as st
from pddl_world import as_global, load_text

from rosa_pddl import Problem, TimedStep, initial_state, parse_domain, schedule_flaw
from rosa_pddl.validate import ended, flaw, missing_at_start, started


def instance(domain, up_problem, step):
    from unified_planning.plans import ActionInstance

    objects = [up_problem.object(domain.inside["object", name.lower()]) for name in step.arguments]
    manager = up_problem.environment.expression_manager
    action = up_problem.action(domain.inside["action", step.schema.lower()])
    return ActionInstance(action, tuple(manager.ObjectExp(thing) for thing in objects))


def accepts(validator_class, up_problem, plan):
    with as_global(up_problem.environment):  # its grounder works in the global environment only
        validator = validator_class()
        validator.skip_checks = True
        return bool(validator.validate(up_problem, plan))


def accepts_sequence(problem, steps):
    from unified_planning.engines.plan_validator import SequentialPlanValidator
    from unified_planning.plans import SequentialPlan

    up_problem = problem.build()
    instances = [instance(problem.domain, up_problem, step) for step in steps]
    return accepts(
        SequentialPlanValidator, up_problem, SequentialPlan(instances, up_problem.environment)
    )


def accepts_schedule(problem, schedule):
    from unified_planning.engines.plan_validator import TimeTriggeredPlanValidator
    from unified_planning.plans import TimeTriggeredPlan

    up_problem = problem.build(overlapping=True)
    timed = [
        (
            Fraction(one.start_s).limit_denominator(1000),
            instance(problem.domain, up_problem, one.step),
            Fraction(one.duration_s).limit_denominator(1000) if one.duration_s else None,
        )
        for one in schedule
    ]
    return accepts(
        TimeTriggeredPlanValidator, up_problem, TimeTriggeredPlan(timed, up_problem.environment)
    )


@st.composite
def walks(draw, domain):
    """Draw a state and a plan that mostly works: at each point a step that can start there, now and then any."""
    steps = sorted(ground_steps(domain), key=str)
    state = initial_state(domain) | {domain.feasible_atom(action) for action in domain.rosa_actions}
    state ^= frozenset(draw(st.sets(st.sampled_from(sorted(state)), max_size=1)))
    now, plan = state, []
    for _ in range(draw(st.integers(0, 5))):
        possible = [step for step in steps if missing_at_start(domain, step, now) is None]
        step = draw(st.sampled_from(possible if possible and draw(st.integers(0, 9)) else steps))
        plan.append(step)
        now = ended(domain, step, started(domain, step, now))
    return state, plan, now


@settings(max_examples=40)
@given(data=st.data())
@pytest.mark.parametrize("which", ["rooms", "extended"])
def test_random_plans_are_judged_as_unified_planning_does(request, which, data):
    domain = request.getfixturevalue(which)
    state, plan, end = data.draw(walks(domain))
    # a goal that the plan reaches, so that it is the steps that decide; or the real one
    reached = tuple(domain.expression(atom) for atom in sorted(end))[:3]
    problem = Problem(domain, state, goals=data.draw(st.sampled_from([reached, None])))
    assert (flaw(domain, plan, state, problem.wanted) is None) == accepts_sequence(problem, plan)


RELAY = """(define (domain relay) (:requirements :durative-actions :negative-preconditions)
  (:types runner) (:predicates (ready ?r - runner) (baton ?r - runner) (home ?r - runner) (lit))
  (:durative-action run :parameters (?r - runner) :duration (= ?duration 2)
    :condition (and (at start (ready ?r)) (over all (lit)) (at end (baton ?r)))
    :effect (and (at start (not (ready ?r))) (at end (home ?r))))
  (:durative-action hand :parameters (?r ?s - runner) :duration (= ?duration 1)
    :condition (and (at start (baton ?r)) (over all (lit)))
    :effect (and (at start (not (baton ?r))) (at end (baton ?s))))
  (:action lamp :parameters () :precondition (not (lit)) :effect (lit))
  (:durative-action wane :parameters () :duration (= ?duration 3) :condition (at start (lit))
    :effect (at end (not (lit)))))"""
RELAY_PROBLEM = """(define (problem p) (:domain relay) (:objects ann bob - runner)
  (:init (ready ann) (ready bob) (baton ann) (lit)) (:goal (home ann)))"""
DURATIONS = {"run": 2.0, "hand": 1.0, "lamp": 0.0, "wane": 3.0}


@pytest.fixture(scope="module")
def relay(tmp_path_factory):
    return load_text(tmp_path_factory.mktemp("relay"), RELAY, RELAY_PROBLEM)


def happening_times(schedule):
    return [at for one in schedule for at in {one.start_s, one.end_s}]


@settings(max_examples=150)
@given(data=st.data())
def test_random_schedules_are_judged_as_unified_planning_does(relay, data):
    steps = sorted(ground_steps(relay), key=str)
    # no two starts or ends at once: there this judge is the stricter one
    offsets = st.permutations([0.01 * number for number in range(8)])
    drawn = data.draw(st.lists(st.tuples(st.sampled_from(steps), st.integers(0, 6)), max_size=3))
    chosen = data.draw(st.booleans())
    base = [(relay.step("run", ["ann"]), 0)] if chosen else []
    times = zip([*base, *drawn], data.draw(offsets), strict=False)
    schedule = [
        TimedStep(step, whole + offset, DURATIONS[step.schema]) for (step, whole), offset in times
    ]
    assert len(set(happening_times(schedule))) == len(happening_times(schedule))
    state = initial_state(relay) ^ frozenset(
        data.draw(st.sets(st.sampled_from(["(lit)", "(baton ann)"]), max_size=1))
    )
    problem = Problem(relay, state)
    assert (schedule_flaw(relay, schedule, state) is None) == accepts_schedule(problem, schedule)


def at(domain, start_s, schema, *arguments):
    return TimedStep(domain.step(schema, arguments), start_s, DURATIONS[schema])


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ([], None),
        ([(1.0, "hand", "ann", "bob")], "(baton ann)"),
        ([(0.5, "hand", "ann", "ann")], None),
        ([(0.0, "wane")], None),
        ([(1.0, "lamp")], "lamp() needs (not (lit))"),
        ([(0.0, "run", "ann")], "each other's way over (ready ann)"),
    ],
)
def test_a_schedule_that_does_not_work_says_why(relay, rest, words):
    schedule = [at(relay, 0.0, "run", "ann"), *(at(relay, *one) for one in rest)]
    wrong = schedule_flaw(relay, schedule, initial_state(relay))
    assert wrong is None if words is None else words in wrong


def test_number_that_one_step_needs_and_another_changes_at_the_same_time_is_in_the_way():
    domain = parse_domain(
        """(define (domain tank) (:predicates (done) (empty)) (:functions (fuel))
          (:durative-action look :duration (= ?duration 2) :condition (at start (>= (fuel) 20)) :effect (at end (done)))
          (:durative-action drain :duration (= ?duration 2)
            :effect (and (at start (decrease (fuel) 15)) (at end (empty)))))""",
        "(define (problem p) (:domain tank) (:init (= (fuel) 30)) (:goal (and (done) (empty))))",
    )

    def flaw_of(drain_s):
        steps = [(domain.step("look", []), 0.0), (domain.step("drain", []), drain_s)]
        return schedule_flaw(
            domain, [TimedStep(step, at_s, 2.0) for step, at_s in steps], initial_state(domain)
        )

    assert (flaw_of(0.0), flaw_of(0.5)) == (
        "look() and drain() get in each other's way over (fuel)",
        None,
    )


def test_what_holds_over_all_is_looked_at_in_between(relay):
    # the light goes out at 3 s, in the midst of the run
    schedule = [at(relay, 0.0, "wane"), at(relay, 2.0, "run", "ann")]
    assert "(lit)" in schedule_flaw(relay, schedule, initial_state(relay))


def test_a_step_that_lasts_as_long_as_no_such_step_does_is_no_step(relay):
    short = [TimedStep(relay.step("run", ["ann"]), 0.0, 1.0)]
    assert "not its duration" in schedule_flaw(relay, short, initial_state(relay))
    long_lamp = [TimedStep(relay.step("lamp", []), 0.0, 1.0)]
    assert "not its duration" in schedule_flaw(relay, long_lamp, frozenset())
