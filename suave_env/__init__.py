"""The simulated sea of the (extended) SUAVE mission: a BlueROV2 in MuJoCo looks for a pipeline and follows it."""

from suave_env.checker import BrokenEnvError, check_env
from suave_env.components import Change, Components
from suave_env.env import Observation, SuaveEnv
from suave_env.exceptions import SuaveEnvError
from suave_env.metrics import Disturbance, Metrics
from suave_env.monitors import Message, Status
from suave_env.pipeline import Pipeline
from suave_env.settings import SettingInfo, Settings

__all__ = [
    "BrokenEnvError",
    "Change",
    "Components",
    "Disturbance",
    "Message",
    "Metrics",
    "Observation",
    "Pipeline",
    "SettingInfo",
    "Settings",
    "Status",
    "SuaveEnv",
    "SuaveEnvError",
    "check_env",
]
