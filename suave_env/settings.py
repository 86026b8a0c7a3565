"""Every constant of the simulated sea, with its unit, its meaning and its source."""

import dataclasses
import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Final, NamedTuple, TypeVar

T = TypeVar("T", float, int, bool, str)


class SuaveEnvError(Exception):
    """Base of every error of this package; the message says what was given, what is allowed and what exists."""


def unknown_name(kind: str, name: object, known: Iterable[str]) -> SuaveEnvError:
    """Make the error for a name that does not exist; it lists the nearest known names, or all if none is near."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, n=3)
    hint = (
        f"the nearest are {', '.join(near)}" if near else f"known are {', '.join(names) or 'none'}"
    )
    return SuaveEnvError(f"there is no {kind} {name!r}; {hint}")


RULES: Final[Mapping[str, Mapping[str, float | bool | str]]] = {
    # kas-lab/suave v1.3.0, with which the table of the ROSA paper was made: the defaults of Settings
    "2024": {},
    # kas-lab/suave of June 2025, and the experiment of that year: visibility period 120 s, no thruster failure
    "2025": {
        "start_y_m": 2.5,
        "start_x_sd_m": 0.0,
        "start_y_sd_m": 0.0,
        "bias_m": 0.0,
        "bias_sd_m": 0.0,
        "boot_s": 20.0,
        "pipe_point_offset_m": 0.0,
        "visibility_period_s": 120.0,
        "thruster_events": "",
        "thruster_events_chained": False,
        "thruster_told_twice": True,
        "recovery_interruptible": True,
        "recharge_period_s": 0.5,
        "recharge_resends": False,
        "spiral_restarts": True,
        "follow_loses_point": False,
        "mission_period_s": 0.1,
    },
}
"""The settings of each set of rules that differ from the defaults."""

_SUAVE = "kas-lab/suave v1.3.0"
_MODEL = "vehicle model clydemcqueen/bluerov2_ignition"
_SUB = "ArduPilot, defaults of Sub"
_OWN = "own choice"
_FITTED = "calibrated on three groups of published runs, see docs/sea.md"
_DRAWN = "calibrated on the table of the ROSA paper, see docs/sea.md"
_SPREAD = "calibrated on the published deviations of managed runs, see docs/sea.md"
_ROS = "typical of ROS 2 (10 to 50 ms)"
_EXPERIMENT = "extended SUAVE experiment of the ROSA paper (300 s, visibility period 80 s)"


def _setting(
    default: T, unit: str, meaning: str, source: str, low: float = -math.inf, high: float = math.inf
) -> T:
    """Declare a setting; `low` and `high` are the inclusive bounds of a number."""
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

    Frames: world frame ENU, z up, surface at z = 0. Times [s] count from GUIDED, the moment at which the vehicle obeys.
    By default the rules are those of SUAVE v1.3.0 of 2024; `replace(rules="2025")` takes those of 2025 (`RULES`).
    """

    rules: str = _setting("2024", "-", "rules of SUAVE: 2024 or 2025", _SUAVE)

    # The loop
    physics_step_s: float = _setting(0.02, "s", "step of the physics engine", _OWN, 1e-4, 0.1)
    control_period_s: float = _setting(
        0.04, "s", "period at which the thrusts are computed", _OWN, 1e-4, 0.2
    )
    pose_period_s: float = _setting(
        0.05, "s", "period at which the camera looks for the pipeline", _MODEL, 1e-3
    )

    # Start; each start or bias that is set is exact, unless its standard deviation is set too
    start_x_m: float = _setting(
        -17.0, "m", "mean start position, east; also the centre of the spiral", _SUAVE
    )
    start_y_m: float = _setting(
        2.4, "m", "mean start position, north; also the centre of the spiral", _DRAWN
    )
    start_z_m: float = _setting(
        -18.5, "m", "height at which the vehicle is put into the sea", _SUAVE, -19.9, -1.0
    )
    start_x_sd_m: float = _setting(
        0.1, "m", "standard deviation of the start position, east", _DRAWN, 0
    )
    start_y_sd_m: float = _setting(
        0.25, "m", "standard deviation of the start position, north", _DRAWN, 0
    )
    bias_m: float = _setting(0.75, "m", "mean of true height minus commanded height", _DRAWN, -5, 5)
    bias_sd_m: float = _setting(0.18, "m", "standard deviation of that bias", _DRAWN, 0)
    boot_s: float = _setting(
        30.0, "s", "time during which the vehicle floats up before GUIDED", _SUAVE, 0, 100
    )
    late_boot_share: float = _setting(
        0.0, "-", "share of the runs whose boot is too long (published: 0.015)", _SPREAD, 0, 1
    )
    late_boot_s: float = _setting(
        15.0, "s", "how much longer such a boot is, which adds to height and bias", _SPREAD, 0, 100
    )
    start_delay_s: float = _setting(4.0, "s", "time until the first setpoint is obeyed", _FITTED, 0)

    # Vehicle
    mass_kg: float = _setting(10.012, "kg", "mass with thrusters", _MODEL, 0.1)
    inertia_roll_kg_m2: float = _setting(
        0.105, "kg m2", "moment of inertia about the forward axis", _MODEL, 1e-3
    )
    inertia_pitch_kg_m2: float = _setting(
        0.184, "kg m2", "moment of inertia about the left axis", _MODEL, 1e-3
    )
    inertia_yaw_kg_m2: float = _setting(
        0.275, "kg m2", "moment of inertia about the upward axis", _MODEL, 1e-3
    )
    centre_of_mass_z_m: float = _setting(
        0.011, "m", "height of the centre of mass, body frame", _MODEL, -1, 1
    )
    displaced_mass_kg: float = _setting(10.040, "kg", "mass of the displaced water", _MODEL, 0)
    centre_of_buoyancy_z_m: float = _setting(
        0.06, "m", "height of the centre of buoyancy, body frame", _MODEL, -1, 1
    )
    gravity_m_s2: float = _setting(9.8, "m/s2", "gravity", "Gazebo, default", 0)
    drag_surge: float = _setting(33.732, "N s2/m2", "quadratic drag, forward", _MODEL, 0)
    drag_sway: float = _setting(54.16, "N s2/m2", "quadratic drag, sideways", _MODEL, 0)
    drag_heave: float = _setting(73.225, "N s2/m2", "quadratic drag, upward", _MODEL, 0)
    drag_roll: float = _setting(3.992, "N m s2", "quadratic drag about the forward axis", _MODEL, 0)
    drag_pitch: float = _setting(3.992, "N m s2", "quadratic drag about the left axis", _MODEL, 0)
    drag_yaw: float = _setting(3.992, "N m s2", "quadratic drag about the upward axis", _MODEL, 0)
    thrust_limit_n: float = _setting(
        50.0, "N", "largest thrust of one thruster, both directions", _MODEL, 0.1
    )
    propeller_m: float = _setting(
        0.076, "m", "diameter of a propeller, for its energy", "T200, data sheet", 0.01
    )

    # Guidance and control
    speed_limit_m_s: float = _setting(
        1.0, "m/s", "horizontal speed limit", f"{_SUB}: WPNAV_SPEED", 0.01
    )
    climb_limit_m_s: float = _setting(
        2.5, "m/s", "upward speed limit", f"{_SUB}: WPNAV_SPEED_UP", 0.01
    )
    descent_limit_m_s: float = _setting(
        1.5, "m/s", "downward speed limit", f"{_SUB}: WPNAV_SPEED_DN", 0.01
    )
    acceleration_limit_m_s2: float = _setting(
        2.5, "m/s2", "horizontal acceleration", f"{_SUB}: WPNAV_ACCEL", 0.01
    )
    climb_acceleration_limit_m_s2: float = _setting(
        1.0, "m/s2", "upward acceleration", f"{_SUB}: WPNAV_ACCEL_Z", 0.01
    )
    jerk_limit_m_s3: float = _setting(0.39, "m/s3", "jerk limit of a move", _FITTED, 0.01)
    velocity_lag_s: float = _setting(0.5, "s", "time constant of the velocity loop", _FITTED, 0.05)
    position_gain: float = _setting(
        1.0, "1/s", "horizontal position gain", f"{_SUB}: PSC_POSXY_P", 0
    )
    height_gain: float = _setting(3.0, "1/s", "vertical position gain", f"{_SUB}: PSC_POSZ_P", 0)
    height_lag_s: float = _setting(
        0.2, "s", "time constant of the vertical velocity loop", _OWN, 0.05
    )
    integral_gain: float = _setting(
        5.0, "N/m", "gain on the integral of the velocity error", _OWN, 0
    )
    integral_limit_n: float = _setting(
        20.0, "N", "largest force of the integral, each axis", _OWN, 0
    )
    heading_gain: float = _setting(1.0, "N m/rad", "gain of the heading loop", _FITTED, 0)
    heading_damping: float = _setting(2.0, "N m s", "damping of the heading loop", _OWN, 0)
    roll_damping: float = _setting(0.5, "N m s", "damping of roll", _OWN, 0)

    # Camera and pipeline
    half_view_angle_rad: float = _setting(
        math.pi / 6, "rad", "half of the camera's field of view", _SUAVE, 0.01, 1.5
    )
    pipe_point_offset_m: float = _setting(
        0.75, "m", "height of the detected points above the pipe (2025: 0)", _SUAVE
    )
    pipe_turn_rad: float = _setting(
        0.0, "rad", "rotation of the pipeline about the mean start, to the left", _OWN
    )

    # Water
    visibility_min_m: float = _setting(1.25, "m", "least water visibility", _EXPERIMENT, 0)
    visibility_max_m: float = _setting(3.75, "m", "greatest water visibility", _EXPERIMENT, 0)
    visibility_period_s: float = _setting(
        80.0, "s", "period of the water visibility", _EXPERIMENT, 1
    )
    visibility_shift_s: float = _setting(0.0, "s", "time shift of the visibility", _EXPERIMENT)
    visibility_monitor_period_s: float = _setting(
        1.0, "s", "period of the visibility monitor", _SUAVE, 0.05
    )

    # Thruster failure and its recovery
    thruster_events: str = _setting(
        "1 failure 35",
        "-",
        "comma-separated events: thruster, failure or recovery, time [s]; or empty",
        _EXPERIMENT,
    )
    thruster_events_chained: bool = _setting(
        True, "-", "times count from the event before (2025: false)", _SUAVE
    )
    thruster_told_twice: bool = _setting(
        False, "-", "publish ERROR and OK as well (2025: true)", _SUAVE
    )
    thruster_monitor_period_s: float = _setting(
        1.0, "s", "period of the thruster monitor", _SUAVE, 0.05
    )
    recovery_wait_s: float = _setting(
        10.0, "s", "time until the first thruster is restored", _SUAVE, 0
    )
    recovery_spacing_s: float = _setting(
        0.25, "s", "time between the recoveries of two thrusters", _SUAVE, 0
    )
    recovery_interruptible: bool = _setting(
        False, "-", "deactivation stops a recovery (2025: true)", _SUAVE
    )

    # Battery and recharge
    battery: bool = _setting(
        True, "-", "whether there is a battery that drains and is monitored", _EXPERIMENT
    )
    discharge_time_s: float = _setting(
        200.0, "s", "time in which a full battery is empty", _EXPERIMENT, 1
    )
    battery_period_s: float = _setting(
        1.0, "s", "period of the battery and its monitor", _SUAVE, 0.05
    )
    recharge_period_s: float = _setting(
        5.0, "s", "period of the recharge node (2025: 0.5)", _SUAVE, 0.05
    )
    recharge_resends: bool = _setting(
        True, "-", "send the station again at each tick (2025: false)", _SUAVE
    )
    recharge_tolerance_m: float = _setting(
        0.5, "m", "distance in x and y at which the station is reached", _SUAVE, 0
    )
    station_x_m: float = _setting(-3.0, "m", "recharge station, east", _SUAVE)
    station_y_m: float = _setting(-2.0, "m", "recharge station, north", _SUAVE)
    transit_altitude_m: float = _setting(
        1.25, "m", "altitude commanded on the way to the station", _SUAVE, 0.1, 19
    )

    # Spiral search
    spiral_period_s: float = _setting(1.0, "s", "period of the spiral node", _SUAVE, 0.05)
    spiral_altitude_m: float = _setting(
        2.0, "m", "altitude of the spiral before one is set", _SUAVE, 0.1, 19
    )
    spiral_angle_step_rad: float = _setting(
        0.1, "rad", "angle between points of the spiral", _SUAVE, 1e-3
    )
    spiral_tolerance_m: float = _setting(
        0.4, "m", "distance in x, y and z at which a point is reached", _SUAVE, 0
    )
    spiral_patience: int = _setting(
        10, "ticks", "ticks without progress before a correction", _SUAVE, 0
    )
    spiral_correction_m: float = _setting(0.25, "m", "descent of one correction", _SUAVE, 0)
    spiral_restarts: bool = _setting(
        False, "-", "activation begins a new spiral there (2025: true)", _SUAVE
    )

    # Pipeline following
    follow_period_s: float = _setting(2.0, "s", "period of the follower", _SUAVE, 0.05)
    follow_altitude_m: float = _setting(1.25, "m", "altitude of following", _SUAVE, 0.1, 19)
    follow_tolerance_m: float = _setting(
        0.5, "m", "distance in x and in y at which a point is reached", _SUAVE, 0
    )
    follow_patience: int = _setting(
        10, "ticks", "ticks after which each tick sends the point again", _SUAVE, 0
    )
    follow_loses_point: bool = _setting(
        True, "-", "deactivation loses the point under way (2025: false)", _SUAVE
    )

    # Mission and managers
    activation_s: float = _setting(0.03, "s", "time to activate a component", _ROS, 0)
    deactivation_s: float = _setting(0.03, "s", "time to deactivate a component", _ROS, 0)
    parameter_s: float = _setting(0.03, "s", "time to set parameters", _ROS, 0)
    guided_period_s: float = _setting(
        1.0, "s", "period at which nodes are told about GUIDED", _SUAVE, 0.01
    )
    mission_period_s: float = _setting(
        1.0, "s", "period of the mission node without a tree (2025: 0.1)", _SUAVE, 0.01
    )
    tree_period_s: float = _setting(
        0.15, "s", "period of SUAVE's tree, which sleeps for 100 and 50 ms", _SUAVE, 0.01
    )

    def __post_init__(self) -> None:
        """Check every value, and the values against each other."""
        for info in fields(self):
            object.__setattr__(self, info.name, _checked(info, getattr(self, info.name)))
        if self.visibility_min_m > self.visibility_max_m:
            least, most = self.visibility_min_m, self.visibility_max_m
            raise SuaveEnvError(f"visibility_min_m {least} is above visibility_max_m {most}")
        period, step = self.control_period_s, self.physics_step_s
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
            **changes: New values by name. New rules change every setting in which they differ and which is not among
                the changes. A start or a bias is the same in every run, unless its standard deviation is among the
                changes too.

        Raises:
            SuaveEnvError: If a name is unknown, or a value is not allowed or at odds with another.
        """
        known = [info.name for info in fields(self)]
        for name in changes:
            if name not in known:
                raise unknown_name("setting", name, known)
        values = dict(changes)
        if (rules := changes.get("rules")) in RULES:
            differing = dict.fromkeys(name for said in RULES.values() for name in said)
            values = {
                **{
                    name: RULES[str(rules)].get(name, getattr(Settings(), name))
                    for name in differing
                },
                **changes,
            }
        exact = {
            spread: 0.0
            for name, spread in _SPREADS.items()
            if name in changes and spread not in changes
        }
        return dataclasses.replace(self, **{**values, **exact})  # type: ignore[arg-type]  # checked by __post_init__, not by its type


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
    events, time = list[ThrusterEvent](), 0.0
    for part in filter(None, (" ".join(one.split()) for one in text.split(","))):
        read = _EVENT.fullmatch(part)
        if read is None:
            allowed = 'events such as "1 failure 35, 1 recovery 90": thruster 1 to 6, what happens, time [s]'
            raise SuaveEnvError(f"thruster_events cannot be {text!r}; allowed are {allowed}")
        time = float(read[3]) + (time if chained else 0.0)
        events.append(ThrusterEvent(int(read[1]), read[2] == "failure", time))
    return tuple(sorted(events, key=lambda event: event.time))


def _checked(
    info: "dataclasses.Field[float]", value: float | int | bool | str
) -> float | int | bool | str:
    """Return the value in the type of the setting, or refuse it."""
    kind, low, high = type(info.default), info.metadata["low"], info.metadata["high"]
    if kind is float and type(value) is int:
        value = float(value)
    is_number = kind in (int, float)
    if type(value) is not kind or (
        is_number and not (math.isfinite(value) and low <= value <= high)
    ):
        words = {bool: "true or false", str: "text", int: "a whole number", float: "a number"}
        bounds = [
            f" {word} {bound:g}"
            for word, bound in (("from", low), ("to", high))
            if math.isfinite(bound)
        ]
        allowed = f"{words[kind]}{''.join(bounds if is_number else [])} [{info.metadata['unit']}]"
        raise SuaveEnvError(f"setting {info.name} cannot be {value!r}; allowed is {allowed}")
    return value
