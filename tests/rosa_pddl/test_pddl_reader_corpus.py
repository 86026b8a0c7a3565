"""Domains as users of ROSA and PlanSys2 write them: each loads as it is, is planned for, and is executed."""

import re
from pathlib import Path

import pytest
from pddl_world import FakeKb, World, load_text
from py_trees.common import Status

from rosa_pddl import (
    PddlError,
    Planner,
    Problem,
    UnknownNameError,
    flaw,
    initial_state,
    load_domain,
    parse_domain,
)
from rosa_pddl.validate import takes_s

CORPUS = Path(__file__).with_name("corpus")
FILES = ("domain.pddl", "problem.pddl")
PLANS = {
    "delivery": (17.0, "load drive drive unload"),
    "inspection": (3.0, "start_robot search_pipeline inspect_pipeline"),
    "kitchen": (5.0, "at heat Cook at SERVE"),
    "patrol": (5.0, "charge move patrol move patrol"),
    "survey": (56.0, "survey move survey report"),
    "untyped": (3.0, "pick move drop"),
}


def load(name, **told):
    return load_domain(CORPUS / name / "domain.pddl", CORPUS / name / "problem.pddl", **told)


def test_every_domain_of_the_corpus_is_tried():
    assert sorted(path.name for path in CORPUS.iterdir()) == sorted(PLANS)


@pytest.mark.parametrize("name", PLANS)
def test_a_domain_loads_unmodified_and_is_planned_for(name):
    domain = load(name)
    state = initial_state(domain) | {domain.feasible_atom(action) for action in domain.rosa_actions}
    result = Planner().plan(Problem(domain, state))
    cost, schemas = PLANS[name]
    assert (result.cost, " ".join(step.schema for step in result.steps)) == (cost, schemas), (
        result.message
    )
    assert flaw(domain, result.steps, state) is None
    for count in range(len(result.steps) + 1):
        steps = result.steps[:count]
        is_valid = flaw(domain, steps, state) is None
        assert kairos_accepts(domain, steps, state) is is_valid, steps


def kairos_accepts(domain, steps, state):
    """Ask the validator of Kairos, which has read the files itself."""
    import kairos  # late, as it complains at exit of what a module holds

    lines = []
    at_s = 0.0
    for step in steps:
        duration_s = takes_s(domain, step, state)
        times = f" [{duration_s}]" if domain.schema_of[step.schema].duration else ""
        lines.append(f"{at_s}: ({step.schema} {' '.join(step.arguments)}){times}")
        at_s += duration_s + 0.01
    files, problem = domain.texts
    files = files.replace("\nwaypoint\n", "\n")  # it is above itself, which Kairos refuses
    init = "(:init " + " ".join(domain.feasible_atom(action) for action in domain.rosa_actions)
    plan = kairos.parse_plan("\n".join(lines) or ";")
    return kairos.validate_plan(files, re.sub(r"\(:init", init, problem, flags=re.I), plan).valid


@pytest.mark.parametrize("name", PLANS)
def test_a_domain_is_executed_to_its_goal(name):
    world = World(load(name))
    assert world.run() is Status.SUCCESS
    assert world.plans() == [PLANS[name][1].split()]


def test_windows_line_ends_tabs_and_a_byte_order_mark_make_no_difference(tmp_path):
    domain, problem = (
        (CORPUS / "patrol" / f"{kind}.pddl").read_text().replace("    ", "\t").replace("\n", "\r\n")
        for kind in ("domain", "problem")
    )
    (tmp_path / "d.pddl").write_bytes(b"\xef\xbb\xbf" + domain.encode())
    (tmp_path / "p.pddl").write_bytes(problem.encode())
    assert load_domain(tmp_path / "d.pddl", tmp_path / "p.pddl").schemas == (
        "move",
        "patrol",
        "charge",
    )


@pytest.mark.parametrize(
    ("types", "of_type"), [("", ""), ("(:types t)", "- t"), ("(:types t s - object)", "- t")]
)
def test_quantified_variables_without_a_type_are_of_any(tmp_path, types, of_type):
    domain = f"""(define (domain bare) {types} (:predicates (p ?x))
      (:action a :parameters (?x) :precondition (forall (?y) (p ?y)) :effect (forall (?z) (not (p ?z)))))"""
    problem = f"""(define (problem none) (:domain bare) (:objects one two {of_type}) (:init (p one) (p two))
      (:goal (forall (?x) (not (p ?x)))))"""
    world = World(load_text(tmp_path, domain, problem))
    assert world.run() is Status.SUCCESS
    assert world.plans() == [["a"]]


@pytest.mark.parametrize("goal", ["()", "(and)"])
def test_a_problem_without_a_goal_is_done_at_once(tmp_path, goal):
    world = World(load_text(tmp_path, PLAIN, PROBLEM.replace("(:goal (done))", f"(:goal {goal})")))
    assert world.run() is Status.SUCCESS
    assert world.executor.plans == ()


@pytest.mark.parametrize(("goal", "count"), [("(:goal)", 8), ("(:goal (done) (ok a))", 16)])
def test_a_goal_of_none_or_several_conditions_is_refused_with_what_to_write(tmp_path, goal, count):
    with pytest.raises(PddlError, match=rf"problem\.pddl:2:{count}: expected"):
        load_text(tmp_path, PLAIN, PROBLEM.replace("(:goal (done))", goal))


def test_sections_come_in_pieces_and_what_others_leave_out_may_be_left_out():
    domain = parse_domain(
        """(define (domain d) (:types x) (:predicates (p ?x - x)) (:types y) (:predicates (q ?y - y)) (:functions (c))
          (:action a :parameters (?x - x ?y - y) :effect (and (p ?x) (q ?y) (increase (c) 2))))""",
        """(define (problem p) (:domain d) (:objects o - x) (:objects u - y) (:goal (and (p o) (q u)))
          (:metric minimize c))""",
    )
    assert Planner().plan(Problem(domain, initial_state(domain))).cost == 2.0


# ------------------------------------------------------------------ which ROSA action a PDDL action does


def test_the_rosa_action_is_found_by_the_predicate_of_its_kind_by_feasibility_or_as_a_constant():
    found = {name: schema.action for name, schema in load("inspection").schema_of.items()}
    assert found == {
        "start_robot": "a",
        "search_pipeline": "a",
        "inspect_pipeline": "a",
        "recharge": "a",
    }
    assert load("inspection").step("recharge", ["x", "y", "z", "r"]).action == "x"
    assert {name: schema.action for name, schema in load("survey").schema_of.items()} == {
        "move": "move",
        "survey": "a",
        "report": None,
    }


def test_a_domain_without_the_conventions_is_told_and_follows_the_knowledge_base():
    domain = load("patrol", actions={"move": "drive", "charge": "charge"})
    assert domain.rosa_actions == ("drive", "charge")
    world = World(domain)
    assert world.run() is Status.SUCCESS
    world = World(domain)
    world.run(until="move")
    world.kb.unfeasible = {"drive"}
    assert world.run() is Status.FAILURE
    assert world.executor.plans[1].reason == "drive became unfeasible"
    assert "unfeasible now: drive" in world.executor.feedback_message
    with pytest.raises(UnknownNameError, match="no PDDL action 'mov'; nearest: move"):
        load("patrol", actions={"mov": "drive"})


def test_actions_on_one_side_only_are_named():
    domain = load("inspection")
    assert domain.check(FakeKb(domain.rosa_actions)) == ()
    (finding,) = domain.check(FakeKb([*domain.rosa_actions, "surface"]))
    assert finding.startswith("the action 'surface' of the knowledge base is never planned")
    with pytest.raises(PddlError, match=r"problem\.pddl:6: .*does not know the action 'recharge'"):
        domain.check(FakeKb(domain.rosa_actions[:-1]))


def test_a_predicate_like_that_of_a_rosa_action_may_have_more_arguments(tmp_path):
    text = """(define (domain d) (:types action thing)
      (:predicates (go_action ?a - action ?t - thing) (action_feasible ?a - action))
      (:action go :parameters (?a - action ?t - thing) :precondition (and (go_action ?a ?t) (action_feasible ?a))
        :effect (go_action ?a ?t)))"""
    goal = "(:objects go - action t - thing) (:init) (:goal (go_action go t))"
    domain = load_text(tmp_path, text, f"(define (problem p) (:domain d) {goal})")
    assert domain.check(FakeKb(("go",))) == ()


def test_an_object_of_type_action_that_no_pddl_action_does_is_named(tmp_path):
    problem = (
        (CORPUS / "inspection" / "problem.pddl")
        .read_text()
        .replace("recharge - action", "recharge fly - action")
    )
    domain = load_text(tmp_path, (CORPUS / "inspection" / "domain.pddl").read_text(), problem)
    (finding,) = domain.check(FakeKb(domain.rosa_actions))
    assert "no PDDL action" in finding
    assert finding.endswith("the ROSA action 'fly'")


# ------------------------------------------------------------------ refused, with place and what would do

PLAIN = """(define (domain plain) (:types thing) (:predicates (ok ?t - thing) (done))
  (:functions (fuel ?t - thing))
  (:action go :parameters (?t - thing) :precondition (ok ?t) :effect (done)))"""
PROBLEM = (
    "(define (problem p) (:domain plain) (:objects a - thing) (:init (ok a))\n (:goal (done)))"
)


def test_types_that_are_above_one_another_are_refused_but_one_above_itself_is_on_top(tmp_path):
    two = PLAIN.replace("(:types thing)", "(:types thing - part part - thing)")
    with pytest.raises(PddlError, match="in a cycle"):
        load_text(tmp_path, two, PROBLEM)
    itself = PLAIN.replace("(:types thing)", "(:types object thing part - thing)")
    assert load_text(tmp_path, itself, PROBLEM).schemas == ("go",)


# ------------------------------------------------------------------ the same as unified-planning's own reader
