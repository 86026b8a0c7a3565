"""The simulated sea of the (extended) SUAVE mission: a BlueROV2 in MuJoCo looks for a pipeline and follows it."""

from importlib import import_module
from typing import TYPE_CHECKING, Final

from suave_env.settings import Settings, SuaveEnvError

if TYPE_CHECKING:
    from suave_env.checker import BrokenEnvError, check_env
    from suave_env.components import Change
    from suave_env.env import SuaveEnv

__all__ = ["BrokenEnvError", "Change", "Settings", "SuaveEnv", "SuaveEnvError", "check_env"]

_MODULES: Final = {"BrokenEnvError": "checker", "check_env": "checker", "Change": "components", "SuaveEnv": "env"}


def __getattr__(name: str) -> object:
    """Import the simulator only when it is asked for: the settings are listed without it."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"suave_env.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
