"""A plan as a tree: it does what the plan executor does, and is the same after it has been written as XML."""

from concurrent.futures import Future
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plan_worlds import GOALS, House, house
from py_trees.common import Status

from missions.engine.mission import MissionError
from missions.planning.tree import plan_registry, plan_tree, plan_xml
from rosa_bt import TreeRunner, export_xml, load_xml
from rosa_pddl import MissingBehaviourError, Outcome, PddlError, PlanExecutor, PlanningResult, UnknownNameError
from rosa_pddl.validate import ended, holds, missing_at_end, missing_meanwhile, missing_of, started

ROOMS = ("kitchen", "hall", "attic")
FACTS = [f"({what} {room})" for what in ("open", "sealed", "broken", "scanned", "lit") for room in ROOMS]
SCRIPTS = st.lists(st.tuples(st.integers(1, 3), st.sampled_from([Status.SUCCESS] * 5 + [Status.FAILURE])), max_size=8)


def disturbances(facts):
    return st.lists(st.tuples(st.integers(0, 8), st.sampled_from(["go", "look", *facts]), st.booleans()), max_size=3)


WORLDS = st.tuples(st.sampled_from(GOALS), SCRIPTS, disturbances(FACTS))
# What contradicts effects at the start of a step counts at once in a tree, and from the next tick on in the executor.
CALMER = st.tuples(st.sampled_from(GOALS), SCRIPTS, disturbances(FACTS[:-3]))


def run_tree(goal, script, disturbances, written=False):
    """Tick the tree of a plan to its end; returns the log and how it ended."""
    domain, steps, _ = house(goal)
    world = House(script, disturbances)
    given = {"kb": world.kb, "behaviours": world.behaviours(domain), "sense": lambda: world.facts}
    tree = plan_tree(domain, steps, **given)
    if written:
        tree = load_xml(export_xml(tree), plan_registry(domain, **given))
    status = Status.RUNNING
    while status is Status.RUNNING:
        world.disturb()
        tree.tick_once()
        status = tree.status
        world.tick += 1
        assert world.tick < 100
    return world.log, status


class Naive:
    """Executes a plan step by step, by the book: the judge's own functions, and no tree."""

    def __init__(self, goal, script, disturbances):
        self.domain, self.steps, _ = house(goal)
        self.world = House(script, disturbances)
        self.believed = {atom for atom in house(goal)[2] if not self.domain.is_feasibility(atom)}

    def state(self):
        domain, kb = self.domain, self.world.kb
        for atom, value in self.world.facts.items():
            (self.believed.add if value else self.believed.discard)(atom)
        feasible = {domain.feasible_atom(one) for one in domain.rosa_actions if kb.is_feasible(one)}
        return frozenset(self.believed) | feasible

    def believe(self, state):
        self.believed = {atom for atom in state if not self.domain.is_feasibility(atom)}

    def run(self):
        status = Status.SUCCESS
        self.world.disturb()
        for step in self.steps:
            status = self.do(step)
            if status is Status.FAILURE:
                break
        return self.world.log, status

    def do(self, step):
        domain, world = self.domain, self.world
        schema = domain.schema_of[step.schema]
        binding = dict(zip((name for name, _ in schema.parameters), step.arguments, strict=True))
        own = [one for one in schema.start if not str(one).startswith("action_feasible")]
        if missing_of(domain, own, binding, self.state()) is not None:
            return Status.FAILURE
        self.believe(started(domain, step, self.state()))
        ticks, end = world.next_task()
        if missing_meanwhile(domain, step, self.state()) is not None:
            return Status.FAILURE
        world.log.append((world.tick, step, "begins"))
        for left in range(ticks - 1, -1, -1):
            if missing_meanwhile(domain, step, self.state()) is not None:
                world.log.append((world.tick, step, "INVALID"))
                return Status.FAILURE
            if left:
                world.tick += 1
                world.disturb()
        world.log.append((world.tick, step, end.value))
        if end is Status.FAILURE or missing_at_end(domain, step, self.state()) is not None:
            return Status.FAILURE
        self.believe(ended(domain, step, self.state()))
        return Status.SUCCESS


@given(WORLDS)
def test_tree_does_the_steps_in_the_order_of_the_plan_watches_over_all_conditions_and_aborts_at_a_failure(drawn):
    assert run_tree(*drawn) == Naive(*drawn).run()


@given(WORLDS)
def test_tree_that_was_written_and_read_again_does_the_same(drawn):
    assert run_tree(*drawn, written=True) == run_tree(*drawn)


class OnePlan:
    """A planner with one plan; afterwards it has none."""

    timeout_s = 1.0
    engine = "one plan"

    def __init__(self, steps):
        self.results = [PlanningResult(Outcome.SOLVED, steps)]

    def start(self, problem):
        future = Future()
        future.set_result(self.results.pop() if self.results else PlanningResult(Outcome.UNSOLVABLE_PROVEN))
        return future


def run_executor(goal, script, disturbances):
    domain, steps, _ = house(goal)
    world = House(script, disturbances)
    executor = PlanExecutor(
        "plan",
        kb=world.kb,
        domain=domain,
        behaviours=world.behaviours(domain),
        sense=lambda: world.facts,
        clock=lambda: float(world.tick),
        planner=OnePlan(steps),
        delay_s=0.0,
    )
    executor.tick_once()  # it plans; nothing has begun
    status = executor.status
    while status is Status.RUNNING:
        world.disturb()
        executor.catch_up()
        executor.tick_once()
        status = executor.status
        world.tick += 1
        assert world.tick < 100
    executor.shutdown()
    return world.log, status


@given(st.sampled_from(GOALS), st.lists(st.integers(1, 3), max_size=8))
def test_undisturbed_tree_does_in_each_tick_what_the_plan_executor_does(goal, ticks):
    script = [(number, Status.SUCCESS) for number in ticks]
    log, status = run_tree(goal, script, [])
    assert status is Status.SUCCESS
    assert len(log) == 2 * len(house(goal)[1])
    assert run_executor(goal, script, []) == (log, status)


@given(CALMER)
def test_what_the_plan_executor_does_before_it_plans_anew_the_tree_does_too(drawn):
    executed, status = run_executor(*drawn)
    log, ended_with = run_tree(*drawn)
    begun = [(tick, step) for tick, step, what in executed if what == "begins"]
    assert begun == [(tick, step) for tick, step, what in log if what == "begins"][: len(begun)]
    if status is Status.SUCCESS and len(begun) == len(house(drawn[0])[1]):
        assert executed == log
        assert ended_with is Status.SUCCESS


def test_xml_has_an_element_for_each_step_with_an_attribute_for_each_parameter():
    domain, steps, _ = house("(scanned kitchen)")
    root = ElementTree.fromstring(plan_xml(domain, steps))
    found = [(element.tag, list(element.attrib.values())) for element in root.iter() if element.tag in domain.schemas]
    assert found == [(step.schema, list(step.arguments)) for step in steps]
    (move,) = root.iter("move")
    assert move.attrib == {"a": "go", "p_name": "robby", "from": "hall", "to": "kitchen"}
    asked = {element.get("condition") for element in root.iter("Holds")}
    assert {"(at robby hall)", "(open kitchen)", "(not (sealed kitchen))"} <= asked
    assert not any("go_action" in condition for condition in asked)
    assert {element.get("action") for element in root.iter("IsActionFeasible")} == {"go", "look"}


def test_quantified_and_conditional_formulas_name_every_object():
    domain, steps, _ = house("(scanned kitchen)")
    text = plan_xml(domain, [step for step in steps if step.schema == "clean"])
    assert "(or (and (at robby kitchen) (broken kitchen)) (and (at robby hall) (broken hall))" in text
    assert "(when (at robby attic) (not (broken attic)))" in text


def test_plan_of_no_steps_is_a_tree_that_succeeds():
    domain, _, _ = house("(scanned hall)")
    world = House()
    tree = plan_tree(domain, [], kb=world.kb, behaviours=world.behaviours(domain))
    tree.tick_once()
    assert tree.status is Status.SUCCESS


def test_step_under_way_is_stopped_when_the_tree_is_shut_down():
    domain, steps, _ = house("(scanned hall)")
    world = House([(3, Status.SUCCESS)])
    runner = TreeRunner(plan_tree(domain, steps, kb=world.kb, behaviours=world.behaviours(domain)), clock=lambda: 0.0)
    runner.tick()
    runner.shutdown()
    assert [what for _, _, what in world.log] == ["begins", "INVALID"]


def test_what_cannot_be_a_tree_is_said():
    domain, steps, _ = house("(scanned hall)")
    world = House()
    with pytest.raises(MissingBehaviourError, match=r"no behaviour for the PDDL action 'scan'.*nearest: scann"):
        plan_tree(domain, steps, kb=world.kb, behaviours={"scann": None, "move": None, "clean": None})
    registry = plan_registry(domain, kb=world.kb, behaviours=world.behaviours(domain))
    for leaf, kind in (
        ('<Holds condition="(shut hall)"/>', UnknownNameError),
        ('<Assume effects="(lit cellar)"/>', UnknownNameError),
        ('<Assume effects="(lit hall"/>', PddlError),
    ):
        xml = f'<root BTCPP_format="4"><BehaviorTree ID="Plan">{leaf}</BehaviorTree></root>'
        with pytest.raises(Exception, match=r"shut|cellar|unbalanced") as raised:
            load_xml(xml, registry)
        assert isinstance(raised.value.__cause__, kind)


def test_pddl_action_called_like_a_node_of_btcpp_is_refused(tmp_path):
    from rosa_pddl import load_domain

    (tmp_path / "d.pddl").write_text("(define (domain d) (:predicates (on)) (:action Sequence :effect (on)))")
    (tmp_path / "p.pddl").write_text("(define (problem p) (:domain d) (:init) (:goal (on)))")
    domain = load_domain(tmp_path / "d.pddl", tmp_path / "p.pddl")
    world = House()
    with pytest.raises(MissionError, match="the PDDL action 'Sequence' cannot be a node of a tree"):
        plan_tree(domain, [domain.step("Sequence", [])], kb=world.kb, behaviours={"Sequence": None})


def test_formulas_written_for_the_tree_mean_what_they_meant():
    domain, _, state = house("(forall (?x - room) (scanned ?x))")
    from missions.planning.tree import written
    from rosa_pddl.formulas import conditions

    (goal,) = domain.up_problem.goals
    text = written(domain, goal, {})
    assert text == "(and (scanned kitchen) (scanned hall) (scanned attic))"
    everything = state | {f"(scanned {room})" for room in ("kitchen", "hall", "attic")}
    for facts in (state, everything):
        read = all(holds(domain, one.expression, {}, facts) for one in conditions(domain, text))
        assert read is holds(domain, goal, {}, facts)
