"""An action is requested when a behaviour starts and released once, however it ends."""

import pytest
from acting import rover
from py_trees.common import Status

from kb import KnowledgeBase, UnknownName
from rosa_bt import IsActionFeasible, RosaAction


class Scripted(RosaAction):
    """Does what its script says at each tick; an exception in the script is raised."""

    _begin = _end = _advance = _request = _work = _save = _has_begun = "a name that users take"

    def __init__(self, kb, action, script, raises_in_terminate=False):
        super().__init__(action, kb, action)
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
    return [(action.action, action.result) for action in kb.history.actions]


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


def test_unknown_action_is_refused_with_the_nearest_name(kb):
    with pytest.raises(UnknownName, match="unknown action 'scam'; did you mean 'scan'"):
        Scripted(kb, "scam", [])


@pytest.mark.parametrize(
    ("ending", "result"),
    [(Status.SUCCESS, "completed"), (Status.FAILURE, "failed"), (RuntimeError("boom"), "failed")],
)
def test_request_is_made_on_initialise_and_released_at_the_end(kb, ending, result):
    action = Scripted(kb, "scan", [Status.RUNNING, ending])
    action.tick_once()
    assert [action.action for action in kb.required_actions] == ["scan"]
    action.tick_once()
    assert kb.required_actions == ()
    assert results(kb) == [("scan", result)]


def test_exception_in_update_is_a_failure_with_its_text(kb):
    action = Scripted(kb, "scan", [ValueError("no such thing")])
    action.tick_once()
    assert action.status is Status.FAILURE
    assert action.feedback_message.startswith("ValueError: no such thing; ")
    assert action.calls == ["initialise", "update", "terminate FAILURE"]


def test_exception_in_terminate_turns_success_into_failure(kb):
    action = Scripted(kb, "scan", [Status.RUNNING, Status.SUCCESS], raises_in_terminate=True)
    action.tick_once()
    action.tick_once()
    assert action.status is Status.FAILURE
    assert results(kb) == [("scan", "failed")]
    assert "cannot let go" in action.feedback_message


def test_refused_request_is_a_failure_with_the_reason(kb):
    kb.measure("light", 0.1)
    action = Scripted(kb, "scan", [])
    action.tick_once()
    assert action.status is Status.FAILURE
    assert "light 0.1 violates >= 0.5" in action.feedback_message
    assert "initialise" not in action.calls
    assert "update" not in action.calls
    assert kb.history.actions == ()


def test_condition_of_a_user_is_initialised_and_must_return_a_status(kb):
    class Asked(IsActionFeasible):
        begun = 0

        def initialise(self):
            self.begun += 1

        def update(self):
            return self.answer

    condition = Asked("scan?", kb, "scan")
    for condition.answer in (Status.RUNNING, Status.SUCCESS, None):
        condition.tick_once()
    assert (condition.begun, condition.status) == (2, Status.FAILURE)
    assert "update returned None" in condition.feedback_message
