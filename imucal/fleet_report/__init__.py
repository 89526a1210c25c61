"""fleet_report: the store of a fleet -> what each sensor model is like, and its pictures, page and files."""

from imucal.fleet_report.as_report import check_fleet, fleet_as_report
from imucal.fleet_report.files import write_fleet
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel, load_fleet

__all__ = ["Fleet", "FleetTerm", "SensorModel", "check_fleet", "fleet_as_report", "load_fleet", "write_fleet"]
