import re
import subprocess
import sys

import pytest
from pddl_world import ROOMS_DOMAIN, ROOMS_PROBLEM, FakeKb, load_mission, load_text

from rosa_pddl import (
    Outcome,
    PddlError,
    Planner,
    Problem,
    RosaPddlError,
    Step,
    UnknownNameError,
    UnsupportedPddlError,
    initial_state,
    load_domain,
    parse_domain,
)
from rosa_pddl.domain import nearest
from rosa_pddl.reader import atom_of, conditions
from rosa_pddl.validate import ended, goal_holds


def test_the_extended_mission_shares_names_between_objects_actions_and_types(extended):
    assert extended.rosa_actions == ("search_pipeline", "inspect_pipeline", "recharge")
    assert extended.schemas == ("search_pipeline", "inspect_pipeline", "recharge")
    assert extended.step("search_pipeline", ["search_pipeline", "pipeline", "bluerov"]) == Step(
        "search_pipeline", ("search_pipeline", "pipeline", "bluerov"), "search_pipeline"
    )


def test_the_base_mission_has_no_recharge():
    domain = load_mission("suave")
    assert domain.rosa_actions == domain.schemas == ("search_pipeline", "inspect_pipeline")


def test_the_spelling_of_the_files_is_kept_although_pddl_ignores_case(tmp_path):
    domain = ROOMS_DOMAIN.replace(":durative-action scan", ":durative-action Scan").replace(
        "(lit ?x - room)", "(Lit ?x - ROOM)"
    )
    loaded = load_text(
        tmp_path,
        domain,
        ROOMS_PROBLEM.replace("kitchen hall", "Kitchen hall").replace("look ", "Look "),
    )
    assert "Scan" in loaded.schemas
    assert loaded.rosa_actions == ("go", "Look")
    assert atom_of(loaded, "lit KITCHEN") == "(Lit Kitchen)"
    assert "(broken Kitchen)" in initial_state(loaded)


def test_what_the_reader_of_unified_planning_stumbles_over_is_tolerated(tmp_path):
    domain = """(define (domain odd) (:requirements :strips :derived-predicates) (:types ) (:constants )
      (:predicates (done)) (:functions )
      (:action instant :precondition () :effect (done))
      (:durative-action lasting :parameters () :duration (= ?duration 1) :condition () :effect ()))"""
    loaded = load_text(
        tmp_path, domain, "(define (problem p) (:domain odd) (:objects ) (:init ) (:goal (done)))"
    )
    assert loaded.schemas == ("instant", "lasting")
    assert loaded.rosa_actions == ()


def in_rooms(old, new):
    assert old in ROOMS_DOMAIN + ROOMS_PROBLEM
    return ROOMS_DOMAIN.replace(old, new, 1), ROOMS_PROBLEM.replace(old, new, 1)


MALFORMED = {
    "unclosed section": (
        in_rooms("(broken ?x - room))", "(broken ?x - room)"),
        "domain.pddl:6:4",
        "expected name, found keyword ':durative-action'",
    ),
    "unclosed effect": (
        in_rooms("(at end (free ?r))))", "(at end (free ?r)))"),
        "domain.pddl:12:3",
        "expected durative action keyword, found '('",
    ),
    "unclosed to the end": (
        in_rooms("(scanned ?x))))", "(scanned ?x)"),
        "problem.pddl:5:1",
        "unexpected end of input",
    ),
    "one parenthesis too many": (
        in_rooms("(not (lit ?x)))))", "(not (lit ?x))))))"),
        "domain.pddl:18:3",
        "unexpected text after the end of the definition",
    ),
    "unknown section": (
        in_rooms(":durative-action move", ":durativ-action move"),
        "domain.pddl:6:4",
        "unknown domain section :durativ-action (did you mean ':durative-action'?)",
    ),
    "unknown keyword": (
        in_rooms(":condition (and (over", ":conditions (and (over"),
        "domain.pddl:15:5",
        "unknown key :conditions in durative action (did you mean ':condition'?)",
    ),
    "unknown type": (
        in_rooms("?from ?to - room", "?from ?to - rom"),
        "domain.pddl:7:53",
        "in durative action 'move': unknown type 'rom' (did you mean 'room'?)",
    ),
    "unknown predicate": (
        in_rooms("(at start (lit ?x))", "(at start (lid ?x))"),
        "domain.pddl:17:28",
        "in durative action 'scan': unknown predicate 'lid' (did you mean 'lit'?)",
    ),
    "misspelt connective": (
        in_rooms("(forall (?x - room) (when", "(forall (?x - room) (wen"),
        "domain.pddl:21:38",
        "in action 'clean': unknown predicate 'wen'",
    ),
    "unknown variable": (
        in_rooms("(at end (scanned ?x))", "(at end (scanned ?y))"),
        "domain.pddl:17:55",
        "in durative action 'scan': variable ?y is not a parameter or quantified variable",
    ),
    "wrong number of arguments": (
        in_rooms("(over all (lit ?x))", "(over all (lit ?x ?r))"),
        "domain.pddl:15:53",
        "in durative action 'scan': 'lit' takes 1 argument(s), 2 given",
    ),
    "unknown object": (
        in_rooms("(broken kitchen)", "(broken kitchn)"),
        "problem.pddl:3:81",
        "in the initial state: unknown object or constant 'kitchn' (did you mean 'kitchen'?)",
    ),
    "object of unknown type": (
        in_rooms("robby - robot", "robby - robbot"),
        "problem.pddl:2:58",
        "unknown type 'robbot' (did you mean 'robot'?)",
    ),
    "argument of the wrong type": (
        in_rooms("(over all (lit ?x))", "(over all (lit ?r))"),
        "domain.pddl:15:58",
        "in durative action 'scan': argument 1 of 'lit' must be room, '?r' is robot",
    ),
    "fact about the wrong type": (
        in_rooms("(broken kitchen)", "(broken robby)"),
        "problem.pddl:3:81",
        "in the initial state: argument 1 of 'broken' must be room, 'robby' is robot",
    ),
    "object declared twice with another type": (
        in_rooms("kitchen hall - room", "kitchen hall - room hall - robot"),
        "problem.pddl:2:50",
        "found 'hall', which was declared before, in line 2",
    ),
    "no goal": (
        in_rooms("(:goal (forall (?x - room) (scanned ?x)))", ""),
        "problem.pddl:1:1",
        "there is no (:goal ...)",
    ),
    "no duration": (
        in_rooms(":duration (= ?duration 5)", ""),
        "domain.pddl:6:4",
        "durative action without :duration",
    ),
    "part of an action twice": (
        in_rooms(
            ":duration (= ?duration 5)", ":duration (= ?duration 5) :duration (= ?duration 6)"
        ),
        "domain.pddl:8:31",
        ":duration appears more than once",
    ),
    "endless number": (
        in_rooms("(= ?duration 5)", "(= ?duration 1e999999999)"),
        "domain.pddl:8:28",
        "number out of range: 1e999999999",
    ),
    "number of Python": (
        in_rooms("(= ?duration 5)", "(= ?duration 1_0)"),
        "domain.pddl:8:28",
        "in durative action 'move': unknown object or constant '1_0'",
    ),
    "type left out": (
        in_rooms("robby - robot", "robby -"),
        "problem.pddl:2:57",
        "expected type, found ')'",
    ),
    "too deep": (
        in_rooms("(broken kitchen)", "(and " * 200 + "(broken kitchen)" + ")" * 200),
        "problem.pddl:3:78",
        "initial facts can only mention objects",
    ),
    "not PDDL": (
        ("hello", ROOMS_PROBLEM),
        "domain.pddl:1:1",
        "expected '(define', found name 'hello'",
    ),
    "empty": (("; nothing\n", ROOMS_PROBLEM), "domain.pddl:2:1", "unexpected end of input"),
    "files exchanged": (
        (ROOMS_PROBLEM, ROOMS_DOMAIN),
        "domain.pddl:1:10",
        "expected 'domain', found name 'problem'",
    ),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_pddl_is_refused_with_place_and_expectation(case, tmp_path):
    (domain, problem), place, expected = MALFORMED[case]
    with pytest.raises(PddlError) as caught:
        load_text(tmp_path, domain, problem)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path}/{place}: {expected}"), message
    assert not isinstance(caught.value, UnsupportedPddlError)


UNSUPPORTED = {
    "either": (
        in_rooms("robby - robot", "robby - (either robot room)"),
        "problem.pddl:2:59",
        "either",
    ),
}


@pytest.mark.parametrize("case", UNSUPPORTED)
def test_pddl_that_cannot_be_handled_is_refused_at_load_with_its_place(case, tmp_path):
    (domain, problem), place, expected = UNSUPPORTED[case]
    with pytest.raises(UnsupportedPddlError, match=expected) as caught:
        load_text(tmp_path, domain, problem)
    assert str(caught.value).startswith(f"{tmp_path}/{place}"), caught.value


@pytest.mark.parametrize("make", ["missing", "folder", "latin"])
def test_an_unreadable_file_is_named_with_the_reason(make, tmp_path):
    path = tmp_path / "domain.pddl"
    if make == "folder":
        path.mkdir()
    elif make == "latin":
        path.write_bytes("; \xe9".encode("latin-1"))
    with pytest.raises(PddlError, match=r"domain\.pddl: cannot read this PDDL file: .+") as caught:
        load_domain(path, path)
    assert isinstance(caught.value, RosaPddlError)


def test_a_rosa_action_that_the_kb_does_not_know_is_refused_with_place_and_nearest(extended):
    with pytest.raises(
        PddlError, match=r"problem\.pddl:6: .*'recharge'.*nearest: recharge_battery"
    ):
        extended.check(FakeKb(["search_pipeline", "inspect_pipeline", "recharge_battery"]))
    extended.check(FakeKb(extended.rosa_actions))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("(pipelin_found pipeline)", "no declared predicate; nearest: pipeline_found"),
        ("(pipeline_found pipline)", "no declared object; nearest: pipeline"),
        ("(pipeline_found)", "expected 1 arguments"),
        ("(pipeline_found bluerov)", "arguments are of other types than"),
    ],
)
def test_an_unknown_atom_is_refused_with_the_nearest_names(extended, text, expected):
    with pytest.raises(UnknownNameError, match=expected):
        atom_of(extended, text)


def test_a_name_near_to_nothing_gets_the_whole_list():
    assert nearest("zzz", ["move", "scan"]) == "known: move, scan"
    assert nearest("zzz", []) == "there are none"


def test_importing_the_package_does_not_import_unified_planning():
    code = "import sys, rosa_pddl; sys.exit(any(name.startswith(('unified', 'up_')) for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_type_without_its_space_is_read_with_a_note_and_a_constant_may_be_named_again():
    domain = """(define (domain d) (:requirements :typing) (:types robot place) (:constants Dock -place)
      (:predicates (at ?r -robot ?x - place))
      (:action go :parameters (?r -robot ?x ?y -place) :precondition (at ?r ?x)
       :effect (and (at ?r ?y) (not (at ?r ?x)))))"""
    problem = """(define (problem p) (:domain d) (:objects dock yard - place r1 - robot)
      (:init (at r1 yard)) (:goal (at r1 dock)))"""
    read = parse_domain(domain, problem)
    assert read.objects_of("place") == ("Dock", "yard")
    assert [
        step.arguments for step in Planner().plan(Problem(read, initial_state(read))).steps
    ] == [("r1", "yard", "Dock")]


def test_a_difference_that_begins_with_a_list_is_not_taken_for_a_type_without_its_space():
    domain = """(define (domain d) (:requirements :typing :fluents) (:functions (full) (used))
      (:predicates (empty)) (:action fill :parameters () :precondition (< (-(full) (used)) 1) :effect (empty)))"""
    read = parse_domain(
        domain, "(define (problem p) (:domain d) (:init (= (full) 1) (= (used) 1)) (:goal (empty)))"
    )
    assert [note for note in read.oversights if "space" in note] == []


def test_a_constant_named_again_with_another_type_is_refused():
    domain = "(define (domain d) (:requirements :typing) (:types a b) (:constants x - a) (:predicates (p ?x - a)))"
    with pytest.raises(PddlError, match=r"declared before, in line 1 of domain\.pddl"):
        parse_domain(
            domain, "(define (problem p) (:domain d) (:objects x - b) (:init) (:goal (p x)))"
        )


LAMPS = """(define (domain lamps) (:types room robot)
  (:predicates (at ?r - robot ?x - room) (door ?x ?y - room) (lamp ?x - room) (bright ?x - room) (safe ?r - robot))
  (:derived (bright ?y - room) (lamp ?y))
  (:derived (bright ?x - room) (exists (?y - room) (and (door ?x ?y) (lamp ?y))))
  (:derived (safe ?r - robot) (forall (?y - room) (imply (at ?r ?y) (bright ?y))))
  (:action move :parameters (?r - robot ?x ?y - room) :precondition (and (at ?r ?x) (door ?x ?y) (bright ?x))
    :effect (and (not (at ?r ?x)) (at ?r ?y)))
  (:action light :parameters (?r - robot ?y - room) :precondition (at ?r ?y) :effect (lamp ?y)))"""
LAMPS_PROBLEM = """(define (problem p) (:domain lamps) (:objects a b c d - room robby - robot)
  (:init (at robby a) (door a b) (door b c) (door c d) (lamp b)) (:goal (and (at robby d) (safe robby))))"""


def test_derived_predicates_hold_where_what_they_are_derived_from_does():
    domain = parse_domain(LAMPS, LAMPS_PROBLEM)
    for engine in ("fast-downward-opt", "kairos"):
        result = Planner(engine).plan(Problem(domain, initial_state(domain)))
        assert result.outcome is Outcome.SOLVED_OPTIMALLY, result.message
        steps = [str(step) for step in result.steps]
        assert len(steps) == 5
        assert steps[:2] == ["move(robby, a, b)", "move(robby, b, c)"]
        assert sorted(steps[2:]) == ["light(robby, c)", "light(robby, d)", "move(robby, c, d)"]
    (dark,) = conditions(domain, "(not (bright c))")
    assert goal_holds(domain, initial_state(domain), [dark.expression])
    assert not goal_holds(domain, initial_state(domain) | {"(lamp d)"}, [dark.expression])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            ":effect (lamp ?y)",
            ":effect (bright ?y)",
            "derived",
        ),
        ("(bright ?x))", "(bright ?r))", "argument 1 of 'bright' must be room"),
        (
            "(:derived (bright ?y - room) (lamp ?y))",
            "(:derived (bright ?y - room))",
            "expected",
        ),
    ],
)
def test_slip_with_a_derived_predicate_is_said_with_its_place(old, new, said):
    assert LAMPS.count(old) == 1
    with pytest.raises(PddlError, match=re.escape(said)) as caught:
        parse_domain(LAMPS.replace(old, new), LAMPS_PROBLEM)
    assert str(caught.value).startswith("domain.pddl:")


TUGS = """(define (domain tugs) (:types tug crane lorry place - thing)
  (:predicates (free ?x - (either tug crane)) (moved ?x - place) (seen ?x - thing) (done))
  (:action move :parameters (?x - (either tug crane) ?p - place) :precondition (free ?x)
    :effect (and (moved ?p) (not (free ?x)) (forall (?y - (either tug lorry)) (seen ?y))))
  (:action end :parameters () :precondition (forall (?p - (either place tug)) (seen ?p)) :effect (done)))"""
TUGS_PROBLEM = """(define (problem p) (:domain tugs) (:objects t - tug c - crane l - lorry a - place)
  (:init (free c) (seen a)) (:goal (and (done) (not (exists (?x - (either crane lorry)) (not (moved a)))))))"""


def test_variables_of_several_types_stand_for_objects_of_these_only():
    domain = parse_domain(TUGS, TUGS_PROBLEM)
    state = initial_state(domain)
    result = Planner().plan(Problem(domain, state))
    assert [str(step) for step in result.steps] == ["move(c, a)", "end()"]
    without = Planner().plan(Problem(domain, state - {"(free c)"}))
    assert without.outcome is Outcome.UNSOLVABLE_PROVEN  # what is free is a lorry
    after = ended(domain, result.steps[0], state)
    assert after - state == {"(moved a)", "(seen t)", "(seen l)"}
