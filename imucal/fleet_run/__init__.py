"""fleet_run: the logs of a fleet -> its store; planning, the work on one log, and who hands the work out."""

from imucal.fleet_run.fleet_call import run_fleet
from imucal.fleet_run.plan import REPORTS, FleetPlan, FleetSettings, LogDone, LogTask, plan_fleet

__all__ = ["REPORTS", "FleetPlan", "FleetSettings", "LogDone", "LogTask", "plan_fleet", "run_fleet"]
