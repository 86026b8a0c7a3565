"""What is read, and what is refused: each refusal says where, what, and what to do."""

import os
import re
from pathlib import Path

import pytest
from py_trees.common import Status
from xml_leaves import registry_of, trace, wrapped

from rosa_bt import BehaviourRegistry, RosaBtError, TreeRunner, XmlError, export_xml, load_xml
from rosa_bt.xml.values import ScriptError
from rosa_bt.xml.elements import MAX_DEPTH, MAX_SIZE
from rosa_bt.xml.nodes import MAX_NODES

LEAVES = {"a": ("A", "S"), "b": ("A", "RS"), "ok": ("C", "S")}


def load(text, **given):
    return load_xml(text, registry_of(LEAVES, []), **given)


REFUSED = {
    "<aa/>": "<text>:2: <aa> is unknown; did you mean 'a'? registered behaviours: Retry, UntilSuccess, a, b, ok",
    "<Sequense><a/></Sequense>": "did you mean the node 'Sequence'",
    "<Other/>": '<Other> is a tree; write <SubTree ID="Other"/>',
    "<SubTreePlus ID='Other'/>": '<SubTreePlus> is of version 3; write BTCPP_format="3"',
    "<ManualSelector><a/></ManualSelector>": "<ManualSelector> is unknown; registered behaviours: Retry, UntilSuccess, a, b, ok",
    "<a/><b/>": "a tree has one child, not 2; put a Sequence around",
    "": "a tree has one child, not 0",
    "<Inverter><a/><b/></Inverter>": "<Inverter> has 2 children; it takes 1; put a Sequence around them",
    "<Inverter/>": "<Inverter> has 0 children; it takes 1",
    "<Sequence/>": "<Sequence> has 0 children; it takes at least 1",
    "<IfThenElse><a/></IfThenElse>": "<IfThenElse> has 1 child; it takes 2 to 3",
    "<RecoveryNode><a/></RecoveryNode>": "it takes 2",
    "<Switch2><a/><b/></Switch2>": "it takes 3",
    "<a><b/></a>": "<a> has 1 child; it takes 0",
    "<Script code='x := 1'><b/></Script>": "it takes 0",
    "<SubTree ID='Other'><b/></SubTree>": "it takes 0",
    "<SubTree ID='Othr'/>": "no tree has the ID 'Othr'; did you mean 'Other'?",
    "<SubTree/>": "<SubTree> has no ID",
    "<Action/>": "<Action> has no ID",
    "<SubTree ID='Main'/>": "a tree contains itself: Main -> Main",
    "<SubTree ID='Other' _autoremap='maybe'/>": "_autoremap is true or false, not 'maybe'",
    "<Repeat><a/></Repeat>": "the port 'num_cycles' is missing",
    "<Repeat num_cycle='2'><a/></Repeat>": "it has no port 'num_cycle'; did you mean 'num_cycles'?",
    "<Repeat num_cycles='two'><a/></Repeat>": "the port 'num_cycles' takes a value of type int, not 'two'",
    "<a speed='2'/>": "<a> cannot be made: it has no port 'speed'; ports: cls, steps, tag",
    "<a _skipIf='x +'/>": "the script 'x +' cannot be read at 'the end'",
    "<a _skipIf=''/>": "the script is empty",
    "<Script code='x ++'/>": "the script 'x ++' cannot be read at '+'",
    "<Script code='1 % 2'/>": "cannot be read at '%'",
    "<Script code='  '/>": "the script is empty",
    "<a ID='b'/>": "<a> has an ID; only <Action ID=...>",
    "<Sequence><SubTree ID='Other' name='n'/><SubTree ID='Other' name='n'/></Sequence>": "two SubTrees are named",
    "<Script code='(((x'/>": "cannot be read at 'the end'",
    "<Precondition if='x'/>": "it takes 1",
    "<LoopInt queue='1;x'><a/></LoopInt>": "'x' is no int",
    "<Delay delay_msec='-5'><a/></Delay>": "takes no negative number",
    "<ReactiveSequence><AsyncSequence><a/></AsyncSequence><AsyncSequence><b/></AsyncSequence></ReactiveSequence>": (
        "a ReactiveSequence has at most one asynchronous child"
    ),
}


@pytest.mark.parametrize("content", REFUSED)
def test_what_cannot_be_made_is_refused_with_file_and_line(content):
    text = wrapped(f"\n{content}", Other="<ok/>")
    with pytest.raises(XmlError) as caught:
        load(text)
    assert re.match(r"<text>:[12]: ", str(caught.value))
    assert REFUSED[content] in str(caught.value)
    assert isinstance(caught.value, RosaBtError)


NO_FILES = {
    "<root": "<text>:1: it is no XML",
    "<root>\n<BehaviorTree>\n</root>": "<text>:3: it is no XML: mismatched tag",
    "<tree/>": "the outermost element is <root>, not <tree>",
    "<root/>": "which tree? There are: none",
    "<root><Sequence/></root>": "which tree? There are: none",
    "<root><BehaviorTree ID='Sequence'><a/></BehaviorTree></root>": "'Sequence' is the name of a node",
    "<root><BehaviorTree ID='A'><a/></BehaviorTree>\n<BehaviorTree ID='B'/></root>": "2: a tree has one child, not 0",
    "<root main_tree_to_execute='A'><BehaviorTree ID='A'><SubTree ID='B'/></BehaviorTree><BehaviorTree ID='B'><a/></Beh"
    "aviorTree><TreeNodesModel><SubTree ID='B'><input_port name='p' default=''/></SubTree></TreeNodesModel></root>": (
        "the tree 'B' needs p=..."
    ),
    "<root><TreeNodesModel><Action ID='a'><input_port name=''/></Action></TreeNodesModel></root>": "which tree?",
    "<root><BehaviorTree><a/></BehaviorTree><BehaviorTree><a/></BehaviorTree></root>": "<BehaviorTree> has no ID",
    "<root><BehaviorTree ID='A'><a/></BehaviorTree>\n<BehaviorTree ID='A'><a/></BehaviorTree></root>": (
        "<text>:2: 'A' is defined twice, first in <text>:1"
    ),
    "<root><BehaviorTree ID='A'><a/></BehaviorTree><BehaviorTree ID='B'><a/></BehaviorTree></root>": (
        "which tree? There are: A, B"
    ),
    "<root main_tree_to_execute='C'><BehaviorTree ID='A'><a/></BehaviorTree></root>": "no tree has the ID 'C'",
    "<root><include ros_pkg='nav' path='x.xml'/></root>": "the ROS package 'nav' is not below AMENT_PREFIX_PATH",
    "<root><include path='there_is_none.xml'/></root>": "there is no file",
    "there_is_none.xml": "there is no file 'there_is_none.xml'",
    '<!DOCTYPE root [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]>\n<root>&b;</root>': "a document type or entity is not read",
    '<!DOCTYPE root SYSTEM "file:///etc/passwd"><root/>': "a document type or entity is not read",
    "<root>" + " " * MAX_SIZE + "</root>": f"it has more than {MAX_SIZE} bytes",
    f"<root><BehaviorTree>{'<Inverter>' * 999}<a/>{'</Inverter>' * 999}</BehaviorTree></root>": (
        f"more than {MAX_DEPTH} levels deep"
    ),
    "": "there is no file '.' that can be read",
    "x\0y": "there is no file",
}


@pytest.mark.parametrize("text", NO_FILES, ids=range(len(NO_FILES)))
def test_what_is_no_file_of_trees_is_refused(text):
    with pytest.raises(XmlError, match=re.escape(NO_FILES[text])):
        load(text)


def test_trees_that_multiply_are_refused_before_they_fill_the_memory():
    trees = {
        f"T{n}": f'<Sequence><SubTree ID="T{n + 1}"/><SubTree ID="T{n + 1}"/></Sequence>'
        for n in range(30)
    }
    with pytest.raises(XmlError, match=f"more than {MAX_NODES} nodes"):
        load(wrapped('<SubTree ID="T0"/>', **trees, T30="<ok/>"))


def test_tree_is_chosen_by_name_by_the_file_or_because_it_is_the_only_one(tmp_path):
    file = tmp_path / "trees.xml"
    file.write_text(wrapped("<a/>", Other="<b/>"))
    assert load(file).child.node.name == "a"
    assert load(file, tree="Other").child.node.name == "b"
    assert load("<root><BehaviorTree><ok/></BehaviorTree></root>").child.node.name == "ok"
    with pytest.raises(XmlError, match="no tree has the ID 'Oter'; did you mean 'Other'"):
        load(file, tree="Oter")


def test_several_files_and_texts_are_read_together(tmp_path):
    parts = '<root><BehaviorTree ID="One"><SubTree ID="Two"/></BehaviorTree></root>'
    (tmp_path / "two.xml").write_text('<root><BehaviorTree ID="Two"><ok/></BehaviorTree></root>')
    main = '<root main_tree_to_execute="Main"><BehaviorTree ID="Main"><SubTree ID="One"/></BehaviorTree></root>'
    tree = load([parts, tmp_path / "two.xml", tmp_path / "two.xml", main])
    assert [one.name for one in tree.iterate()] == ["ok", "Two", "One", "Main"]
    for given, said in (
        ([], "give at least one"),
        ([parts, parts], "'One' is defined twice"),
    ):
        with pytest.raises(XmlError, match=said):
            load(given)


def test_files_of_ros_packages_are_found_where_ros_has_them(tmp_path, monkeypatch):
    share = tmp_path / "install" / "share" / "nav"
    (share / "trees").mkdir(parents=True)
    (share / "trees" / "x.xml").write_text('<root><BehaviorTree ID="X"><ok/></BehaviorTree></root>')
    monkeypatch.setenv(
        "AMENT_PREFIX_PATH", os.pathsep.join([str(tmp_path), str(tmp_path / "install")])
    )
    text = '<root><include ros_pkg="nav" path="trees/x.xml"/></root>'
    assert [one.name for one in load(text).iterate()] == ["ok", "X"]


def test_includes_are_relative_to_the_file_and_read_once(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "main.xml").write_text(
        '<root main_tree_to_execute="Main"><include path="parts/one.xml"/><include path="./parts/two.xml"/>'
        '<BehaviorTree ID="Main"><Sequence><SubTree ID="One"/><SubTree ID="Two"/></Sequence></BehaviorTree></root>'
    )
    one = '<root main_tree_to_execute="One"><include path="two.xml"/><BehaviorTree ID="One"><a/></BehaviorTree></root>'
    (tmp_path / "parts" / "one.xml").write_text(one)
    (tmp_path / "parts" / "two.xml").write_text(
        '<root><BehaviorTree ID="Two"><ok/></BehaviorTree></root>'
    )
    tree = load(tmp_path / "main.xml")
    tree.tick_once()
    assert [one.name for one in tree.iterate()] == ["a", "One", "ok", "Two", "Sequence", "Main"]
    (tmp_path / "parts" / "two.xml").write_text('<root>\n<include path="../main.xml"/></root>')
    with pytest.raises(
        XmlError,
        match=r"two\.xml:2: files include each other: main\.xml -> one\.xml -> two\.xml -> main",
    ):
        load(tmp_path / "main.xml")
