"""fleet_run: the logs of a fleet -> its store; planning, the work on one log, and its distribution."""

from imucal.fleet_run.plan import FleetPlan, FleetSettings, LogTask, fleet_settings, planned
from imucal.fleet_run.running import prepare, run_fleet

__all__ = ["FleetPlan", "FleetSettings", "LogTask", "fleet_settings", "planned", "prepare", "run_fleet"]
