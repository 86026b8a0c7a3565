"""The timeline of a finished run, for pictures: what was seen, done and chosen when, in samples over time."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kb import Model
from missions.engine.runner import MissionRun

Array = NDArray[np.float64]
Events = Sequence[Mapping[str, Any]]

HUES: Final = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#8c6d31", "#b8ac00")
"""Okabe and Ito's colours, but the one for alarms."""

STEPS: Final = 3
"""How many steps of a plan there is room for; the result in JSON has all of them."""

REPORTED_S: Final = 2.0
"""How long after it has happened a failure may be reported, at most."""

STRAY: Final = 0.1
"""Part of the samples that may lie between one action and what is configured for the next."""


@dataclass(frozen=True)
class Leg:
    """A part of the way, `xy` (n, 2) [m], on which one action was done in one choice of designs and configurations."""

    action: str
    choice: str
    xy: Array

    @property
    def length_m(self) -> float:
        """How long it is [m]."""
        return float(self._driven_m[-1])

    @property
    def middle(self) -> Array:
        """The point half way (2,) [m]."""
        return np.asarray(self.xy[np.searchsorted(self._driven_m, self.length_m / 2)])

    @property
    def _driven_m(self) -> Array:
        return np.cumsum([0.0, *np.hypot(*np.diff(self.xy, axis=0).T)])


@dataclass(frozen=True)
class RunTimeline:
    """A run as n samples.

    Attributes:
        end: when it ended [s].
        times: of the samples (n,) [s].
        xy: where the robot was (n, 2) [m], world frame.
        actions, designs, configurations: what was done and chosen, at each sample; names separated by ", ".
        signals: what was measured (n,) by name and unit; NaN where there was nothing.
        limits: labels of the thresholds by attribute and value.
        adaptations, disturbances: as in the result, in order of time.
        planned: the first task plan, if any was made, as an entry of the list of adaptations.
        completed: the actions that ended well, each with when that was [s].
    """

    end: float
    times: Array
    xy: Array
    actions: list[str]
    designs: list[str]
    configurations: list[str]
    signals: dict[str, Array]
    limits: dict[str, dict[float, list[str]]]
    adaptations: Events
    disturbances: Events
    completed: list[tuple[str, float]]
    planned: Events = ()

    @property
    def hues(self) -> dict[str, str]:
        return {name: HUES[index % len(HUES)] for index, name in enumerate(listed(self.actions))}

    def spans(self, column: Sequence[str]) -> Iterator[tuple[str, float, float]]:
        """Yield each name of a column with each span in which it stands there [s]."""
        edges = [*self.times, self.end]
        for names, held in _runs(column):
            yield from ((name, edges[held[0]], edges[held[-1] + 1]) for name in listed([names]))

    def where(self, time: float) -> Array:
        """Return where the robot was at a time [s]: (2,) [m]."""
        return np.array([np.interp(time, self.times, column) for column in self.xy.T])

    @property
    def legs(self) -> list[Leg]:
        """The parts of the way for which something was chosen."""
        chosen = [", ".join(filter(None, both)) for both in zip(self.designs, self.configurations, strict=True)]
        parts = _runs(list(zip(self.actions, chosen, strict=True)))
        return [Leg(action, choice, self.xy[held]) for (action, choice), held in parts if action and choice]


def timeline_of(run: MissionRun, data: Mapping[str, Any]) -> RunTimeline:
    """Return the timeline of a finished run; data is what `views.output.summary` returned for it."""
    samples = [sample for sample, _ in run.trace]
    seen = [one for _, one in run.trace]
    actions = [one.action for one in seen]
    signals = dict.fromkeys(name for sample in samples for name in sample.signals)
    model = run.model
    return RunTimeline(
        max(float(data["duration_s"]), 1e-3),
        np.array([sample.time for sample in samples], dtype=float),
        np.array([sample.position[:2] for sample in samples], dtype=float).reshape(-1, 2),
        actions,
        [one.designs for one in seen],
        _telling([one.configured for one in seen], actions, model),
        {name: np.array([sample.signals.get(name, np.nan) for sample in samples], dtype=float) for name in signals},
        _limits(model),
        data["adaptations"],
        sorted([*data["disturbances"], *_failures(run, data["disturbances"])], key=lambda one: float(one["at_s"])),
        [(one["name"], one["end_s"]) for one in data["actions"] if one["result"] == "completed"],
        [_first_plan(one) for one in data["plans"][:1]],
    )


def _failures(run: MissionRun, disturbances: Events) -> Iterator[Mapping[str, Any]]:
    """Yield the failures of components that were reported, but for those that a disturbance just before stands for."""
    for event in run.controller.kb.log.since(0) if run.controller.kb else ():
        times = (event.time - one["at_s"] for one in disturbances)
        if event.verb == "component_failed" and not any(0 <= since <= REPORTED_S for since in times):
            yield {"at_s": event.time, "what": event.text}


def _first_plan(plan: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a plan as an entry of the list of adaptations, how it was found in place of how soon it was in force."""
    steps, more = plan["steps"][:STEPS], len(plan["steps"]) - STEPS
    change = ", then ".join([*steps, *([f"{more} more"] if more > 0 else [])]) or "none"
    entry = {"at_s": plan["at_s"], "kind": "plan", "trigger": "first plan", "reason": plan["reason"]}
    return {**entry, "change": change, "found": f"{plan['outcome']}, {plan['engine']}"}


def listed(column: Iterable[str]) -> list[str]:
    """Return the names in a column, in the order in which they appear."""
    return list(dict.fromkeys(name for names in column for name in names.split(", ") if name))


def bare(signal: str) -> str:
    return signal.split(" [")[0]


def brief(text: str, most: int = 26) -> str:
    """Return a text as a picture has room for it, with signs instead of ASCII."""
    short = text.replace(" = ", "\u00a0=\u00a0").replace("->", "→").replace(">=", "≥").replace("<=", "≤")
    return short if len(short) <= most else f"{short[: most - 1]}…"


def panels_of(timeline: RunTimeline) -> dict[str, list[str]]:
    """Return the signals worth a panel, each with those that share it since their names end with its name."""
    worth = [
        name
        for name, values in timeline.signals.items()
        if np.isfinite(values).any() and (np.nanmin(values) < np.nanmax(values) or bare(name) in timeline.limits)
    ]
    hosts = {name: next((host for host in worth if name.endswith(f" {host}")), name) for name in worth}
    return {host: [name for name in worth if hosts[name] == host != name] for host in worth if hosts[host] == host}


def _runs(column: Sequence[Any]) -> Iterator[tuple[Any, list[int]]]:
    for value, group in groupby(range(len(column)), key=lambda index: column[index]):
        yield value, list(group)


def _limits(model: Model) -> dict[str, dict[float, list[str]]]:
    limits: dict[str, dict[float, list[str]]] = {}
    for one in model.constraints:
        labels = limits.setdefault(one.attribute.replace("_", " "), {}).setdefault(one.value, [])
        labels += [f"{brief(one.operator)} {one.value:g}  {brief(each.name)}" for each in one.constrained]
    return limits


def _telling(column: list[str], actions: Sequence[str], model: Model) -> list[str]:
    """Leave out the configurations of a component that has one for each action: they say no more than the action."""
    components = {name: one.component for name, one in model.configurations.items()}
    met: dict[str, Counter[tuple[str, str]]] = {}
    for names, action in zip(column, actions, strict=True):
        for name in listed([names]):
            met.setdefault(components.get(name, name), Counter())[name, action] += 1
    dull = {component for component, pairs in met.items() if _is_one_to_one(pairs)}
    return [", ".join(one for one in listed([names]) if components.get(one, one) not in dull) for names in column]


def _is_one_to_one(pairs: Counter[tuple[str, str]]) -> bool:
    most = {name: action for (name, action), _ in reversed(pairs.most_common())}
    strays = sum(count for (name, action), count in pairs.items() if most[name] != action)
    return len(most) > 1 and len(set(most.values())) == len(most) and strays <= STRAY * pairs.total()
