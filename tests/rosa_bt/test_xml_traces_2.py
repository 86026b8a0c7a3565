"""More that BehaviorTree.CPP 4.10 recorded: scripts, rules, ports, blackboards and refusals.

`btcpp_traces_2.json` says in `about` how its cases are read and judged.
"""

import json
import math
from itertools import cycle
from pathlib import Path
from typing import Any, ClassVar

import pytest
from acting import Clock
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin
from xml_leaves import STATUS

from rosa_bt import BehaviourRegistry, XmlError, load_xml
from rosa_bt.xml.reader import SubTree

CASES = json.loads(Path(__file__).with_name("btcpp_traces_2.json").read_text())["cases"]
REFUSALS = [pair for case in CASES if case["category"] == "refused" for pair in case["pairs"]]
TRACES = [case for case in CASES if case["category"] != "refused"] + [
    pair["mended"] for pair in REFUSALS
]
TYPES = {
    "int": int,
    "double": float,
    "bool": bool,
    "string": str,
    "int list": list[int],
    "string list": list[str],
    "point": dict,
}


class Leaf(PortsMixin, Behaviour):
    """Reads its in-ports, writes its out-ports, and does what is next in its script."""

    INPUT_PORTS: ClassVar[dict[str, PortInformation]] = {}
    OUTPUT_PORTS: ClassVar[dict[str, PortInformation]] = {}
    tag: ClassVar[str]
    script: ClassVar[Any]
    said: ClassVar[list[str]]
    written: ClassVar[dict[str, Any]]

    def __init_subclass__(cls, *, tag=None, register=False):
        super().__init_subclass__(tag=tag, register=register)

    def __init__(self, name):
        super().__init__(name)
        self.hook = "c"

    def act(self):
        for port in sorted(self.INPUT_PORTS):
            try:
                self.said.append(f"{self.tag}.{port}={told(self.get_input(port))}")
            except Exception:
                self.said.append(f"{self.tag}.{port}=?")
        for port, values in self.written.items():
            self._set_output(port, next(values))
        result = next(self.script)
        self.said.append(f"{self.tag}:{self.hook}:{result}")
        if result == "X":
            raise RuntimeError("the leaf raised")
        return STATUS[result]

    def update(self):
        return self.act()


class Action(Leaf):
    def initialise(self):
        self.hook = "s"

    def update(self):
        result = self.act()
        self.hook = "r"
        return result

    def terminate(self, new_status):
        if new_status is Status.INVALID and self.status is Status.RUNNING:
            self.said.append(f"{self.tag}:halt")


def told(value):
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return f"(x {told(value['x'])}, y {told(value['y'])})"
    if isinstance(value, list):
        return f"[{','.join(map(told, value))}]"
    return f"'{value}'" if isinstance(value, str) else f"{value:.10g}"


def registry_for(case, said):
    registry = BehaviourRegistry()
    for tag, (kind, script) in case["leaves"].items():
        ports = case.get("ports", {}).get(tag, {})
        ins = ports.get("in", {})
        outs = ports.get("out", {})
        cls = type(tag, (Action if kind == "A" else Leaf,), {})
        cls.INPUT_PORTS = {
            name: PortInformation(TYPES[of], required=False) for name, of in ins.items()
        }
        cls.OUTPUT_PORTS = {
            name: PortInformation(TYPES[of], required=False) for name, (of, _) in outs.items()
        }
        cls.written = {
            name: cycle([held(of, value) for value in values])
            for name, (of, values) in outs.items()
        }
        cls.tag = tag
        cls.script = cycle(script)
        cls.said = said
        registry.register(tag, cls)
    return registry


def held(kind, value):
    return dict(zip("xy", value, strict=True)) if kind == "point" else value


def is_same(recorded, found):
    kind, value, _ = recorded
    if kind not in ("double", "int", "bool"):
        return bool(found == held(kind, value))
    wanted = float(value)
    is_close = isinstance(found, int | float) and math.isclose(found, wanted, rel_tol=1e-9)
    return is_close or (math.isnan(wanted) and math.isnan(found))


def board_differences(recorded, boards):
    for tree, (wanted, board) in enumerate(zip(recorded, boards, strict=True)):
        present = dict(board)
        for key, kept in wanted.items():
            if kept[0] == "empty" and key not in present:
                continue
            if key not in present or not is_same(kept, present[key]):
                yield f"board {tree} {key}: {kept} but {present.get(key, 'nothing')!r}"
        yield from (
            f"board {tree} {key}: nothing but {present[key]!r}"
            for key in present.keys() - wanted.keys()
        )


def differences(case):
    """Yield in which a case is not as it was recorded."""
    said = []
    clock = Clock()
    try:
        tree = load_xml(
            case["xml"], registry_for(case, said), enums=case.get("enums", {}), clock=clock
        )
    except XmlError as error:
        if not case.get("may_refuse"):
            yield f"refused: {error}"
        return
    subtrees = [tree, *subtrees_of(tree)]
    recorded = case["loaded"]
    yield from board_differences(recorded, [subtree.blackboard for subtree in subtrees])
    for number, line in enumerate(case["trace"]):
        if "times" in case:
            clock.now = case["times"][number]
        for key, value in case.get("set", {}).get(str(number), {}).items():
            tree.blackboard[key] = value
        said.clear()
        try:
            tree.tick_once()
            outcome = "SKIPPED" if tree.status is Status.INVALID else tree.status.name
        except Exception as error:
            outcome = "ERROR"
            if not line.endswith("ERROR"):
                outcome += f" {type(error).__name__} {error}"
        mine = f"{number}| {' '.join([*said, ''])}=> {outcome}"
        if mine != line:
            yield f"{line}  but  {mine}"
            return
        if case["boards"][number] is not None:
            recorded = case["boards"][number]
        found = list(board_differences(recorded, [subtree.blackboard for subtree in subtrees]))
        if found:
            yield f"tick {number}: {'; '.join(found)}"
            return


def subtrees_of(node):
    for child in node.children:
        if isinstance(child, SubTree):
            yield child
        yield from subtrees_of(child)


def test_all_recorded_cases_are_here():
    assert (len(TRACES), len(REFUSALS)) == (356 + 51, 51)


@pytest.mark.parametrize("case", TRACES, ids=range(len(TRACES)))
def test_recorded_case_is_reproduced(case):
    assert not list(differences(case))


@pytest.mark.parametrize("pair", REFUSALS, ids=range(len(REFUSALS)))
def test_what_the_library_refuses_is_refused_or_noted(pair):
    registry = registry_for(pair["mended"], [])
    try:
        tree = load_xml(pair["refused"], registry)
    except XmlError:
        return
    noted = ("cannot stand in an ID", "the ID is taken", "texts stand in single quotes")
    assert any(note in " ".join(tree.notes) for note in noted)
