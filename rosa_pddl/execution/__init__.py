"""Carrying plans out: what is believed and wanted, when to plan anew, what runs; `PlanExecutor` puts it together."""
