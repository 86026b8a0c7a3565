"""What of a robot is what of a model: the settings of a bridge, in Python or in `bridge.toml`."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.wires.node import TIMEOUT_S

_ITEMS: Final = {
    "timeouts": ((int, float), "numbers"),
    "diagnostics": ((str, dict), "texts or tables"),
}
"""What the tables of `bridge.toml` hold; any other one texts."""
_WORDS: Final = {str: "a text", bool: "true or false", float: "a number"}


@dataclass(frozen=True)
class BridgeSettings:
    """Which topics and nodes of a robot are which attributes and components, as in `bridge.toml`.

    Attributes:
        url: of the robot's rosbridge, e.g. "ws://127.0.0.1:9090".
        attributes: for each name the field that measures it, "/topic.field" (more dots lead to
            deeper fields and array elements), and after a space the type, e.g.
            "/battery_state.percentage sensor_msgs/msg/BatteryState".
        components: for each name its node, e.g. "/camera"; a lifecycle component that is not named
            here is the node with its own name.
        diagnostics: what the statuses of a name mean, by pattern; see `kb.DiagnosticRules`.
        diagnostics_topic: empty for none.
        timeout_s: how long a call of a node may take [s].
        timeouts: the same for single components, by name [s].
        poll_s: the period at which each node is asked for its state [s].
        notice_s: after which a node that does not answer has failed [s].
        restarted: "recover" if a node that was restarted is used again, "fail" if it stays failed.
        use_sim_time: run by `/clock`, as the nodes do that have this parameter.
    """

    url: str = "ws://127.0.0.1:9090"
    attributes: Mapping[str, str] = field(default_factory=dict)
    components: Mapping[str, str] = field(default_factory=dict)
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    diagnostics_topic: str = "/diagnostics"
    timeout_s: float = TIMEOUT_S
    timeouts: Mapping[str, float] = field(default_factory=dict)
    poll_s: float = 1.0
    notice_s: float = 3.0
    restarted: str = "recover"
    use_sim_time: bool = False

    def __post_init__(self) -> None:
        if self.restarted not in ("recover", "fail"):
            raise MissionError(f"restarted is recover or fail, not {self.restarted!r}")
        for seconds in (self.timeout_s, self.poll_s, self.notice_s, *self.timeouts.values()):
            if not 0 < seconds < math.inf:
                raise MissionError(f"a time of the bridge is more than 0 s, not {seconds!r}")

    @classmethod
    def load(cls, path: str | Path) -> "BridgeSettings":
        """Read `bridge.toml`.

        Raises:
            MissionError: it cannot be read, or a field is unknown or of the wrong type.
        """
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise MissionError(f"cannot read {path}: {reason}") from None
        defaults = vars(cls())
        for name, value in values.items():
            if name not in defaults:
                fields = ", ".join(defaults)
                raise MissionError(f"{path} has an unknown field {name!r}; known are {fields}")
            kind = type(defaults[name])
            if kind is dict:
                item, words = _ITEMS.get(name, (str, "texts"))
                words = f"a table of {words}"
                is_right = isinstance(value, dict) and all(_is(v, item) for v in value.values())
            else:
                words = _WORDS[kind]
                is_right = _is(value, (int, float) if kind is float else kind)
            if not is_right:
                raise MissionError(f"{name} in {path} must be {words}")
        return cls(**values)


def _is(value: object, kind: Any) -> bool:  # noqa: ANN401  # a type or a tuple of types
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
