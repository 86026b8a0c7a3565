"""Behaviours of py_trees that ask which actions are feasible, and request those that they do."""

from rosa_bt.behaviours import HasStatus, IsActionFeasible, Measurement, RosaAction
from rosa_bt.composites import (
    do_until_unfeasible,
    feasible_then_act,
    first_feasible,
    switch_safely,
)
from rosa_bt.decorators import Delay, ForAction, Retry, Timeout, Timer, UntilSuccess
from rosa_bt.exceptions import (
    ClockError,
    ExportError,
    RegistryError,
    RosaBtError,
    TraceError,
    TreeChangeError,
    XmlError,
)
from rosa_bt.requests import forget_progress
from rosa_bt.runner import TreeRunner
from rosa_bt.trace import Trace, TraceVisitor, read_trace, replay_trace
from rosa_bt.worth import Decision, Detour, Gain, Lookahead, MissionValue, ValueSelector
from rosa_bt.xml import BehaviourRegistry, export_xml, load_xml

__all__ = [
    "BehaviourRegistry",
    "ClockError",
    "Decision",
    "Delay",
    "Detour",
    "ExportError",
    "ForAction",
    "Gain",
    "HasStatus",
    "IsActionFeasible",
    "Lookahead",
    "Measurement",
    "MissionValue",
    "RegistryError",
    "Retry",
    "RosaAction",
    "RosaBtError",
    "Timeout",
    "Timer",
    "Trace",
    "TraceError",
    "TraceVisitor",
    "TreeChangeError",
    "TreeRunner",
    "UntilSuccess",
    "ValueSelector",
    "XmlError",
    "do_until_unfeasible",
    "export_xml",
    "feasible_then_act",
    "first_feasible",
    "forget_progress",
    "load_xml",
    "read_trace",
    "replay_trace",
    "switch_safely",
]
