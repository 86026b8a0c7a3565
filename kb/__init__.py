"""What a robot knows: which actions are feasible now, why, and how it has to be configured."""

from kb.diagnostics import DiagnosticProblem, DiagnosticRules
from kb.elements import ComponentKind, Expression
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
from kb.files import ModelFileError
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import ManagedSystem
from kb.manager import ConfigurationManager, Planner
from kb.model import Model
from kb.optimal import OptimalPlanner
from kb.planning import Choice, PriorityPlanner
from kb.processes import ProcessComponents, Program
from kb.records import (
    ReconfigurationPlan,
    RequiredAction,
)
from kb.situations import Situation
from kb.status import Status

__all__ = [
    "AmbiguousName",
    "Choice",
    "ComponentKind",
    "ConfigurationManager",
    "DiagnosticProblem",
    "DiagnosticRules",
    "DuplicateName",
    "Event",
    "EventKind",
    "Expression",
    "InvalidValue",
    "KnowledgeBase",
    "KnowledgeBaseError",
    "ManagedSystem",
    "Model",
    "ModelError",
    "ModelFileError",
    "OptimalPlanner",
    "Planner",
    "PriorityPlanner",
    "ProcessComponents",
    "Program",
    "ProtocolError",
    "ReconfigurationPlan",
    "RequiredAction",
    "Situation",
    "StagedExecutor",
    "Status",
    "StatusChange",
    "UnknownName",
]
