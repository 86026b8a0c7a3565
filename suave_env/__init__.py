"""The simulated sea of the (extended) SUAVE mission: a BlueROV2 in MuJoCo looks for a pipeline and follows it."""

from importlib import import_module
from typing import TYPE_CHECKING

from suave_env.settings import Settings, SuaveEnvError

if TYPE_CHECKING:
    from suave_env.checker import BrokenEnvError, check_env
    from suave_env.components import Change, Components
    from suave_env.env import Observation, SuaveEnv
    from suave_env.metrics import Disturbance, Metrics
    from suave_env.monitors import Message, Status
    from suave_env.pipeline import Pipeline

__all__ = [
    "BrokenEnvError",
    "Change",
    "Components",
    "Disturbance",
    "Message",
    "Metrics",
    "Observation",
    "Pipeline",
    "Settings",
    "Status",
    "SuaveEnv",
    "SuaveEnvError",
    "check_env",
]

_MODULES = ("components", "metrics", "monitors", "pipeline", "env", "checker")


def __getattr__(name: str) -> object:
    """Import the simulator only when it is asked for: the settings are listed without it."""
    if name in __all__:
        for module in _MODULES:
            found = getattr(import_module(f"suave_env.{module}"), name, None)
            if found is not None:
                return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
