"""Idioms: what a mission needs to adapt, in one call each."""

import math

import pytest
from acting import Clock
from hypothesis import given
from hypothesis import strategies as st
from py_trees.behaviours import Failure, Running, StatusQueue, Success
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence

from kb import AmbiguousName, ConfigurationManager, InvalidValue, KnowledgeBase, Model, UnknownName
from rosa_bt import (
    ForAction,
    HasStatus,
    IsActionFeasible,
    Measurement,
    RosaAction,
    TreeChangeError,
    TreeRunner,
    do_until_unfeasible,
    feasible_then_act,
    first_feasible,
    forget_progress,
    switch_safely,
)
from rosa_bt.composites import unguarded


class Robot:
    def __init__(self):
        self.commands = []

    def activate(self, component):
        self.commands.append(("activate", component))

    def deactivate(self, component):
        self.commands.append(("deactivate", component))

    def set_parameters(self, component, parameters):
        pass


def drone() -> Model:
    model = Model("drone")
    light, energy = model.environmental_attribute("light"), model.quality_attribute("energy")
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


class Act(RosaAction):
    """Runs as long as nobody says that it is finished."""

    result = Status.RUNNING

    def __init__(self, kb, action, **named):
        super().__init__(action, kb, action, **named)
        self.begun = 0

    def initialise(self):
        self.begun += 1

    def update(self):
        return self.result


def required(kb):
    return [one.action for one in kb.required_actions]


def history(kb):
    return [(one.action, one.result) for one in kb.history.actions]


# ---------------------------------------------------------------- any behaviour under an action


@pytest.mark.parametrize("ending", [Status.SUCCESS, Status.FAILURE])
def test_unmodified_behaviour_is_requested_for_while_it_runs_and_released_as_it_ends(kb, ending):
    root = ForAction(
        "search", kb, "search", StatusQueue("look", queue=[Status.RUNNING], eventually=ending)
    )
    root.tick_once()
    assert required(kb) == ["search"]
    root.tick_once()
    assert root.status is ending
    assert history(kb) == [("search", "completed" if ending is Status.SUCCESS else "failed")]


def test_unmodified_behaviour_is_stopped_with_the_reason_when_its_action_becomes_unfeasible(kb):
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


# ---------------------------------------------------------------- conditions


def test_status_condition_follows_the_element(kb):
    condition = HasStatus("camera broken?", kb, "camera", "failure")
    condition.tick_once()
    assert condition.status is Status.FAILURE
    assert condition.feedback_message == "camera is not failure but feasible"
    kb.component_failed("camera")
    condition.tick_once()
    assert condition.status is Status.SUCCESS


@pytest.mark.parametrize(
    ("element", "status", "error", "message"),
    [
        ("camra", "failure", UnknownName, "unknown element 'camra'; did you mean 'camera'"),
        (
            "camera",
            "broken",
            InvalidValue,
            "component 'camera' is never 'broken'; it can be 'failure'",
        ),
    ],
)
def test_what_a_status_condition_cannot_mean_is_found_at_construction(
    kb, element, status, error, message
):
    with pytest.raises(error, match=message):
        HasStatus("x", kb, element, status)


def test_name_that_elements_of_two_kinds_share_needs_a_view():
    model = Model("twins")
    model.component("charge").configuration("charge")
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    with pytest.raises(
        AmbiguousName,
        match=r"a component, a configuration; pass the view meant, e.g. kb.components\['",
    ):
        HasStatus("x", kb, "charge", "unfeasible")
    condition = HasStatus("x", kb, kb.components["charge"], "feasible")
    condition.tick_once()
    assert condition.status is Status.SUCCESS


@pytest.mark.parametrize(
    ("operator", "holds"),
    [(">=", [0, 1, 1]), (">", [0, 0, 1]), ("<=", [1, 1, 0]), ("<", [1, 0, 0])],
)
def test_measurement_condition_compares(kb, operator, holds):
    condition = Measurement("x", kb, "energy", operator, 0.25)
    for value, expected in zip([0.2, 0.25, 0.3], holds, strict=True):
        kb.measure("energy", value)
        condition.tick_once()
        assert condition.status is (Status.SUCCESS if expected else Status.FAILURE)


def test_measurement_that_is_not_there_or_too_old_counts_as_the_author_says(clock):
    model = Model("x")
    model.quality_attribute("energy", max_age=5.0)
    kb = KnowledgeBase(model, clock=clock)
    strict, lenient = (
        Measurement("x", kb, "energy", ">", 0),
        Measurement("x", kb, "energy", ">", 1, unknown=Status.RUNNING),
    )
    for text in ("energy is not measured", "energy is not measured any more"):
        for condition in (strict, lenient):
            condition.tick_once()
        assert (strict.status, lenient.status) == (Status.FAILURE, Status.RUNNING)
        assert strict.feedback_message == text
        kb.measure("energy", 0.5)
        clock.now += 10.0


def test_what_a_measurement_condition_cannot_mean_is_found_at_construction(kb):
    with pytest.raises(UnknownName, match="did you mean 'energy'"):
        Measurement("x", kb, "enrgy", ">=", 0.25)
    with pytest.raises(ValueError, match="'=' is not an operator; use one of >="):
        Measurement("x", kb, "energy", "=", 0.25)


# ---------------------------------------------------------------- waiting for the architecture


@pytest.mark.parametrize(
    "make", [lambda kb, **named: Act(kb, "inspect", **named), None], ids=["RosaAction", "ForAction"]
)
def test_action_that_waits_starts_when_the_robot_is_configured_for_it(kb, make):
    child = Running("look")
    task = make(kb, wait=True) if make else ForAction("inspect", kb, "inspect", child, wait=True)
    manager = ConfigurationManager(kb, Robot())

    def has_begun():
        return task.begun == 1 if make else child.status is Status.RUNNING

    task.tick_once()
    assert (task.status, has_begun()) == (Status.RUNNING, False)
    assert task.feedback_message.startswith(
        "waiting: inspect is unsolved because function look is unsolved"
    )
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


def test_action_that_waits_too_long_fails_with_what_is_lacking_and_never_begins(kb, clock):
    task = Act(kb, "inspect", wait=True, timeout=2.0)
    task.tick_once()
    clock.now = 1.9
    task.tick_once()
    assert task.status is Status.RUNNING
    clock.now = 2.0
    task.tick_once()
    assert task.status is Status.FAILURE
    assert task.feedback_message.startswith("not ready within 2 s: inspect is unsolved because")
    assert (task.begun, history(kb)) == (0, [("inspect", "failed")])


@pytest.mark.parametrize("timeout", [0.0, -1.0, math.nan])
def test_time_out_is_more_than_zero(kb, timeout):
    with pytest.raises(ValueError, match="more than 0 s"):
        Act(kb, "inspect", wait=True, timeout=timeout)


# ---------------------------------------------------------------- preference lists


@pytest.mark.parametrize(("memory", "expected"), [(False, "search"), (True, "charge")])
def test_first_feasible_action_is_done_and_a_preferred_one_takes_over_unless_there_is_memory(
    kb, memory, expected
):
    root = first_feasible("best", [Act(kb, "search"), Act(kb, "charge")], memory=memory)
    root.tick_once()
    assert required(kb) == ["search"]
    kb.measure("light", 0.0)
    root.tick_once()
    assert required(kb) == ["charge"]
    kb.measure("light", 1.0)
    root.tick_once()
    assert required(kb) == [expected]


# ---------------------------------------------------------------- do it, or else


@given(
    st.lists(
        st.tuples(st.sampled_from([0.1, 0.9]), st.sampled_from([Status.RUNNING, Status.SUCCESS])),
        min_size=1,
        max_size=12,
    ),
    st.booleans(),
)
def test_exactly_one_action_is_required_after_every_tick_and_the_task_whenever_it_can_be(
    moments, memory
):
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


@pytest.mark.parametrize("memory", [False, True])
def test_task_gives_way_while_it_is_unfeasible_and_something_is_required_after_every_tick(
    kb, memory
):
    search, charge = Act(kb, "search"), Act(kb, "charge")
    root = do_until_unfeasible(search, charge, memory=memory)
    doing = []
    for level in (1.0, 0.1, 0.1, 1.0, 1.0):
        kb.measure("energy", level)
        charge.result = Status.SUCCESS if memory and len(doing) == 4 else Status.RUNNING
        root.tick_once()
        assert root.status is Status.RUNNING
        doing.append(required(kb))
    back = ["charge"] if memory else ["search"]
    assert doing == [["search"], ["charge"], ["charge"], back, ["search"]]


def test_what_is_done_meanwhile_begins_anew_if_the_task_is_still_unfeasible(kb):
    charge = Act(kb, "charge")
    root = do_until_unfeasible(Act(kb, "search"), charge)
    kb.measure("energy", 0.1)
    root.tick_once()
    charge.result = Status.SUCCESS
    root.tick_once()
    assert charge.begun == 2
    charge.result = Status.RUNNING
    root.tick_once()
    assert required(kb) == ["charge"]


@pytest.mark.parametrize("ending", [Status.SUCCESS, Status.FAILURE])
def test_ending_of_the_task_for_any_other_reason_is_the_ending_of_the_whole(kb, ending):
    search = Act(kb, "search")
    root = do_until_unfeasible(search, Act(kb, "charge"))
    root.tick_once()
    search.result = ending
    root.tick_once()
    assert root.status is ending
    assert required(kb) == []


def test_task_may_be_a_subtree_of_several_actions(kb):
    both = Sequence(
        "both",
        memory=True,
        children=[feasible_then_act(Act(kb, name)) for name in ("search", "inspect")],
    )
    root = do_until_unfeasible(both, ForAction("charge", kb, "charge", Running("plug in")))
    root.tick_once()
    kb.measure("energy", 0.1)
    root.tick_once()
    assert required(kb) == ["charge"]
    assert root.feedback_message == "instead of both"


def test_task_whose_action_is_taken_out_of_the_model_gives_way_too(kb):
    runner = TreeRunner(
        do_until_unfeasible(Act(kb, "search"), Act(kb, "charge")), clock=lambda: 0.0
    )
    runner.tick()
    kb.model.remove(kb.model.actions["search"])
    runner.tick()
    assert required(kb) == ["charge"]
    assert runner.status is Status.RUNNING
    runner.shutdown()
    assert history(kb) == [("search", "abandoned"), ("charge", "abandoned")]


# ---------------------------------------------------------------- safe switching


def analysing_after_inspecting(kb, land):
    """Prefer inspecting, which needs light here; analyse on the ground otherwise, for which the drone has to land."""
    tasks = [Act(kb, "search"), Act(kb, "charge")]
    return switch_safely(first_feasible("mission", tasks), {("search", "charge"): land}), tasks


def test_transition_runs_between_two_actions_and_only_in_the_direction_that_was_declared(kb):
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


def test_action_that_is_done_first_needs_no_transition(kb):
    land = Act(kb, "land")
    root, _ = analysing_after_inspecting(kb, land)
    kb.measure("light", 0.0)
    root.tick_once()
    assert required(kb) == ["charge"]
    assert land.begun == 0


def test_transition_that_was_interrupted_is_begun_again(kb):
    land = Act(kb, "land")
    root, _ = analysing_after_inspecting(kb, land)
    root.tick_once()
    kb.measure("light", 0.0)
    root.tick_once()
    root.stop(Status.INVALID)
    assert required(kb) == []
    root.tick_once()
    assert required(kb) == ["land"]
    assert land.begun == 2


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
    with pytest.raises(TreeChangeError, match="2 behaviours do 'charge'"):
        switch_safely(root, {("search", "charge"): Success("land")})


# ---------------------------------------------------------------- resuming


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


def test_another_behaviour_of_the_same_name_continues_as_the_steps_of_a_plan_do(kb):
    first, second, other = (
        Counting(kb, "search"),
        Counting(kb, "search"),
        Counting(kb, "search", name="elsewhere"),
    )
    for task in (first, second, other):
        task.tick_once()
        task.stop(Status.INVALID)
    assert (first.done, second.done, other.done) == ([0], [1], [0])


@pytest.mark.parametrize(
    "how", ["completed", "shut down", "another runner", "forgotten", "root succeeded"]
)
def test_progress_is_dropped_when_the_action_completes_and_when_the_mission_begins_anew(kb, how):
    task = Counting(kb, "search")
    root = Sequence("root", memory=True, children=[task])
    runner = TreeRunner(root, clock=lambda: 0.0)
    runner.tick()
    root.stop(Status.INVALID)
    if how == "completed":
        for _ in range(3):
            task.tick_once()
        assert task.status is Status.SUCCESS
    elif how == "shut down":
        runner.shutdown()
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


def test_what_was_saved_survives_a_start_that_was_refused_or_only_waited(kb):
    task = Counting(kb, "search")
    task.tick_once()
    task.stop(Status.INVALID)
    kb.measure("light", 0.0)
    task.tick_once()
    assert task.status is Status.FAILURE
    kb.measure("light", 1.0)
    task.tick_once()
    assert task.done == [0, 1]


def test_progress_is_kept_apart_for_two_runners_with_behaviours_of_one_name(kb):
    one, other = Counting(kb, "search"), Counting(kb, "search")
    first = TreeRunner(Sequence("one", memory=True, children=[one]), clock=lambda: 0.0)
    first.tick()
    first.tree.root.stop(Status.INVALID)
    second = TreeRunner(Sequence("other", memory=True, children=[other]), clock=lambda: 0.0)
    second.tick()
    second.shutdown()
    first.tick()
    assert (one.done, other.done) == ([0, 1], [0])


# ---------------------------------------------------------------- what becomes unfeasible is given up


@pytest.mark.parametrize(
    "around", [lambda task: task, lambda task: Sequence("all", memory=True, children=[task])]
)
def test_action_that_becomes_unfeasible_is_given_up_with_the_reason_wherever_it_stands(kb, around):
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


def test_action_goes_on_when_it_is_told_to_although_it_is_unfeasible(kb):
    task = Act(kb, "search", even_if_unfeasible=True)
    task.tick_once()
    kb.measure("light", 0.0)
    task.tick_once()
    assert (task.status, required(kb)) == (Status.RUNNING, ["search"])
    task.stop(Status.INVALID)


def test_bare_actions_of_a_task_give_way_too(kb):
    both = Sequence("both", memory=True, children=[Act(kb, "search"), Act(kb, "inspect")])
    root = do_until_unfeasible(both, Act(kb, "charge"))
    root.tick_once()
    kb.measure("energy", 0.1)
    root.tick_once()
    assert (root.status, required(kb)) == (Status.RUNNING, ["charge"])
    root.stop(Status.INVALID)


@pytest.mark.parametrize(
    ("compose", "expected"),
    [
        (lambda bad, real: Selector("choice", memory=False, children=[bad, real]), Status.FAILURE),
        (lambda bad, real: Selector("choice", memory=True, children=[real, bad]), Status.RUNNING),
        (
            lambda bad, real: Sequence(
                "steps",
                memory=True,
                children=[Selector("s", memory=False, children=[bad, Success("ok")]), real],
            ),
            Status.FAILURE,
        ),
        (
            lambda bad, real: Parallel(
                "p", policy=ParallelPolicy.SuccessOnAll(), children=[bad, real]
            ),
            Status.FAILURE,
        ),
        (lambda bad, real: ForAction("f", real_kb(bad), "charge", real), Status.FAILURE),
    ],
    ids=["choice", "condition first", "steps", "parallel", "for"],
)
def test_failure_for_a_real_reason_surfaces_although_another_action_in_the_task_is_unfeasible(
    kb, compose, expected
):
    kb.measure("light", 0.0)
    task = compose(feasible_then_act(Act(kb, "search")), Failure("broken"))
    root = do_until_unfeasible(task, Act(kb, "inspect"))
    root.tick_once()
    assert root.status is expected
    root.stop(Status.INVALID)


def real_kb(guarded):
    return guarded.children[0].kb


def test_actions_that_nothing_stops_when_they_become_unfeasible_are_named(kb):
    def stubborn(action="search"):
        return Act(kb, action, even_if_unfeasible=True)

    asked = [
        feasible_then_act(stubborn()),
        ForAction("for", kb, "search", stubborn()),
        Act(kb, "inspect"),
    ]
    assert unguarded(Sequence("all", memory=True, children=asked)) == []
    bare, for_another = stubborn(), stubborn()
    too_late = Sequence(
        "s", memory=True, children=[IsActionFeasible("?", kb, "search"), stubborn()]
    )
    others = [bare, ForAction("for", kb, "inspect", for_another), too_late]
    found = unguarded(Sequence("all", memory=True, children=others))
    assert found == [bare, for_another, too_late.children[1]]
