"""Every constant of the simulated vehicle and its field, with its unit, its meaning and where the figure comes from."""

from dataclasses import dataclass
from typing import Final

from missions.engine.settings import Constants, setting

MOST_SAMPLES: Final = 8
"""How many samples there may be; the planned task layer has an object for each."""

PERIOD_S: Final = 0.1
"""From one time that the components act to the next [s]."""

_OWN: Final = "own choice"
_SHORT: Final = "own choice: small, so that a mission takes minutes"
_CONTROL: Final = "own choice: common for a vehicle of this size"
_SCENARIO: Final = "own choice, so that the paper's three scenarios occur"


@dataclass(frozen=True, slots=True)
class Settings(Constants):
    """The constants; frozen. World frame ENU, z up, ground at z = 0, base at the origin; times from the start."""

    # What happens
    samples: float = setting(7, "-", "samples that are wanted from the start", _OWN, 1, MOST_SAMPLES - 1)
    added_s: float = setting(60.0, "s", "when an operator reports one more sample; 0 for never", _SCENARIO)
    gripper_worn_s: float = setting(120.0, "s", "from when on a grip jams; 0 for never", _SCENARIO)
    jam_delay_s: float = setting(3.0, "s", "longest time from a worn grip to its jam", _SCENARIO, 0.1, 5)

    # The field
    field_x_m: float = setting(36.0, "m", "length of the field, from the base eastward", _OWN, 10, 90)
    lane_m: float = setting(6.0, "m", "distance between the lanes of the search", _OWN, 2, 10)
    lanes: float = setting(6, "-", "number of lanes; in the middle third there is no sample", _SCENARIO, 3, 9)
    sample_kg: float = setting(0.2, "kg", "mass of a sample", _OWN, 0, 0.5)

    # Flight
    physics_step_s: float = setting(0.01, "s", "step of the physics; thrust is for two of them", _OWN, 0.001, 0.01)
    cruise_m: float = setting(5.0, "m", "height at which it searches and travels", _OWN, 2, 20)
    speed_m_s: float = setting(3.0, "m/s", "horizontal speed limit", _CONTROL, 0.5, 5)
    climb_m_s: float = setting(1.5, "m/s", "vertical speed limit", _CONTROL, 0.2, 3)
    rotor_limit_n: float = setting(8.0, "N", "largest thrust of one rotor", _CONTROL, 5.5, 20)
    rotor_radius_m: float = setting(0.127, "m", "radius of a propeller, for its power", "10 inch propeller", 0.05, 0.5)
    figure_of_merit: float = setting(0.6, "-", "ideal by actual power of a hovering rotor", _CONTROL, 0.1, 1)
    drag: float = setting(0.3, "N s/m", "linear drag of the air", _CONTROL, 0, 1.1)
    wind_m_s: float = setting(1.0, "m/s", "steady wind, from a direction of chance", _OWN, 0, 4)
    gravity_m_s2: float = setting(9.81, "m/s2", "gravity", "standard gravity", 7, 12)
    air_kg_m3: float = setting(1.225, "kg/m3", "density of the air", "standard atmosphere at sea level", 0.5, 2)

    # Battery
    capacity_j: float = setting(28000.0, "J", "energy of a full battery", _SHORT, 1000)
    charge_s: float = setting(10.0, "s", "time in which an empty battery is charged", _SHORT, 0.1)
    avionics_w: float = setting(5.0, "W", "power of what always runs", _OWN)
    pick_up_w: float = setting(40.0, "W", "power of gripper and analyser together", _OWN)
    infrared_w: float = setting(5.0, "W", "power of the infra-red camera", _OWN)
    battery_period_s: float = setting(0.5, "s", "period of the battery monitor", _OWN, 0.05, 5)

    # Work
    half_view_rad: float = setting(0.66, "rad", "half of the sample camera's field of view", _OWN, 0.1, 1.4)
    grip_s: float = setting(1.0, "s", "time that gripping takes", _OWN, 0.1)
    analysis_s: float = setting(6.0, "s", "time that the analyser takes", _OWN, 0.1)
    infrared_s: float = setting(4.0, "s", "time that a look in the infra-red takes", _OWN, 0.1)
    infrared_quality: float = setting(0.6, "-", "worth of such a look; an analysis of a held sample is worth 1", _OWN)
    fold_s: float = setting(1.5, "s", "time that folding or unfolding takes", _OWN, 0.2)

    # Switching
    activation_s: float = setting(0.03, "s", "time that activating a component takes", "order seen in ROS 2")
    deactivation_s: float = setting(0.03, "s", "time that deactivating one takes", "order seen in ROS 2")
