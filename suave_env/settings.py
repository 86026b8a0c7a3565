"""The constants of the simulated sea.

`settings.toml` has the unit, the meaning and the source of each.
"""

import dataclasses
import difflib
import math
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from importlib.resources import files
from typing import Any, Final, NamedTuple


class SuaveEnvError(Exception):
    """Base of every error of this package.

    The message says what was given, what is allowed and what exists.
    """


def unknown_name(kind: str, name: object, existing: Iterable[str]) -> SuaveEnvError:
    """Make the error for a name that does not exist.

    It lists the nearest known names, or all if none is near.
    """
    names = list(existing)
    near = difflib.get_close_matches(str(name), names, n=3)
    hint = (
        f"the nearest are {', '.join(near)}" if near else f"known are {', '.join(names) or 'none'}"
    )
    return SuaveEnvError(f"there is no {kind} {name!r}; {hint}")


_TABLE: Final[dict[str, Any]] = tomllib.loads(
    files("suave_env").joinpath("settings.toml").read_text(encoding="utf-8")
)
"""By name of a setting: default, unit, meaning, source, lowest and highest value."""
RULES: Final[dict[str, Any]] = {"2024": {}, "2025": _TABLE.pop("2025")}
"""By set of rules, the settings that differ from the defaults."""


def _setting(name: str) -> Any:  # noqa: ANN401  # of the type that is declared
    """Return a field of `Settings`, as the table says; the bounds of a number are inclusive."""
    default, unit, meaning, source, low, high = _TABLE[name]
    metadata = {"unit": unit, "meaning": meaning, "source": source, "low": low, "high": high}
    return field(default=default, metadata=metadata)


class ThrusterEvent(NamedTuple):
    """A thruster, 1 to 6, that fails or else recovers by itself, at a time since GUIDED [s]."""

    thruster: int
    fails: bool
    time: float


@dataclass(frozen=True)
class Settings:
    """The constants of the sea, the vehicle and the mission; frozen, so change them with `replace`.

    Frames: world frame ENU, z up, surface at z = 0. Times [s] count from GUIDED, the moment at
    which the vehicle obeys. By default the rules are those of SUAVE v1.3.0 of 2024;
    `replace(rules="2025")` takes those of 2025 (`RULES`).
    """

    rules: str = _setting("rules")

    # The loop
    physics_step_s: float = _setting("physics_step_s")
    control_period_s: float = _setting("control_period_s")
    pose_period_s: float = _setting("pose_period_s")

    # Start; each start or bias that is set is exact, unless its standard deviation is set too
    start_x_m: float = _setting("start_x_m")
    start_y_m: float = _setting("start_y_m")
    start_z_m: float = _setting("start_z_m")
    start_x_sd_m: float = _setting("start_x_sd_m")
    start_y_sd_m: float = _setting("start_y_sd_m")
    bias_m: float = _setting("bias_m")
    bias_sd_m: float = _setting("bias_sd_m")
    boot_s: float = _setting("boot_s")
    late_boot_share: float = _setting("late_boot_share")
    late_boot_s: float = _setting("late_boot_s")
    start_delay_s: float = _setting("start_delay_s")

    # Vehicle
    mass_kg: float = _setting("mass_kg")
    inertia_roll_kg_m2: float = _setting("inertia_roll_kg_m2")
    inertia_pitch_kg_m2: float = _setting("inertia_pitch_kg_m2")
    inertia_yaw_kg_m2: float = _setting("inertia_yaw_kg_m2")
    centre_of_mass_z_m: float = _setting("centre_of_mass_z_m")
    displaced_mass_kg: float = _setting("displaced_mass_kg")
    centre_of_buoyancy_z_m: float = _setting("centre_of_buoyancy_z_m")
    gravity_m_s2: float = _setting("gravity_m_s2")
    drag_surge: float = _setting("drag_surge")
    drag_sway: float = _setting("drag_sway")
    drag_heave: float = _setting("drag_heave")
    drag_roll: float = _setting("drag_roll")
    drag_pitch: float = _setting("drag_pitch")
    drag_yaw: float = _setting("drag_yaw")
    thrust_limit_n: float = _setting("thrust_limit_n")
    propeller_m: float = _setting("propeller_m")

    # Guidance and control
    speed_limit_m_s: float = _setting("speed_limit_m_s")
    climb_limit_m_s: float = _setting("climb_limit_m_s")
    descent_limit_m_s: float = _setting("descent_limit_m_s")
    acceleration_limit_m_s2: float = _setting("acceleration_limit_m_s2")
    climb_acceleration_limit_m_s2: float = _setting("climb_acceleration_limit_m_s2")
    jerk_limit_m_s3: float = _setting("jerk_limit_m_s3")
    velocity_lag_s: float = _setting("velocity_lag_s")
    position_gain: float = _setting("position_gain")
    height_gain: float = _setting("height_gain")
    height_lag_s: float = _setting("height_lag_s")
    integral_gain: float = _setting("integral_gain")
    integral_limit_n: float = _setting("integral_limit_n")
    heading_gain: float = _setting("heading_gain")
    heading_damping: float = _setting("heading_damping")
    roll_damping: float = _setting("roll_damping")

    # Camera and pipeline
    half_view_angle_rad: float = _setting("half_view_angle_rad")
    pipe_point_offset_m: float = _setting("pipe_point_offset_m")
    pipe_turn_rad: float = _setting("pipe_turn_rad")

    # Water
    visibility_min_m: float = _setting("visibility_min_m")
    visibility_max_m: float = _setting("visibility_max_m")
    visibility_period_s: float = _setting("visibility_period_s")
    visibility_shift_s: float = _setting("visibility_shift_s")
    visibility_monitor_period_s: float = _setting("visibility_monitor_period_s")

    # Thruster failure and its recovery
    thruster_events: str = _setting("thruster_events")
    thruster_events_chained: bool = _setting("thruster_events_chained")
    thruster_told_twice: bool = _setting("thruster_told_twice")
    thruster_monitor_period_s: float = _setting("thruster_monitor_period_s")
    recovery_wait_s: float = _setting("recovery_wait_s")
    recovery_spacing_s: float = _setting("recovery_spacing_s")
    recovery_interruptible: bool = _setting("recovery_interruptible")

    # Battery and recharge
    battery: bool = _setting("battery")
    discharge_time_s: float = _setting("discharge_time_s")
    battery_period_s: float = _setting("battery_period_s")
    recharge_period_s: float = _setting("recharge_period_s")
    recharge_resends: bool = _setting("recharge_resends")
    recharge_tolerance_m: float = _setting("recharge_tolerance_m")
    station_x_m: float = _setting("station_x_m")
    station_y_m: float = _setting("station_y_m")
    transit_altitude_m: float = _setting("transit_altitude_m")

    # Spiral search
    spiral_period_s: float = _setting("spiral_period_s")
    spiral_altitude_m: float = _setting("spiral_altitude_m")
    spiral_angle_step_rad: float = _setting("spiral_angle_step_rad")
    spiral_tolerance_m: float = _setting("spiral_tolerance_m")
    spiral_patience: int = _setting("spiral_patience")
    spiral_correction_m: float = _setting("spiral_correction_m")
    spiral_restarts: bool = _setting("spiral_restarts")

    # Pipeline following
    follow_period_s: float = _setting("follow_period_s")
    follow_altitude_m: float = _setting("follow_altitude_m")
    follow_tolerance_m: float = _setting("follow_tolerance_m")
    follow_patience: int = _setting("follow_patience")
    follow_loses_point: bool = _setting("follow_loses_point")

    # Mission and managers
    activation_s: float = _setting("activation_s")
    deactivation_s: float = _setting("deactivation_s")
    parameter_s: float = _setting("parameter_s")
    guided_period_s: float = _setting("guided_period_s")
    mission_period_s: float = _setting("mission_period_s")
    tree_period_s: float = _setting("tree_period_s")

    def __post_init__(self) -> None:
        """Check every value, and the values against each other."""
        for info in fields(self):
            object.__setattr__(self, info.name, _checked(info, getattr(self, info.name)))
        if self.visibility_min_m > self.visibility_max_m:
            least = self.visibility_min_m
            most = self.visibility_max_m
            raise SuaveEnvError(f"visibility_min_m {least} is above visibility_max_m {most}")
        period = self.control_period_s
        step = self.physics_step_s
        if round(period / step) < 1 or abs(period / step - round(period / step)) > 1e-6:
            raise SuaveEnvError(
                f"control_period_s {period} is not a whole multiple of physics_step_s {step}"
            )
        if self.rules not in RULES:
            raise SuaveEnvError(f"there are no rules {self.rules!r}; known are {', '.join(RULES)}")
        parse_thruster_events(self.thruster_events, self.thruster_events_chained)

    def replace(self, **changes: float | int | bool | str) -> "Settings":
        """Return settings with some values changed.

        Args:
            **changes: New values by name. New rules change every setting in which they differ and
                which is not among the changes. A start or a bias is the same in every run, unless
                its standard deviation is among the changes too.

        Raises:
            SuaveEnvError: If a name is unknown, or a value is not allowed or at odds with another.
        """
        for name in changes:
            if name not in _TABLE:
                raise unknown_name("setting", name, _TABLE)
        values = dict(changes)
        rules = str(changes.get("rules"))
        if rules in RULES:
            defaults = {name: _TABLE[name][0] for name in RULES["2025"]}
            values = {**defaults, **RULES[rules], **changes}
        for name, spread in _SPREADS.items():
            if name in changes:
                values[spread] = changes.get(spread, 0.0)
        return dataclasses.replace(self, **values)  # type: ignore[arg-type]  # checked by __post_init__, not by its type


_EVENT: Final = re.compile(r"([1-6]) (failure|recovery) ([0-9]+\.?[0-9]*)")
_SPREADS: Final = {"start_x_m": "start_x_sd_m", "start_y_m": "start_y_sd_m", "bias_m": "bias_sd_m"}


def parse_thruster_events(text: str, chained: bool = False) -> tuple[ThrusterEvent, ...]:
    """Read events such as "1 failure 35, 1 recovery 90".

    Args:
        text: Events separated by commas, each a thruster, "failure" or "recovery", and a time [s].
        chained: Whether the time counts from the event before, not from GUIDED.

    Returns:
        The events in order of time.
    """
    events = list[ThrusterEvent]()
    time = 0.0
    for part in filter(None, (" ".join(words.split()) for words in text.split(","))):
        read = _EVENT.fullmatch(part)
        if read is None:
            example = '"1 failure 35, 1 recovery 90"'
            allowed = f"events such as {example}: thruster 1 to 6, what happens, time [s]"
            raise SuaveEnvError(f"thruster_events cannot be {text!r}; allowed are {allowed}")
        time = float(read[3]) + (time if chained else 0.0)
        events.append(ThrusterEvent(int(read[1]), read[2] == "failure", time))
    return tuple(sorted(events, key=lambda event: event.time))


def _checked(
    info: "dataclasses.Field[float]", value: float | int | bool | str
) -> float | int | bool | str:
    """Return the value in the type of the setting, or refuse it."""
    kind = type(info.default)
    low = info.metadata["low"]
    high = info.metadata["high"]
    if kind is float and type(value) is int:
        value = float(value)
    is_bounded = kind in (int, float)
    if type(value) is kind and (not is_bounded or (math.isfinite(value) and low <= value <= high)):
        return value
    words = {bool: "true or false", str: "text", int: "a whole number", float: "a number"}
    bounds = f" from {low:g}" if is_bounded and low > -math.inf else ""
    bounds += f" to {high:g}" if is_bounded and high < math.inf else ""
    allowed = f"{words[kind]}{bounds} [{info.metadata['unit']}]"
    raise SuaveEnvError(f"setting {info.name} cannot be {value!r}; allowed is {allowed}")
