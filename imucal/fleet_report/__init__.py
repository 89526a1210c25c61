"""fleet_report: the store of a fleet -> what each sensor model is like, and its pictures, page and files."""

from imucal.fleet_report.fleet_files import write_fleet
from imucal.fleet_report.loading import load_fleet
from imucal.fleet_report.summary import Fleet, FleetLog, FleetTerm, SensorModel

__all__ = ["Fleet", "FleetLog", "FleetTerm", "SensorModel", "load_fleet", "write_fleet"]
