"""What is read, and what is refused: each refusal says where, what, and what to do."""

import os
import re

import pytest
from xml_leaves import registry_of, wrapped

from rosa_bt import RosaBtError, XmlError, load_xml

LEAVES = {"a": ("A", "S"), "b": ("A", "RS"), "ok": ("C", "S")}


def load(text, **options):
    return load_xml(text, registry_of(LEAVES, []), **options)


def names(tree):
    return [node.name for node in tree.iterate()]


def tree(name, content="<ok/>"):
    return f'<BehaviorTree ID="{name}">{content}</BehaviorTree>'


def root(*content, main=""):
    attribute = f' main_tree_to_execute="{main}"' if main else ""
    return f"<root{attribute}>{''.join(content)}</root>"


REFUSED = {
    "<aa/>": "<aa> is unknown; did you mean 'a'?",
    "<Sequense><a/></Sequense>": "did you mean 'Sequence' or",
    "<Other/>": '<Other> is a tree; write <SubTree ID="Other"/>',
    "<Subtree ID='Other'/>": "<Subtree> is unknown; did you mean 'SubTree'?",
    "<ManualSelector><a/></ManualSelector>": "no counterpart in version 4; register it",
    "<Parallel success_count='2'><a/></Parallel>": "has 1 children; success_count cannot be more",
    "<SubTreePlus ID='Other'/>": '<SubTreePlus> is of version 3; write BTCPP_format="3"',
    "<a/><b/>": "a tree has one child, not 2; put a Sequence around",
    "<Inverter><a/><b/></Inverter>": "children of <Inverter>: 2; it takes 1",
    "<Sequence/>": "children of <Sequence>: 0; it takes at least 1",
    "<IfThenElse><a/></IfThenElse>": "children of <IfThenElse>: 1; it takes 2 to 3",
    "<a><b/></a>": "children of <a>: 1; it takes 0",
    "<SubTree ID='Othr'/>": "no tree has the ID 'Othr'; did you mean 'Other'?",
    "<SubTree/>": "<SubTree> has no ID",
    "<Action/>": "<Action> has no ID",
    "<SubTree ID='Main'/>": "a tree contains itself: Main -> Main",
    "<SubTree ID='Other' _autoremap='maybe'/>": "<SubTree> cannot be made: 'maybe' is no bool",
    "<Repeat><a/></Repeat>": "it needs a value for 'num_cycles'",
    "<Repeat num_cycle='2'><a/></Repeat>": "no port 'num_cycle'; did you mean 'num_cycles'?",
    "<Repeat num_cycles='two'><a/></Repeat>": "the port 'num_cycles': 'two' is no int",
    "<a _skipIf='x +'/>": "the script 'x +' cannot be read from '+' on",
    "<a _skipIf=''/>": "the script '' cannot be read",
    "<Script code='x ++'/>": "the script 'x ++' cannot be read from '+' on",
    "<Script code='1 % 2'/>": "cannot be read from '% 2' on",
    "<a ID='b'/>": "it has no port 'ID'",
    "<Delay delay_msec='-5'><a/></Delay>": "it takes no negative number",
}


@pytest.mark.parametrize("content", REFUSED)
def test_node_that_cannot_be_made_is_refused_with_its_place(content):
    with pytest.raises(XmlError) as caught:
        load(wrapped(f"\n{content}", Other="<ok/>"))
    assert re.match(r"<text>:[12]: ", str(caught.value))
    assert REFUSED[content] in str(caught.value)
    assert isinstance(caught.value, RosaBtError)


NEEDS = '<SubTree ID="B"><input_port name="p" default=""/></SubTree>'
NO_FILES = {
    "": "<text>:1: it is no XML: no element found",
    "<root": "<text>:1: it is no XML",
    "<root>\n<BehaviorTree>\n</root>": "<text>:3: it is no XML: mismatched tag",
    "<tree/>": "the outermost element is <root>, not <tree>",
    "<root/>": "which tree? There are: []",
    root(tree("Sequence")): "'Sequence' is the name of a node",
    root(tree("A"), "\n<BehaviorTree ID='B'/>"): "2: a tree has one child, not 0",
    root(
        tree("A", "<SubTree ID='B'/>"),
        tree("B"),
        f"<TreeNodesModel>{NEEDS}</TreeNodesModel>",
        main="A",
    ): "<input_port> has no default; write default=... in it",
    root("<BehaviorTree><a/></BehaviorTree>" * 2): "<BehaviorTree> has no ID",
    root(tree("A"), "\n", tree("A")): "<text>:2: 'A' is defined twice, first in <text>:1",
    root(tree("A"), tree("B")): "which tree? There are: ['A', 'B']",
    root(tree("A"), main="C"): "no tree has the ID 'C'",
    root("<include ros_pkg='nav' path='x.xml'/>"): "the ROS package 'nav' is not below AMENT",
    root("<include path='there_is_none.xml'/>"): "there is no file",
    "there_is_none.xml": "there is no file 'there_is_none.xml'",
    "x\0y": "there is no file",
}


@pytest.mark.parametrize("text", NO_FILES, ids=range(len(NO_FILES)))
def test_text_that_is_no_file_of_trees_is_refused(text):
    with pytest.raises(XmlError, match=re.escape(NO_FILES[text])):
        load(text)


def test_tree_is_chosen_by_name_or_by_the_file(tmp_path):
    file = tmp_path / "trees.xml"
    file.write_text(wrapped("<a/>", Other="<b/>"))
    assert names(load(file)) == ["a", "Main"]
    assert names(load(file, tree="Other")) == ["b", "Other"]
    assert names(load("<root><BehaviorTree><ok/></BehaviorTree></root>")) == ["ok", "BehaviorTree"]
    with pytest.raises(XmlError, match="no tree has the ID 'Oter'; did you mean 'Other'"):
        load(file, tree="Oter")


def test_several_files_and_texts_are_read_together(tmp_path):
    (tmp_path / "two.xml").write_text(root(tree("Two")))
    parts = root(tree("One", '<SubTree ID="Two"/>'))
    main = root(tree("Main", '<SubTree ID="One"/>'), main="Main")
    loaded = load([parts, tmp_path / "two.xml", tmp_path / "two.xml", main])
    assert names(loaded) == ["ok", "Two", "One", "Main"]
    with pytest.raises(XmlError, match="'One' is defined twice"):
        load([parts] * 2)


def test_file_of_a_ros_package_is_found_where_ros_has_it(tmp_path, monkeypatch):
    share = tmp_path / "install" / "share" / "nav"
    share.mkdir(parents=True)
    (share / "x.xml").write_text(root(tree("X")))
    path = os.pathsep.join([str(tmp_path), str(tmp_path / "install")])
    monkeypatch.setenv("AMENT_PREFIX_PATH", path)
    assert names(load(root('<include ros_pkg="nav" path="x.xml"/>'))) == ["ok", "X"]


def test_tree_of_an_included_file_is_a_tag_in_version_3(tmp_path):
    (tmp_path / "dock.xml").write_text(root(tree("Dock")))
    main = root('<include path="dock.xml"/>', tree("Main", "<Dock/>"), main="Main")
    (tmp_path / "main.xml").write_text(main.replace("<root", '<root BTCPP_format="3"'))
    assert names(load(tmp_path / "main.xml")) == ["ok", "Dock", "Main"]


def test_include_is_relative_to_its_file_and_read_once(tmp_path):
    includes = '<include path="parts/one.xml"/><include path="./parts/two.xml"/>'
    content = '<Sequence><SubTree ID="One"/><SubTree ID="Two"/></Sequence>'
    parts = tmp_path / "parts"
    parts.mkdir()
    (tmp_path / "main.xml").write_text(root(includes, tree("Main", content), main="Main"))
    (parts / "one.xml").write_text(root('<include path="two.xml"/>', tree("One", "<a/>")))
    (parts / "two.xml").write_text(root(tree("Two")))
    read = ["a", "One", "ok", "Two", "Sequence", "Main"]
    assert names(load(tmp_path / "main.xml")) == read
    (parts / "two.xml").write_text(root('<include path="../main.xml"/>', tree("Two")))
    assert names(load(tmp_path / "main.xml")) == read
