"""A store is gone on with by a model that has changed: what can be taken over is, and what cannot is told."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from threading import RLock
from typing import Any, Final, NamedTuple

from kb.amendments import differences
from kb.elements import Constraint, Element
from kb.events import Event
from kb.exceptions import UnknownName
from kb.knowledge import Knowledge
from kb.model import Model
from kb.network import Network, Ref
from kb.store import Store

_INSTANCES: Final = ("recent", "since", "changed_by")
_TOLD: Final = frozenset({"failed", "active", "selected", "requested", "asserted", "asserted_required"})


class Migration(NamedTuple):
    """What a migration changes, in words: between the models, and what was so of what is no longer there."""

    differences: tuple[str, ...]
    dropped: tuple[str, ...]


def migrate(path: Path, model: Model, *, dry_run: bool = False) -> Migration:
    """Have a store go on with another model, in one step; the log says what changed, and all events stay.

    It happens at the time of the last event. What the other model states to be so is not told again.

    Raises:
        StoreError: it is damaged, in use, or no store.
    """
    store = Store(path, None)
    try:
        now = store.time
        known, fresh = (Knowledge(one, lambda: now, RLock()) for one in (store.model, model))
        store.restore(known, now)
        carrier = _Carrier(known.network, fresh.network)
        written = json.loads(json.dumps(known.to_json(store.keep)))
        found = Migration(tuple(differences(store.model, model)), tuple(carrier.dropped(written)))
        if dry_run or not found.differences:
            return found
        for request in written["records"]["requests"]:
            if request["end"] is None and request["action"] not in fresh.network.actions:
                request.update(end=now, result="abandoned", reason="it is no longer in the model")
        number = known.log.last + 1
        fresh.from_json(carrier.carried(written), number, now)
        words = "; ".join(["the model was changed", *found.differences, *(f"dropped: {one}" for one in found.dropped)])
        events = [*known.log.since(store.saved), Event(number, now, "store", (words,))]
        store.adopt(model, events, (number, now, json.dumps(fresh.to_json(store.keep), separators=(",", ":"))))
        return found
    finally:
        store.close()


class _Carrier:
    """Finds what is known of one model in another: by name, and constraints by what they say."""

    def __init__(self, before: Network, after: Network) -> None:
        self._before, self._after = before, after

    def _ref(self, ref: Iterable[Any]) -> Ref | None:
        kind, name, *position = ref
        try:
            node = self._after.referred((kind, name))
            if not position:
                return node.ref
            said = _said(self._before.referred((kind, name, position[0])).element)
        except UnknownName:
            return None
        return next((one.ref for one in node.constraints if _said(one.element) == said), None)

    def _kept(self, values: Iterable[Any]) -> list[Any]:
        return [(ref, *others) for given, *others in values if (ref := self._ref(given)) is not None]

    def dropped(self, written: Any) -> list[str]:  # noqa: ANN401  # what JSON holds
        facts = [
            f"that {' '.join(map(str, ref[:2]))} is {'' if value is True else f'{value} '}{name.replace('_', ' ')}"
            for name, values in written["facts"].items()
            if name in _TOLD
            for ref, value in values
            if self._ref(ref) is None
        ]
        measured = [
            f"what was measured of {name}" for name, _ in written["histories"] if not self._has("attribute", name)
        ]
        given = [f"the parameters of {name}" for name in written["parameters"] if not self._has("component", name)]
        return [*facts, *measured, *given]

    def _has(self, kind: str, name: str) -> bool:
        return name in self._after.of_kind(kind)

    def carried(self, written: Any) -> dict[str, Any]:  # noqa: ANN401  # what JSON holds
        moved = [(name, self._ref(ref), *others) for name, ref, *others in written["reasons"]]
        return {
            **written,
            "facts": {name: self._kept(values) for name, values in written["facts"].items()},
            "reasons": [one for one in moved if one[1] is not None],
            "parameters": {name: one for name, one in written["parameters"].items() if self._has("component", name)},
            "histories": [one for one in written["histories"] if self._has("attribute", one[0])],
            **{name: self._kept(written[name]) for name in _INSTANCES},
        }


def _said(element: Element | Constraint) -> object:
    if isinstance(element, Constraint):
        return element.attribute, element.operator, element.value, element.hysteresis, element.dwell
    return math.nan
