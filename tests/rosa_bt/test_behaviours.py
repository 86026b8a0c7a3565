"""The request of an action is made when a behaviour starts and released exactly once, however it ends."""

import gc

import pytest
from py_trees.blackboard import Blackboard, Client
from py_trees.common import Access, Status
from py_trees.composites import Selector

from kb import KnowledgeBase, Model, UnknownName
from rosa_bt import IsActionFeasible, RosaAction, TreeRunner


def rover() -> Model:
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.action("scan", constraints=[light >= 0.5])
    model.action("rest")
    return model


class Scripted(RosaAction):
    """Does what its script says at each tick; an exception in the script is raised."""

    def __init__(self, kb, action, script, raises_in_terminate=False, name=None):
        super().__init__(name or action, kb, action)
        self.script = list(script)
        self.raises_in_terminate = raises_in_terminate
        self.calls = []

    def initialise(self):
        self.calls.append("initialise")

    def update(self):
        self.calls.append("update")
        step = self.script.pop(0) if self.script else Status.RUNNING
        if isinstance(step, Exception):
            raise step
        return step

    def terminate(self, new_status):
        self.calls.append(f"terminate {new_status.value}")
        if self.raises_in_terminate:
            raise OSError("cannot let go")


@pytest.fixture
def kb():
    return KnowledgeBase(rover(), clock=lambda: 0.0)


def results(kb):
    return [(one.action, one.result) for one in kb.history.actions]


def test_condition_follows_feasibility_and_gives_the_reason(kb):
    condition = IsActionFeasible("scan?", kb, "scan")
    condition.tick_once()
    assert condition.status is Status.SUCCESS
    kb.measure("light", 0.24)
    condition.tick_once()
    assert condition.status is Status.FAILURE
    assert (
        condition.feedback_message
        == "scan is unfeasible because light 0.24 violates >= 0.5 (measured 0.0 s ago)"
    )


def test_running_action_is_feasible_although_its_status_is_solved(kb):
    kb.request_action("scan")
    assert kb.actions["scan"].status == "solved"
    condition = IsActionFeasible("scan?", kb, "scan")
    condition.tick_once()
    assert condition.status is Status.SUCCESS


@pytest.mark.parametrize("behaviour", [IsActionFeasible, Scripted])
def test_unknown_action_is_found_at_construction_and_names_the_nearest(kb, behaviour):
    arguments = ("x", kb, "scam") if behaviour is IsActionFeasible else (kb, "scam", [])
    with pytest.raises(UnknownName, match="unknown action 'scam'; did you mean 'scan'"):
        behaviour(*arguments)


@pytest.mark.parametrize(
    ("ending", "result"),
    [(Status.SUCCESS, "completed"), (Status.FAILURE, "failed"), (RuntimeError("boom"), "failed")],
)
def test_request_is_made_on_initialise_and_released_at_the_end(kb, ending, result):
    action = Scripted(kb, "scan", [Status.RUNNING, ending])
    action.tick_once()
    assert [one.action for one in kb.required_actions] == ["scan"]
    action.tick_once()
    assert kb.required_actions == ()
    assert results(kb) == [("scan", result)]


def test_interruption_abandons_the_request(kb):
    action = Scripted(kb, "scan", [])
    action.tick_once()
    action.stop(Status.INVALID)
    action.stop(Status.INVALID)
    assert results(kb) == [("scan", "abandoned")]


def test_exception_in_update_is_a_failure_with_its_text_and_terminates_once(kb):
    action = Scripted(kb, "scan", [ValueError("no such thing")])
    action.tick_once()
    assert action.status is Status.FAILURE
    assert action.feedback_message.startswith("ValueError: no such thing; ")
    assert action.calls == ["initialise", "update", "terminate FAILURE"]


def test_exception_in_terminate_turns_success_into_failure_and_releases_the_request(kb):
    action = Scripted(kb, "scan", [Status.RUNNING, Status.SUCCESS], raises_in_terminate=True)
    action.tick_once()
    action.tick_once()
    assert action.status is Status.FAILURE
    assert results(kb) == [("scan", "failed")]
    assert "cannot let go" in action.feedback_message


def test_refused_request_is_a_failure_with_the_reason_and_calls_nothing_of_the_subclass(kb):
    kb.measure("light", 0.1)
    action = Scripted(kb, "scan", [])
    action.tick_once()
    assert action.status is Status.FAILURE
    assert "light 0.1 violates >= 0.5" in action.feedback_message
    assert "initialise" not in action.calls
    assert "update" not in action.calls
    assert kb.history.actions == ()


def test_shutdown_of_the_tree_abandons_what_is_running(kb):
    runner = TreeRunner(Scripted(kb, "scan", []), clock=lambda: 0.0)
    runner.tick()
    runner.shutdown()
    assert results(kb) == [("scan", "abandoned")]
    runner.shutdown()
    assert len(kb.history.actions) == 1


def test_request_outlives_a_switch_between_two_behaviours_of_one_action(kb):
    first = Scripted(kb, "rest", [Status.FAILURE], name="first")
    second = Scripted(kb, "rest", [], name="second")
    root = Selector("root", memory=False, children=[first, second])
    root.tick_once()
    assert second.status is Status.RUNNING
    root.tick_once()  # the first takes over: it starts before the second is stopped
    assert first.status is Status.RUNNING
    assert second.status is Status.INVALID
    assert [one.action for one in kb.required_actions] == ["rest"]
    root.stop(Status.INVALID)
    assert kb.required_actions == ()


def test_knowledge_base_is_not_kept_alive_by_its_behaviours(kb):
    import weakref

    own = KnowledgeBase(rover(), clock=lambda: 0.0)
    Scripted(own, "rest", [Status.SUCCESS]).tick_once()
    reference = weakref.ref(own)
    del own
    gc.collect()
    assert reference() is None


def test_ports_carry_the_action_when_the_constructor_does_not(kb):
    Blackboard.clear()
    writer = Client(name="writer")
    writer.register_key("wanted", access=Access.WRITE)
    writer.set("wanted", "scan")
    condition = IsActionFeasible("feasible?", kb)
    condition.setup_ports({"action": "/wanted"})
    condition.tick_once()
    assert condition.status is Status.SUCCESS
    kb.measure("light", 0.0)
    condition.tick_once()
    assert condition.status is Status.FAILURE
    Blackboard.clear()


def test_condition_whose_port_carries_nothing_or_nonsense_fails_with_the_text(kb):
    Blackboard.clear()
    empty, wrong = IsActionFeasible("empty", kb), IsActionFeasible("wrong", kb)
    empty.setup_ports({})
    wrong.setup_ports({"action": "__const_scam"})
    for condition, text in (
        (empty, "NoDataAvailable"),
        (wrong, "UnknownName: unknown action 'scam'; did you mean"),
    ):
        condition.tick_once()
        assert condition.status is Status.FAILURE
        assert condition.feedback_message.startswith(text)
    Blackboard.clear()


def test_update_that_returns_no_status_is_a_failure_that_says_so(kb):
    action = Scripted(kb, "rest", [None])
    action.tick_once()
    assert action.status is Status.FAILURE
    assert (
        action.feedback_message
        == "TypeError: update returned None, which is no py_trees.common.Status"
    )
    assert results(kb) == [("rest", "failed")]


def test_reason_is_asked_for_again_when_what_is_known_has_changed(kb):
    condition = IsActionFeasible("scan?", kb, "scan")
    reasons = []
    for what, value in (("light", 0.3), (None, None), ("light", 0.9), ("light", 0.1)):
        if what:
            kb.measure(what, value)
        condition.tick_once()
        reasons.append(condition.feedback_message[:47])
    assert reasons == [
        "scan is unfeasible because light 0.3 violates >",
        "scan is unfeasible because light 0.3 violates >",
        "",
        "scan is unfeasible because light 0.1 violates >",
    ]
