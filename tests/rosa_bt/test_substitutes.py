"""Leaves may be substituted when a tree is loaded: for dry runs, and to do again what was recorded."""

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from xml_leaves import Action, registry_of, trace, wrapped

from kb import KnowledgeBase, Model
from rosa_bt import BehaviourRegistry, TraceVisitor, TreeRunner, XmlError, export_xml, load_xml

LEAVES = {"a": ("A", "RS"), "b": ("A", "SF"), "c": ("C", "SF")}
S, F, R = Status.SUCCESS, Status.FAILURE, Status.RUNNING
TREE = wrapped(
    '<Sequence><c/><SubTree ID="Sub"/><a name="last"/></Sequence>',
    Sub='<Sequence><a/><b name="b2"/></Sequence>',
)


def ran(substitutes, ticks=3, text=TREE):
    said = []
    tree = load_xml(text, registry_of(LEAVES, said), substitutes=substitutes)
    return trace(tree.tick_once, tree, said, ticks)


@pytest.mark.parametrize(
    ("substitutes", "lines"),
    [
        ({"last": S}, ["0| c:c:S a:s:R => RUNNING", "1| a:r:S b:s:S => SUCCESS"]),
        ({"a": S}, ["0| c:c:S b:s:S => SUCCESS", "1| c:c:F => FAILURE"]),
        ({"Main/Sub/*": S, "last": F}, ["0| c:c:S => FAILURE", "1| c:c:F => FAILURE"]),
        (
            {"*/b?": [F, R, S], "a": S},
            ["0| c:c:S => FAILURE", "1| c:c:F => FAILURE", "2| c:c:S => RUNNING", "3| => SUCCESS"],
        ),
        (
            {"c": [S, S, F], "Main*": S},
            ["0| => SUCCESS", "1| => SUCCESS", "2| => FAILURE", "3| => FAILURE"],
        ),
    ],
)
def test_leaf_is_substituted_by_name_tag_or_pattern_of_its_path(substitutes, lines):
    assert ran(substitutes, len(lines)) == lines


def test_substitute_needs_no_registered_behaviour_and_rules_stay():
    text = wrapped(
        '<Sequence><drive speed="2" _onSuccess="driven := 1"/><turn _skipIf="driven == 1"/></Sequence>'
    )
    tree = load_xml(text, BehaviourRegistry(), substitutes={"drive": [R, S], "turn": F})
    for outcome in (R, S):
        tree.tick_once()
        assert tree.status is outcome
    assert tree.blackboard["driven"] == 1
    assert '<drive speed="2" _onSuccess="driven := 1" />' in export_xml(tree)


def test_substitute_is_asked_again_only_if_the_leaf_would_be():
    text = wrapped("<PipelineSequence><{}/><a/></PipelineSequence>")
    assert ran({"c": [S, F], "a": R}, 2, text.format("c")) == ["0| => RUNNING", "1| => FAILURE"]
    made = []

    class Kept(Behaviour):
        def initialise(self):
            made.append(self.name)

        def update(self):
            return S

    registry = BehaviourRegistry()
    registry.register("b", Kept)
    registry.register("a", Kept)
    tree = load_xml(text.format("b"), registry, substitutes={"b": [S, F], "a": R})
    for _ in range(2):
        tree.tick_once()
        assert tree.status is R
    assert made == []


def test_function_makes_the_substitute():
    said = []
    tree = load_xml(
        TREE,
        registry_of(LEAVES, said),
        substitutes={"last": lambda name: Action(name, iter("RS"), said)},
    )
    assert trace(tree.tick_once, tree, said, 3)[1:] == [
        "1| a:r:S b:s:S last:s:R => RUNNING",
        "2| last:r:S => SUCCESS",
    ]


@pytest.mark.parametrize(
    ("substitutes", "problem"),
    [
        ({"lst": S}, "no leaf matches 'lst'; leaves: Main/Sub/a, Main/Sub/b2, Main/c, Main/last"),
        ({"last": []}, r"'last' is replaced by statuses of py_trees or by a function, not by \[\]"),
        (
            {"last": "SUCCESS"},
            "'last' is replaced by statuses of py_trees or by a function, not by 'SUCCESS'",
        ),
    ],
)
def test_substitute_that_cannot_be_is_refused(substitutes, problem):
    with pytest.raises(XmlError, match=problem):
        ran(substitutes)


def test_leaves_do_again_what_was_recorded_of_them():
    kb = KnowledgeBase(Model("rover"), clock=lambda: 0.0)
    tree = load_xml(TREE, registry_of(LEAVES, []))
    with TraceVisitor(kb) as visitor:
        runner = TreeRunner(tree, clock=lambda: 0.0)
        runner.tree.add_visitor(visitor)
        outcomes = []
        for _ in range(6):
            runner.tick()
            outcomes.append(runner.status)
    assert len(set(outcomes)) == 3
    recorded = {name: visitor.trace.statuses(name) for name in "cb"}
    assert recorded["c"][:2] == (S, F)
    again = load_xml(
        TREE,
        registry_of({"a": LEAVES["a"], "b": ("A", "F"), "c": ("C", "F")}, []),
        substitutes=recorded,
    )
    for outcome in outcomes:
        again.tick_once()
        assert again.status is outcome
