"""A campaign from beginning to end: what is still to be done is done, each run is kept as soon as it is known."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from missions.campaign.plan import Campaign
from missions.campaign.store import Store, read_store
from missions.campaign.tables import write_tables
from missions.campaign.work import CRASHED
from missions.campaign.workers import Workers, outcomes

__all__ = ["Teller", "conduct", "modules_needed"]


class Teller(Protocol):
    """Who is told of a campaign while it runs."""

    def begin(self, done: int, total: int) -> None:
        """Hear how many runs are done already, of how many."""

    def done(self, record: Mapping[str, Any]) -> None:
        """Hear what came of a run."""

    def note(self, text: str) -> None:
        """Hear of what keeps the runs from being done."""


def conduct(store: Store, folder: Path, workers: Workers, *, retry: bool, teller: Teller) -> list[Path]:
    """Do every run of a campaign that is not done yet, then write the tables.

    Args:
        store: the folder of the campaign, held.
        folder: the same, to be read.
        workers: who does the runs.
        retry: whether runs that crashed are done again.
        teller: hears of each run.

    Returns:
        The tables that were written.

    Raises:
        MissionError: the folder cannot be written, or the workers are out of reach.
    """
    planned = store.campaign.planned()
    before = read_store(folder).records
    done = {name for name, record in before.items() if not (retry and record["outcome"] == CRASHED)}
    left = sorted((run for run in planned if run.name not in done), key=lambda run: run.seed)
    teller.begin(len(done), len(planned))
    for outcome in outcomes(left, workers, teller.note):
        store.keep(outcome)
        teller.done(outcome.record)
    return write_tables(read_store(folder), folder)


def modules_needed(campaign: Campaign) -> tuple[str, ...]:
    """Return the modules of missions and managers of one's own."""
    names = (name.partition(":") for name in (*campaign.missions, *campaign.managers))
    return tuple(dict.fromkeys(module for module, colon, _ in names if colon))
