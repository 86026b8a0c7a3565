"""What Metacontrol knows of the vehicle, read from OWL files."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from missions.mission import MissionError

__all__ = ["Design", "Knowledge", "read_knowledge"]

METAMODEL = Path(__file__).with_name("tomasys.owl")


@dataclass(frozen=True, slots=True)
class Design:
    """A way to realise a function.

    Attributes:
        name: its name, which is that of a mode of the function.
        function: what it realises.
        performance: how good it is; more is better.
        components: what it needs, in order of name.
        qualities: (attribute, value it has to have at least) of each, in order of name.
    """

    name: str
    function: str
    performance: float
    components: tuple[str, ...] = ()
    qualities: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Knowledge:
    """Functions and designs.

    Attributes:
        designs: all, the best first; equally good ones in order of name.
        always_improved: functions for which something better is looked for though all is well.
    """

    designs: tuple[Design, ...]
    always_improved: frozenset[str] = field(default_factory=frozenset)

    def of(self, function: str) -> tuple[Design, ...]:
        """Return the designs of a function, the best first."""
        return tuple(design for design in self.designs if design.function == function)


@cache
def read_knowledge(path: Path) -> Knowledge:
    """Read an ontology of a vehicle, which says what is so in the words of `tomasys.owl`.

    Raises:
        MissionError: the file cannot be read, or a design lacks what it needs.
    """
    import owlready2

    world = owlready2.World()
    try:
        for file in (METAMODEL, path):
            with file.open("rb") as content:
                words = world.get_ontology(f"file://{file}").load(fileobj=content)
        words = world.get_namespace("http://rosa-taca/tomasys#")
        designs = [_design(one) for one in words.FunctionDesign.instances()]
        improved = frozenset(one.name for one in words.Function.instances() if one.is_always_improved)
    except (OSError, owlready2.OwlReadyOntologyParsingError, AttributeError) as error:
        raise MissionError(
            f"cannot read the ontology {path}: {type(error).__name__}: {error}; expected are a FunctionDesign for each "
            "design with solves_function and has_performance, see tomasys.owl"
        ) from error
    finally:
        world.close()
    return Knowledge(tuple(sorted(designs, key=lambda one: (-one.performance, one.name))), improved)


def _design(one: Any) -> Design:  # noqa: ANN401  # an individual of owlready2
    if one.solves_function is None or one.has_performance is None:
        raise AttributeError(f"design {one.name} lacks solves_function or has_performance")
    return Design(
        one.name,
        one.solves_function.name,
        float(one.has_performance),
        _sorted(component.name for component in one.requires_component),
        _sorted((quality.of_attribute.name, float(quality.has_value)) for quality in one.requires_quality),
    )


def _sorted(values: Iterable[Any]) -> tuple[Any, ...]:
    return tuple(sorted(values))
