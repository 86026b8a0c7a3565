"""The simulated sea: vehicle, nodes, monitors and water, advanced in lock-step."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from suave_env.components import (
    Agenda,
    Components,
    FollowPipeline,
    Recharge,
    RecoverThrusters,
    SpiralSearch,
)
from suave_env.monitors import (
    COMPONENT_STATUS,
    EA_MEASUREMENT,
    LOW_LEVEL,
    MISSION_STATUS,
    QA_STATUS,
    Change,
    Message,
    Metrics,
    Outbox,
    Reaction,
    Reactions,
    Violations,
    thruster_words,
)
from suave_env.sea import SEABED_Z_M, THRESHOLDS_M, Pipeline, Water, expected_altitude
from suave_env.settings import Settings, SuaveEnvError, ThrusterEvent, parse_thruster_events
from suave_env.vehicle import Autopilot, Thrusters, Vehicle, floated


@dataclass(frozen=True)
class Observation:
    """The truth at one moment, for plots and records.

    Managers and task layers receive messages only.

    Attributes:
        time: Time since GUIDED [s].
        x, y, z: Position [m], world frame ENU, z up from the surface.
        altitude: Height above the seabed [m].
        speed: Speed [m/s].
        water_visibility: How far one can see [m].
        battery_level: Charge, 1.0 full to 0.0 empty.
        spiral_altitude: Altitude that the spiral search is set to [m].
        recharged: How often the battery was recharged.
    """

    time: float
    x: float
    y: float
    z: float
    altitude: float
    speed: float
    water_visibility: float
    battery_level: float
    thrusters_failed: tuple[int, ...]
    active: tuple[str, ...]
    spiral_altitude: float
    recharged: int


class SuaveEnv:
    """The sea of the (extended) SUAVE mission, with an underwater vehicle in it.

    Time is simulated and moves only in `advance`; the same settings and seed give the same floats.

    Args:
        rng: The only source of chance: start position, vertical bias and the phases of the
            free-running timers.

    Attributes:
        now: Time since GUIDED [s].
        components: The nodes, to be activated, deactivated and given parameters.
        pipeline: The pipeline; its `points` are for plots.
        station: Position (x, y) of the recharge station [m], world frame ENU.
    """

    def __init__(self, settings: Settings, rng: np.random.Generator) -> None:
        self.settings = settings
        east, north, bias = rng.standard_normal(3).tolist()
        phases = rng.random(8).tolist()
        is_late = float(rng.random()) < settings.late_boot_share
        late_m = floated(settings, settings.late_boot_s) if is_late else 0.0
        x = settings.start_x_m + settings.start_x_sd_m * east
        y = settings.start_y_m + settings.start_y_sd_m * north
        self.now = 0.0
        self._search_time: float | None = None
        self._guided = phases[7] * settings.guided_period_s
        self._disturbances: list[tuple[float, str]] = []
        self._violations = Violations()
        self._reactions = Reactions(settings.spiral_altitude_m)
        self._agenda = Agenda()
        self._outbox = Outbox(self._reactions.hear)
        self._battery_level = 1.0
        self._recharges = 0
        self._water = Water(settings)
        self._thrusters = Thrusters(settings)
        self.pipeline = Pipeline(settings)
        self.station = (settings.station_x_m, settings.station_y_m)
        self._vehicle = Vehicle(
            settings, x, y, settings.start_z_m + floated(settings, settings.boot_s) + late_m
        )
        bias = settings.bias_m + settings.bias_sd_m * bias + late_m
        self._autopilot = Autopilot(settings, self._vehicle, self._thrusters, bias)
        self._spiral = SpiralSearch(settings, self._autopilot, (x, y))
        self._follower = FollowPipeline(settings, self._autopilot, self._outbox)
        recover = RecoverThrusters(settings, self._restored, self._agenda, self._outbox)
        recharge = Recharge(settings, self._autopilot, self._recharge)
        nodes = (self._spiral, self._follower, recover, recharge)
        self.components = Components(nodes, lambda: self.now, self._autopilot.hold, self._switched)
        self._visibility: float | None = None  # as published last [m]
        self._whole_periods = 0
        self._thruster_news = list[tuple[int, str]]()
        self._enter_timers(phases, recharge)
        self._enter_disturbances()

    def _enter_timers(self, phases: list[float], recharge: Recharge) -> None:
        """Start the free-running timers, each at its phase, a share of its period."""
        settings = self.settings
        agenda = self._agenda
        timers = (
            (settings.spiral_period_s, self._spiral.tick),
            (settings.follow_period_s, self._follower.tick),
            (settings.recharge_period_s, recharge.tick),
            (settings.visibility_monitor_period_s, self._publish_visibility),
            (settings.thruster_monitor_period_s, self._publish_thrusters),
        )
        for (period, tick), phase in zip(timers, phases, strict=False):
            agenda.every(period, phase * period, tick)
        agenda.at(phases[5] * settings.pose_period_s, self._look)
        if settings.battery:
            phase = phases[6] * settings.battery_period_s
            agenda.at(phase, self._publish_battery)
            agenda.every(settings.battery_period_s, phase + settings.battery_period_s, self._drain)

    def _enter_disturbances(self) -> None:
        settings = self.settings
        for event in parse_thruster_events(
            settings.thruster_events, settings.thruster_events_chained
        ):
            self._agenda.at(event.time, partial(self._thruster_event, event))
        for threshold in THRESHOLDS_M:
            self._await_crossing(threshold, 0.0)

    @property
    def metrics(self) -> Metrics:
        """The metrics of the run up to now."""
        search_time = self._search_time
        return Metrics(
            search_time_s=None
            if search_time is None
            else max(0, math.floor(search_time - self._guided)),
            distance_inspected_m=self._follower.distance_m,
            total_inspected_m=self._follower.total_m,
            found_s=search_time,
            violation_s=self._violations.seconds(self.now),
            uncorrected=self._violations.uncorrected,
            switches=len(self.components.history),
            energy_j=self._thrusters.energy_j,
        )

    @property
    def reactions(self) -> list[Reaction]:
        """The reactions to uncertainties up to now, in order of their ends."""
        return list(self._reactions.found)

    @property
    def disturbances(self) -> list[tuple[float, str]]:
        """The true disturbances up to now, each with its time [s], in order of time."""
        return list(self._disturbances)

    def advance(self, until: float, *, pause: bool = False) -> list[Message]:
        """Simulate to a time.

        Args:
            until: Time since GUIDED [s], not before now.
            pause: Stop as soon as something was published.

        Returns:
            What was published in `(now, until]`, in order of time.

        Raises:
            SuaveEnvError: If the time is not finite, or before now.
        """
        if not self.now <= until < math.inf:
            raise SuaveEnvError(
                f"cannot advance to {until!r} s; allowed is a finite time from {self.now} s on"
            )
        agenda = self._agenda
        fly = self._autopilot.fly
        outbox = self._outbox
        while (due := agenda.next_time) <= until:
            fly(due)
            self.now = due
            agenda.happen()
            if pause and outbox.is_waiting:
                return outbox.fetch()
        fly(until)
        self.now = float(until)
        return self._outbox.fetch()

    def observe(self) -> Observation:
        """Return the truth now.

        The vehicle's state is that at the end of the last control period.
        """
        x, y, z = self._vehicle.position
        return Observation(
            time=self.now,
            x=x,
            y=y,
            z=z,
            altitude=z - SEABED_Z_M,
            speed=math.hypot(*self._vehicle.velocity),
            water_visibility=self._water.visibility(self.now),
            battery_level=self._battery_level,
            thrusters_failed=self._thrusters.failed,
            active=self.components.active,
            spiral_altitude=self._spiral.parameters["spiral_altitude"],
            recharged=self._recharges,
        )

    def _look(self, time: float) -> None:
        """Look for the pipeline every period until it is found, whichever component is active."""
        index = None
        if self._visibility is not None:
            index = self.pipeline.first_visible(*self._autopilot.position, self._visibility)
        if index is None:
            self._agenda.at(time + self.settings.pose_period_s, self._look)
            return
        self._search_time = time
        self._follower.take_path(self.pipeline.path_from(index))
        self._outbox.publish(time, "pipeline_detection", MISSION_STATUS, "pipeline_found", "true")

    def _drain(self, time: float) -> None:
        """Discharge the battery by one period.

        The rounding errors add up, as in kas-lab/suave v1.3.0.

        After 150 steps of 1 s out of 200 s the level is 0.24999999999999933.
        """
        settings = self.settings
        before = self._battery_level
        self._battery_level = max(
            0.0, before - settings.battery_period_s / settings.discharge_time_s
        )
        if before >= LOW_LEVEL > self._battery_level:
            self._disturbances.append((time, f"battery level fell below {LOW_LEVEL}"))
            self._judge(time, corrected=False)
        self._publish_battery(time)

    def _publish_visibility(self, time: float) -> None:
        """Publish the visibility at whole periods since the start, as kas-lab/suave v1.3.0."""
        self._visibility = self._water.visibility(
            self._whole_periods * self.settings.visibility_monitor_period_s
        )
        self._whole_periods += 1
        self._outbox.publish(
            time, "water_visibility_monitor", EA_MEASUREMENT, "water_visibility", self._visibility
        )

    def _publish_thrusters(self, time: float) -> None:
        """Publish each failure and each recovery by itself once.

        The recovery node publishes its own recoveries.
        """
        for thruster, word in self._thruster_news:
            self._outbox.publish(
                time, "thruster_monitor", COMPONENT_STATUS, f"c_thruster_{thruster}", word
            )
        self._thruster_news.clear()

    def _publish_battery(self, time: float) -> None:
        self._outbox.publish(
            time, "battery_monitor", QA_STATUS, "battery_level", self._battery_level
        )

    def _recharge(self, time: float) -> None:
        self._battery_level = 1.0
        self._recharges += 1
        if self.settings.battery:
            self._publish_battery(time)
        self._outbox.publish(time, "recharge", MISSION_STATUS, "battery_recharged", "true")

    def _thruster_event(self, event: ThrusterEvent, time: float) -> None:
        change = self._thrusters.fail if event.fails else self._thrusters.recover
        change(event.thruster)
        self._judge(time, corrected=False)
        self._thruster_news += [
            (event.thruster, word) for word in thruster_words(self.settings, event.fails)
        ]
        self._disturbances.append(
            (time, f"thruster {event.thruster} {'failed' if event.fails else 'recovered'}")
        )

    def _await_crossing(self, threshold: float, after: float) -> None:
        crossing = self._water.next_crossing(threshold, after)
        if crossing is None:
            return
        due, falls = crossing
        text = f"water visibility {'fell below' if falls else 'rose to'} {threshold} m"

        def cross(time: float) -> None:
            self._disturbances.append((time, text))
            self._judge(
                time + 1e-6, corrected=False
            )  # a moment later, when the threshold is surely passed
            self._await_crossing(threshold, time)

        self._agenda.at(due, cross)

    def _switched(self, change: Change) -> None:
        self._reactions.see(change)
        self._judge(change.time, corrected=self._spiral.active)

    def _restored(self, thruster: int, time: float) -> None:
        self._thrusters.recover(thruster)
        self._judge(time, corrected=True)

    def _judge(self, time: float, corrected: bool) -> None:
        """Record which violations hold now, and whether those that have ended were corrected."""
        note = self._violations.note
        spiral = self._spiral
        expected = expected_altitude(self._water.visibility(time))
        wrong = spiral.active and spiral.parameters["spiral_altitude"] != expected
        note(time, "visibility", wrong, corrected)
        note(time, "thruster", bool(self._thrusters.failed), corrected)
        low = self._battery_level < LOW_LEVEL and not self.components.is_active(Recharge.name)
        note(time, "battery", low, corrected=True)
