"""The traces that BehaviorTree.CPP 4.10 recorded of itself are reproduced.

`btcpp_traces.json` says how it was recorded: BehaviorTree.CPP 4.10.0 (commit 879522c7),
`Tree::tickExactlyOnce`.
"""

import json
from pathlib import Path

import pytest
from xml_leaves import registry_of, trace

from rosa_bt import TreeRunner, export_xml, load_xml

CASES = json.loads(Path(__file__).with_name("btcpp_traces.json").read_text())["cases"]
RANDOM = [case for case in CASES if "xml" in case]
(MISSION,) = (case for case in CASES if "file" in case)

# Written here in the style of the mission's file, of which the recording names only the leaves.
MISSION_XML = """
<root BTCPP_format="4" main_tree_to_execute="Main">
  <BehaviorTree ID="Main">
    <RetryUntilSuccessful num_attempts="-1">
      <Fallback>
        <Condition ID="is_mission_aborted"/>
        <SequenceWithMemory>
          <SubTree ID="GetReady" _autoremap="true"/>
          <ReactiveSequence>
            <Condition ID="is_action_feasible"/>
            <Action ID="search_pipeline"/>
          </ReactiveSequence>
          <ReactiveSequence>
            <Condition ID="is_action_feasible"/>
            <Action ID="inspect_pipeline"/>
          </ReactiveSequence>
        </SequenceWithMemory>
      </Fallback>
    </RetryUntilSuccessful>
  </BehaviorTree>
  <BehaviorTree ID="GetReady">
    <Sequence>
      <arm_thrusters/>
      <set_guided_mode/>
    </Sequence>
  </BehaviorTree>
</root>
"""


@pytest.mark.parametrize("case", RANDOM, ids=range(len(RANDOM)))
def test_recorded_trace_is_reproduced_also_after_export(case):
    said = []
    text = export_xml(load_xml(case["xml"], registry_of(case["leaves"], said)))
    for xml in (case["xml"], text):
        tree = load_xml(xml, registry_of(case["leaves"], said))
        runner = TreeRunner(tree, clock=lambda: 0.0)
        assert trace(runner.tick, tree, said, len(case["trace"])) == case["trace"]


def test_mission_does_what_was_recorded_of_it(tmp_path):
    said = []
    file = tmp_path / "mission.xml"
    file.write_text(MISSION_XML)
    tree = load_xml(file, registry_of(MISSION["leaves"], said))
    lines = trace(tree.tick_once, tree, said, len(MISSION["trace"]))
    assert lines == MISSION["trace"]
