"""The four nodes that can be switched: spiral search, follow pipeline, recover thrusters, recharge.

Each has a free-running timer and acts only while active. Their rules are those of the nodes of
kas-lab/suave v1.3.0.
"""

import heapq
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import ClassVar

from suave_env.monitors import COMPONENT_STATUS, MISSION_STATUS, Change, Outbox, thruster_words
from suave_env.sea import SEABED_Z_M
from suave_env.settings import Settings, SuaveEnvError, unknown_name
from suave_env.vehicle import COUNT, Autopilot, Vector

HIGHEST_ALTITUDE_M = 19.0
"""Altitude above the seabed [m] that a parameter may command at most: 1 m below the surface."""


class Agenda:
    """The events to come, in order of time [s].

    Those at the same time in the order of their entry.
    """

    def __init__(self) -> None:
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._entered = 0

    @property
    def next_time(self) -> float:
        """Time of the next event [s]; infinite if there is none."""
        return self._events[0][0] if self._events else float("inf")

    def at(self, time: float, event: Callable[[float], None]) -> None:
        """Enter an event, which is called with its time [s]."""
        heapq.heappush(self._events, (time, self._entered, event))
        self._entered += 1

    def every(self, period: float, phase: float, event: Callable[[float], None]) -> None:
        """Enter a timer, called at `phase + k * period` [s] without accumulating error."""
        count = 0

        def tick(time: float) -> None:
            nonlocal count
            count += 1
            self.at(phase + count * period, tick)
            event(time)

        self.at(phase, tick)

    def happen(self) -> None:
        """Remove the next event and call it."""
        time, _, event = heapq.heappop(self._events)
        event(time)


class Component:
    """A node that can be active or inactive, and has parameters."""

    name: ClassVar[str]

    def __init__(self) -> None:
        self.active = False
        self.parameters: dict[str, float] = {}

    def activated(self, time: float) -> None:
        """Begin; called when it has become active, with the time [s]."""

    def deactivated(self, time: float) -> None:
        """End; called when it has become inactive, with the time [s]."""


class Mover(Component):
    """A node that sends setpoints.

    At each of its periods, while it is active and setpoints are obeyed.
    """

    def __init__(self, settings: Settings, autopilot: Autopilot) -> None:
        super().__init__()
        self._settings = settings
        self._autopilot = autopilot

    def tick(self, time: float) -> None:
        """Act if it may; called at each of its periods, with the time [s]."""
        if self.active and time >= self._settings.start_delay_s:
            self._act(time)

    def _act(self, time: float) -> None: ...

    def _is_near(self, point: tuple[float, ...], tolerance: float) -> bool:
        """Tell whether the vehicle is that close [m] to a point along each of its axes."""
        position = self._autopilot.position
        return all(
            abs(here - there) <= tolerance for here, there in zip(position, point, strict=False)
        )


class SpiralSearch(Mover):
    """Searches along a spiral whose turns lie as far apart as the camera sees.

    Per point the radius grows by `2 a tan(30 deg) 0.1 / (2 pi)` for an altitude `a`, the parameter
    `spiral_altitude` [m]. A change of altitude skips one angle. A point counts as reached within
    0.4 m in x, y and z; after more than 10 ticks without reaching it, it is sent again, and lower
    by 0.25 m if only the height is off, while the goal that is checked stays as it was.
    """

    name = "spiral_search"

    def __init__(
        self, settings: Settings, autopilot: Autopilot, centre: tuple[float, float]
    ) -> None:
        super().__init__(settings, autopilot)
        self.parameters["spiral_altitude"] = settings.spiral_altitude_m
        self._begin(centre)

    def _begin(self, centre: tuple[float, float]) -> None:
        self._centre = centre
        self._offset = (0.0, 0.0)
        self._goal: Vector | None = None
        self._altitude: float | None = None
        self._count = 0
        self._waits = 0
        self._correction = 0.0

    def activated(self, time: float) -> None:
        if self._settings.spiral_restarts:
            x, y, _ = self._autopilot.position
            self._begin((x, y))

    def _act(self, time: float) -> None:
        settings = self._settings
        altitude = self.parameters["spiral_altitude"]
        goal = self._goal
        if altitude != self._altitude:
            self._altitude = altitude
            self._count += 1
        is_reached = goal is None or self._is_near(goal, settings.spiral_tolerance_m)
        if self._waits > settings.spiral_patience:
            if (
                goal is not None
                and not is_reached
                and self._is_near(goal[:2], settings.spiral_tolerance_m)
            ):
                self._correction -= settings.spiral_correction_m
            self._send(altitude, time)
        if is_reached:
            step = settings.spiral_angle_step_rad
            width = 2 * altitude * math.tan(settings.half_view_angle_rad)
            radius = math.hypot(*self._offset) + width * step / (2 * math.pi)
            angle = step * self._count
            self._offset = (radius * math.cos(angle), radius * math.sin(angle))
            self._goal = self._send(altitude, time)
            self._count += 1
        else:
            self._waits += 1

    def _send(self, altitude: float, time: float) -> Vector:
        """Send the current point, corrected in height; return it uncorrected."""
        x = self._centre[0] + self._offset[0]
        y = self._centre[1] + self._offset[1]
        z = SEABED_Z_M + altitude
        self._autopilot.go_to((x, y, z + self._correction), time)
        self._waits = 0
        return x, y, z


class FollowPipeline(Mover):
    """Follows the path along the pipeline, point by point, 1.25 m above the seabed.

    Every 2 s it checks the point under way, and takes on as many further points as are within 0.5 m
    in x and in y. What is left of the path outlives a deactivation; the distance does not outlive
    the next activation.

    Attributes:
        distance_m: Distance inspected since the last activation [m].
        total_m: Distance inspected since GUIDED [m].
    """

    name = "follow_pipeline"

    def __init__(self, settings: Settings, autopilot: Autopilot, outbox: Outbox) -> None:
        super().__init__(settings, autopilot)
        self.distance_m = 0.0
        self.total_m = 0.0
        self._outbox = outbox
        self._path: deque[tuple[float, float]] | None = None
        self._is_under_way = False  # to the first point of the path
        self._last: tuple[float, float] | None = None
        self._waits = 0
        self._published = (-math.inf, math.nan)

    def take_path(self, path: tuple[tuple[float, float], ...]) -> None:
        """Take over the path of a pipeline that was found: points (x, y) [m], world frame ENU."""
        self._path = deque(path)

    def activated(self, time: float) -> None:
        self.distance_m = 0.0
        self._last = None

    def deactivated(self, time: float) -> None:
        if self._is_under_way and self._path and self._settings.follow_loses_point:
            self._path.popleft()
        self._is_under_way = False

    def _act(self, time: float) -> None:
        settings = self._settings
        path = self._path
        before = self._last
        if path is None:
            return
        while path:
            if not self._is_under_way:
                self._is_under_way = True
                self._waits = 0
                self._send(path[0], time)
            if not self._is_near(path[0], settings.follow_tolerance_m):
                self._waits += 1
                if self._waits > settings.follow_patience:
                    self._send(path[0], time)
                break
            self._count(path.popleft())
            self._is_under_way = False
        else:
            self._path = None
            self._outbox.publish(time, self.name, MISSION_STATUS, "pipeline_inspected", "true")
        since, distance_m = self._published
        if self._last != before and distance_m != self.distance_m and time - since >= 1:
            self._published = (time, self.distance_m)
            self._outbox.publish(
                time, self.name, MISSION_STATUS, "distance_inspected", self.distance_m
            )

    def _send(self, point: tuple[float, float], time: float) -> None:
        self._autopilot.go_to((*point, SEABED_Z_M + self._settings.follow_altitude_m), time)

    def _count(self, point: tuple[float, float]) -> None:
        leg_m = math.dist(self._last, point) if self._last is not None else 0.0
        self.distance_m += leg_m
        self.total_m += leg_m
        self._last = point


class RecoverThrusters(Component):
    """Restores the thrusters one after another.

    The first after 10 s, then one every 0.25 s, failed or not.

    Once begun, it runs to its end even when it is deactivated, unless the settings say otherwise.
    """

    name = "recover_thrusters"

    def __init__(
        self,
        settings: Settings,
        restored: Callable[[int, float], None],
        agenda: Agenda,
        outbox: Outbox,
    ) -> None:
        super().__init__()
        self._settings = settings
        self._restored = restored
        self._agenda = agenda
        self._outbox = outbox
        self._run = 0

    def activated(self, time: float) -> None:
        self._run += 1
        for index in range(COUNT):
            due = time + self._settings.recovery_wait_s + index * self._settings.recovery_spacing_s
            self._agenda.at(due, partial(self._restore, index + 1, self._run))

    def _restore(self, number: int, run: int, time: float) -> None:
        if self._settings.recovery_interruptible and (run != self._run or not self.active):
            return
        self._restored(number, time)
        for word in thruster_words(self._settings, fails=False):
            self._outbox.publish(time, self.name, COMPONENT_STATUS, f"c_thruster_{number}", word)


class Recharge(Mover):
    """Drives to the recharge station and recharges the battery there.

    Every 5 s it sends the station as setpoint, and recharges if it is within 0.5 m in x and in y.
    By the rules of 2025 it checks twice a second, and sends the setpoint once for each drive.
    """

    name = "recharge"

    def __init__(
        self, settings: Settings, autopilot: Autopilot, recharge: Callable[[float], None]
    ) -> None:
        super().__init__(settings, autopilot)
        self._recharge = recharge
        self._is_sent = False

    def activated(self, time: float) -> None:
        self._is_sent = False

    def _act(self, time: float) -> None:
        settings = self._settings
        station = (settings.station_x_m, settings.station_y_m)
        if not self._is_sent or settings.recharge_resends:
            self._autopilot.go_to((*station, SEABED_Z_M + settings.transit_altitude_m), time)
            self._is_sent = True
        if self._is_near(station, settings.recharge_tolerance_m):
            self._recharge(time)


class Components:
    """The components by name; a change takes effect at once.

    Attributes:
        history: Every change so far that changed something, in order of time.

    Every method that takes a name raises `SuaveEnvError` if there is no such component.
    """

    def __init__(
        self,
        components: Iterable[Component],
        clock: Callable[[], float],
        hold: Callable[[float], None],
        switched: Callable[[Change], None],
    ) -> None:
        self.history: list[Change] = []
        self._components = {component.name: component for component in components}
        self._clock = clock
        self._hold = hold
        self._switched = switched

    @property
    def active(self) -> tuple[str, ...]:
        """The names of the components that are active."""
        return tuple(name for name, component in self._components.items() if component.active)

    def is_active(self, name: str) -> bool:
        """Tell whether a component is active."""
        return self._component(name).active

    def parameters(self, name: str) -> dict[str, float]:
        """Return a copy of the parameters of a component."""
        return dict(self._component(name).parameters)

    def check(self, name: str, values: Mapping[str, object]) -> None:
        """Raise `SuaveEnvError` if a component cannot take these values by parameter name."""
        _taken(self._component(name), values)

    def activate(self, name: str) -> None:
        """Make a component active; one that is active already stays as it is."""
        component = self._component(name)
        time = self._clock()
        if not component.active:
            component.active = True
            component.activated(time)
            self._note(time, component)

    def deactivate(self, name: str) -> None:
        """Make a component inactive; one that is inactive already stays as it is."""
        component = self._component(name)
        time = self._clock()
        if component.active:
            component.active = False
            component.deactivated(time)
            movers = [other for other in self._components.values() if isinstance(other, Mover)]
            if component in movers and not any(other.active for other in movers):
                self._hold(time)
            self._note(time, component)

    def set_parameters(self, name: str, values: Mapping[str, object]) -> None:
        """Set parameters of a component by name, all at once; raises as `check`."""
        component = self._component(name)
        taken = {**component.parameters, **_taken(component, values)}
        if taken != component.parameters:
            component.parameters = taken
            self._note(self._clock(), component)

    def _component(self, name: str) -> Component:
        if name not in self._components:
            raise unknown_name("component", name, self._components)
        return self._components[name]

    def _note(self, time: float, component: Component) -> None:
        change = Change(time, component.name, component.active, dict(component.parameters))
        self.history.append(change)
        self._switched(change)


def _taken(component: Component, values: Mapping[str, object]) -> dict[str, float]:
    """Return the values as floats; `SuaveEnvError` if the component does not take them."""
    taken = {}
    for key, value in values.items():
        if key not in component.parameters:
            raise unknown_name(f"parameter of {component.name}", key, component.parameters)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        taken[key] = float(value) if is_number else math.nan  # type: ignore[arg-type]  # it is a number
        if not 0 < taken[key] <= HIGHEST_ALTITUDE_M:
            allowed = f"a number above 0 and up to {HIGHEST_ALTITUDE_M:g} [m]"
            raise SuaveEnvError(
                f"parameter {key} of {component.name} cannot be {value!r}; allowed is {allowed}"
            )
    return taken
