"""Idioms: what a mission needs to adapt, in one call each."""

import pytest
from acting import Act, Clock, Managed
from hypothesis import given
from hypothesis import strategies as st
from py_trees.behaviours import Failure, Running, Success
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from xml_leaves import wrapped

from kb import ConfigurationManager, InvalidValue, KnowledgeBase, Model, UnknownName
from rosa_bt import (
    BehaviourRegistry,
    ForAction,
    HasStatus,
    Measurement,
    RosaAction,
    TreeChangeError,
    TreeRunner,
    do_until_unfeasible,
    feasible_then_act,
    first_feasible,
    forget_progress,
    load_xml,
    switch_safely,
)


def drone() -> Model:
    model = Model("drone")
    light = model.environmental_attribute("light")
    energy = model.quality_attribute("energy")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration("day", {"exposure_s": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure_s": 0.2}, priority=2)
    look = model.function("look")
    look.design("by_camera", [camera])
    model.action("inspect", requires=[look], constraints=[energy >= 0.25])
    model.action("search", constraints=[energy >= 0.25, light >= 0.1])
    model.action("charge")
    model.action("land")
    return model


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def kb(clock):
    return KnowledgeBase(drone(), clock=clock)


def required(kb):
    return [action.action for action in kb.required_actions]


def history(kb):
    return [(action.action, action.result) for action in kb.history.actions]


def test_unmodified_behaviour_is_stopped_with_the_reason(kb):
    child = Running("look")
    root = ForAction("search", kb, "search", child)
    root.tick_once()
    kb.measure("light", 0.0)
    root.tick_once()
    assert (root.status, child.status) == (Status.FAILURE, Status.INVALID)
    assert (
        root.feedback_message
        == "search is unfeasible because light 0 violates >= 0.1 (measured 0.0 s ago)"
    )
    assert history(kb) == [("search", "abandoned")]
    root.stop(Status.INVALID)
    assert len(kb.history.actions) == 1


def test_child_is_stopped_before_its_action_is_released(kb):
    child = Running("look")
    seen = []
    child.terminate = lambda status: seen.append((status, required(kb)))
    root = ForAction("search", kb, "search", child)
    root.tick_once()
    root.stop(Status.INVALID)
    assert (seen, required(kb)) == ([(Status.INVALID, ["search"])], [])


@pytest.mark.parametrize(
    ("element", "status", "error", "message"),
    [
        ("camra", "failure", UnknownName, "unknown element 'camra'; did you mean 'camera'"),
        (
            "camera",
            "broken",
            InvalidValue,
            "a component is never broken; it can be failure",
        ),
    ],
)
def test_status_condition_that_means_nothing_is_refused(kb, element, status, error, message):
    with pytest.raises(error, match=message):
        HasStatus("x", kb, element, status)


@pytest.mark.parametrize(("operator", "holds"), [(">=", "FSS"), (">", "FFS"), ("<", "SFF")])
def test_measurement_condition_compares(kb, operator, holds):
    condition = Measurement("x", kb, "energy", operator, 0.25)
    for value, expected in zip([0.2, 0.25, 0.3], holds, strict=True):
        kb.measure("energy", value)
        condition.tick_once()
        assert condition.status.name[0] == expected


def test_measurement_that_is_missing_or_stale_counts_as_said(clock):
    model = Model("x")
    model.quality_attribute("energy", max_age=5.0)
    kb = KnowledgeBase(model, clock=clock)
    strict = Measurement("x", kb, "energy", ">", 0)
    lenient = Measurement("x", kb, "energy", ">", 1, unknown=Status.RUNNING)
    for text in ("energy is not measured yet", "energy is not measured any more"):
        for condition in (strict, lenient):
            condition.tick_once()
        assert (strict.status, lenient.status) == (Status.FAILURE, Status.RUNNING)
        assert strict.feedback_message == text
        kb.measure("energy", 0.5)
        clock.now += 10.0


@pytest.mark.parametrize(
    "make", [lambda kb, **named: Act(kb, "inspect", **named), None], ids=["RosaAction", "ForAction"]
)
def test_waiting_action_starts_when_the_robot_is_configured(kb, make):
    child = Running("look")
    task = make(kb, wait=True) if make else ForAction("inspect", kb, "inspect", child, wait=True)
    manager = ConfigurationManager(kb, Managed())

    def has_begun():
        return task.begun == 1 if make else child.status is Status.RUNNING

    task.tick_once()
    assert (task.status, has_begun()) == (Status.RUNNING, False)
    assert task.feedback_message.startswith("waiting: inspect is unsolved because")
    kb.select(designs={"look": "by_camera"}, configurations={"camera": "night"})
    kb.component_active("camera", True)
    task.tick_once()
    assert not has_begun()
    assert "being reconfigured (activate camera; configure night)" in task.feedback_message
    kb.finish_plan(kb.pending_plan, "completed")
    task.tick_once()
    assert has_begun()
    assert manager is not None
    task.stop(Status.INVALID)
    assert history(kb) == [("inspect", "abandoned")]


@pytest.mark.parametrize(("memory", "expected"), [(False, "search"), (True, "charge")])
def test_first_feasible_action_is_done(kb, memory, expected):
    root = first_feasible("best", [Act(kb, "search"), Act(kb, "charge")], memory=memory)
    root.tick_once()
    assert required(kb) == ["search"]
    kb.measure("light", 0.0)
    root.tick_once()
    assert required(kb) == ["charge"]
    kb.measure("light", 1.0)
    root.tick_once()
    assert required(kb) == [expected]


@given(
    st.lists(
        st.tuples(st.sampled_from([0.1, 0.9]), st.sampled_from([Status.RUNNING, Status.SUCCESS])),
        min_size=1,
        max_size=12,
    ),
    st.booleans(),
)
def test_one_action_is_required_after_every_tick(moments, memory):
    kb = KnowledgeBase(drone(), clock=Clock())
    charge = Act(kb, "charge")
    root = do_until_unfeasible(Act(kb, "search"), charge, memory=memory)
    runner = TreeRunner(root, clock=lambda: 0.0)
    for level, charge.result in moments:
        was_charging = charge.status is Status.RUNNING
        kb.measure("energy", level)
        runner.tick()
        if kb.is_feasible("search"):
            goes_on = memory and was_charging and charge.result is Status.RUNNING
            assert required(kb) == ["charge" if goes_on else "search"]
        else:
            assert required(kb) == (["charge"] if charge.result is Status.RUNNING else [])
    runner.shutdown()
    assert required(kb) == []


def analysing_after_inspecting(kb, land):
    """Prefer inspecting, which needs light here.

    Analyse on the ground otherwise, for which the drone has to land.
    """
    tasks = [Act(kb, "search"), Act(kb, "charge")]
    return switch_safely(first_feasible("mission", tasks), {("search", "charge"): land}), tasks


def test_transition_runs_only_in_its_direction(kb):
    land = Act(kb, "land")
    root, (_, charge) = analysing_after_inspecting(kb, land)
    root.tick_once()
    kb.measure("light", 0.0)
    root.tick_once()
    assert required(kb) == ["land"]
    assert charge.begun == 0
    land.result = Status.SUCCESS
    root.tick_once()
    assert required(kb) == ["charge"]
    kb.measure("light", 1.0)
    root.tick_once()
    assert required(kb) == ["search"]
    assert land.begun == 1


def test_action_does_not_begin_when_its_transition_fails(kb):
    root, (_, charge) = analysing_after_inspecting(kb, Failure("land"))
    root.tick_once()
    kb.measure("light", 0.0)
    root.tick_once()
    assert root.status is Status.FAILURE
    assert charge.begun == 0


def test_transition_names_actions_of_the_tree_and_has_one_place(kb):
    root = first_feasible("mission", [Act(kb, "search"), Act(kb, "charge"), Act(kb, "charge")])
    with pytest.raises(
        UnknownName, match="unknown action of the tree 'serch'; did you mean 'search'"
    ):
        switch_safely(root, {("serch", "charge"): Success("land")})
    with pytest.raises(RuntimeError, match="'land' already has parent 'switch to charge'"):
        switch_safely(root, {("search", "charge"): Success("land")})


@pytest.mark.parametrize("node", ["ParallelAll", "NonblockingSequence", "PipelineSequence"])
def test_transition_below_a_node_of_xml_that_is_parallel_is_refused(kb, node):
    registry = BehaviourRegistry(kb=kb)
    registry.register("Act", lambda name, action: Act(kb, action))
    actions = '<Act action="search"/><Act action="charge"/>'
    root = load_xml(wrapped(f"<{node}>{actions}</{node}>"), registry)
    with pytest.raises(TreeChangeError, match=f"'search' is below '{node}': its actions run at"):
        switch_safely(root, {("search", "charge"): Success("land")})


def test_transition_in_a_parallel_is_refused(kb):
    policy = ParallelPolicy.SuccessOnAll()
    root = Parallel("both", policy, [Act(kb, "search"), Act(kb, "charge")])
    with pytest.raises(TreeChangeError, match="'search' is below 'both': its actions run at the"):
        switch_safely(root, {("search", "charge"): Success("land")})


class Counting(RosaAction):
    """Does 4 steps: one in each tick."""

    def __init__(self, kb, action, name=None):
        super().__init__(name or action, kb, action)
        self.step = 0
        self.done = []

    def initialise(self):
        self.step = 0

    def update(self):
        self.done.append(self.step)
        self.step += 1
        return Status.SUCCESS if self.step == 4 else Status.RUNNING

    def save_progress(self):
        return self.step

    def restore_progress(self, progress):
        self.step = progress


@pytest.mark.parametrize("action", ["search", "inspect"])
def test_action_continues_where_an_adaptation_interrupted_it(kb, action):
    task = Counting(kb, action)
    runner = TreeRunner(do_until_unfeasible(task, Act(kb, "charge")), clock=lambda: 0.0)
    for level in (1.0, 1.0, 0.1, 0.1, 1.0, 1.0):
        kb.measure("energy", level)
        runner.tick()
    assert task.done == [0, 1, 2, 3]
    assert runner.status is Status.SUCCESS


@pytest.mark.parametrize("how", ["completed", "another runner", "forgotten", "root succeeded"])
def test_progress_is_dropped_when_action_or_mission_ends(kb, how):
    task = Counting(kb, "search")
    root = Sequence("root", memory=True, children=[task])
    runner = TreeRunner(root, clock=lambda: 0.0)
    runner.tick()
    root.stop(Status.INVALID)
    if how == "completed":
        for _ in range(3):
            task.tick_once()
        assert task.status is Status.SUCCESS
    elif how == "another runner":
        TreeRunner(root, clock=lambda: 0.0)
    elif how == "forgotten":
        forget_progress(kb)
    else:
        runner.tree.replace_subtree(task.id, Success("else"))
        runner.tick()
        TreeRunner(task, clock=lambda: 0.0)
    task.tick_once()
    assert task.done[-1] == 0


@pytest.mark.parametrize(
    "around", [lambda task: task, lambda task: Sequence("all", memory=True, children=[task])]
)
def test_action_that_becomes_unfeasible_is_given_up(kb, around):
    task = Counting(kb, "search")
    root = around(task)
    root.tick_once()
    kb.measure("light", 0.0)
    root.tick_once()
    assert (root.status, task.status, task.done) == (Status.FAILURE, Status.FAILURE, [0])
    assert (
        task.feedback_message
        == "search is unfeasible because light 0 violates >= 0.1 (measured 0.0 s ago)"
    )
    assert history(kb) == [("search", "abandoned")]
    kb.measure("light", 1.0)
    root.tick_once()
    assert task.done == [0, 1], "it goes on where it was"


@pytest.mark.parametrize(
    ("compose", "expected"),
    [
        (lambda bad, real: Selector("choice", memory=False, children=[bad, real]), Status.FAILURE),
        (lambda bad, real: Selector("choice", memory=True, children=[real, bad]), Status.RUNNING),
        (
            lambda bad, real: Parallel("p", ParallelPolicy.SuccessOnAll(), [bad, real]),
            Status.FAILURE,
        ),
    ],
)
def test_failure_for_a_real_reason_surfaces(kb, compose, expected):
    kb.measure("light", 0.0)
    task = compose(feasible_then_act(Act(kb, "search")), Failure("broken"))
    root = do_until_unfeasible(task, Act(kb, "inspect"))
    root.tick_once()
    assert root.status is expected


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: do_until_unfeasible([Success("a")], Success("b")), "children must be behaviours"),
        (lambda: TreeRunner(Success("a"), clock=0.0), "a function that returns the time"),
        (lambda: KnowledgeBase(Model("robot"), clock=0.0), "a function that returns the time"),
    ],
)
def test_slip_of_an_author_is_named(make, words):
    with pytest.raises((TypeError, InvalidValue), match=words):
        make()
