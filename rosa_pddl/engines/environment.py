"""The environment of unified-planning's problems, without its engines until they are asked for.

Imported late. unified-planning 1.3 imports every engine with the environment, and with them what they tune parameters
by, which takes longer than the rest of a mission's start.
"""

from typing import Any

from unified_planning import model
from unified_planning.environment import Environment
from unified_planning.model import walkers
from unified_planning.model.type_manager import TypeManager


class LateEnvironment(Environment):  # type: ignore[misc]  # unified-planning ships no types
    """An environment whose factory of engines is made when it is asked for; it is silent, too."""

    def __init__(self) -> None:
        self._type_manager = TypeManager()
        self._late_factory: Any = None
        self._tc = walkers.TypeChecker(self)
        self._expression_manager = model.ExpressionManager(self)
        self._free_vars_oracle = model.FreeVarsOracle()
        self._simplifier = walkers.Simplifier(self)
        self._substituter = walkers.Substituter(self)
        self._free_vars_extractor = walkers.FreeVarsExtractor()
        self._names_extractor = walkers.NamesExtractor()
        self._credits_stream = None
        self._error_used_name = True

    @property
    def _factory(self) -> Any:  # noqa: ANN401  # unified-planning ships no types
        if self._late_factory is None:
            from unified_planning.engines import Factory

            self._late_factory = Factory(self)
        return self._late_factory

    def __reduce__(self) -> tuple[Any, ...]:
        """Become an ordinary one in the process of an engine, which knows nothing of this package."""
        state: dict[str, Any] = {**self.__dict__, "_factory": self._factory}
        del state["_late_factory"], state["_credits_stream"]
        return object.__new__, (Environment,), state
