"""A certificate says for every combination of feasible actions what planning from there says."""

import time
from itertools import chain, combinations

import pytest
from faulty_worlds import Ground
from pddl_world import World, load_mission, load_text
from py_trees.common import Status

from missions.engine.mission import find_mission
from missions.engine.question import ask, certified
from missions.views.output import as_json
from missions.views.plan import certificate_as_data
from rosa_pddl import (
    Certificate,
    Outcome,
    Planner,
    PlannerSettingError,
    PlanningResult,
    Problem,
    certificate,
    initial_state,
    parse_domain,
)
from rosa_pddl.domain import without_feasibility
from rosa_pddl.validate import flaw


def supposing_of(domain):
    def supposing(unfeasible):
        feasible = {
            domain.feasible_atom(one) for one in domain.rosa_actions if one not in set(unfeasible)
        }
        return Problem(domain, without_feasibility(domain, initial_state(domain)) | feasible)

    return supposing


@pytest.mark.parametrize("which", ["suave_extended", 5, 6])
def test_each_entry_is_what_planning_from_there_says_and_its_plan_works(which):
    domain = load_mission(which) if isinstance(which, str) else Ground(which).domain
    supposing, cold = supposing_of(domain), Planner(cached=0)
    found = certificate(domain, supposing, Planner())
    actions = domain.rosa_actions
    assert list(found.entries) == list(
        chain.from_iterable(combinations(actions, n) for n in range(len(actions) + 1))
    )
    for out, result in found.entries.items():
        other = cold.plan(supposing(out))
        assert (result.outcome, result.cost) == (other.outcome, other.cost)
        assert (
            not result.outcome.is_solved or flaw(domain, result.steps, supposing(out).state) is None
        )
    ends = [one for one in actions if found.entries[one,].outcome is Outcome.UNSOLVABLE_PROVEN]
    assert found.fatal == (tuple(ends) if found.entries[()].outcome.is_solved else ())
    assert {result.outcome.is_solved for result in found.entries.values()} == {True, False}


def agv_and_other_plannings(every):
    """The ground vehicle's certificate with two failures at once, and plannings from the beginning for some of it."""
    question = ask(mission=find_mission("agv"))
    found, cold = (
        certified(question, 300.0, 2),
        Planner(timeout_s=300.0, cached=0),
    )
    return found, {out: cold.plan(question.problem_without(out)) for out in list(found.entries)[::every]}


def test_entries_of_the_ground_vehicle_are_what_planning_from_there_says():
    found, others = agv_and_other_plannings(every=5)
    assert len(others) > 3
    for out, other in others.items():
        assert (found.entries[out].outcome, found.entries[out].cost) == (
            other.outcome,
            other.cost,
        ), out


def test_what_it_takes_is_limited_by_how_much_fails_at_once():
    domain = load_mission("suave_extended")
    supposing = supposing_of(domain)
    assert len(certificate(domain, supposing, Planner(), failures=1).entries) == 4
    for failures in (-1, 4):
        with pytest.raises(PlannerSettingError, match=f"failures is {failures}, expected 0 to 3"):
            certificate(domain, supposing, Planner(), failures)


def test_trouble_with_a_planner_is_no_proof_that_a_failure_ends_the_mission():
    domain = load_mission("suave_extended")
    found = certificate(domain, supposing_of(domain), Planner("tamer"))
    assert {result.outcome for result in found.entries.values()} == {Outcome.ENGINE_MISSING}
    assert found.fatal == ()


HOUSE = """(define (domain house) (:types action place)
  (:predicates (action_feasible ?a - action) (walk_action ?a - action) (drive_action ?a - action)
    (road ?x ?y - place) (at ?x - place))
  (:durative-action walk :parameters (?a - action ?x ?y - place) :duration (= ?duration 9)
    :condition (and (over all (walk_action ?a)) (over all (action_feasible ?a)) (at start (at ?x)))
    :effect (and (at start (not (at ?x))) (at end (at ?y))))
  (:durative-action drive :parameters (?a - action ?x ?y - place) :duration (= ?duration 2)
    :condition (and (over all (drive_action ?a)) (over all (action_feasible ?a)) (at start (at ?x))
      (over all (road ?x ?y))) :effect (and (at start (not (at ?x))) (at end (at ?y)))))
"""
TO_WORK = """(define (problem p) (:domain house) (:objects walk drive - action home hall work - place)
  (:init (walk_action walk) (drive_action drive) (at home) (road home hall) (road hall work)) (:goal (at work)))
"""


@pytest.fixture
def house(tmp_path):
    return load_text(tmp_path, HOUSE, TO_WORK)


@pytest.fixture
def written(house, tmp_path):
    """The file of a certificate whose plans without `walk` drive through the hall."""
    made = certificate(house, supposing_of(house), Planner())
    (tmp_path / "certificate.json").write_text(as_json(certificate_as_data(made)))
    return tmp_path / "certificate.json"


def test_a_certificate_that_was_written_is_read_as_it_was(house, written):
    read, made = (
        Certificate.load(written, house),
        certificate(house, supposing_of(house), Planner()),
    )
    assert {out: (one.outcome, one.steps, one.cost) for out, one in read.entries.items()} == {
        out: (one.outcome, one.steps, one.cost) for out, one in made.entries.items()
    }
    assert read.fatal == made.fatal == ()
    other = load_mission("suave_extended")
    with pytest.raises(PlannerSettingError, match=r"is no certificate of .*'walk'.*--certificate"):
        Certificate.load(written, other)


def test_the_fall_back_is_in_force_in_the_tick_of_the_failure_however_long_a_planner_takes(
    house, written
):
    world = World(house, Planner(certificate=Certificate.load(written, house)), delay_s=5.0)
    assert world.tick() is Status.RUNNING
    assert [step.schema for step in world.executor.current_steps] == ["walk"]
    world.kb.unfeasible = {"walk"}
    world.tick()  # less than `at_most_every_s` after the planning before
    assert [str(step) for step in world.executor.current_steps] == ["drive(drive, home, hall)"]
    world.kb.unfeasible = {"drive"}
    world.tick()
    assert [str(step) for step in world.executor.current_steps] == ["walk(walk, home, work)"]
    assert world.run() is Status.SUCCESS
    assert [record.at_s for record in world.executor.plans] == [0.0, 0.1, 0.2]
    assert {record.engine for record in world.executor.plans} == {"certificate"}


def test_where_a_robot_has_come_farther_the_end_of_a_certified_plan_will_do(house, written):
    certified = Certificate.load(written, house)
    state = supposing_of(house)(["walk"]).state - {"(at home)"} | {"(at hall)"}
    assert [str(step) for step in certified.prepared(Problem(house, state)).steps] == [
        "drive(drive, hall, work)"
    ]
    step = house.step("drive", ("drive", "hall", "work"))
    assert (
        certified.prepared(Problem(house, state, weights={step: 0})) is None
    )  # it has failed too often
    assert certified.prepared(Problem(house, state - {"(road hall work)"})) is None
    assert Planner(certificate=certified).plan(
        Problem(house, state - {"(road hall work)"})
    ).outcome is (Outcome.UNSOLVABLE_PROVEN)


def test_a_certified_plan_is_replayed_once_for_each_question(house, written):
    asked = []

    class Counting(Certificate):
        def prepared(self, problem):
            asked.append(problem)
            return super().prepared(problem)

    world = World(house, Planner(certificate=Counting(Certificate.load(written, house).entries)))
    world.tick()
    assert [step.schema for step in world.executor.current_steps] == ["walk"]
    assert len(asked) == 1


TANK = """(define (domain tank) (:predicates (there)) (:functions (used) (left))
  (:action go :effect (and (there) (increase (used) 1))))"""


@pytest.mark.parametrize("delay_s", [0.2, None])
def test_where_a_limit_is_not_known_no_certified_plan_is_taken_and_it_is_told(tmp_path, delay_s):
    goal = "(:goal (and (there) (<= (used) (left))))"
    tank = load_text(
        tmp_path, TANK, f"(define (problem p) (:domain tank) (:init (= (used) 0)) {goal})"
    )
    made = Certificate({(): PlanningResult(Outcome.SOLVED, (tank.step("go", ()),))})
    world = World(tank, Planner(certificate=made), delay_s=delay_s)
    while world.tick() is Status.RUNNING:
        time.sleep(0.001)  # without a delay the planner takes what it takes
    assert world.root.status is Status.FAILURE
    assert "(left) is needed but has no value" in world.executor.feedback_message
    world.facts = {"(left)": 2}
    assert world.run() is Status.SUCCESS
    assert world.executor.plans[-1].engine == "certificate"


def test_domain_that_asks_for_no_feasibility_has_a_certificate_too():
    domain = parse_domain(
        """(define (domain d) (:types action) (:predicates (done))
          (:action go :parameters (?a - action) :effect (done)))""",
        "(define (problem p) (:domain d) (:objects walk - action) (:goal (done)))",
    )
    problem = Problem(domain, initial_state(domain))
    planner = Planner(certificate=Certificate({(): Planner().plan(problem)}))
    assert [str(step) for step in planner.start(problem).result().steps] == ["go(walk)"]
