"""A leaf that is mocked does what its script says, in any tree; what it stands for is still requested and released."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from py_trees.behaviours import Success
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from small_rover import Sensing, rover_model, rover_tree

from kb import KnowledgeBase, UnknownName
from missions.engine.mission import Percepts
from missions.engine.recording import measured
from missions.testing import FakeClock, mock_leaf, replay
from missions.testing.scripted import LETTERS
from rosa_bt import BehaviourRegistry, TreeRunner, load_xml

XML = """
<root BTCPP_format="4">
  <BehaviorTree ID="Main">
    <Fallback>
      <ReactiveSequence>
        <IsActionFeasible name="can explore" action="explore"/>
        <Explore name="look around"/>
      </ReactiveSequence>
      <Charge/>
    </Fallback>
  </BehaviorTree>
</root>
"""


@pytest.fixture
def kb():
    return KnowledgeBase(rover_model(), clock=FakeClock())


def ticked(root, times):
    """Tick a tree and return the statuses of its root."""
    runner = TreeRunner(root, clock=FakeClock())
    statuses = []
    for _ in range(times):
        runner.tick()
        statuses.append(root.status)
    runner.shutdown()
    return statuses


@given(st.text("RSF", min_size=1, max_size=8), st.integers(1, 12))
def test_leaf_yields_its_script_and_then_its_last_outcome_for_ever(script, times):
    root = Sequence("root", memory=False, children=[Success("leaf")])
    mock = mock_leaf(root, "leaf", script)
    expected = [LETTERS[script[min(number, len(script) - 1)]] for number in range(times)]
    assert ticked(root, times) == expected
    assert mock.ticks == times
    ended = [status is not Status.RUNNING for status in expected]
    assert mock.starts == 1 + sum(ended[:-1])
    assert mock.interruptions == (not ended[-1])  # by the shutdown


@given(st.text("RSF", min_size=1, max_size=6))
def test_mocked_action_is_requested_while_it_runs_and_released_with_its_result(script):
    kb = KnowledgeBase(rover_model(), clock=FakeClock())
    root = Selector("root", memory=False, children=[Sensing("explore", kb, Percepts(), "never")])
    mock_leaf(root, "explore", script)
    ticked(root, len(script))
    rounds = [part for part in script.replace("S", "S ").replace("F", "F ").split(" ") if part]
    results = {"S": "completed", "F": "failed", "R": "abandoned"}
    assert [one.result for one in kb.history.actions] == [results[part[-1]] for part in rounds]
    assert not kb.required_actions


def test_mock_stands_in_for_a_leaf_of_an_xml_tree(kb):
    registry = BehaviourRegistry(kb=kb)
    percepts = Percepts()
    registry.register("Explore", lambda name, kb: Sensing("explore", kb, percepts, "never"))
    registry.register("Charge", lambda name, kb: Sensing("charge", kb, percepts, "never"))
    root = load_xml(XML, registry)
    mock = mock_leaf(root, "explore", "RF")
    charge = mock_leaf(root, "charge", "S")
    assert ticked(root, 2) == [Status.RUNNING, Status.SUCCESS]
    assert (mock.ticks, charge.ticks) == (2, 1)
    assert [(one.action, one.result) for one in kb.history.actions] == [
        ("explore", "failed"),
        ("charge", "completed"),
    ]


def test_condition_can_be_mocked_as_well(kb):
    root = rover_tree(kb, Percepts())
    mock_leaf(root, "explore feasible?", "FS")
    assert ticked(root, 1) == [Status.FAILURE]
    kb.measure("energy", 0.1)
    assert ticked(root, 1) == [Status.RUNNING]


def test_architecture_follows_a_mocked_action_in_a_replay():
    def tree(kb, percepts):
        root = rover_tree(kb, percepts)
        mock_leaf(root, "explore", "RRRRRS")
        return root

    decisions = replay(
        [measured(0.0, light=0.9, energy=1.0), measured(3.0, light=0.8)], rover_model(), tree
    )
    decisions.assert_reconfigures(at=0.0, activate="camera", configure="day", within=0.2)
    decisions.assert_ends("explore", "completed", at=0.5, within=0.0)


def test_unknown_leaf_and_wrong_outcomes_are_named(kb):
    root = rover_tree(kb, Percepts())
    with pytest.raises(UnknownName, match=r"unknown leaf 'explor'; did you mean 'explore'"):
        mock_leaf(root, "explor", "S")
    with pytest.raises(UnknownName, match="unknown leaf 'mission'"):
        mock_leaf(root, "mission", "S")
    for wrong in ("RSX", "", [], [Status.INVALID]):
        with pytest.raises(
            ValueError, match="outcomes are R, S and F, or RUNNING, SUCCESS and FAILURE"
        ):
            mock_leaf(root, "explore", wrong)
