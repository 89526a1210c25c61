"""fleet_run: the logs of a fleet -> its store; planning, the work on one log, and who hands the work out."""

from imucal.fleet_run.fleet_call import fleet_settings, planned, prepare, run_fleet
from imucal.fleet_run.plan import FleetPlan, FleetSettings, LogTask

__all__ = ["FleetPlan", "FleetSettings", "LogTask", "fleet_settings", "planned", "prepare", "run_fleet"]
