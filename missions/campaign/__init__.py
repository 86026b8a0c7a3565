"""Campaigns: many runs over missions, managers, settings and seeds, and the report on them."""

from missions.campaign.conduct import Teller, conduct
from missions.campaign.plan import Campaign, PlannedRun, check_campaign, paper_table, read_campaign
from missions.campaign.store import Kept, Store, read_store
from missions.campaign.workers import Cluster, Processes

__all__ = [
    "Campaign",
    "Cluster",
    "Kept",
    "PlannedRun",
    "Processes",
    "Store",
    "Teller",
    "check_campaign",
    "conduct",
    "paper_table",
    "read_campaign",
    "read_store",
]
