"""Files in the style of those that people have are read, noted and run."""

import re
from pathlib import Path

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin

from rosa_bt import BehaviourRegistry, TreeRunner, load_xml
from rosa_bt.xml.document import MODELS
from rosa_bt.xml.nodes import NODES

TREES = Path(__file__).parent / "trees"
BLANK = "' ' cannot stand in an ID"
QUOTES = "texts stand in single quotes"
NOTES = {
    "names_with_blanks": [f"4: .*{BLANK}", f"11: .*{BLANK}"],
    "names_with_signs": ["2: .*':' cannot", "8: .*'/' cannot", "9: .*'/' cannot"],
    "names_of_other_languages": ["2: .*' ' cannot"],
    "models_with_blanks": [f"6: .*{BLANK}", f"7: .*{BLANK}"],
    "double_quotes_in_script": [f"4: code: {QUOTES}", f"5: code: {QUOTES}", f"6: if: {QUOTES}"],
    "double_quotes_in_rules": [
        f"3: _onSuccess: {QUOTES}: last := 'main'",
        f"4: _skipIf: {QUOTES}",
        f"4: _onHalted: {QUOTES}",
    ],
    "double_quotes_around_apostrophe": [],
    "raw_ampersands": ["xml: read as it stands"],
    "no_format": [
        "1: it has no BTCPP_format; read as version 4",
        '3: read as it stands; in version 3, place="dock" is place="{dock}"',
    ],
    "v3_said": ['4: .*output_key="{bay}" is output_key="bay"', '5: .*place="bay" is place="{bay}"'],
    "v3_subtree_plus": [
        "1: it has no BTCPP_format; read as version 3",
        "4: .*<SubTreePlus> is <SubTree>",
        "4: .*__autoremap is _autoremap, without keys that begin with _",
    ],
    "v3_shared_blackboard": ["1: it has no", "5: .*__shared_blackboard is _autoremap"],
    "v3_stars": [
        "1: it has no",
        "3: .*<SequenceStar> is <SequenceWithMemory>",
        "5: .*<RetryUntilSuccesful> is <RetryUntilSuccessful>",
        "6: .*<FallbackStar> is <Fallback>",
    ],
    "v3_explicit": ["3: .*<SequenceStar> is <SequenceWithMemory>"],
    "v3_checks": [
        "1: it has no",
        "5: <BlackboardCheckString> is not in version 4; read as in 3",
        "6: <BlackboardCheckInt> is not in version 4; read as in 3",
    ],
    "v3_parallel": [
        "1: it has no BTCPP_format; read as version 3",
        "4: .*threshold is success_count",
        "5: .*success_threshold is success_count",
        "5: .*failure_threshold is failure_count",
    ],
    "v3_tree_as_tag": [
        "1: it has no",
        '2: .*<Dock> is <SubTree ID="Dock">',
        '2: .*speed="v" is speed="{v}"',
    ],
    "v4_with_words_of_v3": [
        "4: __shared_blackboard means nothing; did you mean _autoremap?",
        "5: __autoremap means nothing; did you mean _autoremap?",
    ],
    "misspelt_rules": [
        "3: _onsuccess means nothing; did you mean _onSuccess?",
        "4: _onlyIf means nothing; did you mean _skipIf .with the opposite condition",
        "5: _precondition means nothing; did you mean _skipIf .with the opposite condition",
        "6: _autoRemap means nothing; did you mean _autoremap?",
        "6: _autoreamp means nothing; did you mean _autoremap?",
        "7: _skipif means nothing; did you mean _skipIf?",
        "7: _failureif means nothing; did you mean _failureIf?",
        "7: _onHalt means nothing; did you mean _onHalted?",
        "7: _color means nothing; the rules are _failureIf, _successIf, _skipIf, _while, ",
    ],
    "of_editors": [],
    "nav2_newest": [],
    "nav2_of_foxy": ["2: it has no", "9: .*<SequenceStar> is <SequenceWithMemory>"],
    "late_declaration": ["xml: read as it stands, though it is no XML"],
    "format_of_tomorrow": ["1: it has BTCPP_format '4.2'; read as version 4"],
}


class Leaf(PortsMixin, Behaviour, register=False):
    """Stands for any leaf: it has the ports that the file gives it, reads them, and succeeds."""

    INPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it
    OUTPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it

    def update(self):
        return Status.SUCCESS


def registry_for(path):
    """Return a registry with a leaf for each tag and ID of a file that is no node and no tree."""
    text = path.read_text()
    leaves = re.findall(r"<(?:(?:Action|Condition) ID=\"([^\"]+)\"|(\w+))([^>]*?)/?>", text)
    trees = re.findall(r'<BehaviorTree ID="([^"]+)"', text)
    registry = BehaviourRegistry()
    ports = {}
    for identifier, tag, attributes in leaves:
        names = re.findall(r"\b(?<!_)([a-z]\w*)=", attributes)
        ports.setdefault(identifier or tag, set()).update(set(names) - {"name", "ID"})
    for tag, names in ports.items():
        if tag not in {*MODELS, *NODES, *trees, "BehaviorTree", "TreeNodesModel", "root"}:
            declared = {name: PortInformation(object, required=False) for name in sorted(names)}
            registry.register(tag, type(tag, (Leaf,), {"INPUT_PORTS": declared}, register=False))
    return registry


def test_every_file_is_listed():
    assert sorted(NOTES) == sorted(path.stem for path in TREES.glob("*.xml"))
    assert len(NOTES) >= 20


@pytest.mark.parametrize("name", NOTES)
def test_file_is_read_with_its_notes_and_runs(name, caplog):
    path = TREES / f"{name}.xml"
    tree = load_xml(path, registry_for(path))
    assert len(tree.notes) == len(NOTES[name]), tree.notes
    for note, expected in zip(tree.notes, NOTES[name], strict=True):
        assert re.search(rf"{name}\.xml.{expected}".replace(".xml.xml", ".xml"), note), note
    assert caplog.messages == list(tree.notes)
    runner = TreeRunner(tree, clock=lambda: 0.0, on_error="raise")
    for _ in range(9):
        if runner.status is not Status.SUCCESS:
            runner.tick()
    assert runner.status is Status.SUCCESS
