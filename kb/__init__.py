"""What a robot knows: which actions are feasible now, why, and how it has to be configured for what it does."""

from kb.checks import Finding, Severity
from kb.diagnostics import DiagnosticProblem, DiagnosticRules
from kb.elements import AttributeKind, ComponentKind, EstimationKind, Expression, StalePolicy
from kb.events import Event, EventKind, StatusChange
from kb.exceptions import (
    AmbiguousName,
    DuplicateName,
    InvalidValue,
    KnowledgeBaseError,
    ModelError,
    ProtocolError,
    UnknownName,
)
from kb.execution import StagedExecutor
from kb.explain import ChoiceExplanation, Explanation
from kb.files import ModelFileError
from kb.forecast import FeasibleUntil, Forecast
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import ManagedSystem, Operation
from kb.manager import ConfigurationManager, Executor, Monitor, Planner
from kb.model import Model
from kb.optimal import OptimalPlanner, Optimum
from kb.planning import Choice, Obsolete, PriorityPlanner
from kb.processes import ProcessComponents, Program
from kb.records import (
    Attempt,
    Log,
    Process,
    ReconfigurationPlan,
    Reply,
    RequiredAction,
    VetoAnswer,
)
from kb.situations import Situation
from kb.status import Status
from kb.store import StoreError

__all__ = [
    "AmbiguousName",
    "Attempt",
    "AttributeKind",
    "Choice",
    "ChoiceExplanation",
    "ComponentKind",
    "ConfigurationManager",
    "DiagnosticProblem",
    "DiagnosticRules",
    "DuplicateName",
    "EstimationKind",
    "Event",
    "EventKind",
    "Executor",
    "Explanation",
    "Expression",
    "FeasibleUntil",
    "Finding",
    "Forecast",
    "InvalidValue",
    "KnowledgeBase",
    "KnowledgeBaseError",
    "Log",
    "ManagedSystem",
    "Model",
    "ModelError",
    "ModelFileError",
    "Monitor",
    "Obsolete",
    "Operation",
    "OptimalPlanner",
    "Optimum",
    "Planner",
    "PriorityPlanner",
    "Process",
    "ProcessComponents",
    "Program",
    "ProtocolError",
    "ReconfigurationPlan",
    "Reply",
    "RequiredAction",
    "Severity",
    "Situation",
    "StagedExecutor",
    "StalePolicy",
    "Status",
    "StatusChange",
    "StoreError",
    "UnknownName",
    "VetoAnswer",
]
