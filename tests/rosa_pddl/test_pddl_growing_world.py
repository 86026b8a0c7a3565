"""Objects that come and go while a plan runs, and questions to what is believed."""

import gc
import weakref

import pytest
from pddl_world import FakeKb, World
from py_trees.common import Status

from rosa_pddl import PddlError, Planner, Problem, UnknownNameError, initial_state, parse_domain
from rosa_pddl.domain import with_object

DOMAIN = """(define (domain rocks) (:types action place sample - object)
  (:predicates (action_feasible ?a - action) (drive_action ?a - action) (at ?p - place) (lies ?s - sample ?p - place)
    (analysed ?s - sample))
  (:durative-action drive :parameters (?a - action ?from ?to - place) :duration (= ?duration 2)
    :condition (and (at start (at ?from)) (over all (drive_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at start (not (at ?from))) (at end (at ?to))))
  (:durative-action analyse :parameters (?s - sample ?p - place) :duration (= ?duration 2)
    :condition (and (over all (at ?p)) (at start (lies ?s ?p))) :effect (at end (analysed ?s))))"""
PROBLEM = """(define (problem p) (:domain rocks)
  (:objects drive - action base crater - place sample_1 - sample)
  (:init (at base) (drive_action drive) (lies sample_1 base)) (:goal (forall (?s - sample) (analysed ?s))))"""


@pytest.fixture(scope="module")
def rocks():
    return parse_domain(DOMAIN, PROBLEM)


def begun(world):
    return [name for _, name, what in world.log if what == "begins"]


def test_a_sample_that_appears_while_the_plan_runs_is_analysed_too(rocks):
    world = World(rocks)
    assert world.run(until="analyse") is Status.RUNNING
    world.executor.add_object("sample_9", "sample")
    world.facts = {"(lies sample_9 crater)": True}
    assert world.executor.objects("sample") == ("sample_1", "sample_9")
    for _ in range(100):
        if world.tick() is Status.SUCCESS:
            break
    assert begun(world) == ["analyse", "drive", "analyse"]
    assert world.executor.holds("(forall (?s - sample) (analysed ?s))")
    assert "(analysed sample_9)" in world.executor.state
    assert rocks.objects_of("sample") == (
        "sample_1",
    )  # what was loaded is shared, and stays as it is


def test_objects_are_sensed_to_appear_and_to_vanish(rocks):
    world = World(rocks)
    world.facts = {"sample_9 - sample": True, "(lies sample_9 crater)": True}
    assert world.run(until="drive") is Status.RUNNING
    world.facts = {"sample_9 - sample": False}
    assert world.run() is Status.SUCCESS
    assert begun(world) == ["analyse", "drive"]
    assert world.executor.objects("sample") == ("sample_1",)
    assert not [fact for fact in world.executor.state if "sample_9" in fact]
    world.facts = {"sample_9 - sample": True, "(lies sample_9 base)": True}
    world.tick()
    assert world.run() is Status.SUCCESS
    assert world.executor.holds("(analysed sample_9)")


def test_a_step_that_is_done_with_what_has_gone_is_stopped(rocks):
    world = World(rocks)
    assert world.run(until="analyse") is Status.RUNNING
    world.executor.remove_object("sample_1")
    assert world.executor.current_steps == ()
    assert ("analyse", "INVALID") in [entry[1:] for entry in world.log]
    assert world.run() is Status.SUCCESS


def test_objects_are_known_in_any_capitals(rocks):
    world = World(rocks)
    assert world.run(until="analyse") is Status.RUNNING
    world.executor.remove_object("SAMPLE_1")
    assert world.executor.current_steps == ()
    world.facts = {"BASE - place": True, "Crater - place": False}
    world.tick()
    assert world.executor.objects("place") == ("base",)
    assert world.executor.objects("OBJECT") == ("drive", "base")


def test_with_an_object_goes_what_is_believed_of_it_and_of_no_predicate_of_its_name():
    files = DOMAIN, PROBLEM.replace("crater", "crater at")
    world = World(parse_domain(*files))
    world.facts = {"(lies sample_1 at)": True}
    world.tick()
    before = world.executor.state
    world.facts = {}
    world.executor.remove_object("at")
    assert before - world.executor.state == {"(lies sample_1 at)"}


def test_what_a_running_step_takes_back_is_of_no_object_that_has_gone():
    effect = "(and (at start (forall (?o - sample) (not (lies ?o ?p)))) (at end (analysed ?s)))"
    files = (
        DOMAIN.replace("(at end (analysed ?s))", effect),
        PROBLEM.replace("sample_1 -", "sample_1 sample_2 -"),
    )
    world = World(parse_domain(*files))
    world.facts = {"(lies sample_2 base)": True, "(lies sample_1 base)": True}
    world.executor.goals.replace("(analysed sample_1)")
    assert world.run(until="analyse") is Status.RUNNING
    world.facts = {}
    world.executor.remove_object("sample_2")
    world.executor.stop(Status.INVALID)
    assert "(lies sample_1 base)" in world.executor.state
    assert not [fact for fact in world.executor.state if "sample_2" in fact]


def test_what_cannot_come_or_go_is_refused_by_name_and_nothing_changes(rocks):
    world = World(rocks)
    for name, kind, words in (
        ("sample_1", "sample", "a name that no object has"),
        ("sample 2", "sample", "a name that no object has"),
        ("sample_2", "smple", "no type 'smple'.*nearest: sample"),
        ("fly", "action", "does not know the action 'fly'"),
    ):
        with pytest.raises((UnknownNameError, PddlError), match=words):
            world.executor.add_object(name, kind)
    with pytest.raises(UnknownNameError, match="no object 'sample_3'"):
        world.executor.remove_object("sample_3")
    with pytest.raises(UnknownNameError, match="is a ROSA action"):
        world.executor.remove_object("drive")
    assert world.executor.objects("place") == ("base", "crater")
    assert world.run() is Status.SUCCESS


def test_a_domain_without_a_problem_gets_all_from_python():
    world = World(parse_domain(DOMAIN), kb=lambda _: FakeKb(["drive"]))
    executor = world.executor
    world.facts = {"(drive_action drive)": True, "(at base)": True}
    for name, kind in (("drive", "action"), ("base", "place"), ("crater", "place")):
        executor.add_object(name, kind)
    assert executor.findings == ()
    executor.goals.add("(at crater)")
    assert world.run(until="drive") is Status.RUNNING
    world.facts = {}
    assert world.run() is Status.SUCCESS
    assert executor.holds("(at crater)")


TANKS = (
    """(define (domain tanks) (:types tank) (:predicates (ready ?t - tank) (full ?t - tank))
  (:functions (level ?t - tank))
  (:durative-action fill :parameters (?t - tank) :duration (= ?duration (level ?t))
    :condition (over all (ready ?t)) :effect (at end (full ?t))))""",
    """(define (problem p) (:domain tanks)
  (:objects a b - tank) (:init (ready a) (ready b) (= (level a) 7) (= (level b) 7))
  (:goal (forall (?t - tank) (full ?t))))""",
)


@pytest.mark.parametrize(("kind", "is_driven"), [("truck", True), ("bike", False)])
def test_a_variable_of_several_types_is_of_what_appears_later_too(kind, is_driven):
    domain = parse_domain(
        """(define (domain d) (:types car truck bike - vehicle place) (:predicates (at ?v - vehicle ?p - place))
          (:action drive :parameters (?v - (either car truck) ?a ?b - place) :precondition (at ?v ?a)
            :effect (and (not (at ?v ?a)) (at ?v ?b))))""",
        """(define (problem p) (:domain d) (:objects c - car x y - place) (:init (at c x))
          (:goal (forall (?v - vehicle) (at ?v y))))""",
    )
    grown = with_object(domain, "new", kind)
    result = Planner().plan(Problem(grown, initial_state(grown) | {"(at new x)"}))
    assert result.outcome.is_solved is is_driven


def test_worlds_of_objects_that_were_there_before_are_forgotten(rocks):
    planner = Planner()
    made = []
    for number in range(40):
        grown = with_object(rocks, f"sample_{number + 10}", "sample")
        made.append(weakref.ref(grown))
        result = planner.plan(Problem(grown, initial_state(grown) | {"(action_feasible drive)"}))
        assert result.engine == "search"
    gc.collect()
    assert sum(one() is not None for one in made) < 20
