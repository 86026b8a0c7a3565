"""The words that ROSA's models are written in: types, the roles of relations, and attributes, in all their spellings.

The public models and schemas do not all spell alike. A type is compared without its capitals, `-` and `_`; a role is
understood with words such as `required-` before it, an attribute with anything before it: `action-name` is a name.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

__all__ = [
    "ALIASES",
    "ENTITIES",
    "FIELDS",
    "Field",
    "Kind",
    "QUALIFIERS",
    "RELATIONS",
    "ROLES",
    "Role",
    "SLIPS",
    "Value",
]


class Kind(StrEnum):
    """What a thing in a file is."""

    ACTION = "action"
    FUNCTION = "function"
    COMPONENT = "component"
    PARAMETER = "component parameter"
    ATTRIBUTE = "attribute"
    MODEL = "robot model"
    DESIGN = "function design"
    CONFIGURATION = "component configuration"
    REQUIREMENT = "functional requirement"
    CONSTRAINT = "constraint"
    ESTIMATION = "estimation"
    MEASUREMENT = "measurement"
    REQUIRED_ACTION = "required action"
    PLAN = "reconfiguration plan"
    ACTIVATION = "component activation"
    DEACTIVATION = "component deactivation"
    STRUCTURAL = "structural adaptation"
    ADAPTATION = "parameter adaptation"
    PROCESS = "component process"

    @property
    def label(self) -> str:
        """How it is spelled in the names of attributes."""
        return self.replace(" ", "-")


class Value(StrEnum):
    """What sort of value an attribute has, as messages call it."""

    TEXT = "a text in quotes"
    FLAG = "true or false"
    WHOLE = "a whole number"
    NUMBER = "a number"
    TIME = "a date and time such as 2024-05-01T12:30:00"
    ANY = "a text, a number or true or false"


@dataclass(frozen=True, slots=True)
class Field:
    """An attribute of a kind of thing, with the endings by which its name is known."""

    name: str
    value: Value
    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Role:
    """A part that things play in a relation.

    Attributes:
        name: what messages call it.
        kinds: what can play it.
        words: its spellings, without `QUALIFIERS`, in the singular.
        least, most: how many players it needs and can have; a `most` of 0 is any number.
    """

    name: str
    kinds: tuple[Kind, ...]
    words: tuple[str, ...]
    least: int
    most: int


ENTITIES: Final[Mapping[str, tuple[str | None, Kind]]] = {
    "Action": (None, Kind.ACTION),
    "Function": (None, Kind.FUNCTION),
    "Component": (None, Kind.COMPONENT),
    "ROSNode": ("Component", Kind.COMPONENT),
    "LifeCycleNode": ("ROSNode", Kind.COMPONENT),
    "ComponentParameter": (None, Kind.PARAMETER),
    "Attribute": (None, Kind.ATTRIBUTE),
    "QualityAttribute": ("Attribute", Kind.ATTRIBUTE),
    "EnvironmentalAttribute": ("Attribute", Kind.ATTRIBUTE),
    "RobotModel": (None, Kind.MODEL),
}
"""Each entity type: which one it is a sort of, and what we make of it."""

ALIASES: Final[Mapping[str, str]] = {
    "Measure": "Attribute",
    "EnvironmentAttribute": "EnvironmentalAttribute",
    "Parameter": "ComponentParameter",
}
"""Other names of the same types."""

RELATIONS: Final[Mapping[str, Kind]] = {
    "functional-requirement": Kind.REQUIREMENT,
    "function-design": Kind.DESIGN,
    "component-configuration": Kind.CONFIGURATION,
    "constraint": Kind.CONSTRAINT,
    "estimation": Kind.ESTIMATION,
    "measurement": Kind.MEASUREMENT,
    "required-action": Kind.REQUIRED_ACTION,
    "reconfiguration-plan": Kind.PLAN,
    "component-activation": Kind.ACTIVATION,
    "component-deactivation": Kind.DEACTIVATION,
    "structural-adaptation": Kind.STRUCTURAL,
    "parameter-adaptation": Kind.ADAPTATION,
    "component-process": Kind.PROCESS,
}
"""Each relation type, and what we make of it."""


SLIPS: Final[Mapping[str, str]] = {"=<": "<=", "=>": ">=", "≤": "<=", "≥": ">="}
"""What is written for a comparison by mistake, and what is meant."""


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


QUALIFIERS: Final = frozenset(
    _words(
        "action activated active adapted affected affecting causing chosen component configuration configured "
        "configuring constrained constraining constraint current deactivated design desired estimated estimating "
        "estimation executed function impacted impacting influenced influencing measured measurement measuring "
        "monitored new observed old own preference preferred process realised realized related relevant requested "
        "required requiring selected target used"
    )
)
"""Words before a role that add nothing to it."""

_ATTRIBUTE: Final = (
    "attribute measure quality-attribute environmental-attribute environment-attribute metric qa ea element"
)
_CHOICE: Final = "function-design design component component-configuration configuration element"
_STEPS: Final = (
    ("component-activation", Kind.ACTIVATION, "activation activate activated component-to-activate"),
    ("component-deactivation", Kind.DEACTIVATION, "deactivation deactivate deactivated component-to-deactivate"),
)


def _role(name: str, kinds: tuple[Kind, ...], words: str, *, least: int = 1, most: int = 0) -> Role:
    return Role(name, kinds, _words(words), least, most)


def _component(words: str = "", *, least: int = 0, most: int = 0) -> Role:
    return _role("component", (Kind.COMPONENT,), f"component node {words}", least=least, most=most)


_SWITCHED: Final = tuple(_role(name, (kind, Kind.COMPONENT), words, least=0) for name, kind, words in _STEPS)
_CHOICES: Final = (Kind.DESIGN, Kind.COMPONENT, Kind.CONFIGURATION)

ROLES: Final[Mapping[Kind, tuple[Role, ...]]] = {
    Kind.REQUIREMENT: (
        _role("action", (Kind.ACTION,), "action requirer"),
        _role("required-function", (Kind.FUNCTION,), "function required requirement"),
    ),
    Kind.DESIGN: (
        _role("function", (Kind.FUNCTION,), "function solved realised realized", most=1),
        _role("required-component", (Kind.COMPONENT,), "component node required", least=0),
    ),
    Kind.CONFIGURATION: (
        _component("configured", least=1, most=1),
        _role("parameter", (Kind.PARAMETER,), "parameter parameter-value", least=0),
    ),
    Kind.CONSTRAINT: (
        _role(
            "constrained",
            (Kind.ACTION, *_CHOICES),
            f"constrained constrainee constrained-thing constrained-entity action {_CHOICE}",
        ),
        _role(
            "attribute",
            (Kind.ATTRIBUTE,),
            f"condition constraint constrainer constraining measurement measured {_ATTRIBUTE}",
            most=1,
        ),
    ),
    Kind.ESTIMATION: (
        _role(
            "affected",
            (Kind.ATTRIBUTE,),
            f"affected affectee impacted influenced estimated estimation impact effect target {_ATTRIBUTE}",
        ),
        _role(
            "causer",
            _CHOICES,
            "causer cause causing affecting affecter impacting influencing influencer source estimating "
            f"estimator effector estimation origin contributor impact {_CHOICE}",
        ),
    ),
    Kind.MEASUREMENT: (_role("measured-attribute", (Kind.ATTRIBUTE,), f"measured measurement {_ATTRIBUTE}"),),
    Kind.REQUIRED_ACTION: (
        _role("action", (Kind.ACTION,), "action required requested"),
        _role(
            "preferred-attribute",
            (Kind.ATTRIBUTE, Kind.ESTIMATION),
            f"preferred preference estimation estimated {_ATTRIBUTE}",
            least=0,
        ),
    ),
    Kind.PLAN: (
        _role(
            "structural-adaptation",
            (Kind.STRUCTURAL, Kind.ACTIVATION, Kind.DEACTIVATION),
            "structural-adaptation adaptation structural plan reconfiguration",
            least=0,
        ),
        *_SWITCHED,
        _role(
            "parameter-adaptation",
            (Kind.ADAPTATION, Kind.CONFIGURATION),
            "parameter-adaptation adaptation parameter plan reconfiguration component-configuration configuration",
            least=0,
        ),
    ),
    Kind.ACTIVATION: (_component("activated activation"),),
    Kind.DEACTIVATION: (_component("deactivated deactivation"),),
    Kind.STRUCTURAL: _SWITCHED,
    Kind.ADAPTATION: (
        _role(
            "component-configuration",
            (Kind.CONFIGURATION,),
            "component-configuration configuration adaptation parameter-adaptation adapted",
            least=0,
        ),
        _component(),
        _role("parameter", (Kind.PARAMETER,), "parameter", least=0),
    ),
    Kind.PROCESS: (_component("process", least=1, most=1),),
}
"""The roles of each relation."""

_NAME: Final = Field("name", Value.TEXT, ("name",))
_STATUS: Final = Field("status", Value.TEXT, ("status",))
_REQUIRED: Final = Field("required", Value.FLAG, ("is-required", "required"))
_SELECTED: Final = Field("selected", Value.FLAG, ("is-selected", "selected"))
_IMPROVE: Final = Field("always_improve", Value.FLAG, ("always-improve", "improve"))
_PRIORITY: Final = Field("priority", Value.NUMBER, ("priority",))
_VALUE: Final = Field("value", Value.NUMBER, ("value",))
_PERIOD: Final = (
    Field("start", Value.TIME, ("start-time", "start", "time", "started", "timestamp", "begin")),
    Field("end", Value.TIME, ("end-time", "end", "ended", "finish-time")),
    Field("start", Value.NUMBER, ("start-seconds",)),
    Field("end", Value.NUMBER, ("end-seconds",)),
)
_RESULT: Final = Field("result", Value.TEXT, ("result",))
_PID: Final = Field("pid", Value.WHOLE, ("pid",))
_MEASURED: Final = (
    Field("value", Value.NUMBER, ("value", "measurement")),
    Field("time", Value.TIME, ("time", "timestamp", "time-stamp", "date")),
    Field("time", Value.NUMBER, ("time-seconds",)),
    Field("latest", Value.FLAG, ("latest", "is-latest")),
)

FIELDS: Final[Mapping[Kind, tuple[Field, ...]]] = {
    Kind.ACTION: (_NAME, _STATUS, _REQUIRED),
    Kind.FUNCTION: (_NAME, _STATUS, _REQUIRED, _IMPROVE),
    Kind.COMPONENT: (
        _NAME,
        _STATUS,
        _REQUIRED,
        Field("active", Value.FLAG, ("is-active", "active")),
        _IMPROVE,
        Field("stops_to_configure", Value.FLAG, ("stops-to-configure",)),
        Field("package", Value.TEXT, ("package", "package-name")),
        Field("executable", Value.TEXT, ("executable", "executable-name")),
        _PID,
    ),
    Kind.PARAMETER: (
        Field("key", Value.TEXT, ("key", "name")),
        Field("value", Value.ANY, ("value",)),
        Field("type", Value.TEXT, ("type",)),
    ),
    Kind.ATTRIBUTE: (
        _NAME,
        *_MEASURED,
        Field("max_age", Value.NUMBER, ("max-age",)),
        Field("when_stale", Value.TEXT, ("when-stale",)),
        Field("agreement", Value.TEXT, ("agreement",)),
    ),
    Kind.MODEL: (_NAME,),
    Kind.DESIGN: (_NAME, _PRIORITY, _STATUS, _SELECTED),
    Kind.CONFIGURATION: (_NAME, _PRIORITY, _STATUS, _SELECTED),
    Kind.REQUIREMENT: (),
    Kind.CONSTRAINT: (
        Field("operator", Value.TEXT, ("operator",)),
        _VALUE,
        _STATUS,
        Field("hysteresis", Value.NUMBER, ("hysteresis",)),
        Field("dwell", Value.NUMBER, ("dwell",)),
    ),
    Kind.ESTIMATION: (_VALUE, Field("type", Value.TEXT, ("type",))),
    Kind.MEASUREMENT: _MEASURED,
    Kind.REQUIRED_ACTION: (*_PERIOD, _RESULT, Field("weights", Value.TEXT, ("preference-weights",))),
    Kind.PLAN: (*_PERIOD, _RESULT),
    Kind.ACTIVATION: (),
    Kind.DEACTIVATION: (),
    Kind.STRUCTURAL: (),
    Kind.ADAPTATION: (),
    Kind.PROCESS: (_PID, *_PERIOD),
}
"""The attributes that each kind of thing has."""
