"""fleet: the logs of many units -> the numbers of the sensor model, and odd units."""

from imucal.fleet.population import Population, population
from imucal.fleet.values import LogValue, log_values

__all__ = ["LogValue", "Population", "log_values", "population"]
