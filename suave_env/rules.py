"""The rule sets of SUAVE: what its later versions do differently."""

from collections.abc import Mapping
from types import MappingProxyType

__all__ = ["RULES"]

RULES: Mapping[str, Mapping[str, float | bool | str]] = MappingProxyType(
    {
        # kas-lab/suave v1.3.0, with which the table of the ROSA paper was made: the defaults of Settings
        "2024": MappingProxyType({}),
        # kas-lab/suave of June 2025, and the experiment of that year: visibility period 120 s, no thruster failure
        "2025": MappingProxyType(
            {
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
            }
        ),
    }
)
"""What each set of rules says of the settings in which they differ, where that is not the default."""
