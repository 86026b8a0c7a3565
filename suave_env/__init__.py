"""The simulated sea of the (extended) SUAVE mission.

A BlueROV2 in MuJoCo looks for a pipeline and follows it.
"""

from suave_env.env import SuaveEnv
from suave_env.monitors import Change
from suave_env.settings import Settings, SuaveEnvError

__all__ = ["Change", "Settings", "SuaveEnv", "SuaveEnvError"]
